"""The haptic loop, from the hand to the hand: emulated Falcon, USB packets, driver, loop, simulation.

*holds* and *scenarios*, in simulated time: three hands, steady and with a tremor, hold the tool at depths, rest, press,
tap, slide, are released, and meet a simulation that stops or is slow (`haptics_scenarios`). Measured are shown over
true force, the greatest change in a millisecond, energy given to the hand, limit cycles, times. Hours on one core.

*stiffness*: the greatest that is stable, by hand, rate and delay (`haptics_stiffness`).

*signals*, in real time: how long after each signal to the program, its group and the loop zeros come to the motors
(`haptics_signals`).

*period*, in real time: a simulated hand presses the spatula into the organ and draws it back, again and again. Measured
are the loop's period, how the force follows a step, how long it lasts after the simulation has stopped, and the energy
that the motors have put into the hand. The loop runs in a process of its own, and for comparison in a thread beside the
simulation::

    python -m benchmarks.haptics --parts period --seconds 60
    python -m benchmarks.haptics --parts holds scenarios --hands nominal --scales 1
"""

from __future__ import annotations

import math
import multiprocessing
import os
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

import gymnasium
import numpy as np

import spatula_env
from benchmarks import measure
from benchmarks.haptics_closed_loop import HANDS, TOUCHES
from benchmarks.haptics_scenarios import SCENARIOS, Cell, run
from benchmarks.haptics_signals import measure_signals
from benchmarks.haptics_stiffness import table
from spatula_env.teleop.device import TeleopDevice
from spatula_env.teleop.emulator import ElasticHand, GuidedHand, RealClock
from spatula_env.teleop.falcon.frames import position_to_falcon
from spatula_env.teleop.haptics import HapticDevice, HapticSettings
from spatula_env.teleop.haptics.device import Where
from spatula_env.teleop.scripted import EmulatedFalcon
from spatula_env.teleop.wrapper import FalconTeleop

gymnasium.register_envs(spatula_env)

PARTS = ("holds", "scenarios", "stiffness", "signals", "period")
"""What there is to measure."""
WORST: Mapping[str, Callable[[Sequence[float]], float]] = {
    "shown_over_true_least": min,
    "shown_over_true_greatest": max,
    "difference_of_light_touch_mn": max,
    "hold_step_n_per_ms": max,
    "limit_cycle_mm": max,
    "energy_to_hand_mj": max,
    "peak_ratio": max,
    "surface_to_force_ms": max,
    "back_to_95_ms": max,
    "steepest_n_per_ms": max,
    "buzz_mn": max,
    "to_zero_ms": max,
}
"""Measures, and which of their values is the worst."""
CYCLE = 4.0
"""One press and its release [s]."""
DEPTH = 0.045
"""From the highest to the lowest place of the hand's target [m]."""
START_HEIGHT = 0.0
"""Of the tool, workspace frame [m]."""
FORCE_SCALES = (1.0, 5.0)
"""The organ as it is, and five times as stiff to the hand."""
STEP_FORCE = 3.0
"""[N]."""
STALL_WATCH = 0.1
"""For how long a stall is watched [s]."""
POLL = 5e-4
"""How often the force is looked at [s]."""
TRIALS = 20
"""Steps and stalls."""
MOVE_START = 1.0
"""So long the hand waits before it moves [s]."""


class PressingMotion:
    """Down and up again, smoothly, in the Falcon's frame."""

    def __init__(self, depth: float) -> None:
        """Say how deep [m]."""
        self._depth = depth

    def __call__(self, seconds: float) -> tuple[float, float, float]:
        """The target at a time."""
        phase = max(0.0, seconds - MOVE_START) / CYCLE
        return position_to_falcon((0.0, 0.0, 0.5 * self._depth * math.cos(2.0 * math.pi * phase)))


def make_falcon(depth: float) -> TeleopDevice:
    """An emulated Falcon in real time, with a hand that presses and draws back."""
    motion = PressingMotion(depth)
    return EmulatedFalcon(ElasticHand(motion, position=motion(0.0)), clock=RealClock())


