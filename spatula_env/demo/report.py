"""The comparison in words and numbers: a table for the terminal, one for a document, and a file of data."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spatula_env import __version__, scenes
from spatula_env.demo.measure import GRID
from spatula_env.demo.press import FINAL_HEIGHT, GAP, SURFACE_STRIDE, WINDOW, PressResult
from spatula_env.demo.verdict import CRITERIA
from spatula_env.engines import bullet_version
from spatula_env.files import write_text

if TYPE_CHECKING:
    from rich.table import Table

FORMAT = 1
"""Of the data file; goes up when a key changes its meaning."""

COLUMNS = (
    ("contact", "left"),
    ("speed\nu/s", "right"),
    ("surface\nmean u", "right"),
    ("surface\nmax u", "right"),
    ("force\nmean N", "right"),
    ("force\ndev. N", "right"),
    ("force\npeak N", "right"),
    ("nodes\nl/u", "right"),
    ("both\nsteps", "right"),
    ("verdict", "left"),
)
"""Headings and alignment of the terminal's table."""

LEGEND = (
    "surface: height of the organ's surface over the spatula's lower face, by vertical rays over its footprint. "
    f"force: upward on the spatula. Both over the last {WINDOW} steps. nodes: contact nodes of the lower and the upper "
    "face flagged at the end (with engines' own contact it is only watched). both: steps in which both nodes of a pair "
    "were flagged."
)
"""What the columns say."""

VERDICT_STYLES = {"contact": "green", "unstable": "yellow", "inside": "red"}


def table_rows(results: Sequence[PressResult]) -> list[tuple[str, ...]]:
    """The cells of the table, one row per result, in the order of `COLUMNS`."""
    return [
        (
            result.case.contact,
            f"{result.case.speed:g}",
            "none" if result.residual_mean is None else f"{result.residual_mean:.3f}",
            "none" if result.residual_max is None else f"{result.residual_max:.4f}",
            f"{result.force_mean:.2f}",
            f"{result.force_deviation:.3f}",
            f"{result.force_peak:.2f}",
            f"{result.lower_nodes}/{result.upper_nodes}",
            f"{result.pairs_steps}",
            result.verdict,
        )
        for result in results
    ]


def terminal_table(results: Sequence[PressResult], width: int = 80) -> Table:
    """The comparison as a table for the terminal, one section per contact model.

    Args:
        results: In the order of the rows.
        width: Of the terminal [characters]; from 80 on all of the table fits.
    """
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1 if width >= 96 else 0))
    for heading, side in COLUMNS:
        table.add_column(heading, justify="right" if side == "right" else "left", no_wrap=True)
    before = None
    for result, row in zip(results, table_rows(results), strict=True):
        if before not in (None, row[0]):
            table.add_section()
        style = VERDICT_STYLES[result.verdict]
        table.add_row("" if before == row[0] else row[0], *row[1:-1], f"[{style}]{row[-1]}[/{style}]")
        before = row[0]
    return table


def markdown_table(results: Sequence[PressResult]) -> str:
    """The comparison as a table in Markdown."""
    headings = (
        "contact",
        "speed [u/s]",
        "surface, mean [u]",
        "surface, max [u]",
        "force, mean [N]",
        "deviation [N]",
        "peak [N]",
        "nodes lower/upper",
        "both [steps]",
        "verdict",
    )
    rules = ["---:" if side == "right" else "---" for _, side in COLUMNS]
    lines = [headings, rules, *table_rows(results)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def as_document(
    results: Sequence[PressResult], episode: dict[str, Any] | None, pictures: Sequence[str]
) -> dict[str, Any]:
    """Everything that was found, as JSON has it.

    Args:
        results: Of the comparison.
        episode: The result of the episode, if there was one.
        pictures: Names of the files beside this one.
    """
    scene = scenes.seed()
    organ, tool = scene.organs[0], scene.tools[0]
    return {
        "format": FORMAT,
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "versions": {
            "spatula_env": __version__,
            "python": platform.python_version(),
            **{name: metadata.version(name) for name in ("gymnasium", "numba", "numpy")},
            **dict(filter(None, [bullet_version()])),
        },
        "platform": platform.platform(),
        "units": {
            "length": "u, scene units",
            "speed": "u/s",
            "time": "s",
            "force_newtons": "N",
            "force_scene_units": "kg u/s2",
        },
        "scene": {
            "name": scene.name,
            "organ_nodes": len(organ.organ.vertices),
            "organ_triangles": len(organ.organ.triangles),
            "organ_mass": organ.mass,
            "tool_size": tool.tool.size.tolist(),
            "tool_nodes": len(tool.tool.nodes),
            "friction": tool.friction,
            "gravity": scene.gravity,
            "dt": scene.dt,
            "metres_per_u": scene.scale.length,
            "kilograms_per_kg": scene.scale.mass,
            "newtons_per_force_unit": scene.scale.force,
        },
        "press": {
            "gap_at_start": GAP,
            "final_height_of_centre": FINAL_HEIGHT,
            "window_steps": WINDOW,
            "surface_every_steps": SURFACE_STRIDE,
            "rays": GRID * GRID,
        },
        "criteria": CRITERIA,
        "results": [result.as_record() for result in results],
        "episode": episode,
        "pictures": list(pictures),
    }


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a document so that the file is either as it was or complete.

    Raises:
        OSError: If it cannot be written.
        ValueError: If a number in it is not finite.
    """
    write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")
