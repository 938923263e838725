"""Does an organ come out of a bad surface, and does it bear the spatula? Twenty-three surfaces, inspected step by step.

Each surface is prepared as `spatula organ prepare` does, or has to be refused: the presets' organs; an ellipsoid as a
staircase of voxels, with slivers, as triangles without shared vertices, inverted, half inverted, with holes, a fin,
islands, and a cavity; a sphere of 40,962 vertices; a torus; both hemispheres of fsaverage5 and the white matter of the
MNI 152 template, thresholded, where nilearn is installed; and a sheet, wrong units, an organ of 60 um, points without
triangles, and an empty file. `benchmarks.surfaces` makes them.

A prepared organ is held at its lowest 18 % (brains: 35 %) and pressed by the spatula of Press, 20 x 20 x 2.5 mm, 10 mm
deep along the normal, at 0.05, 0.5 and 4 m/s; it stays there for a quarter of a second. The place is that which bears
the deepest press, and of those nearly as deep the nearest to the workspace's middle. Limits:

    reported    residual that the contact model reports: 1 % of the organ's radius, half of its smallest extent
    depth       exact depth of spatula in organ or organ in spatula, by `benchmarks.inspection`: likewise
    missed      steps in which a contact node was deeper than 0.01 u, or the spatula's middle inside, without a flag: 0
    inside      steps in which the spatula's middle, or a column through it, was inside, or surface had gone through: 0
    crossed     steps in which the organ went through itself: no more than 0.1 s in a row
    diverged    presses that ended before their time, or had numbers that are not finite: 0

"shaking", without a limit, is the root mean square speed of the organ's nodes at the end of a press, the greatest of
the three. Tissue shakes where a step is too long for its stiffness and its edges, of which the scene warns.

With `--experts` the scripted expert of Press plays 32 episodes on five of the organs, of which 90 % must succeed, and
the pretrained policy, which has seen nothing but the sphere, as many: a number, whatever it is. Tissue needs Netgen
(the extra `tissue`), which makes the tetrahedra.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.measure import finish, load_average, output_file, parser
from benchmarks.presses import SPEEDS, Press, Pressed, press_organ
from benchmarks.surfaces import Source, sources
from spatula_env.geometry.prepared import write_prepared
from spatula_env.sim.report import LONGEST_CROSSED

if TYPE_CHECKING:
    from spatula_env.geometry import PreparedOrgan

ENGINES = ("batch", "tissue")

RESIDUAL_LIMIT = 0.01
"""Greatest depth, as a part of the organ's radius."""

EXPERT_LIMIT = 0.9
"""Least rate of success of the expert."""

PLAYED = ("preset seed", "staircase", "torus", "fine sphere", "left pial", "fin", "preset fissure")
"""Surfaces on which policies play; the first five that were prepared."""

MOST_PLAYED, EPISODES = 5, 32

ENV_ID = "Spatula/Press-v0"


