"""The scenarios of the haptic benchmark: what the hand does in each, and what is measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.haptics_closed_loop import (
    ABOVE,
    HANDS,
    TOUCH_SPEED,
    TOUCHES,
    WAIT,
    ClosedLoop,
    Path,
    Touch,
    Trace,
    hold_target,
    ramp,
)
from spatula_env.teleop.emulator import Mechanism
from spatula_env.teleop.haptics import HapticSettings

FloatArray = NDArray[np.float64]
WINDOW = 2.0
"""Length of the windows whose mean shown and true force are compared [s]."""
SETTLING = 1.0
"""Time for which a hold settles before it is measured [s]."""
TREMOR = 3e-4
"""Amplitude of the tremor of a free grip [m]."""
BUZZ = (20.0, 300.0)
"""Band of frequencies that a hand feels as roughness [Hz]."""
LIGHTEST = 0.01
"""A mean force below this is only a few counts of the motors: shown and true force are then compared by difference, not
by ratio [N]."""
FELT = 5e-3
"""Smallest force, or difference of forces, that counts [N]."""


@dataclass(frozen=True)
class Cell:
    """Parameters of one run.

    Attributes:
        scenario: Name of the scenario in `SCENARIOS`.
        hand: Name of the hand in `HANDS`.
        tremor: Whether the hand trembles.
        scale: Force on the hand over force on the tool.
        task: Name of the touch in `TOUCHES`.
        depth: Depth of a hold [m].
        seconds: Duration of a hold [s].
        settings: Settings of the haptic loop, whose force scale is replaced by `scale`; None for the default.
        mechanism: Whether the emulated device has weight, friction and a structural mode.
        engine: Engine of the simulation.
    """

    scenario: str
    hand: str = "nominal"
    tremor: bool = False
    scale: float = 1.0
    task: str = "press"
    depth: float = 0.010
    seconds: float = 30.0
    settings: HapticSettings | None = None
    mechanism: bool = False
    engine: str = "batch"

    def but(self, **changes: Any) -> Cell:
        """A copy with some parameters changed."""
        return replace(self, **changes)


def run(cell: Cell) -> dict[str, Any]:
    """Run a cell.

    Returns:
        Parameters of the cell, and its measurements.
    """
    found = SCENARIOS[cell.scenario](cell)
    described = {
        "scenario": cell.scenario,
        "task": cell.task,
        "hand": cell.hand,
        "tremor": cell.tremor,
        "scale": cell.scale,
        "mechanism": cell.mechanism,
        "engine": cell.engine,
    }
    return described | {name: round(value, 5) if isinstance(value, float) else value for name, value in found.items()}


def hold(cell: Cell) -> dict[str, Any]:
    """Hold the tool in the organ."""
    loop, _, begin = _to_depth(cell)
    trace = _run(loop, begin + cell.seconds)
    return {"depth_mm": 1e3 * cell.depth, **_common(trace), **_held(trace, begin, cell.tremor)}


def rest(cell: Cell) -> dict[str, Any]:
    """Rest just above the organ."""
    loop = _loop(cell, lambda _: 0.0)
    trace = _run(loop, 6.0)
    return {**_common(trace), "greatest_force_n": float(np.linalg.norm(trace.shown, axis=1).max())}


def push(cell: Cell) -> dict[str, Any]:
    """Press and draw back, slowly and then quickly."""
    target = hold_target(cell.task, cell.depth, HANDS[cell.hand], cell.scale, cell.engine)
    down, up = ramp(target, 0.05), ramp(target, 0.05, WAIT + _duration(target, 0.05) + 0.5)
    second = WAIT + 2.0 * _duration(target, 0.05) + 1.0
    again, back = ramp(target, 0.1, second), ramp(target, 0.1, second + _duration(target, 0.1) + 0.5)
    loop = _loop(cell, lambda time: down(time) - up(time) + again(time) - back(time))
    trace = _run(loop, second + 2.0 * _duration(target, 0.1) + 1.5)
    return {**_common(trace), **_latency(trace, cell)}


def tap(cell: Cell, speed: float) -> dict[str, Any]:
    """Tap the organ: come down from above, with a given greatest speed [m/s], and lift off again."""
    lift, depth = 0.010, 0.010
    touch = TOUCHES[cell.task]
    x, y, z = (place - (lift - ABOVE) * way for place, way in zip(touch.start, touch.direction, strict=True))
    period = 2.0 * math.pi * 0.5 * (lift + depth) / speed

    def path(time: float) -> float:
        share = min(1.0, max(0.0, (time - WAIT) / period))
        return 0.5 * (lift + depth) * (1.0 - math.cos(2.0 * math.pi * share))

    loop = _loop(cell, path, replace(touch, start=(x, y, z)))
    trace = _run(loop, WAIT + period + 1.0)
    shown, true = (float(np.linalg.norm(force, axis=1).max()) for force in (trace.shown, trace.true))
    return {"speed": speed, **_common(trace), "shown_peak_n": shown, "true_peak_n": true, "peak_ratio": shown / true}


def slide(cell: Cell) -> dict[str, Any]:
    """Slide over the organ in contact."""
    depth = 0.004
    target = hold_target(cell.task, depth, HANDS[cell.hand], cell.scale, cell.engine)
    down, up = ramp(target), ramp(target, start=6.0)
    loop = _loop(cell, lambda time: down(time) - up(time))
    loop.aside = lambda time: 0.012 * math.sin(2.0 * math.pi * 0.4 * max(0.0, time - 1.5)) if time < 6.0 else 0.0
    trace = _run(loop, 7.5)
    rows = trace.between(2.5, 6.0)
    shown, true = trace.shown[rows], trace.true[rows]
    cosine = (shown * true).sum(axis=1) / (np.linalg.norm(shown, axis=1) * np.linalg.norm(true, axis=1) + 1e-12)
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return {**_common(trace), **_fidelity(trace, 2.5, 6.0), "direction_median_deg": float(np.median(angle))}


def release(cell: Cell) -> dict[str, Any]:
    """Hold the tool deep in the organ when the device releases the force, as at the end of an episode."""
    loop, _, begin = _to_depth(cell)
    loop.run(begin)
    at = loop.device.now()
    loop.device.release()
    loop.device.sleep(1.0)
    trace = _closed(loop)
    force = np.linalg.norm(trace.shown, axis=1)
    ended = trace.time[(trace.time > at) & (force > 1e-3)]
    return {
        **_common(trace),
        "to_zero_ms": 1e3 * float(ended.max() - at) if len(ended) else 0.0,
        "steepest_n_per_ms": _greatest_step(trace.shown[trace.between(at - 0.005, math.inf)]),
    }


def stall(cell: Cell, duration: float) -> dict[str, Any]:
    """Hold the tool deep in the organ while the simulation stops once, for some time [s]."""
    loop, _, begin = _to_depth(cell)
    trace = _run(loop, begin + duration + 4.0, stall=(begin, duration))
    after = begin + duration
    ratios = [_ratio(trace, after + start, after + start + 0.1) for start in np.arange(0.0, 3.8, 0.05)]
    back = next((0.05 * index for index in range(len(ratios)) if min(ratios[index:]) >= 0.95), math.inf)
    return {
        "stall_ms": 1e3 * duration,
        **_common(trace),
        "back_to_95_ms": 1e3 * back,
        "steepest_n_per_ms": _greatest_step(trace.shown[trace.between(begin - 0.01, math.inf)]),
        **_fidelity(trace, after + 1.0, after + 3.9),
    }


def slow(cell: Cell, speed: float) -> dict[str, Any]:
    """Hold the tool in the organ while the simulation runs slower than real time, at a share `speed` of it."""
    loop, _, begin = _to_depth(cell, speed=speed)
    begin += 1.0
    trace = _run(loop, begin + 4.0)
    rows = trace.between(begin, math.inf)
    return {
        "speed": speed,
        **_common(trace),
        **_held(trace, begin, cell.tremor),
        "buzz_mn": 1e3 * buzz(trace.shown[rows]),
        "is_slow": trace.statistics.is_slow,
    }


SCENARIOS: Mapping[str, Callable[[Cell], dict[str, Any]]] = {
    "hold": hold,
    "rest": rest,
    "push": push,
    "tap 0.25": lambda cell: tap(cell, 0.25),
    "tap 0.5": lambda cell: tap(cell, 0.5),
    "slide": slide,
    "release": release,
    "stall 50": lambda cell: stall(cell, 0.05),
    "stall 200": lambda cell: stall(cell, 0.2),
    "stall 300": lambda cell: stall(cell, 0.3),
    "stall 2000": lambda cell: stall(cell, 2.0),
    "half speed": lambda cell: slow(cell, 0.5),
    "0.3 of speed": lambda cell: slow(cell, 0.3),
    "0.1 of speed": lambda cell: slow(cell, 0.1),
}


def buzz(force: FloatArray) -> float:
    """Root mean square of the part of forces (n, 3), sampled once a millisecond, within the band `BUZZ` [N]."""
    spectrum = np.fft.rfft(force - force.mean(axis=0), axis=0)
    frequencies = np.fft.rfftfreq(len(force), 1e-3)
    spectrum[(frequencies < BUZZ[0]) | (frequencies > BUZZ[1])] = 0.0
    left = np.fft.irfft(spectrum, len(force), axis=0)
    return float(np.sqrt((left**2).sum(axis=1).mean()))


def _loop(cell: Cell, path: Path, touch: Touch | None = None, speed: float = 1.0) -> ClosedLoop:
    settings = replace(cell.settings if cell.settings is not None else HapticSettings(), force_scale=cell.scale)
    mechanism = Mechanism() if cell.mechanism else None
    if mechanism is not None:
        settings = replace(settings, weight=mechanism.weight, friction=mechanism.coulomb)
    return ClosedLoop(
        path,
        HANDS[cell.hand],
        touch=touch if touch is not None else TOUCHES[cell.task],
        settings=settings,
        tremor=TREMOR if cell.tremor else 0.0,
        speed=speed,
        mechanism=mechanism,
        engine=cell.engine,
    )


def _to_depth(cell: Cell, speed: float = 1.0) -> tuple[ClosedLoop, Path, float]:
    """A loop whose hand goes to the cell's depth and stays there, its path, and the time when it has settled [s]."""
    target = hold_target(cell.task, cell.depth, HANDS[cell.hand], cell.scale, cell.engine)
    path = ramp(target)
    return _loop(cell, path, speed=speed), path, WAIT + _duration(target, TOUCH_SPEED) + SETTLING


