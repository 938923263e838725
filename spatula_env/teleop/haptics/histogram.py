"""Histogram of a loop's periods: a thousand a second for hours, in constant memory."""

from __future__ import annotations

from array import array

WIDTH = 1e-5
"""Width of a bin [s]."""
BINS = 10_000
"""Number of bins. Periods beyond the last one are counted in it; the longest of all is known exactly."""


class PeriodHistogram:
    """Counts periods by their length.

    Attributes:
        count: Number of periods.
        longest: Longest period [s].
    """

    def __init__(self) -> None:
        """Start without any periods."""
        self.count = 0
        self.longest = 0.0
        self._bins = array("Q", bytes(8 * BINS))

    def add(self, period: float) -> None:
        """Add a period [s]; a negative one, which no clock should show, counts as zero."""
        self._bins[min(BINS - 1, max(0, int(period / WIDTH)))] += 1
        self.count += 1
        if period > self.longest:
            self.longest = period

    def quantile(self, share: float) -> float:
        """Quantile of the periods, to within the width of a bin [s]; 0 if there are none."""
        wanted, seen = share * self.count, 0
        for index, number in enumerate(self._bins):
            seen += number
            if number and seen >= wanted:
                return self.longest if index == BINS - 1 else min(self.longest, (index + 1) * WIDTH)
        return self.longest
