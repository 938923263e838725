"""A hand on an emulated Falcon in an environment, in simulated time: what is felt beside what the organ does.

All between the hand and the organ is what an operator uses: mechanism, encoders, USB packets, driver, haptic loop,
wrapper, physics. The hand is a mass that a spring pulls to where the operator wants it, with a tremor that would move a
free grip by a given amplitude. Runs are as fast as the machine and the same every time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, cast

import gymnasium
import numpy as np
from numpy.typing import NDArray

import spatula_env
from spatula_env.envs import SpatulaEnv
from spatula_env.teleop.emulator import ElasticHand, Hand, HandOnMechanism, Mechanism
from spatula_env.teleop.falcon.frames import direction_to_device, position_to_device, position_to_falcon
from spatula_env.teleop.haptics import HapticDevice, HapticSettings, LoopStatistics
from spatula_env.teleop.haptics.rendering import ForceRenderer
from spatula_env.teleop.scripted import EmulatedFalcon
from spatula_env.teleop.wrapper import FalconTeleop

gymnasium.register_envs(spatula_env)

FloatArray = NDArray[np.float64]
Path = Callable[[float], float]
"""Of the hand, along the direction of a touch, against time [m]."""

TREMOR = ((8.0, 0.3), (9.3, 1.1), (10.7, 2.9), (12.0, 4.3))
"""Frequencies [Hz] and phases [rad] of a tremor's parts."""
SHIFTS = tuple((math.cos(2.1 * axis), math.sin(2.1 * axis)) for axis in (1, 2))
"""Cosine and sine of the phases by which the tremor along the second and third axis is ahead of the first's."""
WAIT = 0.2
"""So long the hand waits before it moves [s]."""
TOUCH_SPEED = 0.04
"""At which a hand goes to a hold [m/s]."""
ABOVE = 0.002
"""So far from the organ it begins [m]."""


@dataclass(frozen=True)
class HandModel:
    """What holds the grip.

    Attributes:
        mass: Of hand and grip [kg].
        stiffness: Of the arm [N/m].
        damping: Of the arm [N s/m].
    """

    mass: float
    stiffness: float
    damping: float

    def transmissibility(self, frequency: float) -> float:
        """How far a free grip moves for a motion of where the operator wants it."""
        turning = 2.0 * math.pi * frequency
        return self.stiffness / abs(complex(self.stiffness - self.mass * turning**2, self.damping * turning))


HANDS: Mapping[str, HandModel] = {
    "light": HandModel(0.15, 100.0, 2.0),
    "nominal": HandModel(0.29, 300.0, 6.0),
    "firm": HandModel(1.0, 1000.0, 20.0),
}


@dataclass(frozen=True)
class Touch:
    """Where a task's tool meets tissue.

    Attributes:
        env_id: Of the environment.
        start: (3,) of the tool, just off the tissue [m].
        direction: (3,) into the tissue, unit.
        depths: How deep it usually goes [m].
        keywords: Further arguments of the environment.
    """

    env_id: str
    start: tuple[float, float, float]
    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)
    depths: tuple[float, ...] = (0.005,)
    keywords: Mapping[str, Any] = field(default_factory=dict)


TOUCHES: Mapping[str, Touch] = {
    "press": Touch("Spatula/Press-v0", (0.0, 0.0, -0.0237 + ABOVE), depths=(0.001, 0.002, 0.005, 0.010, 0.015)),
    "retract": Touch("Spatula/Retract-v0", (0.0165, 0.0021, -0.0285 + ABOVE), depths=(0.001,)),
    "palpate": Touch("Spatula/Palpate-v0", (0.0039, -0.0031, -0.0240 + ABOVE), depths=(0.003,)),
    "fissure": Touch("Spatula/Fissure-v0", (0.0063, 0.0083, -0.0055 + ABOVE), depths=(0.008,)),
    "clamp": Touch("Spatula/Clamp-v0", (-0.0073, -0.0077, -0.0217 + ABOVE), depths=(0.006,)),
}
"""Found by lowering each task's tool from where it begins with seed 0."""


