"""Scripted operators: a policy as a device, either alone or with a simulated hand on an emulated Falcon.

Recordings of them are labelled "scripted", as they are not human demonstrations.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, TypeAlias

import gymnasium
import numpy as np

from spatula_env.teleop.device import DeviceError, DeviceSample, FloatArray, TeleopDevice
from spatula_env.teleop.emulator import Clock, ElasticHand, FalconEmulator, Hand, Mechanism
from spatula_env.teleop.falcon import Falcon
from spatula_env.teleop.falcon.frames import position_to_device, position_to_falcon
from spatula_env.teleop.haptics.device import HapticDevice
from spatula_env.teleop.haptics.settings import HapticSettings

Policy: TypeAlias = Callable[[Any], Any]
"""Maps an observation to an action, in fractions of the greatest velocities."""

TREMOR_FREQUENCY = 9.0
"""Middle of the part of physiological tremor (8 to 12 Hz) that 20 control steps per second can represent [Hz]."""
TREMOR_BANDWIDTH = 3.0
"""Rate at which the tremor's amplitude and phase wander [Hz]."""
ARM_STIFFNESS = 800.0
ARM_DAMPING = 25.0
"""Stiffness and damping of a scripted operator's arm, firmer than a relaxed human's [N/m], [N s/m]."""
REACH = 0.036
"""Distance from the centre at which a scripted operator uses the clutch [m]."""
RETURN_SPEED = 0.15
"""Speed of the grip on its way back to the centre, with the clutch held [m/s]."""
RETURNED = 0.004
"""Distance from the centre at which it releases the clutch [m]."""


class Tremor:
    """Involuntary motion: narrow-band noise, reproducible for the same generator."""

    def __init__(self, amplitude: float, generator: np.random.Generator) -> None:
        """Set up the noise.

        Args:
            amplitude: Standard deviation of the velocity along each axis, in any unit.
            generator: Source of randomness.

        Raises:
            ValueError: If the amplitude is negative or not finite.
        """
        if not 0.0 <= amplitude < math.inf:
            raise ValueError(f"tremor must be zero or more and finite, got {amplitude!r}")
        self._amplitude = amplitude
        self._generator = generator
        self._state = np.zeros((3, 2))

    def step(self, duration: float) -> FloatArray:
        """Velocity (3,) after a further time step [s]."""
        if self._amplitude == 0.0:
            return np.zeros(3)
        # A vector per axis that rotates at the tremor's frequency, decays slowly and is excited by noise; its first
        # component has a standard deviation of one.
        keep = math.exp(-2.0 * math.pi * TREMOR_BANDWIDTH * duration)
        angle = 2.0 * math.pi * TREMOR_FREQUENCY * duration
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        kick = self._generator.standard_normal((3, 2)) * math.sqrt(1.0 - keep**2)
        self._state = keep * self._state @ turn + kick
        return np.asarray(self._amplitude * self._state[:, 0])


class _Reaction:
    """A policy's actions with delay, gain and tremor."""

    def __init__(
        self, policy: Policy, generator: np.random.Generator | None, delay: float, tremor: float, gain: float
    ) -> None:
        if not 0.0 <= delay < math.inf:
            raise ValueError(f"reaction_delay must be zero or more and finite, got {delay!r}")
        if not 0.0 < gain <= 1.0:
            raise ValueError(f"gain must be positive and 1 at most, got {gain!r}")
        self._policy = policy
        self._delay, self._gain = delay, gain
        self._tremor = Tremor(tremor, generator if generator is not None else np.random.default_rng(0))
        self._wanted: deque[FloatArray] = deque()

    def forget(self) -> None:
        """Discard the actions of the last episode."""
        self._wanted.clear()

    def action(self, observation: Any, period: float) -> FloatArray:
        """(A,) action to take now, fractions of the greatest velocities."""
        self._wanted.append(np.asarray(self._policy(observation), dtype=np.float64))
        late = round(self._delay / period)
        wanted = self._wanted[0] if len(self._wanted) > late else np.zeros_like(self._wanted[0])
        while len(self._wanted) > late:
            self._wanted.popleft()
        action = self._gain * wanted
        action[:3] += self._tremor.step(period)
        return np.clip(action, -1.0, 1.0)


