"""The time of worlds, as a number of steps times their length: a sum of many steps would accumulate rounding errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

ON_STEP = 1e-6
"""A time that differs from a whole number of steps by less than this fraction of a step counts as that number."""


def later(times: ArrayLike, steps: int, dt: float) -> NDArray[np.float64]:
    """Advance times by some steps.

    Args:
        times: Times now [s].
        steps: Number of steps.
        dt: Length of a step [s].

    Returns:
        The later times [s]; multiples of `dt` stay multiples of it, however many steps are taken.
    """
    now = np.asarray(times, dtype=np.float64)
    whole = np.round(now / dt)
    off = now - whole * dt
    return (whole + steps) * dt + np.where(np.abs(off) < ON_STEP * dt, 0.0, off)
