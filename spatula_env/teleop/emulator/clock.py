"""The time in which an emulated device lives: real, or simulated."""

from __future__ import annotations

import math
import threading
import time
from typing import Protocol


class Clock(Protocol):
    """A clock, and a way to wait by it."""

    def now(self) -> float:
        """The time; never goes back [s]."""

    def sleep(self, duration: float) -> None:
        """Wait.

        Args:
            duration: How long; nothing happens if it is not positive [s].
        """


class RealClock:
    """The machine's monotonic clock."""

    def now(self) -> float:
        """See `Clock`."""
        return time.monotonic()

    def sleep(self, duration: float) -> None:
        """See `Clock`."""
        if duration > 0.0:
            time.sleep(duration)


class SimulatedClock:
    """A clock that stands still until somebody waits, and then is there at once.

    Simulations by it are as fast as the machine, and the same every time. May be used from several threads.
    """

    def __init__(self, start: float = 0.0) -> None:
        """Set the clock.

        Args:
            start: The time at first [s].
        """
        self._now = start
        self._lock = threading.Lock()

    def now(self) -> float:
        """See `Clock`."""
        return self._now

    def sleep(self, duration: float) -> None:
        """See `Clock`."""
        if duration > 0.0:
            with self._lock:
                # At least one step of the floating-point numbers, or a short wait late in the day would last for ever.
                self._now = max(self._now + duration, math.nextafter(self._now, math.inf))
