"""A Gymnasium wrapper through which an operator acts, instead of an agent or by taking over from it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Literal, Protocol, SupportsFloat, TypeAlias, runtime_checkable

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spatula_env.envs.steering import STEERING, Pilot, mean_of_track
from spatula_env.geometry.checks import check_positive
from spatula_env.tasks.plain import as_plain
from spatula_env.teleop.device import DeviceError, DeviceSample, FloatArray, TeleopDevice
from spatula_env.teleop.haptics.device import HapticDevice
from spatula_env.teleop.haptics.settings import HapticSettings
from spatula_env.teleop.haptics.tap import EnvironmentTap
from spatula_env.teleop.registry import make_device

Mode: TypeAlias = Literal["auto", "position", "rate"]
Intervention: TypeAlias = Literal["always", "button", "motion"]

MODES = ("auto", "position", "rate")
INTERVENTIONS = ("always", "button", "motion")

CENTRE_ZONE = 0.1
"""Share of a position device's half workspace in which it commands no rate."""
STANDSTILL, UNUSUAL = 0.04, 3.0
"""Hand and tool are matched anew after a pause between physics steps that is longer than the first [s] and longer than
the second times the pause before."""
RETURN = 0.1
"""Time after that in which the tool goes no deeper, while the force comes back [s]."""
CENTRED = 0.006
"""Distance from the goal at which the grip counts as centred [m]."""
CENTRING_TIME, CENTRING_LOOK = 20.0, 0.02
"""Longest time to wait for the operator, and interval at which the grip is checked [s]."""
TELL_AGAIN = 5.0
"""Least time between two messages of the same kind to the operator [s]."""
PACE_TIME, SLOW = 1.0, 0.9
"""Time over which the simulation's pace is measured [s], and share of real time below which it counts as slow."""
WAYS = (("to the right", "to the left"), ("away from you", "towards you"), ("up", "down"))
"""Words for the directions along the device's axes."""
BEHIND = 2.0
"""Delay behind real time, in control periods, beyond which the simulation no longer tries to catch up."""


@runtime_checkable
class HasExtraRates(Protocol):
    """A device that commands more than three rates."""

    def extra_rates(self) -> Mapping[str, float]:
        """Fractions in [-1, 1] of the greatest rates, by names of action components: "rotation_x", "jaw_speed" …."""


@runtime_checkable
class HasSteering(Protocol):
    """A device, such as a recording, that knows its command for each physics step."""

    def steering(self) -> NDArray[np.float32] | None:
        """(S, A) commands for the S physics steps of the coming control step; None to use `read` for all of them."""


@runtime_checkable
class Watching(Protocol):
    """A device, such as a scripted operator, that acts on observations."""

    def watch(self, observation: Any, env: gymnasium.Env[Any, Any]) -> None:
        """Receive the current observation, once per control step.

        Args:
            observation: Observation of the environment.
            env: The environment.
        """


