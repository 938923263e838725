"""The interface that every teleoperation device implements, independent of its hardware.

The device frame is the same for all of them: x to the operator's right, y away from the operator, z up, origin in
the middle of the workspace, in metres. Each driver converts from its hardware's own frame.

There are two kinds of device. A *position* device (Novint Falcon, Force Dimension) measures where its grip is; a
*rate* device (gamepad, SpaceMouse, keyboard) measures how far a stick that springs back is deflected.
`DeviceSample.kind` tells them apart.

The vocabulary maps onto LeRobot's `Teleoperator` as follows; the names on the left exist here too:

======================  =================================================
LeRobot                 here
======================  =================================================
``connect()``           ``open()``, and ``calibrate()`` if it is asked to
``is_connected``        ``is_open``
``calibrate()``         ``calibrate()``
``is_calibrated``       ``is_calibrated``
``get_action()``        ``read()``, as a flat dictionary
``send_feedback({…})``  ``send_force((x, y, z))``
``disconnect()``        ``close()``
======================  =================================================
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
Progress = Callable[[str], None]
"""Receives a message for the operator, such as what to do with the grip now."""

_Device = TypeVar("_Device", bound="TeleopDevice")

AXES = ("x", "y", "z")


class DeviceError(RuntimeError):
    """A device failed; the message says what is wrong and what to do about it."""


class DeviceNotFound(DeviceError):
    """The device was not found."""


class DeviceBusy(DeviceError):
    """Another program has the device open."""


class DeviceLost(DeviceError):
    """A device that was open no longer answers."""


class NotCalibrated(DeviceError):
    """The device does not know yet where its grip is because it is not calibrated."""


class FirmwareError(DeviceError):
    """The device's firmware is missing, or could not be loaded."""


@dataclass(frozen=True, eq=False)
class DeviceSample:
    """A device's measurement at one moment.

    Attributes:
        kind: ``"position"`` or ``"rate"``.
        time: When it was measured, on the device's monotonic clock (`TeleopDevice.now`) [s].
        sequence: Counts measurements from 1. Two samples with the same number are the same measurement.
        position: The grip, shape (3,), device's frame [m]; None from a rate device.
        rate: The deflection, shape (3,), each in [-1, 1]; None from a position device.
        velocity: The grip's velocity, shape (3,), device's frame; zeros from a rate device [m/s].
        buttons: Names of the buttons that are held down.
    """

    kind: Literal["position", "rate"]
    time: float
    sequence: int
    position: FloatArray | None
    rate: FloatArray | None
    velocity: FloatArray
    buttons: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        """Check that the sample has what its kind needs, and guard the arrays against writing."""
        if self.kind not in ("position", "rate"):
            raise ValueError(f"kind must be 'position' or 'rate', got {self.kind!r}")
        if (self.position is None) != (self.kind == "rate") or (self.rate is None) != (self.kind == "position"):
            raise ValueError(f"a {self.kind!r} sample must have {self.kind} and only {self.kind}")
        for name in ("position", "rate", "velocity"):
            value = getattr(self, name)
            if value is not None:
                array = np.array(value, dtype=np.float64)
                if array.shape != (3,):
                    raise ValueError(f"{name} must have shape (3,), got {array.shape}")
                array.setflags(write=False)
                object.__setattr__(self, name, array)

    def age(self, now: float) -> float:
        """How long ago the sample was measured.

        Args:
            now: The time on the device's clock, `TeleopDevice.now()` [s].

        Returns:
            The age [s].
        """
        return now - self.time


