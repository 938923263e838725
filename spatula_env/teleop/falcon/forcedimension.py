"""Haptic devices of Force Dimension, and the Falcon, driven through the vendor's library.

For users who have the Force Dimension SDK installed: it drives Force Dimension's delta and omega devices and the
Novint Falcon. The SDK is not free software and not part of this package. The Python package ``forcedimension-core``
locates the SDK; it is imported only when a device is opened.

The SDK's frame has x towards the operator, y to the operator's right, z up, its origin in the middle of the workspace.
"""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from spatula_env.teleop.device import (
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceSample,
    FloatArray,
    NotCalibrated,
    Progress,
    TeleopDevice,
    check_force,
    limit_force,
)
from spatula_env.teleop.falcon.driver import FORCE_TIMEOUT, GREATEST_DAMPING, GREATEST_FORCE, GREATEST_STIFFNESS

HALF_WIDTH = 0.04
"""Half edge of the cube that the grip can always reach, on the smallest of these devices [m]."""
CALIBRATION_TIMEOUT = 60.0
"""How long to wait for the operator to calibrate the device [s]."""
WATCH_PERIOD = 0.005
"""Interval at which the watchdog looks for forces that have expired [s]."""
FAILED = -1
"""Return value of the SDK's functions when they fail."""

# Numbers of the Falcon's buttons in the SDK: centre 0, left 1, up 2, right 3.
BUTTON_NAMES = ("center", "minus", "forward", "plus")

_TO_DEVICE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""From the SDK's frame to the device frame: (x, y, z) becomes (y, -x, z)."""