@dataclass(frozen=True)
class Prepared:
    """What became of a surface.

    Attributes:
        name: Its name.
        source: Where it came from, and what ought to become of it.
        triangles: Number of triangles before, as read or as marching cubes gave them; 0 if it was refused.
        nodes: Number of nodes after; 0 if it was refused.
        seconds: CPU time of the preparation, tetrahedra included [s].
        reason: Why it was refused; "" if it was not.
        organ: The organ, held; None if it was refused.
        changes: What the preparation changed.
    """

    name: str
    source: Source
    triangles: int = 0
    nodes: int = 0
    seconds: float = 0.0
    reason: str = ""
    organ: PreparedOrgan | None = None
    changes: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether it was prepared, or refused for the right reason, as it ought to be."""
        if self.source.refusal:
            return self.organ is None and self.source.refusal in self.reason
        return self.organ is not None

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "surface": self.name,
            "triangles": self.triangles,
            "nodes": self.nodes,
            "seconds": self.seconds,
            "outcome": "refused" if self.organ is None else "prepared",
            "reason": self.reason,
            "changes": list(self.changes),
            "passed": self.passed,
        }


def prepare(name: str, source: Source, folder: Path) -> Prepared | None:
    """Prepare a surface, or have it refused; None if its origin is not installed."""
    from spatula_env.anatomy import PrepareOptions, prepare_organ

    file = source.write(folder)
    if file is None:
        return None
    options = PrepareOptions(units=source.units, nodes=source.nodes, **source.options)
    start = time.process_time()
    try:
        organ, report, _ = prepare_organ(file, options)
    except ValueError as error:
        return Prepared(name, source, seconds=time.process_time() - start, reason=str(error))
    seconds = time.process_time() - start
    heights = organ.vertices[:, 2] - organ.vertices[:, 2].min()
    held = np.flatnonzero(heights <= source.held * heights.max())
    organ = replace(organ, name=name, held=tuple(held.tolist()))
    return Prepared(name, source, report.read[1], report.result["nodes"], seconds, "", organ, report.changes)


def find_faults(pressed: Pressed, dt: float = 1.0 / 240.0) -> list[str]:
    """What of the presses with an engine is beyond its limit, in words."""
    faults = [pressed.failure] if pressed.failure else []
    for press in pressed.presses:
        found = {
            "reported residual": press.reported > RESIDUAL_LIMIT * pressed.radius,
            "depth": press.depth > RESIDUAL_LIMIT * pressed.radius,
            "missed": press.missed > 0,
            "inside": press.inside > 0,
            "crossed": press.longest_crossed * dt > LONGEST_CROSSED,
            f"diverged ({press.diverged})": bool(press.diverged),
            "no contact": press.touching == 0,
        }
        faults += [f"{name} at {press.speed:g} m/s" for name, is_so in found.items() if is_so]
    return faults


def describe_prepared(rows: Sequence[Prepared]) -> str:
    """Table of the preparation."""
    lines = [
        "| Surface | Triangles before | Nodes after | CPU time [s] | Outcome |",
        "| --- | ---: | ---: | ---: | --- |",
    ]
    for row in rows:
        outcome = "prepared" if row.organ is not None else f"refused: {row.reason}"
        counts = (f"{row.triangles:,}", f"{row.nodes:,}") if row.organ is not None else ("", "")
        wrong = "" if row.passed else " **(ought not to be)**"
        lines.append(f"| {row.name} | {counts[0]} | {counts[1]} | {row.seconds:.1f} | {outcome}{wrong} |")
    return "\n".join(lines)


def describe_presses(table: dict[str, dict[str, Pressed]], speeds: Sequence[float] = SPEEDS) -> str:
    """Table of the presses: residual and depth at each speed, and counts of all speeds together, with their limits."""
    limit = f"{100.0 * RESIDUAL_LIMIT:g}"
    columns = [f"{speed:g} m/s: reported, depth [%] (≤ {limit})" for speed in speeds]
    head = [
        "Surface",
        "Engine",
        "Radius [u]",
        *columns,
        "Missed (0)",
        "Inside (0)",
        "Crossed",
        "Diverged (0)",
        "Shaking [m/s]",
    ]
    lines = [f"| {' | '.join(head)} |", "| --- | --- |" + " ---: |" * (len(head) - 2)]
    for name, engines in table.items():
        for engine, pressed in engines.items():
            if not pressed.presses:
                why = pressed.failure or f"no place: {_why(pressed.places)}"
                lines.append(f"| {name} | {engine} | {_number(pressed.radius)} | {why} |" + " |" * (len(head) - 4))
                continue
            cells = [_cell(press, pressed.radius) for press in pressed.presses]
            totals = [
                str(sum(getattr(press, count) for press in pressed.presses))
                for count in ("missed", "inside", "crossed")
            ]
            totals += [str(sum(bool(press.diverged) for press in pressed.presses))]
            totals += [f"{max(press.shaking for press in pressed.presses):.3f}"]
            lines.append(f"| {' | '.join([name, engine, _number(pressed.radius), *cells, *totals])} |")
    return "\n".join(lines)


def _cell(press: Press, radius: float) -> str:
    return f"{100.0 * press.reported / radius:.2f}, {100.0 * press.depth / radius:.2f}"


def _number(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.2f}"


def _why(told: str) -> str:
    """The reasons alone."""
    return re.sub(r"^organ .* has 0 places that the tool reaches: ", "", told)


def describe_policies(rows: Sequence[dict[str, Any]]) -> str:
    """Table of the policies."""
    lines = [
        "| Surface | Engine | Policy | Success | Within the budget | Steps |",
        "| --- | --- | --- | ---: | ---: | ---: |",
    ]
    for row in rows:
        head = f"| {row['surface']} | {row['engine']} | {row['policy']} |"
        if row["failure"]:
            lines.append(f"{head} {row['failure']} | | |")
        else:
            lines.append(f"{head} {row['success_rate']:.0%} | {row['safe_success_rate']:.0%} | {row['steps']:.0f} |")
    return "\n".join(lines)


def play(name: str, file: Path, engine: str, policy: str, episodes: int = EPISODES) -> dict[str, Any]:
    """Let a policy press an organ in some episodes; what became of it.

    Args:
        name: Name of the surface.
        file: File of the organ.
        engine: "batch" or "tissue".
        policy: "expert" or "pretrained"; see `learning.finding.find_policy`.
        episodes: How many.
    """
    from spatula_env.learning.evaluation import Plan, evaluate, summarize
    from spatula_env.learning.finding import find_policy

    row: dict[str, Any] = {"surface": name, "engine": engine, "policy": policy, "failure": ""}
    source = find_policy(policy, ENV_ID)
    kwargs = {**source.kwargs, "organ": str(file), "max_episode_steps": 200}
    try:
        found, _ = evaluate(source, Plan(ENV_ID, kwargs, engine, episodes, seed=0))
    except (ImportError, ValueError) as error:
        return {**row, "failure": str(error), "passed": False}
    summary = summarize(found)
    good = policy != "expert" or summary["success_rate"] >= EXPERT_LIMIT
    return {**row, **summary, "passed": bool(good and not summary["diverged"])}


class _Progress:
    """A sign of progress on standard error."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    def __call__(self, text: str) -> None:
        print(f"{time.perf_counter() - self._start:5.0f} s  {text}", file=sys.stderr, flush=True)