class ScriptedOperator(TeleopDevice):
    """A policy as a rate device.

    `FalconTeleop` passes it every observation; the policy's action takes effect a `reaction_delay` later, with a
    tremor. Its clock is that of the episodes.

    Attributes:
        operator: "scripted".
    """

    kind = "rate"
    operator: ClassVar[str] = "scripted"

    def __init__(
        self,
        policy: Policy,
        generator: np.random.Generator | None = None,
        *,
        reaction_delay: float = 0.0,
        tremor: float = 0.0,
        gain: float = 1.0,
    ) -> None:
        """Store the policy and the operator's properties.

        Args:
            policy: Policy of the operator, for example an expert.
            generator: Source of the tremor; None for a generator with seed 0.
            reaction_delay: Delay of its actions, rounded to control steps [s].
            tremor: Standard deviation of its tremor along each axis, as a share of the greatest speed.
            gain: Factor on the policy's actions. A feedback policy oscillates if it acts late; at a lower gain it does
                not.

        Raises:
            ValueError: If a number is out of its range.
        """
        self.name = "scripted operator"
        self._reaction = _Reaction(policy, generator, reaction_delay, tremor, gain)
        self._is_open = False
        self._time = 0.0
        self._sequence = 0
        self._action: FloatArray = np.zeros(3)
        self._names: tuple[str, ...] = ("velocity_x", "velocity_y", "velocity_z")

    @property
    def is_open(self) -> bool:
        """See `TeleopDevice`."""
        return self._is_open

    def open(self) -> None:
        """See `TeleopDevice`."""
        self._is_open = True

    def watch(self, observation: Any, env: gymnasium.Env[Any, Any]) -> None:
        """See `Watching`."""
        if _is_beginning(env):
            self._reaction.forget()
        made: Any = env.unwrapped
        period = made.steps_per_action * made.simulation.dt
        self._names = made.control.names
        self._action = self._reaction.action(observation, period)
        self._time += period
        self._sequence += 1

    def read(self) -> DeviceSample:
        """See `TeleopDevice`."""
        if not self._is_open:
            raise DeviceError(f"the {self.name} is not open: call open(), or use it in a with statement")
        return DeviceSample("rate", self._time, self._sequence, None, self._action[:3], np.zeros(3))

    def extra_rates(self) -> Mapping[str, float]:
        """See `HasExtraRates`."""
        return dict(zip(self._names[3:], self._action[3:].tolist(), strict=False))

    def close(self) -> None:
        """See `TeleopDevice`."""
        self._is_open = False

    def now(self) -> float:
        """Time for which the operator has acted [s]."""
        return self._time


class EmulatedFalcon(Falcon):
    """A Falcon that exists in software only: the driver on an emulator, homed, without a thread of its own.

    Attributes:
        emulator: The emulated device and the hand on it.
    """

    def __init__(
        self,
        hand: Hand | None = None,
        clock: Clock | None = None,
        mechanism: Mechanism | None = None,
        **options: Any,
    ) -> None:
        """Make the emulator and its driver.

        Args:
            hand: What holds the grip; None for a hand at rest.
            clock: The clock; None for a simulated one, which advances only in `sleep` and `exchange`.
            mechanism: Weight, friction and elasticity of the links; None for an ideal mechanism.
            **options: Arguments of `Falcon`.
        """
        self.emulator = FalconEmulator(hand, clock=clock, homed=True, mechanism=mechanism)
        time = self.emulator.clock
        super().__init__(
            transport=self.emulator.connect,
            **{"threaded": False, "clock": time.now, "sleep": time.sleep, **options},
        )

    def sleep(self, duration: float) -> None:
        """Wait by the emulator's clock [s]."""
        self.emulator.clock.sleep(duration)