class ForceDimensionDevice(TeleopDevice):
    """A device of Force Dimension, or a Falcon, driven by the Force Dimension SDK.

    Calls go straight to the SDK; a thread of this object ends forces that are not renewed.

    Attributes:
        name: The SDK's name of the device, once it is open.
    """

    kind = "position"
    button_names = BUTTON_NAMES
    has_force = True
    greatest_stiffness = GREATEST_STIFFNESS
    greatest_damping = GREATEST_DAMPING

    def __init__(
        self,
        index: int | None = None,
        *,
        greatest_force: float = GREATEST_FORCE,
        force_timeout: float = FORCE_TIMEOUT,
        calibration_timeout: float = CALIBRATION_TIMEOUT,
        threaded: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Store the settings of the device; `open` opens it.

        Args:
            index: Number in the SDK's order; None for the first device that is free.
            greatest_force: Greatest magnitude of a force, positive [N].
            force_timeout: A force ends when `send_force` has not been called for this long, positive [s].
            calibration_timeout: How long `calibrate` waits for the operator, positive [s].
            threaded: False to start no thread; the caller then has to call `expire_force` regularly.
            clock: Returns the time [s].

        Raises:
            ValueError: If a limit is not positive.
        """
        for label, value in (
            ("greatest_force", greatest_force),
            ("force_timeout", force_timeout),
            ("calibration_timeout", calibration_timeout),
        ):
            if not 0.0 < value < float("inf"):
                raise ValueError(f"{label} must be positive and finite, got {value!r}")
        self.name = "Force Dimension device"
        self.greatest_force = greatest_force
        self.workspace_low = np.full(3, -HALF_WIDTH)
        self.workspace_high = np.full(3, HALF_WIDTH)
        self._index = index
        self._force_timeout = force_timeout
        self._calibration_timeout = calibration_timeout
        self._threaded = threaded
        self._clock = clock
        self._connection: _Connection | None = None
        self._finish: Callable[[], object] | None = None
        self._sequence = 0
        self._last: tuple[float, FloatArray] | None = None

    @property
    def is_open(self) -> bool:
        """See `TeleopDevice`."""
        return self._connection is not None

    @property
    def is_calibrated(self) -> bool:
        """Whether the device is calibrated, as far as the SDK says: it does not await a calibration."""
        return self._connection is not None and not self._connection.awaits_calibration()

    def open(self) -> None:
        """See `TeleopDevice`."""
        if self._connection is not None:
            return
        dhd, containers = _load_bindings()
        number = dhd.open() if self._index is None else dhd.openID(self._index)
        if number == FAILED:
            reason = dhd.errorGetLastStr()
            if dhd.getDeviceCount() > 0 and dhd.getAvailableCount() <= 0:
                raise DeviceBusy(f"another program has the Force Dimension device open ({reason}); close it first")
            raise DeviceNotFound(f"the Force Dimension SDK finds no device ({reason}); check its cable and power")
        self.name = dhd.getSystemName(number) or self.name
        self._last = None
        connection = _Connection(dhd, containers, number, self.name, self._clock, self._force_timeout)
        thread = None
        if self._threaded:
            thread = threading.Thread(target=connection.watch, name="force-dimension", daemon=True)
            thread.start()
        # The finalizer also runs at the interpreter's exit: a program that forgets to close leaves no force behind.
        self._finish = weakref.finalize(self, _finish, connection, thread)
        self._connection = connection
        try:
            connection.call("enableForce", True)
        except BaseException:
            self.close()
            raise

    def calibrate(self, progress: Progress | None = None) -> None:
        """See `TeleopDevice`."""
        connection = self._checked_connection()
        if not connection.awaits_calibration():
            return
        if progress is not None:
            progress("Calibrate the device: on a Falcon, pull the grip all the way out, then push it all the way in.")
        try:
            connection.call("waitForReset", round(1000.0 * self._calibration_timeout))
        except DeviceLost as error:
            raise NotCalibrated(f"the {self.name} was not calibrated within {self._calibration_timeout:g} s") from error
        if progress is not None:
            progress("The device is calibrated.")

    def read(self) -> DeviceSample:
        """Measure the grip's position and velocity. See `TeleopDevice`."""
        connection = self._checked_connection()
        if connection.awaits_calibration():
            raise NotCalibrated(f"the {self.name} is not calibrated: call calibrate()")
        position = [0.0, 0.0, 0.0]
        velocity = [0.0, 0.0, 0.0]
        connection.call("getPosition", position)
        moment = self._clock()
        # The SDK's estimate needs two measurements within 20 ms; for slower readers it fails, so take a difference
        # quotient.
        measured = _TO_DEVICE @ position
        if connection.attempt("getLinearVelocity", velocity) != FAILED:
            speed = _TO_DEVICE @ velocity
        else:
            speed = self._difference(moment, measured)
        self._last = (moment, measured)
        # A device without buttons may have no mask.
        mask = max(connection.attempt("getButtonMask"), 0)
        self._sequence += 1
        return DeviceSample(
            kind="position",
            time=moment,
            sequence=self._sequence,
            position=measured,
            rate=None,
            velocity=speed,
            buttons=frozenset(name for bit, name in enumerate(BUTTON_NAMES) if mask >> bit & 1),
        )

    def send_force(self, force: ArrayLike) -> None:
        """See `TeleopDevice`."""
        connection = self._checked_connection()
        try:
            checked = check_force(force)
        except (TypeError, ValueError):
            connection.set_force(np.zeros(3))
            raise
        connection.set_force(_TO_DEVICE.T @ limit_force(checked, self.greatest_force))

    def expire_force(self) -> None:
        """End a force that has not been renewed in time; the thread calls this every few milliseconds."""
        self._checked_connection().expire_force()

    def close(self) -> None:
        """See `TeleopDevice`."""
        finish, self._finish, self._connection = self._finish, None, None
        if finish is not None:
            finish()

    def now(self) -> float:
        """See `TeleopDevice`."""
        return self._clock()

    def _difference(self, moment: float, position: FloatArray) -> FloatArray:
        """Mean velocity since the last reading; zero at the first."""
        if self._last is None or moment <= self._last[0]:
            return np.zeros(3)
        then, last = self._last
        return (position - last) / (moment - then)

    def _checked_connection(self) -> _Connection:
        if self._connection is None:
            raise DeviceError(f"the {self.name} is not open: call open(), or use it in a with statement")
        return self._connection


class _Connection:
    """An open device of the SDK; a lock lets one thread at a time call the SDK's functions."""

    def __init__(
        self, dhd: Any, containers: Any, number: int, name: str, clock: Callable[[], float], force_timeout: float
    ) -> None:
        self._dhd = dhd
        self._status = containers.Status()
        self._number = number
        self._name = name
        self._clock = clock
        self._force_timeout = force_timeout
        self._expires: float | None = None
        self._lock = threading.RLock()
        self._closing = threading.Event()

    def call(self, function: str, *arguments: Any) -> int:
        """Call one of the SDK's functions on this device.

        Raises:
            DeviceLost: If it fails.
        """
        with self._lock:
            result = self.attempt(function, *arguments)
            if result == FAILED:
                raise DeviceLost(
                    f"the {self._name} does not answer any more ({function}: {self._dhd.errorGetLastStr()}); "
                    "check its cable and power, then open it again"
                )
            return result

    def attempt(self, function: str, *arguments: Any) -> int:
        """Call one of the SDK's functions on this device; return `FAILED` if it fails."""
        with self._lock:
            return int(getattr(self._dhd, function)(*arguments, self._number))

    def awaits_calibration(self) -> bool:
        with self._lock:
            self.call("getStatus", self._status)
            return bool(self._status.reset)

    def set_force(self, force: FloatArray) -> None:
        with self._lock:
            self._expires = self._clock() + self._force_timeout if force.any() else None
            self.call("setForce", force.tolist())

    def expire_force(self) -> None:
        with self._lock:
            if self._expires is not None and self._clock() >= self._expires:
                self.set_force(np.zeros(3))

    def watch(self) -> None:
        while not self._closing.wait(WATCH_PERIOD):
            try:
                self.expire_force()
            except DeviceLost:
                # Swallowed here: the operator's next call raises the same error.
                return

    def close(self, thread: threading.Thread | None) -> None:
        self._closing.set()
        if thread is not None:
            thread.join()
        try:
            self.set_force(np.zeros(3))
        except DeviceLost:
            pass
        with self._lock:
            self._dhd.close(self._number)


def _finish(connection: _Connection, thread: threading.Thread | None) -> None:
    connection.close(thread)


def _load_bindings() -> tuple[Any, Any]:
    """Import the Python bindings, which look for the SDK at import."""
    try:
        return import_module("forcedimension_core.dhd"), import_module("forcedimension_core.containers")
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("forcedimension_core"):
            raise
        raise ImportError(
            "this driver needs the Force Dimension SDK, and its Python bindings: pip install forcedimension-core"
        ) from error
    except ImportError as error:
        raise ImportError(
            f"forcedimension-core does not find the Force Dimension SDK ({error}); install the SDK, or set FDSDK to "
            "its folder"
        ) from error
