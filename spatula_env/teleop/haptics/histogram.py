"""Periods of a loop, counted: a thousand a second for hours, in a place that never grows."""

from __future__ import annotations

from array import array

WIDTH = 1e-5
"""Of a bin [s]."""
BINS = 10_000
"""What is longer than all of them counts in the last, whose longest is known."""


class PeriodHistogram:
    """How often periods were how long.

    Attributes:
        count: How many there were.
        longest: The longest [s].
    """

    def __init__(self) -> None:
        """There was none yet."""
        self.count = 0
        self.longest = 0.0
        self._bins = array("Q", bytes(8 * BINS))

    def add(self, period: float) -> None:
        """Count one [s]; one below zero, which no clock shows, counts as zero."""
        self._bins[min(BINS - 1, max(0, int(period / WIDTH)))] += 1
        self.count += 1
        if period > self.longest:
            self.longest = period

    def quantile(self, share: float) -> float:
        """Quantile of the periods, to the width of a bin [s]; 0 without any."""
        wanted, seen = share * self.count, 0
        for index, number in enumerate(self._bins):
            seen += number
            if number and seen >= wanted:
                return self.longest if index == BINS - 1 else min(self.longest, (index + 1) * WIDTH)
        return self.longest
