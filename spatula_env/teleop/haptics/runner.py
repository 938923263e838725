"""Interface for running a device with its haptic loop, and its implementation in this process."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

from spatula_env.teleop.device import (
    DeviceError,
    DeviceLost,
    DeviceSample,
    FloatArray,
    NotCalibrated,
    Progress,
    TeleopDevice,
)
from spatula_env.teleop.haptics.contact import ZERO, Contact, LoopStatistics, Vector
from spatula_env.teleop.haptics.loop import HapticLoop
from spatula_env.teleop.haptics.settings import PERIOD, HapticSettings
from spatula_env.teleop.haptics.track import HapticTrack

Factory: TypeAlias = Callable[[], TeleopDevice]
Answer = TypeVar("Answer")

END_TIMEOUT = 5.0
"""Longest time that `close` waits for a thread or a process, in real time [s]."""


@dataclass(frozen=True, eq=False)
class Description:
    """Fixed properties of a device, wherever it runs; see `TeleopDevice`."""

    name: str
    button_names: tuple[str, ...]
    workspace_low: FloatArray | None
    workspace_high: FloatArray | None
    greatest_force: float
    greatest_stiffness: float
    greatest_damping: float
    is_calibrated: bool


class Runner(ABC):
    """A device and its loop, wherever they run.

    Attributes:
        description: Fixed properties of the device.
    """

    description: Description

    @property
    @abstractmethod
    def is_calibrated(self) -> bool:
        """Whether the loop runs."""

    @property
    @abstractmethod
    def force(self) -> Vector:
        """The force last rendered to the hand [N]."""

    @abstractmethod
    def calibrate(self, progress: Progress | None) -> None:
        """See `TeleopDevice`."""

    @abstractmethod
    def read(self) -> DeviceSample:
        """See `TeleopDevice`."""

    @abstractmethod
    def tell(self, contact: Contact | None) -> None:
        """Take the simulation's report; None to end all force now."""

    @abstractmethod
    def ask(self, question: Callable[[TeleopDevice], Answer]) -> Answer:
        """Call a function with the device where the loop runs, between two cycles."""

    @abstractmethod
    def statistics(self) -> LoopStatistics:
        """Statistics of how regularly the loop ran."""

    @abstractmethod
    def keep_track(self, seconds: float) -> None:
        """See `HapticLoop.keep_track`."""

    @abstractmethod
    def take_track(self) -> HapticTrack:
        """See `HapticLoop.take_track`."""

    @abstractmethod
    def close(self) -> None:
        """End the force, the loop and the device."""

    @abstractmethod
    def now(self) -> float:
        """The time on the device's clock [s]."""

    def sleep(self, duration: float) -> None:
        """Wait [s]."""
        time.sleep(max(0.0, duration))


