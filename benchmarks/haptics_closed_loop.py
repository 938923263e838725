"""A model hand on an emulated Falcon in an environment, in simulated time: the force it feels beside the true force.

Everything between hand and organ is what an operator uses: mechanism, encoders, USB packets, driver, haptic loop,
wrapper, physics. The hand is a damped mass that a spring pulls to the place where the operator wants it, with a tremor
that would move a free grip by a given amplitude. Runs go as fast as the machine allows and are deterministic.
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
"""Target position of the hand over time [s], along the direction of a touch [m]."""

TREMOR = ((8.0, 0.3), (9.3, 1.1), (10.7, 2.9), (12.0, 4.3))
"""Frequencies [Hz] and phases [rad] of the components of the tremor."""
SHIFTS = tuple((math.cos(2.1 * axis), math.sin(2.1 * axis)) for axis in (1, 2))
"""Cosine and sine of the phase leads of the tremor along the second and third axis over that along the first."""
WAIT = 0.2
"""Time that the hand waits before it moves [s]."""
TOUCH_SPEED = 0.04
"""Greatest speed at which the hand goes to a hold [m/s]."""
ABOVE = 0.002
"""Distance of the tool from the organ at the start [m]."""


@dataclass(frozen=True)
class HandModel:
    """Mechanical parameters of a hand that holds the grip.

    Attributes:
        mass: Mass of hand and grip [kg].
        stiffness: Stiffness of the arm [N/m].
        damping: Damping of the arm [N s/m].
    """

    mass: float
    stiffness: float
    damping: float

    def transmissibility(self, frequency: float) -> float:
        """Amplitude of a free grip over the amplitude of its target, at a frequency [Hz].

        The target acts through the spring alone, the damper on the absolute velocity of the hand.
        """
        turning = 2.0 * math.pi * frequency
        return self.stiffness / abs(complex(self.stiffness - self.mass * turning**2, self.damping * turning))


HANDS: Mapping[str, HandModel] = {
    "light": HandModel(0.15, 100.0, 2.0),
    "nominal": HandModel(0.29, 300.0, 6.0),
    "firm": HandModel(1.0, 1000.0, 20.0),
}


@dataclass(frozen=True)
class Touch:
    """A place where a task's tool meets tissue.

    Attributes:
        env_id: Id of the environment.
        start: (3,) start position of the tool, just off the tissue [m].
        direction: (3,) unit vector into the tissue.
        depths: Usual depths of a hold [m].
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
"""Touches by task; the starts were found by lowering each task's tool from its initial position with seed 0."""


@dataclass(frozen=True, eq=False)
class Trace:
    """Record of a run, sampled once a millisecond.

    Attributes:
        time: (n,) [s].
        position: (n, 3) position of the grip, device's frame [m].
        shown: (n, 3) force of the motors on the hand, without the part that supports the grip [N].
        true: (n, 3) force of the organ on the tool, times the force scale [N].
        energy: (n,) energy that the motors have given the hand, without that of the supporting part [J].
        statistics: Statistics of the haptic loop.
    """

    time: FloatArray
    position: FloatArray
    shown: FloatArray
    true: FloatArray
    energy: FloatArray
    statistics: LoopStatistics

    def between(self, start: float, end: float) -> slice:
        """Slice of the rows from one time to another [s]."""
        first, last = np.searchsorted(self.time, [start, end])
        return slice(int(first), int(last))


class Watched:
    """Wraps a `Hand`, and records the grip's position, motor force, true force and energy once a millisecond."""

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
                # A force is sent with the packet of the cycle after the one that computed it.
                self.acting, self.support = self.support, renderer.support
            place, force = position_to_device(self.position), direction_to_device(motor_force)
            self.rows.append((time + step, *place, *force, *self.true, self.energies.motors, *self.acting))


class ClosedLoop:
    """An environment, a haptic device and a model hand whose target moves along a line.

    Attributes:
        aside: Target of the hand across that line, over time [m]; zero by default.
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
        """Create environment, device and hand, and reset to the touch's start.

        Args:
            path: Target of the hand over time, along the touch's direction, relative to its `start` [m].
            hand: Model of the hand that holds the grip.
            touch: Where the tool begins, and the direction of the path; the press by default.
            settings: Settings of the haptic loop.
            tremor: Amplitude of the tremor along each axis, of a free grip [m].
            speed: Speed of the simulation, relative to real time.
            mechanism: Mechanism between motors and hand; None for an ideal one.
            **keywords: Further arguments of the environment.
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
        """Run up to a time.

        Args:
            until: Device time at which to end [s].
            stall: Time at which the simulation stops once, and for how long [s].

        Returns:
            The record of everything so far.
        """
        while self.device.now() < until:
            if stall is not None and self.device.now() >= stall[0]:
                self.device.sleep(stall[1])
                stall = None
            self.teleop.step()
        return self.trace()

    def trace(self) -> Trace:
        """The record of everything so far."""
        rows = np.array(self.hand.rows)
        position, shown, support = rows[:, 1:4], rows[:, 4:7], rows[:, 11:14]
        # The force that supports the grip is not to be felt, and its work is not done by the organ: both are removed.
        borne = np.concatenate([[0.0], np.cumsum((support[1:] * np.diff(position, axis=0)).sum(axis=1))])
        return Trace(
            rows[:, 0], position, shown - support, rows[:, 7:10], rows[:, 10] - borne, self.device.statistics()
        )

    def close(self) -> None:
        """Close the device and the environment."""
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
    """Path that goes smoothly from 0 to `goal` [m], with a greatest speed [m/s], beginning at `start` [s]."""
    duration = max(1e-3, 0.5 * math.pi * abs(goal) / speed)

    def path(time: float) -> float:
        share = min(1.0, max(0.0, (time - start) / duration))
        return goal * 0.5 * (1.0 - math.cos(math.pi * share))

    return path


@cache
def static_force(name: str, depth: float, engine: str) -> float:
    """Force of the organ on a tool that has been held at a depth [m] for a second [N]."""
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
    """Target of the hand, relative to the touch's start, with which it comes to rest at a depth [m].

    The target is beyond the depth by what the organ's force, times the force scale, stretches the arm's spring.
    """
    return depth + ABOVE + scale * static_force(name, depth, engine) / hand.stiffness