class FalconTeleop(gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs):
    """Takes actions from a `TeleopDevice`, such as a Falcon, and renders the contact force to the hand.

    *Position mode*: the tool follows the grip's position, one to one (`scale`). At the beginning of an episode, and
    when the operator takes over from a policy, the two are matched where they are, so that nothing jumps. While the
    clutch is held, the tool stands still, no force is rendered, and the grip can be moved to a more comfortable place.
    The tool follows the grip in every physics step, with the velocity that brings it to the grip's position within that
    step, clipped: following the hand late would delay the force, and a delayed spring gives out more energy than it
    took in. What the hand did in a control step is ``info["steering"]``, its mean ``info["action"]``.

    *Rate mode*: the deflection is the velocity. A position device then has a dead zone around its centre, like a stick.

    Further components of an action, rotations and jaws, come from `HasExtraRates` or from two buttons: "plus" and
    "minus" move the first of them, and every press of "forward" selects the next.

    *Force*: a `HapticDevice` is told after every physics step what the tool feels, and its own loop renders it. Any
    other device with force gets the force itself, held in between. Whatever ends an episode or the wrapper ends the
    force.

    *Intervention*: with "always", the operator acts all the time, and `step` may be given None. With "button" and
    "motion", the action given to `step` is used until the operator holds a button or moves.

    Added to `info`, by `reset` too: ``acted_by`` ("human", "policy" or "scripted"), ``intervened`` (whether a policy's
    action was replaced), and ``action`` (the action taken; its mean, if it changed within the control step). In
    position mode there is ``steering`` as well, (S, A) float32: the commands of the S physics steps, NaN where the tool
    was not steered. `SpatulaEnv.steer` can repeat them bit by bit.

    Example:
        >>> import gymnasium as gym
        >>> import spatula_env
        >>> from spatula_env.teleop.registry import make_device
        >>> from spatula_env.teleop.wrapper import FalconTeleop
        >>> with make_device("falcon") as device:  # doctest: +SKIP
        ...     device.calibrate(print)
        ...     env = FalconTeleop(gym.make("Spatula/Press-v0"), device)
        ...     observation, info = env.reset(seed=0)
        ...     observation, reward, terminated, truncated, info = env.step()

    Attributes:
        device: The operator's device; opened and closed by the caller who made it.
        mode: "position" or "rate".
        pressed: Names of the buttons that were held down in the last step.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        device: TeleopDevice | str | None,
        *,
        mode: Mode = "auto",
        scale: float = 1.0,
        clutch: str = "center",
        intervention: Intervention = "always",
        intervention_button: str = "center",
        motion_threshold: float | None = None,
        release_time: float = 1.0,
        real_time: bool = True,
        buttons: Mapping[str, str] | None = None,
        centring: bool = False,
        tell: Callable[[str], None] | None = None,
        now: Callable[[], float] | None = None,
        sleep: Callable[[float], None] | None = None,
    ) -> None:
        """Connect a device and an environment.

        Args:
            env: One of the Spatula environments, for one agent, wrapped or not.
            device: Open and calibrated by the time of `reset`. Or its name, one of `registry.DEVICES`: it is then made
                here, and the caller opens and closes the attribute `device`. An environment specification keeps a name,
                but no device.
            mode: "auto" chooses by the kind of device.
            scale: Ratio of the tool's motion to the grip's, in position mode; forces are not scaled by it.
            clutch: Button that uncouples grip and tool, in position mode.
            intervention: When the operator acts.
            intervention_button: Button with which the operator takes over; for "button". It is then not used as clutch.
            motion_threshold: Speed of the grip [m/s], or deflection of a rate device, with which the operator takes
                over; for "motion". By default 0.02 m/s, or a tenth of the full deflection.
            release_time: Time that the operator has to be still before the policy acts again; for "motion" [s].
            real_time: Whether every physics step waits for its time. If not, the environment runs as fast as it can; a
                `HapticDevice` whose loop runs "here" is always waited for.
            buttons: Renames buttons of the device, from its own names to others: {"forward": "finish"}.
            centring: Whether the grip of a position device is brought to the position that corresponds to the tool's
                before each episode, so that the whole task is in reach: `tell` directs the operator, who is waited for.
            tell: Receives messages for the operator: where to bring the grip, and that the simulation is slow.
            now: Returns the time; by default the device's clock [s].
            sleep: Waits by that clock; by default the device's `sleep`, if it has one.

        Raises:
            ValueError: If an argument is invalid, or the device cannot provide what `mode` asks for.
            TypeError: If `env` is not one of this package, or there is no device.
        """
        # A device is a physical object and a clock cannot be serialised, so a specification can hold neither.
        arguments = {
            "mode": mode,
            "scale": scale,
            "clutch": clutch,
            "intervention": intervention,
            "intervention_button": intervention_button,
            "motion_threshold": motion_threshold,
            "release_time": release_time,
            "real_time": real_time,
            "buttons": dict(buttons) if buttons is not None else None,
            "centring": centring,
        }
        gymnasium.utils.RecordConstructorArgs.__init__(
            self, device=device if isinstance(device, str) else None, **as_plain(arguments)
        )
        gymnasium.Wrapper.__init__(self, env)
        device = self.device = _find_device(device)
        _check_choice(mode, "mode", MODES)
        _check_choice(intervention, "intervention", INTERVENTIONS)
        _check_mode(mode, device)
        if motion_threshold is None:
            motion_threshold = 0.02 if device.kind == "position" else 0.1
        for name, value in (("scale", scale), ("motion_threshold", motion_threshold), ("release_time", release_time)):
            check_positive(value, name)
        self.mode: Literal["position", "rate"] = device.kind if mode == "auto" else mode
        self.pressed: frozenset[str] = frozenset()
        self._scale = scale
        self._buttons = dict(buttons) if buttons is not None else {}
        _check_buttons(self._buttons, device)
        self._centring = centring and self.mode == "position"
        self._tell: Callable[[str], None] = tell if tell is not None else _tell_nobody
        self._pace = Pace()
        self._clutch = None if intervention == "button" and intervention_button == clutch else clutch
        self._intervention: Intervention = intervention
        self._intervention_button = intervention_button
        self._motion_threshold, self._release_time = motion_threshold, release_time
        # A haptic loop that runs only within `sleep` has a time of its own, in which waiting costs nothing.
        self._real_time = real_time or (isinstance(device, HapticDevice) and device.where == "here")
        self._now = now if now is not None else device.now
        self._sleep: Callable[[float], None] = sleep if sleep is not None else getattr(device, "sleep", time.sleep)
        self._tap = EnvironmentTap(env)
        self._extras, self._extra = self._tap.control.names[3:], 0
        self._operator = str(getattr(device, "operator", "human"))
        self._offset: FloatArray | None = None
        self._sample: DeviceSample | None = None
        self._track: list[NDArray[np.float32]] = []
        self._lost = self._acting = False
        self._told, self._pause = -math.inf, 0.0
        self._yields_until = -math.inf
        self._into: FloatArray = np.zeros(3)
        self._still_for = math.inf
        self._due: float | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """See `gymnasium.Env.reset`. The force is zero, and grip and tool are matched where they are."""
        self.let_go()
        observation, info = self.env.reset(seed=seed, options=options)
        self._offset, self._due, self._lost, self._track = None, None, False, []
        self._into = np.zeros(3)
        self._extra, self._still_for = 0, math.inf
        self._acting = self._intervention == "always"
        self._show(observation)
        if self._centring:
            self._centre()
        self._pace.begin()
        sample = self._read()
        self.pressed = sample.buttons
        by = self._operator if self._acting else "policy"
        return observation, self._inform(info, by, False, np.zeros(self.action_space.shape or (), dtype=np.float32))

    def step(self, action: Any = None) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """See `gymnasium.Env.step`.

        Args:
            action: The policy's action; None if the operator always acts.

        Raises:
            DeviceLost: If the device no longer answers. The force is zero, and nothing has changed: after opening the
                device again, continue with `step`.
            ValueError: If there is no policy's action while the operator does not act.
        """
        try:
            sample = self._read()
        except DeviceError:
            self.let_go()
            self._offset = None
            raise
        if self._lost:
            # Match anew: the hand may be anywhere by now.
            self._offset, self._lost = None, False
        rates = self._rates(sample)
        acting = self._who(sample, rates)
        if acting and not self._acting:
            self._offset = None
        self._acting = acting
        by = self._operator if acting else "policy"
        if acting:
            chosen = np.asarray(np.clip(rates, -1.0, 1.0), dtype=np.float32)
        elif action is None:
            raise ValueError(f"action must be given, as intervention is {self._intervention!r} and nobody intervenes")
        else:
            chosen = np.asarray(action, dtype=np.float32)
        self._sample, self.pressed = sample, sample.buttons
        pilot = self._pilot() if acting else None
        self._track = []
        self._confine()
        try:
            self._tap.install(self._after_physics, pilot)
            observation, reward, terminated, truncated, info = self.env.step(chosen)
        except BaseException:
            self.let_go()
            raise
        finally:
            self._tap.remove()
        if pilot is not None:
            chosen = np.asarray(mean_of_track(np.array(self._track, dtype=np.float64)), dtype=np.float32)
        if terminated or truncated:
            self.let_go()
        self._show(observation)
        intervened = acting and self._intervention != "always"
        return observation, reward, terminated, truncated, self._inform(info, by, intervened, chosen)

    def close(self) -> None:
        """End the force and close the environment. The device is left open."""
        self.let_go()
        super().close()

    # The operator's commands.

    def _who(self, sample: DeviceSample, rates: FloatArray) -> bool:
        """Whether the operator acts in this step."""
        if self._intervention == "always":
            return True
        if self._intervention == "button":
            return self._intervention_button in sample.buttons
        extra = any(rates[3:])
        if sample.kind == "position":
            moves = extra or float(np.linalg.norm(sample.velocity)) > self._motion_threshold
        else:
            moves = bool(np.abs(rates).max() > self._motion_threshold)
        self._still_for = 0.0 if moves else self._still_for + self._tap.period
        return self._still_for < self._release_time

    def _pilot(self) -> Pilot | None:
        """Function that steers in the coming control step; None if the control step's action is used throughout."""
        if self.mode == "position":
            return self._steer
        track = self.device.steering() if isinstance(self.device, HasSteering) else None
        if track is None:
            return None
        rows = iter(track)

        def repeat(_: FloatArray) -> NDArray[np.float32]:
            self._track.append(next(rows))
            return self._track[-1]

        return repeat

    def _steer(self, grip: FloatArray) -> NDArray[np.float32]:
        """The operator's action for the coming physics step."""
        now = self.device.now()
        pause, self._told = now - self._told, now
        if pause > max(STANDSTILL, UNUSUAL * self._pause):
            # The hand has moved on without the tool: to follow it now would make the tool plunge.
            self._offset = None
            if math.isfinite(pause):
                self._yields_until = now + RETURN
        self._pause = pause
        if self._track:
            # The first physics step uses the sample that the control step was decided by.
            try:
                self._sample = self._read()
            except DeviceError:
                # Finish the control step without the device; the next step raises the error.
                self.let_go()
                self._lost = True
        sample = self._sample
        assert sample is not None
        assert sample.position is not None
        chosen = np.zeros(3 + len(self._extras))
        if not self._lost:
            self.pressed |= sample.buttons
            chosen[3:] = self._extra_rates(sample)
            if self._offset is None or self._clutch in sample.buttons:
                self._offset = grip - self._scale * sample.position
                self._confine()
            wanted = self._scale * sample.position + self._offset
            deeper = float((wanted - grip) @ self._into)
            if now < self._yields_until and deeper > 0.0:
                # The force is still coming back: the hand must not press deeper while it cannot feel the contact.
                self._offset = self._offset - deeper * self._into
                wanted = wanted - deeper * self._into
            chosen[:3] = (wanted - grip) / (self._tap.time_step * self._tap.control.max_speed)
        action = np.asarray(np.clip(chosen, -1.0, 1.0), dtype=np.float32)
        self._track.append(action)
        return action

    def _read(self) -> DeviceSample:
        """The device's sample, with its buttons renamed."""
        sample = self.device.read()
        if not self._buttons or not sample.buttons:
            return sample
        return replace(sample, buttons=frozenset(self._buttons.get(name, name) for name in sample.buttons))

    def _confine(self) -> None:
        """Tell a haptic device in which region the tool follows the hand."""
        if not isinstance(self.device, HapticDevice):
            return
        if self._offset is None or not self._acting or self.mode != "position":
            # The tool does not follow the hand at all, so there are no bounds.
            self.device.confine(None, None)
            return
        low, high = self._tap.reach()
        self.device.confine((low - self._offset) / self._scale, (high - self._offset) / self._scale)

    def _centre(self) -> None:
        """Ask the operator to bring the grip to the tool's position in its workspace, and wait until it is there."""
        low, high = self.device.workspace_low, self.device.workspace_high
        goal = self._tap.grip() / self._scale
        if low is not None and high is not None:
            goal = np.clip(goal, low + CENTRED, high - CENTRED)
        deadline = self._now() + CENTRING_TIME
        told = -math.inf
        while self._now() < deadline:
            sample = self._read()
            assert sample.position is not None
            away = goal - sample.position
            if float(np.linalg.norm(away)) < CENTRED or sample.buttons:
                break
            if self._now() - told > TELL_AGAIN:
                told = self._now()
                self._tell(f"Bring the grip {way_in_words(away)}; any button goes on from where it is.")
            self._sleep(CENTRING_LOOK)

    def _rates(self, sample: DeviceSample) -> FloatArray:
        """(A,) rates that the device commands, fractions of the greatest."""
        rates = np.zeros(3 + len(self._extras))
        if sample.rate is not None:
            rates[:3] = sample.rate
        elif self.mode == "rate":
            rates[:3] = _as_stick(sample, self.device)
        if self._extras and "forward" in sample.buttons and "forward" not in self.pressed:
            self._extra = (self._extra + 1) % len(self._extras)
        rates[3:] = self._extra_rates(sample)
        return rates

    def _extra_rates(self, sample: DeviceSample) -> FloatArray:
        """Rates of rotation and jaws, fractions of the greatest."""
        rates = np.zeros(len(self._extras))
        if isinstance(self.device, HasExtraRates):
            named = self.device.extra_rates()
            rates[:] = [named.get(name, 0.0) for name in self._extras]
        elif self._extras:
            rates[self._extra] = float("plus" in sample.buttons) - float("minus" in sample.buttons)
        return rates

    # Feedback to the operator.

    def _after_physics(self, grip: FloatArray, force: FloatArray) -> None:
        """Pass the force to the device, and wait for the time of the physics step."""
        device = self.device
        size = float(np.linalg.norm(force))
        self._into = -force / size if size > 0.0 else np.zeros(3)
        try:
            if isinstance(device, HapticDevice):
                clutched = self._sample is not None and self._clutch in self._sample.buttons
                felt = self._acting and not (clutched and self.mode == "position")
                offset = self._offset if felt and self.mode == "position" else None
                place = None if offset is None else (grip - offset) / self._scale
                shift = np.zeros(3) if offset is None else -offset / self._scale
                device.tell(place, force if felt else np.zeros(3), shift)
            elif device.has_force:
                device.send_force(force if self._acting else np.zeros(3))
        except DeviceError:
            # Finish the control step without the device, so that nothing of the episode is lost; the next step raises
            # it.
            self.let_go()
        if self._real_time:
            self._wait()
            slow = self._pace.step(self._now(), self._tap.time_step)
            if slow is not None:
                self._tell(slow)

    def _wait(self) -> None:
        now = self._now()
        due = self._due if self._due is not None else now
        if now - due > BEHIND * self._tap.period:
            due = now
        self._due = due + self._tap.time_step
        ahead = self._due - now
        # Sleep even without time left, so that other threads, such as the device's, get to run.
        self._sleep(max(ahead, 0.0))

    def let_go(self) -> None:
        """Set the force to zero; the device may be lost or closed."""
        try:
            if isinstance(self.device, HapticDevice):
                self.device.release()
            elif self.device.has_force:
                self.device.send_force(np.zeros(3))
        except DeviceError:
            # The device produces no force any more.
            pass

    def _show(self, observation: Any) -> None:
        if isinstance(self.device, Watching):
            self.device.watch(observation, self)

    def _inform(self, info: dict[str, Any], by: str, intervened: bool, action: NDArray[np.float32]) -> dict[str, Any]:
        told = {**info, "acted_by": by, "intervened": intervened, "action": action.copy()}
        if self.mode == "position" or isinstance(self.device, HasSteering):
            steering = np.full((self._tap.steps, self._tap.control.size), np.nan, dtype=np.float32)
            steering[: len(self._track)] = np.array(self._track).reshape(-1, self._tap.control.size)
            told[STEERING] = steering
        return told


