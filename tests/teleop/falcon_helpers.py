"""An emulated Falcon and the driver on it, in simulated time."""

from __future__ import annotations

from typing import Any

import numpy as np

from spatula_env.teleop.emulator import ElasticHand, FalconEmulator, GuidedHand
from spatula_env.teleop.falcon import Falcon
from spatula_env.teleop.falcon.frames import HALF_WIDTH, position_to_falcon

MIDDLE = (0.0, 0.0, 0.12)


def make_driver(emulator: FalconEmulator, **options: Any) -> Falcon:
    """A driver whose time is the emulator's, without a thread unless one is asked for."""
    chosen = {"threaded": False, "clock": emulator.clock.now, "sleep": emulator.clock.sleep, **options}
    return Falcon(transport=emulator.connect, **chosen)


def open_homed(**options: Any) -> tuple[FalconEmulator, Falcon]:
    """An emulated Falcon that is homed already, with a hand at rest in the middle, and its driver, open."""
    emulator = FalconEmulator(options.pop("hand", None) or ElasticHand(), homed=True)
    falcon = make_driver(emulator, **options)
    falcon.open()
    return emulator, falcon


def held_at(position: tuple[float, float, float]) -> GuidedHand:
    """A hand that does not yield, Falcon's frame."""
    return GuidedHand(lambda _: position)


def workspace_points(count: int, seed: int = 0, half_width: float = HALF_WIDTH) -> list[tuple[float, float, float]]:
    """Random points of the workspace, corners included, Falcon's frame."""
    generator = np.random.default_rng(seed)
    points = generator.uniform(-half_width, half_width, (count, 3))
    points[:8] = half_width * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return [position_to_falcon((x, y, z)) for x, y, z in points.tolist()]


def exchange_for(falcon: Falcon, duration: float) -> None:
    """Let the driver exchange packets for some simulated time."""
    until = falcon.now() + duration
    while falcon.now() < until:
        falcon.exchange()