def _duration(target: float, speed: float) -> float:
    return max(1e-3, 0.5 * math.pi * abs(target) / speed)


def _run(loop: ClosedLoop, until: float, stall: tuple[float, float] | None = None) -> Trace:
    loop.run(until, stall)
    return _closed(loop)


def _closed(loop: ClosedLoop) -> Trace:
    trace = loop.trace()
    loop.close()
    return trace


def _common(trace: Trace) -> dict[str, Any]:
    cycles = max(1, trace.statistics.cycles)
    return {
        "energy_to_hand_mj": 1e3 * float(trace.energy.max()),
        "greatest_step_n_per_ms": _greatest_step(trace.shown),
        "limited_share": trace.statistics.limited / cycles,
        "stalls": trace.statistics.stalls,
    }


def _held(trace: Trace, begin: float, tremor: bool) -> dict[str, Any]:
    rows = trace.between(begin, math.inf)
    last = trace.position[trace.between(max(begin, float(trace.time[-1]) - 3.0), math.inf)]
    found = {**_fidelity(trace, begin, float(trace.time[-1])), "hold_step_n_per_ms": _greatest_step(trace.shown[rows])}
    if not tremor:
        # The slow part of the motion, which `_swing` removes, is creep of the organ.
        found["limit_cycle_mm"] = 1e3 * _swing(last)
    return found


