"""How far organs and tools move in a step."""

from __future__ import annotations

import numpy as np

from spatula_env._kernels import kernel


@kernel("f8(f8[:,::1], f8[:,::1])")
def largest_shift(before: np.ndarray, now: np.ndarray) -> float:
    """The greatest distance between two positions of one vertex [u].

    Args:
        before: (V, 3) [u].
        now: (V, 3) [u].

    Returns:
        It.
    """
    largest = 0.0
    for i in range(before.shape[0]):
        x, y, z = now[i, 0] - before[i, 0], now[i, 1] - before[i, 1], now[i, 2] - before[i, 2]
        largest = max(largest, x * x + y * y + z * z)
    return float(np.sqrt(largest))


@kernel("b1(f8[::1], f8[::1], f8, f8[:,::1], f8[:,::1])")
def tool_passes(
    start_position: np.ndarray, position: np.ndarray, radius: float, before: np.ndarray, now: np.ndarray
) -> bool:
    """Whether the box around a tool's path overlaps the box around the organs' motion.

    Args:
        start_position: (3,) of the tool [u].
        position: (3,) of the tool [u].
        radius: Of a ball around the tool's origin that holds the tool [u].
        before: (V, 3) of the organs [u].
        now: (V, 3) of the organs [u].

    Returns:
        False if nothing can have met.
    """
    for axis in range(3):
        low, high = np.inf, -np.inf
        for i in range(before.shape[0]):
            low = min(low, before[i, axis], now[i, axis])
            high = max(high, before[i, axis], now[i, axis])
        if max(start_position[axis], position[axis]) + radius < low:
            return False
        if min(start_position[axis], position[axis]) - radius > high:
            return False
    return True