def make_held_falcon() -> TeleopDevice:
    """An emulated Falcon in real time, in a hand that does not yield."""
    return EmulatedFalcon(GuidedHand(lambda _: position_to_falcon((0.0, 0.0, 0.0))), clock=RealClock())


def energies(device: TeleopDevice) -> dict[str, float]:
    """What has been exchanged with the hand [J]; asked where the device is."""
    assert isinstance(device, EmulatedFalcon)
    found = device.emulator.hand.energies
    return {"motors": found.motors, "arm": found.arm, "dissipated": found.dissipated}


def press(where: Where, force_scale: float, seconds: float) -> dict[str, Any]:
    """Press and draw back for some time.

    Args:
        where: Where the loop runs.
        force_scale: How much stiffer the organ is to the hand.
        seconds: For how long.

    Returns:
        Periods [ms], energies [mJ], forces [N].
    """
    env = gymnasium.make("Spatula/Press-v0", max_episode_steps=10**9)
    settings = HapticSettings(force_scale=force_scale)
    device = HapticDevice(partial(make_falcon, DEPTH), settings, where=where, exchange=True)
    forces, steps, late = [], [], 0
    with device:
        teleop = FalconTeleop(env, device)
        teleop.reset(seed=0, options={"tool_position": (0.0, 0.0, START_HEIGHT)})
        period = teleop.get_wrapper_attr("steps_per_action") / 240.0
        start = last = time.monotonic()
        while time.monotonic() - start < seconds:
            _, _, _, _, info = teleop.step()
            now = time.monotonic()
            steps.append(now - last)
            late += now - last > 1.2 * period
            last = now
            forces.append(info["force"])
        found = device.statistics()
        exchanged = device.ask(energies)
        teleop.close()
    return {
        "where": where,
        "force_scale": force_scale,
        "seconds": seconds,
        "cycles": found.cycles,
        "period_p50_ms": 1e3 * found.median_period,
        "period_p99_ms": 1e3 * found.late_period,
        "period_max_ms": 1e3 * found.longest_period,
        "control_step_p99_ms": 1e3 * float(np.quantile(steps, 0.99)),
        "late_control_steps": int(late),
        "stalls": found.stalls,
        "limited_cycles": found.limited,
        "peak_tool_force_n": float(max(forces)),
        "energy_into_hand_mj": 1e3 * exchanged["motors"],
        "energy_by_loop_mj": -1e3 * found.balance,
    }


def step_response() -> dict[str, float]:
    """How the force follows a step of the simulation's force, and how long it lasts without a heartbeat.

    Returns:
        Medians of times to 63 % and 95 % of the step, median and longest time from the last heartbeat to zero [ms].
    """
    found: dict[str, list[float]] = {"rise_63": [], "rise_95": [], "stall_to_zero": []}
    with HapticDevice(make_held_falcon, where="process", exchange=True) as device:
        for _ in range(TRIALS):
            _beat(device, 0.0, lambda force: force == 0.0)
            found["rise_63"].append(_beat(device, STEP_FORCE, lambda force: force >= 0.632 * STEP_FORCE))
            further = _beat(device, STEP_FORCE, lambda force: force >= 0.95 * STEP_FORCE)
            found["rise_95"].append(found["rise_63"][-1] + further)
            device.tell(None, (0.0, 0.0, STEP_FORCE))
            start = time.monotonic()
            while device.force.any() and time.monotonic() - start < STALL_WATCH:
                time.sleep(POLL)
            found["stall_to_zero"].append(time.monotonic() - start)
    medians = {f"{name}_ms": 1e3 * float(np.median(times)) for name, times in found.items()}
    return {**medians, "stall_to_zero_longest_ms": 1e3 * max(found["stall_to_zero"])}


