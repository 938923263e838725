"""Blocks of worlds, for all engines that keep worlds in the lanes of vector registers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env._kernels import array_kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

WIDE, NARROW = 16, 8
"""Worlds in a block, when there are many and when there are few. Sixteen numbers in single precision fill the widest
registers."""

CACHE_LINE = 64
"""Size of a cache line [bytes]."""


def choose_lanes(worlds: int, threads: int) -> int:
    """Number of worlds in a block that suits a number of worlds and of threads: every thread is to have a block."""
    if worlds == 1:
        return 1
    return WIDE if worlds >= WIDE * threads else NARROW


def aligned_zeros(shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """An array of zeros that begins at a cache line, so that no vector of a block straddles two."""
    size = math.prod(shape) * dtype.itemsize
    memory = np.zeros(size + CACHE_LINE, dtype=np.uint8)
    start = -memory.ctypes.data % CACHE_LINE
    return memory[start : start + size].view(dtype).reshape(shape)


@array_kernel
def tell_finite(velocities: np.ndarray, finite: np.ndarray) -> None:
    """Find which worlds of a block have finite velocities.

    Args:
        velocities: (V, C, lanes) of the block's nodes; only the first three of C coordinates are checked.
        finite: (lanes,) result: zero where all velocities are finite, NaN otherwise.
    """
    for k in range(finite.shape[0]):
        finite[k] = 0.0
    for i in range(velocities.shape[0]):
        for axis in range(3):
            for k in range(finite.shape[0]):
                # Stays zero as long as all values are finite; the first that is not makes it NaN for good.
                finite[k] += velocities[i, axis, k] - velocities[i, axis, k]
