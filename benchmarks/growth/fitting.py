"""Exponents of growth, the slope of cost over size on logarithmic scales; and processor times."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np


def exponent(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """The power of the size with which a cost grows, by least squares; 0: constant, 1: proportional.

    Args:
        sizes: Two or more different sizes.
        costs: Cost at each size, positive.
    """
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])


def growth(costs: Mapping[int, float], unit: str, what: str) -> dict[str, Any]:
    """A curve of cost over size, with its exponents.

    Args:
        costs: Costs by size, ascending.
        unit: Unit of the costs.
        what: Name of the size.

    Returns:
        The curve; "exponent" of all of it, and "last_exponent" of its larger half, where a constant part of the cost
        matters less.
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
    """The least processor time of a call over some repeats [s]."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)


def cpu_microseconds(call: Callable[[], object], repeats: int, warm_up: int = 2) -> float:
    """The median processor time of a call, which other programs hardly change [us].

    Args:
        call: Function to time.
        repeats: Number of timed calls.
        warm_up: Number of untimed calls before them.
    """
    times = []
    for number in range(warm_up + repeats):
        start = time.process_time_ns()
        call()
        if number >= warm_up:
            times.append(time.process_time_ns() - start)
    return float(np.median(times)) / 1e3


def tell(words: str) -> None:
    """Print a progress message on standard error."""
    print(words, file=sys.stderr, flush=True)
