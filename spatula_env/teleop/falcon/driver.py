"""The Novint Falcon as a teleoperation device."""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from spatula_env.teleop.device import (
    DeviceError,
    DeviceSample,
    FirmwareError,
    NotCalibrated,
    Progress,
    TeleopDevice,
    check_force,
    limit_force,
)
from spatula_env.teleop.falcon import frames
from spatula_env.teleop.falcon.firmware import UploadProgress, enter_normal_mode, read_firmware, upload
from spatula_env.teleop.falcon.protocol import BUTTON_NAMES, Lights
from spatula_env.teleop.falcon.servo import PERIOD, LoopStatistics, ServoLoop, ServoState, send_zeros
from spatula_env.teleop.falcon.transport import Transport, UsbTransport
from spatula_env.teleop.falcon.vector import ZERO, as_vector

GREATEST_FORCE = 8.0
GREATEST_STIFFNESS = 3000.0
GREATEST_DAMPING = 20.0
"""Limits that CHAI3D gives the Falcon [N], [N/m], [N s/m] (its ``CDeltaDevices.cpp``)."""

FORCE_TIMEOUT = 0.02
"""A force ends when `Falcon.send_force` has not been called for this long [s]."""
HOMING_TIMEOUT = 60.0
"""How long `Falcon.calibrate` waits for the operator [s]."""
FIRST_EXCHANGES = 40
"""If none of this many packets is answered, no firmware runs."""
THREAD_END_TIMEOUT = 5.0
"""How long `Falcon.close` waits for its thread, in real time [s]."""
WAKE_UP = 0.05
"""How often a waiting call checks whether the thread has ended, in real time [s]."""

LEGS = ("top", "right", "left")
HOMING_REQUEST = "Pull the grip all the way out towards you, then push it all the way in."


