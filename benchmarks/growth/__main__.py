"""How does the cost of what users do grow with size?

Each row is something that users do, measured at several sizes. Its exponent is the power of the size with which the
cost grows, by least squares: 0 for a constant cost, 1 for a proportional one, 2 for a quadratic one.

sizes     A control step of W worlds and a reset of one of them (`gymnasium.make_vec`), over W; a physics step in
          contact, over the organ's nodes, the tool's nodes, and the number of tools; a picture, over its pixels.
          Processor time of one thread.
datasets  A dataset of 10,000 short episodes: appending to it when it is small and when it is large, listing, opening,
          merging, reading it with Minari, and the size of an episode's file relative to its numbers.
killing   Two programs that write into one dataset, one of which is killed at a random moment, again and again.
left      Environments, 200 for each engine and ending, closed or only dropped: memory, PyBullet clients, file
          descriptors, threads and temporary files that they leave behind.
long      Memory over 1,000,000 steps of the batch engine's environments and 100,000 of Bullet's. Takes an hour, and
          runs only on request.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.growth import sizes as sizes_part
from benchmarks.growth.judging import judge
from benchmarks.growth.memory import ENVIRONMENTS, measure_left, measure_long
from benchmarks.growth.picture import draw
from benchmarks.growth.sizes import QUICK, Sizes
from benchmarks.measure import finish, installed, load_average, parser
from spatula_env.engines import ENGINES, OF_EXTRAS

PARTS = ("sizes", "datasets", "killing", "left", "long")
USUAL = ("sizes", "datasets", "killing", "left")
SIZES: dict[str, Callable[[Sizes], dict[str, Any]]] = {
    "worlds": sizes_part.measure_worlds,
    "nodes": sizes_part.measure_nodes,
    "tools": sizes_part.measure_tools,
    "pictures": sizes_part.measure_pictures,
}
QUICK_MILESTONES = (30, 100, 300)
KILLS, QUICK_KILLS = 50, 3
QUICK_ENVIRONMENTS = 40
QUICK_SHARE = 0.01


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print and draw; returns the exit status."""
    options, usual = parser(__doc__ or ""), [each for each in ENGINES if each not in OF_EXTRAS]
    options.add_argument("--parts", nargs="+", choices=PARTS, default=list(USUAL), help="default: %(default)s")
    options.add_argument("--of-sizes", nargs="+", choices=tuple(SIZES), default=list(SIZES), help="what of `sizes`")
    options.add_argument("--engines", nargs="+", choices=ENGINES, default=usual, help="of `left` and `long`")
    options.add_argument("--quick", action="store_true", help="few and small sizes, in a few minutes")
    options.add_argument("--picture", type=Path, metavar="FILE", help="draw the curves")
    chosen = options.parse_args(arguments)
    start = time.perf_counter()
    result: dict[str, Any] = {"benchmark": "growth", "quick": chosen.quick, "parts": chosen.parts}
    engines = installed(chosen.engines)
    for part in chosen.parts:
        result[part] = _measure(part, chosen.quick, chosen.of_sizes, engines)
    thresholds = judge(result)
    result |= {"thresholds": thresholds, "passed": all(row["passed"] for row in thresholds.values())}
    if not chosen.json:
        _show(thresholds)
    if chosen.picture is not None:
        draw(result, chosen.picture)
    finish({**result, "load": load_average(), "seconds": time.perf_counter() - start})
    return 0 if result["passed"] else 1


def _measure(part: str, quick: bool, of_sizes: Sequence[str], engines: list[str]) -> dict[str, Any]:
    if part == "sizes":
        return sizes_part.measure_sizes(QUICK if quick else Sizes(), {name: SIZES[name] for name in of_sizes})
    if part == "left":
        return measure_left(engines, QUICK_ENVIRONMENTS if quick else ENVIRONMENTS)
    if part == "long":
        return measure_long(engines, QUICK_SHARE if quick else 1.0)
    # The other parts need Minari.
    if part == "killing":
        from benchmarks.growth.killing import measure_killing

        return measure_killing(QUICK_KILLS if quick else KILLS)
    from benchmarks.growth.datasets import COMPARED, MILESTONES, measure_datasets

    with tempfile.TemporaryDirectory() as folder:
        if quick:
            return measure_datasets(Path(folder), QUICK_MILESTONES, 30)
        return measure_datasets(Path(folder), MILESTONES, COMPARED)


def _show(thresholds: dict[str, dict[str, Any]]) -> None:
    for name, row in thresholds.items():
        verdict = "passed" if row["passed"] else "FAILED"
        print(f"{name:45} {row['value']:10.3f}  at most {row['limit']:8.3f}  {verdict}")


if __name__ == "__main__":
    sys.exit(main())
