"""Kernels on blocks of worlds, for all engines that keep worlds in the lanes of vector registers."""

from __future__ import annotations

import numpy as np

from spatula_env._kernels import array_kernel


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