class Falcon(TeleopDevice):
    """A Novint Falcon on the USB, or an emulated one.

    While it is open, a thread exchanges packets with it a thousand times a second; it converts forces to torques at the
    grip position of that millisecond. The position is meaningless, and forces are zero, until the Falcon has been
    homed (`calibrate`); it stays homed as long as it has power, even from one program to the next.

    Positions and forces are in the device frame (:mod:`spatula_env.teleop.device`).

    Example:
        >>> from spatula_env.teleop.falcon import Falcon
        >>> with Falcon(firmware="falcon.bin") as falcon:  # doctest: +SKIP
        ...     falcon.calibrate(print)
        ...     while "center" not in falcon.read().buttons:
        ...         falcon.send_force(-200.0 * falcon.read().position)

    Attributes:
        name: Name of the device in messages; contains the USB address once it is open.
    """

    kind = "position"
    button_names = BUTTON_NAMES
    has_force = True
    greatest_stiffness = GREATEST_STIFFNESS
    greatest_damping = GREATEST_DAMPING

    def __init__(
        self,
        index: int = 0,
        *,
        firmware: str | Path | None = None,
        transport: Callable[[], Transport] | None = None,
        greatest_force: float = GREATEST_FORCE,
        force_timeout: float = FORCE_TIMEOUT,
        homing_timeout: float = HOMING_TIMEOUT,
        threaded: bool = True,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        upload_progress: UploadProgress | None = None,
    ) -> None:
        """Store the settings of the Falcon; `open` opens it.

        Args:
            index: Number of the device, if there are several.
            firmware: File with the firmware. If given, `open` loads it, and the Falcon has to be homed again; if not,
                the Falcon must have its firmware loaded already.
            transport: Function that makes the connection; None for USB.
            greatest_force: Greatest magnitude of a force [N].
            force_timeout: A force ends when `send_force` has not been called for this long, at least 5 ms [s].
            homing_timeout: How long `calibrate` waits for the operator [s].
            threaded: False to start no thread; the caller then has to call `exchange` a thousand times a second.
            clock: Returns the time by which the device lives [s].
            sleep: Waits by that clock for some seconds.
            upload_progress: Called while firmware is loaded.

        Raises:
            ValueError: If a limit is not positive, or `force_timeout` is too short.
        """
        for label, value, least in (
            ("greatest_force", greatest_force, 0.0),
            ("force_timeout", force_timeout, 5.0 * PERIOD),
            ("homing_timeout", homing_timeout, 0.0),
        ):
            if not least <= value < float("inf"):
                raise ValueError(f"{label} must be at least {least} and finite, got {value!r}")
        self.name = "Novint Falcon"
        self.greatest_force = min(greatest_force, GREATEST_FORCE)
        self.workspace_low = np.full(3, -frames.HALF_WIDTH)
        self.workspace_high = np.full(3, frames.HALF_WIDTH)
        self._firmware = firmware
        self._connect = transport if transport is not None else lambda: UsbTransport(index)
        self._force_timeout = force_timeout
        self._homing_timeout = homing_timeout
        self._threaded = threaded
        self._clock = clock
        self._sleep = sleep
        self._upload_progress = upload_progress
        self._loop: ServoLoop | None = None
        self._finish: Callable[[], object] | None = None

    @property
    def is_open(self) -> bool:
        """See `TeleopDevice`."""
        return self._loop is not None

    @property
    def is_calibrated(self) -> bool:
        """Whether all three legs are homed."""
        return self._loop is not None and self._loop.error is None and self._loop.state.is_homed

    def open(self) -> None:
        """Connect, load the firmware if a file was given, and start the exchange.

        Raises:
            ImportError: If pyusb is missing.
            DeviceNotFound: If there is no Falcon.
            DeviceBusy: If another program has it.
            FirmwareError: If the firmware could not be loaded, or none runs.
            DeviceError: If the user lacks permission to open it.
        """
        if self._loop is not None:
            return
        # Read the file before touching the device: a wrong file name must not cost the operator another homing.
        firmware = None if self._firmware is None else read_firmware(self._firmware)
        transport = self._connect()
        try:
            self.name = transport.name
            if firmware is not None:
                upload(transport, firmware, self._clock, self._upload_progress)
            enter_normal_mode(transport)
            loop = ServoLoop(transport, self._clock, self._force_timeout)
            if not any(loop.exchange() for _ in range(FIRST_EXCHANGES)):
                raise FirmwareError(self._no_answer())
        except BaseException:
            transport.close()
            raise
        thread = None
        if self._threaded:
            thread = threading.Thread(target=loop.run, args=(self._sleep,), name="falcon", daemon=True)
            thread.start()
        # A finalizer also runs at the interpreter's exit, while daemon threads are still alive, so a program that
        # forgets to close leaves no force behind. It must not hold a reference to this object.
        self._finish = weakref.finalize(self, _finish, loop, thread, transport)
        self._loop = loop

    def exchange(self) -> bool:
        """Exchange one packet with the Falcon; for ``threaded=False`` only.

        Returns:
            Whether it answered.

        Raises:
            DeviceLost: If it is not there any more.
            DeviceError: If it is not open, or if a thread already makes the exchanges.
        """
        loop = self._checked_loop()
        if self._threaded:
            raise DeviceError(f"the {self.name} has a thread that exchanges packets; exchange() is for threaded=False")
        try:
            return loop.exchange()
        except BaseException as error:
            loop.error = error
            loop.send_zeros()
            raise

    def wait_for_sample(self) -> None:
        """Wait until another packet has been exchanged; without a thread, exchange one here.

        Waits at most a few hundredths of a second; also returns if the Falcon did not answer.

        Raises:
            DeviceLost: If the device does not answer any more.
            DeviceError: If it is not open.
        """
        if self._threaded:
            loop = self._checked_loop()
            loop.wait(WAKE_UP)
            loop.check()
        else:
            self.exchange()

    def calibrate(self, progress: Progress | None = None) -> None:
        """Home the Falcon: its encoders find their zeros while the operator pulls the grip out and pushes it in.

        A Falcon that is homed already keeps its zeros.

        Args:
            progress: Called with a message whenever the operator has to be told something.

        Raises:
            NotCalibrated: If homing was not completed within `homing_timeout`.
            DeviceLost: If the device does not answer any more.
            DeviceError: If it is not open.
        """
        loop = self._checked_loop()
        tell = progress if progress is not None else _tell_nobody
        deadline = self._clock() + self._homing_timeout
        if not loop.state.is_homed:
            tell(HOMING_REQUEST)
        told = 0
        while not loop.state.is_homed:
            homed = sum(loop.state.homed)
            if homed > told:
                tell(f"{homed} of 3 legs homed.")
                told = homed
            if self._clock() >= deadline:
                missing = ", ".join(leg for leg, done in zip(LEGS, loop.state.homed, strict=True) if not done)
                raise NotCalibrated(
                    f"the {self.name} was not homed within {self._homing_timeout:g} s (missing: {missing}). "
                    + HOMING_REQUEST
                )
            self.wait_for_sample()
        tell("The Falcon is homed.")

    def read(self) -> DeviceSample:
        """See `TeleopDevice`."""
        state = self._checked_loop().state
        if not state.is_homed:
            raise NotCalibrated(f"the {self.name} is not homed: call calibrate(). {HOMING_REQUEST}")
        return DeviceSample(
            kind="position",
            time=state.time,
            sequence=state.sequence,
            position=np.array(frames.position_to_device(state.position)),
            rate=None,
            velocity=np.array(frames.direction_to_device(state.velocity)),
            buttons=state.buttons,
        )

    def send_force(self, force: ArrayLike) -> None:
        """Apply a force to the operator's hand for `force_timeout`, or until the next call if that comes earlier.

        A force above `greatest_force` is scaled down to it, as is one that a motor cannot produce; its direction is
        kept. No force is produced until the Falcon is homed. An invalid argument ends the force of the previous call.

        Args:
            force: Force of the grip on the hand, shape (3,), device frame [N].

        Raises:
            ValueError: If the force has another shape or is not finite.
            DeviceLost: If the device does not answer any more.
            DeviceError: If it is not open.
        """
        loop = self._checked_loop()
        try:
            checked = check_force(force)
        except (TypeError, ValueError):
            loop.command(ZERO)
            raise
        loop.command(frames.direction_to_falcon(as_vector(limit_force(checked, self.greatest_force))))

    def set_lights(self, lights: Lights | None) -> None:
        """Switch the coloured lights.

        Args:
            lights: Lights to turn on; None for red until the Falcon is homed, then green.

        Raises:
            DeviceLost: If the device does not answer any more.
            DeviceError: If it is not open.
        """
        self._checked_loop().set_lights(lights)

    def state(self) -> ServoState:
        """The Falcon's last answer, in its own frame; available before it is homed, too.

        Returns:
            The state.

        Raises:
            DeviceLost: If the device does not answer any more.
            DeviceError: If it is not open.
        """
        return self._checked_loop().state

    def statistics(self) -> LoopStatistics:
        """Statistics of how regularly packets were exchanged.

        Returns:
            The statistics; also available for a device that was lost.

        Raises:
            DeviceError: If it is not open.
        """
        return self._open_loop().statistics()

    def stop_motors(self) -> None:
        """See `TeleopDevice`; sends zeros at once, without waiting for answers. The Falcon stays homed."""
        transport = self._connect()
        try:
            send_zeros(transport)
        finally:
            transport.close()

    def close(self) -> None:
        """See `TeleopDevice`."""
        finish, self._finish, self._loop = self._finish, None, None
        if finish is not None:
            finish()

    def now(self) -> float:
        """See `TeleopDevice`."""
        return self._clock()

    def _open_loop(self) -> ServoLoop:
        if self._loop is None:
            raise DeviceError(f"the {self.name} is not open: call open(), or use it in a with statement")
        return self._loop

    def _checked_loop(self) -> ServoLoop:
        loop = self._open_loop()
        loop.check()
        return loop

    def _no_answer(self) -> str:
        if self._firmware is not None:
            return (
                f"the {self.name} does not run the firmware of {str(self._firmware)!r}: every byte was loaded, but "
                "packets are not answered. Is it a Falcon's firmware, and for this grip?"
            )
        return (
            f"the {self.name} does not answer: it has no firmware, or no power. Take it off its power supply and the "
            "USB for a few seconds, then give the firmware's file (see docs/falcon.md)"
        )


def _finish(loop: ServoLoop, thread: threading.Thread | None, transport: Transport) -> None:
    """End the forces, the thread and the connection, in that order."""
    loop.stop()
    if thread is not None:
        thread.join(THREAD_END_TIMEOUT)
    else:
        loop.send_zeros()
    transport.close()


def _tell_nobody(_: str) -> None:
    pass