@dataclass(frozen=True, eq=False)
class Trace:
    """What happened, once a millisecond.

    Attributes:
        time: (n,) [s].
        position: (n, 3) of the grip, device's frame [m].
        shown: (n, 3) what the motors do to the hand [N].
        true: (n, 3) what the organ does to the tool, scaled as it is to be felt [N].
        energy: (n,) that the motors have given the hand [J].
        statistics: Of the loop.
    """

    time: FloatArray
    position: FloatArray
    shown: FloatArray
    true: FloatArray
    energy: FloatArray
    statistics: LoopStatistics

    def between(self, start: float, end: float) -> slice:
        """Of the rows from one time to another."""
        first, last = np.searchsorted(self.time, [start, end])
        return slice(int(first), int(last))


class Watched:
    """A hand that remembers, once a millisecond, where the encoders were and what the motors did: a `Hand`."""

    def __init__(self, hand: Hand) -> None:
        self.rows: list[tuple[float, ...]] = []
        self.renderer: Callable[[], ForceRenderer | None] | None = None
        self.true = self.support = self.acting = (0.0, 0.0, 0.0)
        self._hand = hand
        self._next = 0.0
        self.position, self.velocity, self.energies = hand.position, hand.velocity, hand.energies

    def advance(self, time: float, step: float, motor_force: tuple[float, float, float]) -> None:
        """See `Hand`."""
        self._hand.advance(time, step, motor_force)
        self.position, self.velocity = self._hand.position, self._hand.velocity
        if time + step >= self._next:
            self._next += 1e-3
            renderer = self.renderer() if self.renderer is not None else None
            if renderer is not None:
                # A force goes out with the packet of the cycle after it was made.
                self.acting, self.support = self.support, renderer.support
            place, force = position_to_device(self.position), direction_to_device(motor_force)
            self.rows.append((time + step, *place, *force, *self.true, self.energies.motors, *self.acting))


