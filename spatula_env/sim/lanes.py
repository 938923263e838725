"""What all engines do that have worlds in the lanes of vector registers: kernels on blocks of worlds."""

from __future__ import annotations

import numpy as np

from spatula_env._kernels import array_kernel


@array_kernel
def tell_finite(velocities: np.ndarray, finite: np.ndarray) -> None:
    """Tell which worlds of a block are finite.

    Args:
        velocities: (V, C, lanes) of the block's nodes, of which the first three of C coordinates are looked at.
        finite: (lanes,) result: zero where all velocities are finite, NaN otherwise.
    """
    for k in range(finite.shape[0]):
        finite[k] = 0.0
    for i in range(velocities.shape[0]):
        for axis in range(3):
            for k in range(finite.shape[0]):
                # Stays zero as long as all is finite, and is NaN from then on otherwise.
                finite[k] += velocities[i, axis, k] - velocities[i, axis, k]