class LocalLoop(Runner):
    """A device and its loop in this process, either in a thread or within `sleep`.

    Attributes:
        loop: The loop; None before the device is calibrated.
    """

    def __init__(self, factory: Factory, settings: HapticSettings, exchange: bool, *, threaded: bool) -> None:
        """Open the device; start the loop if the device is calibrated.

        Args:
            factory: Makes the device.
            settings: The gains.
            exchange: Whether the loop has to call the device's `exchange`.
            threaded: Whether the loop runs in a thread of its own.
        """
        device = factory()
        check_haptic(device)
        device.open()
        self.description = describe(device)
        self._device = device
        self._force: Vector = ZERO
        self._settings, self._exchange, self._threaded = settings, exchange, threaded
        self._contact: Contact | None = None
        self._sample: DeviceSample | None = None
        self.loop: HapticLoop | None = None
        self._thread: threading.Thread | None = None
        self._due = 0.0
        if device.is_calibrated:
            self._begin()

    @property
    def is_calibrated(self) -> bool:
        """See `Runner`."""
        return self._device.is_calibrated

    @property
    def force(self) -> Vector:
        """See `Runner`."""
        return self._force

    def calibrate(self, progress: Progress | None) -> None:
        """See `Runner`."""
        self._device.calibrate(progress)
        if self.loop is None or isinstance(self.loop.error, NotCalibrated):
            self._begin()

    def read(self) -> DeviceSample:
        """See `Runner`."""
        if self.loop is None:
            raise NotCalibrated(f"the {self._device.name} is not calibrated: call calibrate()")
        pass_on(self.loop.error, self._device.name)
        return self._sample if self._sample is not None else self._device.read()

    def tell(self, contact: Contact | None) -> None:
        """See `Runner`."""
        if contact is not None and self.loop is not None:
            pass_on(self.loop.error, self._device.name)
        self._contact = contact

    def sleep(self, duration: float) -> None:
        """See `Runner`."""
        if self._threaded or self.loop is None:
            super().sleep(duration)
            return
        until = self.now() + duration
        wait: Callable[[float], None] = getattr(self._device, "sleep", time.sleep)
        while self._due <= until:
            if self._due > self.now():
                wait(self._due - self.now())
            self._cycle()
            self._due = max(self._due + PERIOD, self.now())
        if until > self.now():
            wait(until - self.now())

    def ask(self, question: Callable[[TeleopDevice], Answer]) -> Answer:
        """See `Runner`."""
        return question(self._device)

    def statistics(self) -> LoopStatistics:
        """See `Runner`."""
        return self._checked_loop().statistics()

    def _checked_loop(self) -> HapticLoop:
        if self.loop is None:
            raise NotCalibrated(f"the {self._device.name} is not calibrated: call calibrate()")
        return self.loop

    def keep_track(self, seconds: float) -> None:
        """See `Runner`."""
        self._checked_loop().keep_track(seconds)

    def take_track(self) -> HapticTrack:
        """See `Runner`."""
        return self._checked_loop().take_track()

    def close(self) -> None:
        """See `Runner`."""
        if self.loop is not None:
            self.loop.stop()
            if self._thread is not None:
                self._thread.join(END_TIMEOUT)
            self.loop.release()
        self._device.close()

    def now(self) -> float:
        """See `Runner`."""
        return self._device.now()

    def _begin(self) -> None:
        self.loop = HapticLoop(self._device, self._settings, lambda: self._contact, self._take, self._exchange)
        self._due = self.now()
        if self._threaded:
            self._thread = threading.Thread(target=self.loop.run, args=(time.sleep,), name="haptics", daemon=True)
            self._thread.start()

    def _take(self, sample: DeviceSample, force: Vector) -> None:
        self._sample, self._force = sample, force

    def _cycle(self) -> None:
        assert self.loop is not None
        if self.loop.error is not None:
            return
        try:
            self.loop.cycle()
        except DeviceError as error:
            # As in a thread: the error is not raised to the caller of `sleep`, but to the next caller who reads or
            # tells.
            self.loop.error = error
            self._force = ZERO


def check_haptic(device: TeleopDevice) -> None:
    """Check that a device can have a haptic loop.

    Raises:
        ValueError: If it has no position or no force.
    """
    if device.kind != "position" or not device.has_force:
        raise ValueError(f"a haptic loop needs a position device with force, got the {device.name}")


def pass_on(error: BaseException | None, name: str) -> None:
    """Raise the error that ended a loop, as a device error.

    Raises:
        DeviceLost: If the device is lost.
        NotCalibrated: If it no longer knows where its grip is and has to be calibrated again.
        DeviceError: If something else went wrong.
    """
    if error is None:
        return
    if isinstance(error, DeviceLost):
        raise DeviceLost(str(error)) from error
    if isinstance(error, NotCalibrated):
        raise NotCalibrated(str(error)) from error
    raise DeviceError(
        f"the haptic loop of the {name} has ended because of {error!r}; close it, then open it again"
    ) from (error)


def describe(device: TeleopDevice) -> Description:
    """Describe an open device."""
    return Description(
        name=device.name,
        button_names=device.button_names,
        workspace_low=device.workspace_low,
        workspace_high=device.workspace_high,
        greatest_force=device.greatest_force,
        greatest_stiffness=device.greatest_stiffness,
        greatest_damping=device.greatest_damping,
        is_calibrated=device.is_calibrated,
    )