class ClosedLoop:
    """An environment, a device and a hand that moves along a line.

    Attributes:
        aside: Where the operator wants the hand besides, across that line, against time [m].
    """

    def __init__(
        self,
        path: Path,
        hand: HandModel,
        *,
        touch: Touch | None = None,
        settings: HapticSettings | None = None,
        tremor: float = 0.0,
        speed: float = 1.0,
        mechanism: Mechanism | None = None,
        **keywords: Any,
    ) -> None:
        """Put it together.

        Args:
            path: Where the operator wants the hand, along the touch's direction, from `start` on [m].
            hand: What holds the grip.
            touch: Where the tool begins, and which way the path leads.
            settings: Of the loop.
            tremor: Amplitude along each axis, of a free grip [m].
            speed: Of the simulation, share of real time.
            mechanism: Between motors and hand.
            **keywords: Of the environment.
        """
        self.touch = touch if touch is not None else TOUCHES["press"]
        self._direction = self.touch.direction
        self._path, self._tremor = path, tremor
        self.aside: Path = lambda _: 0.0
        self.settings = settings if settings is not None else HapticSettings()
        self._parts = [
            (2.0 * math.pi * frequency, phase, 0.5 * tremor / hand.transmissibility(frequency))
            for frequency, phase in TREMOR
        ]
        held: Hand = ElasticHand(
            self._target,
            position=self._target(0.0),
            mass=hand.mass,
            stiffness=hand.stiffness,
            damping=hand.damping,
        )
        if mechanism is not None:
            held = HandOnMechanism(held, mechanism)
        self.hand = Watched(held)
        self.falcon = EmulatedFalcon(self.hand)
        self.device = HapticDevice(lambda: self.falcon, self.settings, where="here", exchange=True)
        self.env = gymnasium.make(
            self.touch.env_id, max_episode_steps=10**9, **{**dict(self.touch.keywords), **keywords}
        )
        self.device.open()
        self.hand.renderer = lambda: self.device.renderer if self.device.is_open else None
        self.teleop = FalconTeleop(
            self.env,
            self.device,
            now=lambda: self.device.now() * speed,
            sleep=lambda duration: self.device.sleep(duration / speed),
        )
        self._stop = cast("SpatulaEnv", self.env.unwrapped).listen(self._hear)
        self.teleop.reset(seed=0, options={"tool_position": self.touch.start})

    def run(self, until: float, stall: tuple[float, float] | None = None) -> Trace:
        """Go on until a time.

        Args:
            until: When to end [s].
            stall: When the simulation stops for once, and for how long [s].
        """
        while self.device.now() < until:
            if stall is not None and self.device.now() >= stall[0]:
                self.device.sleep(stall[1])
                stall = None
            self.teleop.step()
        return self.trace()

    def trace(self) -> Trace:
        """What has happened so far."""
        rows = np.array(self.hand.rows)
        position, shown, support = rows[:, 1:4], rows[:, 4:7], rows[:, 11:14]
        # What bears the grip is no part of what is to be felt, and its work none of the organ's.
        borne = np.concatenate([[0.0], np.cumsum((support[1:] * np.diff(position, axis=0)).sum(axis=1))])
        return Trace(
            rows[:, 0], position, shown - support, rows[:, 7:10], rows[:, 10] - borne, self.device.statistics()
        )

    def close(self) -> None:
        """End it."""
        self._stop()
        self.device.close()
        self.env.close()

    def _hear(self, step: Any) -> None:
        x, y, z = (self.settings.force_scale * step.force).tolist()
        self.hand.true = (x, y, z)

    def _target(self, time: float) -> tuple[float, float, float]:
        along, across = self._path(time), self.aside(time)
        (x, y, z), tremor = self._direction, self._tremor
        place = (along * x + across * z, along * y + across * x, along * z + across * y)
        if tremor:
            sine = cosine = 0.0
            for turning, phase, amplitude in self._parts:
                sine += amplitude * math.sin(turning * time + phase)
                cosine += amplitude * math.cos(turning * time + phase)
            place = (
                place[0] + sine,
                place[1] + sine * SHIFTS[0][0] + cosine * SHIFTS[0][1],
                place[2] + sine * SHIFTS[1][0] + cosine * SHIFTS[1][1],
            )
        return position_to_falcon(place)


def ramp(goal: float, speed: float = TOUCH_SPEED, start: float = WAIT) -> Path:
    """From 0 to a place, smoothly, with a greatest speed."""
    duration = max(1e-3, 0.5 * math.pi * abs(goal) / speed)

    def path(time: float) -> float:
        share = min(1.0, max(0.0, (time - start) / duration))
        return goal * 0.5 * (1.0 - math.cos(math.pi * share))

    return path


@cache
def static_force(name: str, depth: float, engine: str) -> float:
    """What the organ does to a tool that has been held at a depth for a second [N]."""
    touch = TOUCHES[name]
    env = gymnasium.make(touch.env_id, max_episode_steps=10**9, engine=engine, **dict(touch.keywords))
    env.reset(seed=0, options={"tool_position": touch.start})
    made: Any = env.unwrapped
    period = made.steps_per_action * made.simulation.dt
    steps = math.ceil((depth + ABOVE) / (0.02 * period))
    action = np.zeros(made.control.size, dtype=np.float32)
    action[:3] = (depth + ABOVE) / (steps * period * made.control.max_speed) * np.array(touch.direction)
    for _ in range(steps):
        env.step(action)
    for _ in range(round(1.0 / period)):
        *_, info = env.step(np.zeros_like(action))
    env.close()
    return float(info["force"])


def hold_target(name: str, depth: float, hand: HandModel, scale: float, engine: str) -> float:
    """Where an operator has to want a hand for it to stay at a depth, from the start on [m]."""
    return depth + ABOVE + scale * static_force(name, depth, engine) / hand.stiffness
