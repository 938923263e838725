"""The time of worlds: so many steps since it was zero, and no sum of many of them, which rounds differently."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

ON_STEP = 1e-6
"""A time that is so near to a whole number of steps is one, as a part of a step."""


def later(times: ArrayLike, steps: int, dt: float) -> NDArray[np.float64]:
    """Times after some more steps.

    Args:
        times: Times now [s].
        steps: How many steps.
        dt: Length of a step [s].

    Returns:
        As many [s]; multiples of `dt` stay multiples of it, however many steps they took.
    """
    now = np.asarray(times, dtype=np.float64)
    whole = np.round(now / dt)
    off = now - whole * dt
    return (whole + steps) * dt + np.where(np.abs(off) < ON_STEP * dt, 0.0, off)
