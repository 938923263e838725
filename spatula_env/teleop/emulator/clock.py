"""Clocks of an emulated device: real or simulated time."""

from __future__ import annotations

import math
import threading
import time
from typing import Protocol


class Clock(Protocol):
    """A clock, and a way to wait by it."""

    def now(self) -> float:
        """The current time, which never decreases [s]."""

    def sleep(self, duration: float) -> None:
        """Wait.

        Args:
            duration: How long; returns at once if it is not positive [s].
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
    """A clock that advances only when something waits for it, and then jumps to the end of the wait at once.

    Simulations with it run as fast as the machine allows and are reproducible. May be used from several threads.
    """

    def __init__(self, start: float = 0.0) -> None:
        """Set the clock.

        Args:
            start: Initial time [s].
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
                # Advance by at least one unit in the last place, or a short wait at a large time would never end.
                self._now = max(self._now + duration, math.nextafter(self._now, math.inf))