def _beat(device: HapticDevice, force: float, reached: Callable[[float], bool]) -> float:
    """Tell a force, again and again, until what is felt is as it should be; how long that took [s]."""
    start = time.monotonic()
    while True:
        device.tell(None, (0.0, 0.0, force))
        time.sleep(POLL)
        if reached(float(device.force[2])):
            return time.monotonic() - start


def main() -> None:
    """Measure and print."""
    options = measure.parser(__doc__ or "")
    options.add_argument(
        "--parts", choices=PARTS, nargs="*", default=list(PARTS), help="what to measure (default: all of it)"
    )
    options.add_argument(
        "--seconds", type=float, default=60.0, help="length of a run in real time (default: %(default)s)"
    )
    options.add_argument("--hold-seconds", type=float, default=30.0, help="length of a hold (default: %(default)s)")
    options.add_argument("--hands", choices=tuple(HANDS), nargs="*", default=list(HANDS), help="(default: all three)")
    options.add_argument("--scales", type=float, nargs="*", default=[1.0, 3.0, 5.0], help="(default: 1 3 5)")
    options.add_argument(
        "--mechanism", action="store_true", help="the emulated device has weight, friction and bending links"
    )
    options.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: all cores)")
    options.add_argument("--where", choices=("process", "thread"), nargs="*", default=["process", "thread"])
    chosen = options.parse_args()
    result: dict[str, Any] = {}
    if "period" in chosen.parts:
        result["runs"] = [press(where, scale, chosen.seconds) for where in chosen.where for scale in FORCE_SCALES]
        result["step"] = step_response()
        if not chosen.json:
            _print_period(result["runs"], result["step"])
    if "stiffness" in chosen.parts:
        result["greatest_stiffness_n_per_m"] = table(chosen.hands)
        if not chosen.json:
            for hand, found in result["greatest_stiffness_n_per_m"].items():
                _print_cell({"hand": hand, **found})
    if "signals" in chosen.parts:
        result["signals_ms"] = measure_signals()
        if not chosen.json:
            _print_cell(result["signals_ms"])
    cells = [
        cell
        for part in ("holds", "scenarios")
        if part in chosen.parts
        for cell in make_cells(part, chosen.hands, chosen.scales, chosen.hold_seconds, chosen.mechanism)
    ]
    if cells:
        result["cells"] = run_cells(cells, chosen.workers, None if chosen.json else _print_cell)
        result["summary"] = summarize(result["cells"])
        if not chosen.json:
            _print_cell(result["summary"])
    measure.finish({**result, "load": measure.load_average()})


def make_cells(
    part: str, hands: Sequence[str], scales: Sequence[float], hold_seconds: float, mechanism: bool = False
) -> list[Cell]:
    """What there is to run in simulated time."""
    touches = [(task, depth) for task, touch in TOUCHES.items() for depth in touch.depths]
    kinds = [(hand, tremor, scale) for hand in hands for tremor in (False, True) for scale in scales]
    if part == "holds":
        return [
            Cell("hold", hand, tremor, scale, task, depth, hold_seconds, mechanism=mechanism)
            for hand, tremor, scale in kinds
            for task, depth in touches
        ]
    return [
        Cell(name, hand, tremor, scale, mechanism=mechanism)
        for hand, tremor, scale in kinds
        for name in SCENARIOS
        if name != "hold"
    ]


def run_cells(
    cells: Sequence[Cell], workers: int, progress: Callable[[Mapping[str, Any]], None] | None = None
) -> list[dict[str, Any]]:
    """Run cells, in processes of their own; results in their order."""
    found = []
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        for each in pool.map(run, cells):
            found.append(each)
            if progress is not None:
                progress(each)
    return found


def summarize(cells: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The worst of each measure over all cells that have it, by force scale."""
    worst: dict[str, Any] = {}
    for scale in sorted({cell["scale"] for cell in cells}):
        rows = [cell for cell in cells if cell["scale"] == scale]
        for name, choose in WORST.items():
            values = [row[name] for row in rows if row.get(name) is not None and not math.isnan(row[name])]
            if values:
                worst[f"{name} x{scale:g}"] = choose(values)
    return worst


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