class TeleopDevice(ABC):
    """A device that an operator holds.

    Opened by `open` or by a ``with`` statement, which closes it however the block ends. `read` and `send_force` do not
    wait and do not block for longer than a few microseconds: a driver that has to wait does so in a thread of its own.

    Attributes:
        name: Name of the device in messages.
        kind: ``"position"`` or ``"rate"``.
        button_names: Names of all buttons of the device.
        has_force: Whether the operator can feel `send_force`.
        workspace_low: Lowest corner of a box that the grip can always reach, shape (3,) [m]; None for a rate device.
        workspace_high: The opposite corner, shape (3,) [m]; None for a rate device.
        greatest_force: Greatest magnitude of a force; larger forces are scaled down to it [N]. 0 without force.
        greatest_stiffness: Stiffest spring that a 1 kHz loop may render on the device [N/m]. 0 without force.
        greatest_damping: Strongest damper, likewise [N s/m]. 0 without force.
    """

    name: str = "device"
    kind: Literal["position", "rate"] = "position"
    button_names: tuple[str, ...] = ()
    has_force: bool = False
    workspace_low: FloatArray | None = None
    workspace_high: FloatArray | None = None
    greatest_force: float = 0.0
    greatest_stiffness: float = 0.0
    greatest_damping: float = 0.0

    @property
    @abstractmethod
    def is_open(self) -> bool:
        """Whether the device is open. A device whose connection was lost stays open until it is closed."""

    @property
    def is_calibrated(self) -> bool:
        """Whether the device knows where its grip is. Devices that need no calibration know it once they are open."""
        return self.is_open

    @abstractmethod
    def open(self) -> None:
        """Find the device and take possession of it. Opening an open device does nothing.

        Raises:
            DeviceNotFound: If there is none.
            DeviceBusy: If another program has it.
            FirmwareError: If its firmware is missing or could not be loaded.
            ImportError: If a library is missing; the message says what to install.
        """

    def calibrate(self, progress: Progress | None = None) -> None:  # noqa: B027 - most devices need nothing
        """Find the grip's true position, with the operator's help. Blocks until done; most devices need no calibration.

        Args:
            progress: Called with a message whenever the operator has to be told something.

        Raises:
            NotCalibrated: If calibration was not completed in time.
            DeviceLost: If the device does not answer any more.
        """

    @abstractmethod
    def read(self) -> DeviceSample:
        """Return the latest measurement without waiting; `DeviceSample.sequence` tells whether it is a new one.

        Raises:
            NotCalibrated: If the device does not know yet where its grip is.
            DeviceLost: If it does not answer any more.
            DeviceError: If it is not open.
        """

    def send_force(self, force: ArrayLike) -> None:
        """Apply a force to the operator's hand, until the next call or until the device's watchdog ends it.

        A device without force feedback only checks the argument.

        Args:
            force: Force of the grip on the hand, shape (3,), device frame [N].

        Raises:
            ValueError: If the force has another shape or is not finite.
            DeviceLost: If the device does not answer any more.
            DeviceError: If it is not open.
        """
        check_force(force)

    def stop_motors(self) -> None:
        """End the forces on a device that another process left behind. The device is not open afterwards.

        Raises:
            DeviceError: As `open` does.
        """
        with self:
            self.send_force(np.zeros(3))

    @abstractmethod
    def close(self) -> None:
        """End all forces and release the device. Closing twice is allowed."""

    @abstractmethod
    def now(self) -> float:
        """The time on the clock that stamps the samples [s]."""

    def __enter__(self: _Device) -> _Device:
        self.open()
        return self

    def __exit__(
        self,
        exception_type: type[BaseException] | None,
        exception: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    # The same methods under the names that LeRobot uses.

    @property
    def is_connected(self) -> bool:
        """`is_open`, under LeRobot's name."""
        return self.is_open

    def connect(self, calibrate: bool = True) -> None:
        """`open`, under LeRobot's name.

        Args:
            calibrate: Whether to calibrate a device that needs it.
        """
        self.open()
        if calibrate and not self.is_calibrated:
            self.calibrate()

    def disconnect(self) -> None:
        """`close`, under LeRobot's name."""
        self.close()

    @property
    def action_features(self) -> dict[str, type]:
        """Keys and types of the dictionary that `get_action` returns."""
        main: dict[str, type] = {f"{self.kind}.{axis}": float for axis in AXES}
        return (
            main | {f"velocity.{axis}": float for axis in AXES} | {f"button.{name}": bool for name in self.button_names}
        )

    @property
    def feedback_features(self) -> dict[str, type]:
        """Keys and types of the dictionary that `send_feedback` takes; empty without force."""
        return {f"force.{axis}": float for axis in AXES} if self.has_force else {}

    def get_action(self) -> dict[str, float | bool]:
        """`read`, under LeRobot's name.

        Returns:
            ``position.x`` … or ``rate.x`` …, ``velocity.x`` …, and ``button.NAME`` for each button.
        """
        sample = self.read()
        main = sample.position if sample.position is not None else sample.rate
        assert main is not None  # Checked by DeviceSample.
        action: dict[str, float | bool] = {}
        for label, values in ((self.kind, main), ("velocity", sample.velocity)):
            action |= {f"{label}.{axis}": float(value) for axis, value in zip(AXES, values, strict=True)}
        return action | {f"button.{name}": name in sample.buttons for name in self.button_names}

    def send_feedback(self, feedback: Mapping[str, float]) -> None:
        """Process all events that are due by now, moving the hand no further than they need.

        Args:
            feedback: ``force.x``, ``force.y`` and ``force.z`` [N]; nothing for a device without force.

        Raises:
            ValueError: If a component is missing on a device with force.
        """
        missing = [key for key in self.feedback_features if key not in feedback]
        if missing:
            raise ValueError(f"feedback must have {', '.join(missing)}, got {sorted(feedback)}")
        if self.has_force:
            self.send_force([feedback[f"force.{axis}"] for axis in AXES])


def check_force(force: ArrayLike) -> FloatArray:
    """Check a force before it goes to a device.

    Args:
        force: The force [N].

    Returns:
        A copy, shape (3,), float64 [N].

    Raises:
        ValueError: If it has another shape or is not finite.
    """
    array = np.array(force, dtype=np.float64)
    if array.shape != (3,):
        raise ValueError(f"force must have shape (3,), got {array.shape}")
    if not all(map(math.isfinite, array.tolist())):
        raise ValueError(f"force must be finite, got {array.tolist()}")
    return array


def limit_force(force: FloatArray, greatest: float) -> FloatArray:
    """Scale a force down to a greatest magnitude, keeping its direction.

    Args:
        force: Shape (3,) [N].
        greatest: Greatest magnitude [N].

    Returns:
        The force, or a shorter one, shape (3,) [N].
    """
    # hypot: no square that could overflow, and no temporary array, as this runs a thousand times a second.
    magnitude = math.hypot(*force.tolist())
    return force if magnitude <= greatest else force * (greatest / magnitude)