class Pace:
    """Measures how fast simulated time passes, and when to tell the operator that it is slow."""

    def __init__(self) -> None:
        self._start: float | None = None
        self._simulated = 0.0
        self._told = -math.inf

    def begin(self) -> None:
        """Begin an episode: restart the measurement."""
        self._start, self._simulated = None, 0.0

    def step(self, now: float, time_step: float) -> str | None:
        """Count a physics step.

        Args:
            now: The current time [s].
            time_step: Time step of the simulation [s].

        Returns:
            A message for the operator, or None.
        """
        if self._start is None:
            self._start = now
            return None
        self._simulated += time_step
        passed = now - self._start
        if passed < PACE_TIME:
            return None
        share = self._simulated / passed
        self._start, self._simulated = now, 0.0
        if share >= SLOW or now - self._told < TELL_AGAIN:
            return None
        self._told = now
        least = time_step / HapticSettings.longest_stall
        return (
            f"The simulation is slow: {share:.2f} of real time. Forces come late, and below {least:.2f} there are none."
        )


def way_in_words(way: FloatArray) -> str:
    """A displacement (3,) in the device frame [m] in words, for an operator: "12 mm to the right and 5 mm up"."""
    words = [
        f"{1000.0 * abs(part):.0f} mm {names[part < 0.0]}"
        for part, names in zip(way.tolist(), WAYS, strict=True)
        if abs(part) >= 1e-3
    ]
    return " and ".join(words) if words else "nowhere"


