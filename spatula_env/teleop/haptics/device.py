"""A haptic device with its loop: it is told what the tool feels, and lets the hand feel it."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from spatula_env.teleop.device import (
    DeviceError,
    DeviceSample,
    FloatArray,
    Progress,
    TeleopDevice,
    check_force,
)
from spatula_env.teleop.haptics.contact import ZERO, Contact, LoopStatistics, Vector
from spatula_env.teleop.haptics.loop import HapticLoop
from spatula_env.teleop.haptics.remote import RemoteLoop
from spatula_env.teleop.haptics.rendering import ForceRenderer
from spatula_env.teleop.haptics.runner import Answer, Factory, LocalLoop, Runner
from spatula_env.teleop.haptics.settings import HapticSettings
from spatula_env.teleop.haptics.track import HapticTrack

Where: TypeAlias = Literal["process", "thread", "here"]

PLACES = ("process", "thread", "here")
"""Where the loop can run."""


class HapticDevice(TeleopDevice):
    """A position device with force, and the haptic loop between it and a simulation.

    `tell` is called as often as the simulation has something new, and the loop makes of it what the hand feels. What
    ends the calls ends the force.

    Where the loop runs:

    - "process": in a process of its own, with shared memory in between. The simulation's Python cannot delay it.
    - "thread": in a thread. Python lets one thread run at a time, and the simulation delays the loop.
    - "here": nowhere by itself; `sleep` goes round while it waits. For a simulated clock: always the same.

    Example:
        >>> from functools import partial
        >>> from spatula_env.teleop.falcon import Falcon
        >>> from spatula_env.teleop.haptics import HapticDevice
        >>> device = HapticDevice(partial(Falcon, threaded=False), exchange=True)
        >>> with device:  # doctest: +SKIP
        ...     device.calibrate(print)
        ...     device.tell(position=(0.0, 0.0, -0.01), force=(0.0, 0.0, 1.5))

    Attributes:
        settings: The gains.
        where: Where the loop runs.
    """

    kind = "position"
    has_force = True

    def __init__(
        self,
        factory: Factory,
        settings: HapticSettings | None = None,
        *,
        where: Where = "process",
        exchange: bool = False,
    ) -> None:
        """Describe the device; `open` opens it.

        Args:
            factory: Makes the device, where the loop runs. With "process" it must be possible to pickle it.
            settings: The gains; None for the defaults.
            where: Where the loop runs.
            exchange: Whether the device has no thread of its own, so that the loop has to call its method `exchange`.

        Raises:
            ValueError: If `where` is not one of `PLACES`.
        """
        if where not in PLACES:
            raise ValueError(f"where must be one of {list(PLACES)}, got {where!r}")
        self.name = "haptic device"
        self.settings = settings if settings is not None else HapticSettings()
        self.where = where
        self._factory = factory
        self._exchange = exchange
        self._runner: Runner | None = None
        self._room: tuple[Vector, Vector] | None = None
        self._finish: Callable[[], object] | None = None

    @property
    def is_open(self) -> bool:
        """See `TeleopDevice`."""
        return self._runner is not None

    @property
    def is_calibrated(self) -> bool:
        """See `TeleopDevice`."""
        return self._runner is not None and self._runner.is_calibrated

    def open(self) -> None:
        """See `TeleopDevice`; also starts the loop, if the device is calibrated."""
        if self._runner is not None:
            return
        runner: Runner
        if self.where == "process":
            runner = RemoteLoop(self._factory, self.settings, self._exchange)
        else:
            runner = LocalLoop(self._factory, self.settings, self._exchange, threaded=self.where == "thread")
        described = runner.description
        self.name, self.button_names = described.name, described.button_names
        self.workspace_low, self.workspace_high = described.workspace_low, described.workspace_high
        self.greatest_force = described.greatest_force
        self.greatest_stiffness, self.greatest_damping = described.greatest_stiffness, described.greatest_damping
        # Also when the object is forgotten, and at the interpreter's end; must not refer to this object.
        self._finish = weakref.finalize(self, runner.close)
        self._runner = runner

    def calibrate(self, progress: Progress | None = None) -> None:
        """See `TeleopDevice`; starts the loop afterwards."""
        self._open_runner().calibrate(progress)

    def read(self) -> DeviceSample:
        """See `TeleopDevice`."""
        return self._open_runner().read()

    def tell(self, position: ArrayLike | None, force: ArrayLike, shift: ArrayLike = ZERO) -> None:
        """Tell what the tool feels. The force on the hand lasts for `stall_time`, and is to be told anew before.

        Args:
            position: Where the grip would be if it were where the tool is, shape (3,), device's frame [m]. None: hand
                and tool are not coupled.
            force: What the organ does to the tool, shape (3,), device's frame [N].
            shift: How much of the position is a matter of how hand and tool are matched, shape (3,) [m]: it changes
                when they are matched anew, and what is left of the position moves only as the tool does.

        Raises:
            ValueError: If one has another shape or is not finite.
            DeviceLost: If the device does not answer any more.
            DeviceError: If it is not open.
        """
        runner = self._open_runner()
        place = None if position is None else _as_vector(check_force(position))
        low, high = self._room if self._room is not None else (None, None)
        felt, matched = _as_vector(check_force(force)), _as_vector(check_force(shift))
        runner.tell(Contact(runner.now(), place, felt, low, high, matched))

    def confine(self, low: ArrayLike | None, high: ArrayLike | None) -> None:
        """Tell where the grip may be for the tool to follow: beyond, soft walls push it back, from the next `tell` on.

        Args:
            low: Lowest corner, shape (3,), device's frame [m]; None: anywhere.
            high: Highest corner [m].

        Raises:
            ValueError: If one has another shape or is not finite, or one is missing.
        """
        if (low is None) != (high is None):
            raise ValueError(f"low and high must both be given, or none of them, got {low!r} and {high!r}")
        if low is None or high is None:
            self._room = None
        else:
            self._room = _as_vector(check_force(low)), _as_vector(check_force(high))

    def send_force(self, force: ArrayLike) -> None:
        """`tell` without a place: the force alone, filtered and limited."""
        self.tell(None, force)

    def release(self) -> None:
        """End the force now, as when an episode ends. Nothing happens if the device is lost or closed."""
        if self._runner is not None:
            self._runner.tell(None)

    @property
    def force(self) -> FloatArray:
        """(3,) what the hand was last made to feel, device's frame [N]."""
        return np.array(self._open_runner().force)

    @property
    def renderer(self) -> ForceRenderer | None:
        """What makes the forces, to be looked at, if it is in this process."""
        loop = getattr(self._open_runner(), "loop", None)
        return loop.renderer if isinstance(loop, HapticLoop) else None

    def sleep(self, duration: float) -> None:
        """Wait; with "here" the loop goes round meanwhile.

        Args:
            duration: How long [s].
        """
        self._open_runner().sleep(duration)

    def ask(self, question: Callable[[TeleopDevice], Answer]) -> Answer:
        """Call a function with the device itself, where the loop runs, between two of its cycles.

        Args:
            question: What to call. With "process" it and its result must be possible to pickle.

        Returns:
            Its result.
        """
        return self._open_runner().ask(question)

    def statistics(self) -> LoopStatistics:
        """How regularly the loop went round.

        Raises:
            DeviceError: If the device is not open.
        """
        return self._open_runner().statistics()

    def keep_track(self, seconds: float) -> None:
        """Keep what happens in every cycle from now on: time, grip, forces, buttons.

        Args:
            seconds: For how long at most; there is a place for it beforehand. 0: keep nothing any more.

        Raises:
            NotCalibrated: If the loop does not run yet.
        """
        self._open_runner().keep_track(seconds)

    def take_track(self) -> HapticTrack:
        """The samples kept since the last call; the loop waits meanwhile, so best while there is no force."""
        return self._open_runner().take_track()

    def close(self) -> None:
        """See `TeleopDevice`."""
        finish, self._finish, self._runner = self._finish, None, None
        if finish is not None:
            finish()

    def now(self) -> float:
        """See `TeleopDevice`."""
        return self._open_runner().now()

    def _open_runner(self) -> Runner:
        if self._runner is None:
            raise DeviceError(f"the {self.name} is not open: call open(), or use it in a with statement")
        return self._runner


def _as_vector(array: FloatArray) -> Vector:
    x, y, z = array.tolist()
    return x, y, z
