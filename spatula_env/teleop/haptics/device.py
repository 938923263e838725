"""A haptic device with its loop: it is told what the tool feels and renders it to the hand."""

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
"""Where the loop can run: see `HapticDevice`."""


class HapticDevice(TeleopDevice):
    """A position device with force feedback, and the haptic loop between it and a simulation.

    Call `tell` whenever the simulation has something new; the loop renders it to the hand. If the calls stop, the force
    ends.

    Where the loop runs:

    - "process": in a process of its own, with shared memory in between. The simulation's Python code cannot delay it.
    - "thread": in a thread. Python runs one thread at a time, so the simulation delays the loop.
    - "here": only within `sleep`, which runs the loop while it waits. For a simulated clock; reproducible.

    Example:
        >>> from functools import partial
        >>> from spatula_env.teleop.falcon import Falcon
        >>> from spatula_env.teleop.haptics import HapticDevice
        >>> device = HapticDevice(partial(Falcon, threaded=False), exchange=True)
        >>> with device:  # doctest: +SKIP
        ...     device.calibrate(print)
        ...     device.tell(position=(0.0, 0.0, -0.01), force=(0.0, 0.0, 1.5))

    Attributes:
        settings: Gains of the loop.
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
        """Store the settings of the device; `open` opens it.

        Args:
            factory: Makes the device in the place where the loop runs. For "process" it has to be picklable.
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
        # Also runs when the object is garbage collected and at the interpreter's exit; must not refer to this object.
        self._finish = weakref.finalize(self, runner.close)
        self._runner = runner

    def calibrate(self, progress: Progress | None = None) -> None:
        """See `TeleopDevice`; starts the loop afterwards."""
        self._open_runner().calibrate(progress)

    def read(self) -> DeviceSample:
        """See `TeleopDevice`."""
        return self._open_runner().read()

    def tell(self, position: ArrayLike | None, force: ArrayLike, shift: ArrayLike = ZERO) -> None:
        """Report what the tool feels. The force on the hand lasts for `stall_time`; report again before it is over.

        Args:
            position: Grip position that corresponds to the tool's position, shape (3,), device frame [m]. None if hand
                and tool are not coupled.
            force: Force of the organ on the tool, shape (3,), device frame [N].
            shift: Part of `position` that comes from how hand and tool are matched, shape (3,) [m]. It changes when
                they are matched anew; the rest of the position moves only when the tool moves.

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
        """Bound the grip positions that the tool can follow. Soft walls push back beyond them, from the next `tell` on.

        Args:
            low: Lowest corner, shape (3,), device frame [m]; None for no bounds.
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
        """`tell` without a position: the force alone, filtered and limited."""
        self.tell(None, force)

    def release(self) -> None:
        """End the force now, as at the end of an episode. Does nothing if the device is lost or closed."""
        if self._runner is not None:
            self._runner.tell(None)

    @property
    def force(self) -> FloatArray:
        """(3,) force last rendered to the hand, device frame [N]."""
        return np.array(self._open_runner().force)

    @property
    def renderer(self) -> ForceRenderer | None:
        """The renderer that makes the forces, for inspection, if it is in this process; None otherwise."""
        loop = getattr(self._open_runner(), "loop", None)
        return loop.renderer if isinstance(loop, HapticLoop) else None

    def sleep(self, duration: float) -> None:
        """Wait; with "here" the loop runs meanwhile.

        Args:
            duration: How long [s].
        """
        self._open_runner().sleep(duration)

    def ask(self, question: Callable[[TeleopDevice], Answer]) -> Answer:
        """Call a function with the underlying device, where the loop runs, between two of its cycles.

        The loop waits meanwhile, and a force on the motors stays. In contact, ask only quick questions, or `release`
        first.

        Args:
            question: Function to call. For "process", it and its result have to be picklable.

        Returns:
            Its result.
        """
        return self._open_runner().ask(question)

    def statistics(self) -> LoopStatistics:
        """Statistics of how regularly the loop ran.

        Raises:
            DeviceError: If the device is not open.
        """
        return self._open_runner().statistics()

    def keep_track(self, seconds: float) -> None:
        """Record every cycle from now on: time, grip, forces, buttons.

        Args:
            seconds: Longest time to record; memory for it is allocated in advance. 0 stops the recording.

        Raises:
            NotCalibrated: If the loop is not running yet.
        """
        self._open_runner().keep_track(seconds)

    def take_track(self) -> HapticTrack:
        """The samples recorded since the last call. The loop waits meanwhile, so best call it without force."""
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
