"""Draws the curves of growth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.pictures import LINES, new_figure

PANELS = (
    ("worlds", "worlds", ("step of all worlds", "reset of one world")),
    ("nodes and tools", "nodes, or tools", ("step, organ's nodes", "step, tool's nodes", "step, tools")),
    ("pictures", "pixels", ("picture",)),
    ("datasets", "episodes", ("appended", "merged", "opened", "summarized")),
)
"""Panels: title, label of the horizontal axis, and names of the curves."""

SECONDS = {"us": 1e-6, "s": 1.0}


def draw(result: Mapping[str, Any], path: Path) -> None:
    """Draw cost over size, both on logarithmic scales, with the exponent of each curve.

    Args:
        result: Results of the benchmark.
        path: File to write; its suffix determines the format.

    Raises:
        ImportError: If Matplotlib is not installed.
    """
    figure = new_figure(10.0, 7.5)
    curves = dict(_curves(result))
    for panel, (title, along, names) in zip(figure.subplots(2, 2).flat, PANELS, strict=True):
        for name, (colour, marker, dash) in zip(names, LINES, strict=False):
            if name not in curves:
                continue
            row = curves[name]
            costs = [SECONDS[row["unit"]] * cost for cost in row["costs"]]
            panel.plot(
                row["sizes"], costs, color=colour, marker=marker, linestyle=dash, markerfacecolor="none",
                label=f"{name}: exponent {row['exponent']:.2f}",
            )  # fmt: skip
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_title(title, fontsize=10)
        panel.set_xlabel(along)
        panel.set_ylabel("time [s]")
        panel.grid(color="0.92")
        panel.set_axisbelow(True)
        if panel.lines:
            low, high = panel.get_ylim()
            # At least three decades, so that a flat curve looks flat.
            middle = (low * high) ** 0.5
            panel.set_ylim(min(low, middle / 30.0), max(high, middle * 30.0))
            panel.legend(frameon=False, fontsize=8)
    figure.suptitle("Growth of what users do: an exponent of 1 is in proportion, of 2 quadratic", fontsize=11)
    figure.savefig(path)


def _curves(value: Any) -> list[tuple[str, Mapping[str, Any]]]:
    """All curves in the figures, by name."""
    found: list[tuple[str, Mapping[str, Any]]] = []
    if isinstance(value, Mapping):
        for name, each in value.items():
            if isinstance(each, Mapping) and "exponent" in each:
                found.append((name, each))
            else:
                found += _curves(each)
    return found
