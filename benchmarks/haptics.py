"""Is the haptic loop faithful, stable and on time? Emulated Falcon, USB packets, driver, loop and simulation together.

*holds* and *scenarios*, in simulated time: three model hands, with and without tremor, hold the tool at several depths,
rest, press, tap, slide, let go, and meet a simulation that stops or is slow (`haptics_scenarios`). The device is either
ideal, motors alone, or has weight, friction and compliant links. Measured are the ratio of shown to true force, the
greatest change of force in a millisecond, the energy given to the hand, limit cycles and delays; the worst value of
each is compared with its limit (`haptics_matrix`). 792 runs, 3.6 hours of simulated time: about 40 minutes on two
cores.

*stiffness*: the greatest stable stiffness of an organ, by hand, rate and delay (`haptics_stiffness`).

*signals*, in real time: how long it takes after a signal to the program, its process group or the loop's process until
the motors get zeros (`haptics_signals`).

*period*, in real time: how regular the loop's period is, in a process of its own and in a thread beside the simulation
(`haptics_period`). Needs a machine that does nothing else::

    python -m benchmarks.haptics --file haptics.jsonl
    python -m benchmarks.haptics --parts period --seconds 60
    python -m benchmarks.haptics --parts holds scenarios --hands nominal --scales 1 --mechanisms off
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import measure
from benchmarks.haptics_closed_loop import HANDS
from benchmarks.haptics_matrix import check, describe, lightest, make_cells, run_cells
from benchmarks.haptics_period import FORCE_SCALES, press, step_response
from benchmarks.haptics_signals import measure_signals
from benchmarks.haptics_stiffness import table
from benchmarks.parallel import available_cores
from spatula_env.engines import ENGINES

PARTS = ("holds", "scenarios", "stiffness", "signals", "period")
"""The parts of the benchmark."""
MECHANISMS = {"off": False, "on": True}
"""Whether the emulated device has weight, friction and compliant links."""


def main() -> None:
    """Measure and print."""
    options = measure.parser(__doc__ or "")
    options.add_argument(
        "--parts", choices=PARTS, nargs="*", default=list(PARTS), help="what to measure (default: all of it)"
    )
    options.add_argument("--hands", choices=tuple(HANDS), nargs="*", default=list(HANDS), help="default: all three")
    options.add_argument(
        "--scales",
        type=float,
        nargs="*",
        default=[1.0, 3.0, 5.0],
        help="of forces on the hand; default: 1 3 5",
    )
    options.add_argument(
        "--mechanisms",
        choices=tuple(MECHANISMS),
        nargs="*",
        default=list(MECHANISMS),
        help="whether the emulated device has weight, friction and bending links; default: both",
    )
    options.add_argument("--engine", choices=ENGINES, default="batch", help="of the simulation; default: %(default)s")
    options.add_argument("--hold-seconds", type=float, default=30.0, help="length of a hold; default: %(default)s")
    options.add_argument("--workers", type=int, default=available_cores(), help="processes; default: all cores")
    options.add_argument(
        "--file",
        type=Path,
        help="keep every run in simulated time here as soon as it is over, and take from here what is there already",
    )
    options.add_argument(
        "--seconds", type=float, default=60.0, help="length of a run in real time; default: %(default)s"
    )
    options.add_argument(
        "--where",
        choices=("process", "thread"),
        nargs="*",
        default=["process", "thread"],
        help="for period",
    )
    chosen = options.parse_args()
    if chosen.workers < 1:
        options.error(f"--workers must be 1 or more, got {chosen.workers}")
    result: dict[str, Any] = {}
    # Parts in real time come first, before worker processes load the machine.
    if "period" in chosen.parts:
        result["runs"] = [press(where, scale, chosen.seconds) for where in chosen.where for scale in FORCE_SCALES]
        result["step"] = step_response()
        if not chosen.json:
            _print_period(result["runs"], result["step"])
    if "signals" in chosen.parts:
        result["signals_ms"] = measure_signals()
        if not chosen.json:
            _print_cell(result["signals_ms"])
    if "stiffness" in chosen.parts:
        result["greatest_stiffness_n_per_m"] = table(chosen.hands)
        if not chosen.json:
            for hand, found in result["greatest_stiffness_n_per_m"].items():
                _print_cell({"hand": hand, **found})
    cells = make_cells(
        chosen.parts,
        chosen.hands,
        chosen.scales,
        [MECHANISMS[name] for name in chosen.mechanisms],
        chosen.hold_seconds,
        chosen.engine,
    )
    if cells:
        result["cells"] = run_cells(cells, chosen.workers, chosen.file)
        result["checks"] = check(result["cells"])
        result["difference_of_light_touch_mn"] = lightest(result["cells"])
        if not chosen.json:
            print(describe(result["checks"]))
            light = result["difference_of_light_touch_mn"]
            print(f"in windows of a hold with less than 10 mN: at most {light:.2f} mN too much or too little")
    measure.finish({**result, "load": measure.load_average()})


def _print_cell(cell: Mapping[str, Any]) -> None:
    print(
        ", ".join(
            f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}" for name, value in cell.items()
        )
    )


def _print_period(runs: Sequence[Mapping[str, Any]], response: Mapping[str, float]) -> None:
    for run_found in runs:
        print(
            f"{run_found['where']:8} x{run_found['force_scale']:g}: period {run_found['period_p50_ms']:.3f} ms, "
            f"p99 {run_found['period_p99_ms']:.3f}, longest {run_found['period_max_ms']:.1f}; motors gave the hand "
            f"{run_found['energy_into_hand_mj']:.2f} mJ; force on the tool up to {run_found['peak_tool_force_n']:.2f} N"
        )
    print(" ".join(f"{name} {value:.1f}" for name, value in response.items()))


if __name__ == "__main__":
    main()
