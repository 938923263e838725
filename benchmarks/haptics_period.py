"""The haptic loop in real time: its period, its step response, and how long a force lasts without a heartbeat.

To measure the period, and the energy that the motors put into the hand, a simulated hand presses the spatula into the
organ and draws it back, again and again.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import numpy as np

import spatula_env
from spatula_env.teleop.device import TeleopDevice
from spatula_env.teleop.emulator import ElasticHand, GuidedHand, RealClock
from spatula_env.teleop.falcon.frames import position_to_falcon
from spatula_env.teleop.haptics import HapticDevice, HapticSettings
from spatula_env.teleop.haptics.device import Where
from spatula_env.teleop.scripted import EmulatedFalcon
from spatula_env.teleop.wrapper import FalconTeleop

gymnasium.register_envs(spatula_env)

CYCLE = 4.0
"""Duration of one press and its release [s]."""
DEPTH = 0.045
"""Distance between the highest and the lowest position of the hand's target [m]."""
START_HEIGHT = 0.0
"""Initial height of the tool, workspace frame [m]."""
FORCE_SCALES = (1.0, 5.0)
"""Forces as they are, and with the organ five times as stiff to the hand."""
STEP_FORCE = 3.0
"""Height of the force step [N]."""
STALL_WATCH = 0.1
"""Longest time for which a stall is watched [s]."""
POLL = 5e-4
"""Interval at which the force is read [s]."""
TRIALS = 20
"""Number of force steps, and of stalls."""
MOVE_START = 1.0
"""Time that the hand waits before it moves [s]."""


class PressingMotion:
    """Smooth motion down and up, again and again, in the Falcon's frame."""

    def __init__(self, depth: float) -> None:
        """Set the distance between the highest and the lowest position [m]."""
        self._depth = depth

    def __call__(self, seconds: float) -> tuple[float, float, float]:
        """The target position at a time [s]."""
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
    """Energies exchanged with the hand [J]; called in the process or thread that owns the device."""
    assert isinstance(device, EmulatedFalcon)
    found = device.emulator.hand.energies
    return {"motors": found.motors, "arm": found.arm, "dissipated": found.dissipated}


def press(where: Where, force_scale: float, seconds: float) -> dict[str, Any]:
    """Press and draw back for some time.

    Args:
        where: Where the loop runs, "process" or "thread".
        force_scale: How much stiffer the organ is to the hand.
        seconds: Duration [s].

    Returns:
        Arguments and measurements: periods [ms], energies [mJ], force [N] and counts.
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
    """Measure how the force follows a step of the simulation's force, and how long it lasts without a heartbeat.

    Returns:
        Median times to 63 % and 95 % of the step, median and longest time from the last heartbeat to zero force [ms].
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
    """Send a force again and again until the shown force satisfies `reached`; returns how long that took [s]."""
    start = time.monotonic()
    while True:
        device.tell(None, (0.0, 0.0, force))
        time.sleep(POLL)
        if reached(float(device.force[2])):
            return time.monotonic() - start