class ScriptedFalcon(HapticDevice):
    """A policy whose simulated hand moves the grip of an emulated Falcon and feels the forces.

    Everything between the hand and the action is the same as for a human: mechanism, encoders, USB packets, driver,
    haptic loop, clutch. It runs in simulated time: as fast as the machine allows, and reproducibly.

    Attributes:
        operator: "scripted".
        hand: The hand that holds the grip.
    """

    operator: ClassVar[str] = "scripted"

    def __init__(
        self,
        policy: Policy,
        generator: np.random.Generator | None = None,
        settings: HapticSettings | None = None,
        *,
        reaction_delay: float = 0.0,
        tremor: float = 0.0,
        gain: float = 1.0,
    ) -> None:
        """Set up the operator and the device.

        Args:
            policy: Policy of the operator, for example an expert.
            generator: Source of the tremor; None for a generator with seed 0.
            settings: Gains of the haptic loop.
            reaction_delay: Delay of its actions, rounded to control steps [s].
            tremor: Standard deviation of its tremor along each axis, as a share of the greatest speed.
            gain: Factor on the policy's actions. A feedback policy oscillates if it acts late; at a lower gain it does
                not.

        Raises:
            ValueError: If a number is out of its range.
        """
        self._arm = _Arm()
        self.hand = ElasticHand(self._arm, stiffness=ARM_STIFFNESS, damping=ARM_DAMPING)
        self._reaction = _Reaction(policy, generator, reaction_delay, tremor, gain)
        self._owed: FloatArray = np.zeros(0)
        self._falcon = EmulatedFalcon(self.hand)
        super().__init__(lambda: self._falcon, settings, where="here", exchange=True)

    def watch(self, observation: Any, env: gymnasium.Env[Any, Any]) -> None:
        """See `Watching`."""
        made: Any = env.unwrapped
        control = made.control
        period = made.steps_per_action * made.simulation.dt
        if _is_beginning(env):
            self._reaction.forget()
            self._owed = np.zeros(control.size - 3)
        action = self._reaction.action(observation, period)
        clutched = self._arm.move(self._falcon.now(), control.max_speed * action[:3])
        held = ["center"] if clutched else []
        self._falcon.emulator.press([*held, *self._buttons(action[3:])])

    def _buttons(self, extras: FloatArray) -> list[str]:
        """Buttons for the first of an action's further numbers: pulsed on and off so that the mean rate is right."""
        if len(extras) == 0:
            return []
        self._owed = np.clip(self._owed + extras, -1.0, 1.0)
        if abs(self._owed[0]) < 0.5:
            return []
        sign = math.copysign(1.0, self._owed[0])
        self._owed[0] -= sign
        return ["plus" if sign > 0.0 else "minus"]


class _Arm:
    """Where a scripted operator wants the grip, over time: motion at a constant velocity that is updated regularly."""

    def __init__(self) -> None:
        self._from: FloatArray = np.zeros(3)
        self._velocity: FloatArray = np.zeros(3)
        self._since = 0.0
        self._returning = False

    def __call__(self, time: float) -> tuple[float, float, float]:
        """The target position in the Falcon's frame [m]."""
        x, y, z = np.clip(self._place(time), -REACH, REACH).tolist()
        return position_to_falcon((x, y, z))

    def move(self, time: float, velocity: FloatArray) -> bool:
        """Continue with a new velocity (3,), device frame [m/s]; True if the clutch is to be held on the way back."""
        self._from = np.clip(self._place(time), -REACH, REACH)
        self._since = time
        distance = float(np.linalg.norm(self._from))
        if not self._returning and (np.abs(self._from) >= REACH).any():
            self._returning = True
        elif self._returning and distance < RETURNED:
            self._returning = False
        self._velocity = (
            -self._from * (RETURN_SPEED / max(distance, RETURN_SPEED * 0.05)) if self._returning else velocity
        )
        return self._returning

    def _place(self, time: float) -> FloatArray:
        return np.asarray(self._from + self._velocity * (time - self._since))


def device_position(emulator: FalconEmulator) -> FloatArray:
    """Position (3,) of an emulated Falcon's grip, device frame [m]."""
    return np.array(position_to_device(emulator.grip))


def _is_beginning(env: gymnasium.Env[Any, Any]) -> bool:
    """Whether the episode has just been reset."""
    made: Any = env.unwrapped
    return bool(made.simulation.time == 0.0)
