"""Exponents: how steep a cost is over a size, where both have logarithmic scales."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np


def exponent(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """The power of the size with which a cost grows, by least squares; 0: it does not, 1: in proportion.

    Args:
        sizes: Two or more, different.
        costs: Of each, positive.
    """
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])


def growth(costs: Mapping[int, float], unit: str, what: str) -> dict[str, Any]:
    """A curve with its exponents.

    Args:
        costs: By size, ascending.
        unit: Of the costs.
        what: What the size is.

    Returns:
        The curve; "exponent" of all of it, and "last_exponent" of the larger half, where what is constant counts less.
    """
    sizes, values = list(costs), list(costs.values())
    half = min(len(sizes) // 2, len(sizes) - 2)
    return {
        "over": what,
        "unit": unit,
        "sizes": sizes,
        "costs": values,
        "exponent": round(exponent(sizes, values), 3),
        "last_exponent": round(exponent(sizes[half:], values[half:]), 3),
    }


def cpu_seconds(call: Callable[[], object], repeats: int = 1) -> float:
    """The least processor time of a call, of some repeats [s]."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)


def cpu_microseconds(call: Callable[[], object], repeats: int, warm_up: int = 2) -> float:
    """The median of a call's processor time, which other programs do not lengthen much [us].

    Args:
        call: What is timed.
        repeats: How often.
        warm_up: How many calls come first and do not count.
    """
    times = []
    for number in range(warm_up + repeats):
        start = time.process_time_ns()
        call()
        if number >= warm_up:
            times.append(time.process_time_ns() - start)
    return float(np.median(times)) / 1e3


def tell(words: str) -> None:
    """Say on standard error what is being done."""
    print(words, file=sys.stderr, flush=True)