def _swing(position: FloatArray) -> float:
    """Peak-to-peak motion of positions (n, 3), sampled once a millisecond, less their mean over half a second [m]."""
    width = 500
    window = np.hanning(width) / np.hanning(width).sum()
    smooth = np.stack([np.convolve(column, window, mode="valid") for column in position.T], axis=1)
    middle = position[width // 2 : width // 2 + len(smooth)] - smooth
    return float(np.ptp(middle, axis=0).max())


def _fidelity(trace: Trace, begin: float, end: float) -> dict[str, float]:
    starts = np.arange(begin, max(begin + 1e-3, end - WINDOW + 1e-3), WINDOW)
    means = []
    for start in starts:
        rows = trace.between(start, start + WINDOW)
        means.append([float(np.linalg.norm(force[rows].mean(axis=0))) for force in (trace.shown, trace.true)])
    ratios = [shown / true for shown, true in means if true >= LIGHTEST]
    light = [abs(shown - true) for shown, true in means if true < LIGHTEST]
    rows = trace.between(begin, end)
    return {
        "true_n": float(np.linalg.norm(trace.true[rows].mean(axis=0))),
        "shown_over_true_least": min(ratios, default=math.nan),
        "shown_over_true_greatest": max(ratios, default=math.nan),
        "difference_of_light_touch_mn": 1e3 * max(light, default=0.0),
    }


def _ratio(trace: Trace, begin: float, end: float) -> float:
    rows = trace.between(begin, end)
    shown, true = (float(np.linalg.norm(force[rows].mean(axis=0))) for force in (trace.shown, trace.true))
    if abs(shown - true) < FELT:
        # The difference is only a count or two of the motors.
        return 1.0
    return shown / max(true, 1e-9)


def _greatest_step(force: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(force, axis=0), axis=1).max())


def _latency(trace: Trace, cell: Cell) -> dict[str, float]:
    """Longest time, over the touches, from when the hand reaches the surface until it feels a force [ms]."""
    touch = TOUCHES[cell.task]
    moved = (trace.position - trace.position[0]) @ np.array(touch.direction)
    felt = np.linalg.norm(trace.shown, axis=1) > FELT * cell.scale
    times = []
    inside = moved > ABOVE
    for enters in np.flatnonzero(inside[1:] & ~inside[:-1]) + 1:
        later = np.flatnonzero(felt[enters:])
        if len(later) and inside[enters : enters + 100].all():
            times.append(1e3 * float(trace.time[enters + later[0]] - trace.time[enters]))
    return {"surface_to_force_ms": max(times) if times else math.nan}