def measure(
    names: Sequence[str], engines: Sequence[str], folder: Path, tell: Any = lambda _: None
) -> tuple[list[Prepared], dict[str, dict[str, Pressed]]]:
    """Prepare surfaces and press the organs.

    Args:
        names: Names of the surfaces.
        engines: Engines to press with.
        folder: Folder for the surfaces' files; organs are written there too, each as NAME.npz.
        tell: Called with a line before each step.

    Returns:
        What became of each surface, and the presses by surface and engine.
    """
    rows: list[Prepared] = []
    table: dict[str, dict[str, Pressed]] = {}
    known = sources()
    for name in names:
        tell(f"{name}: preparing")
        row = prepare(name, known[name], folder)
        if row is None:
            print(f"{name} is left out: nilearn, which has it, is not installed", file=sys.stderr)
            continue
        rows.append(row)
        if row.organ is None:
            tell(f"{name}: refused")
            continue
        write_prepared(folder / f"{name}.npz", row.organ)
        table[name] = {}
        for engine in engines:
            tell(f"{name}: pressing, {engine}")
            table[name][engine] = press_organ(row.organ, engine)
    return rows, table


def _play_all(
    rows: Sequence[Prepared], engines: Sequence[str], folder: Path, episodes: int, tell: Any
) -> list[dict[str, Any]]:
    chosen = [name for name in PLAYED if any(row.name == name and row.organ is not None for row in rows)]
    found = []
    for name in chosen[:MOST_PLAYED]:
        for engine in engines:
            for policy in ("expert", "pretrained"):
                tell(f"{name}: {policy}, {engine}")
                found.append(play(name, folder / f"{name}.npz", engine, policy, episodes))
    return found


def _usable(engines: Sequence[str]) -> list[str]:
    """The engines without tissue, with a message, if nothing makes tetrahedra."""
    if "tissue" not in engines or find_spec("netgen") is not None:
        return list(engines)
    print("Netgen (the extra tissue) is not installed: 'tissue' is left out", file=sys.stderr)
    return [engine for engine in engines if engine != "tissue"]


def main() -> None:
    """Prepare, press, print, and end with status 1 if something is beyond its limit."""
    options = parser(__doc__ or "")
    names = list(sources())
    options.add_argument("--surfaces", nargs="+", choices=names, default=names, metavar="NAME", help=", ".join(names))
    options.add_argument("--engines", nargs="+", choices=ENGINES, default=list(ENGINES))
    options.add_argument("--picture", type=output_file, help="draw the pressed organs into this file")
    options.add_argument("--experts", action="store_true", help="let the expert and the pretrained policy play")
    options.add_argument("--episodes", type=int, default=EPISODES, help="with --experts: episodes of each")
    arguments = options.parse_args()
    if arguments.episodes < 1:
        options.error(f"--episodes must be at least 1, got {arguments.episodes}")
    if arguments.picture is not None:
        from benchmarks import pictures

        pictures.require_matplotlib()
    with tempfile.TemporaryDirectory() as folder:
        passed = _run(arguments, Path(folder))
    sys.exit(0 if passed else 1)


def _run(arguments: argparse.Namespace, folder: Path) -> bool:
    """Measure and print; whether nothing is beyond its limit."""
    start, tell, engines = time.perf_counter(), _Progress(), _usable(arguments.engines)
    rows, table = measure(arguments.surfaces, engines, folder, tell)
    policies = _play_all(rows, engines, folder, arguments.episodes, tell) if arguments.experts else []
    faults = {
        f"{name}, {engine}": found
        for name, by_engine in table.items()
        for engine, pressed in by_engine.items()
        if (found := find_faults(pressed))
    }
    passed = all(row.passed for row in rows) and not faults and all(row["passed"] for row in policies)
    if not arguments.json:
        print(describe_prepared(rows), describe_presses(table), sep="\n\n")
        if policies:
            print("", describe_policies(policies), sep="\n")
        for where, found in faults.items():
            print(f"beyond the limit: {where}: {', '.join(found)}")
        for row in rows:
            if not row.passed:
                print(f"beyond the limit: {row.name} ought to be {'refused' if row.source.refusal else 'prepared'}")
        for each in policies:
            if not each["passed"]:
                print(f"beyond the limit: {each['surface']}, {each['engine']}: {each['policy']}")
    if arguments.picture is not None and table:
        from benchmarks import organ_pictures

        organ_pictures.draw_pressed(table, arguments.picture)
    finish(
        {
            "benchmark": "organs",
            "passed": passed,
            "limits": {"residual": RESIDUAL_LIMIT, "expert": EXPERT_LIMIT, "crossed": LONGEST_CROSSED},
            "surfaces": [row.as_dict() for row in rows],
            "presses": {name: {e: pressed.as_dict() for e, pressed in found.items()} for name, found in table.items()},
            "faults": faults,
            "policies": policies,
            "load": load_average(),
            "seconds": time.perf_counter() - start,
        }
    )
    return passed


if __name__ == "__main__":
    main()