def _tell_nobody(_: str) -> None:
    pass


def _as_stick(sample: DeviceSample, device: TeleopDevice) -> FloatArray:
    """Deflection (3,) of a position device from its centre, zero near it."""
    assert sample.position is not None
    low, high = device.workspace_low, device.workspace_high
    if low is None or high is None:
        raise ValueError(f"mode must be 'position' with the {device.name}, whose workspace is not known")
    share = (sample.position - 0.5 * (low + high)) / (0.5 * (high - low))
    beyond = np.maximum(np.abs(share) - CENTRE_ZONE, 0.0) / (1.0 - CENTRE_ZONE)
    return np.asarray(np.sign(share) * np.minimum(beyond, 1.0))


def _check_choice(value: str, name: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise ValueError(f"{name} must be one of {list(allowed)}, got {value!r}")


def _find_device(device: TeleopDevice | str | None) -> TeleopDevice:
    """The given device, or one made by its name."""
    if device is None:
        raise TypeError(
            "device must be a device or the name of one, got None: a specification holds no device; "
            "make the environment without FalconTeleop, and put that around it with a device"
        )
    return make_device(device) if isinstance(device, str) else device


def _check_mode(mode: Mode, device: TeleopDevice) -> None:
    """Raise a ValueError if position mode is asked of a device without positions."""
    if mode == "position" and device.kind != "position":
        raise ValueError(f"mode must be 'rate' or 'auto' with the {device.name}, got {mode!r}")


def _check_buttons(buttons: Mapping[str, str], device: TeleopDevice) -> None:
    """Raise a ValueError if a button is named that the device does not have."""
    unknown = sorted(set(buttons) - set(device.button_names))
    if unknown and device.button_names:
        raise ValueError(
            f"buttons must name buttons of the {device.name} ({', '.join(device.button_names)}), got {unknown}"
        )
