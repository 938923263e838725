"""Small vector helpers of the contact kernels."""

from __future__ import annotations

import numpy as np

from spatula_env._kernels import inline_kernel


@inline_kernel
def dot(a: np.ndarray, b: np.ndarray) -> float:
    """Scalar product of two vectors (3,)."""
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


@inline_kernel
def turn(rotation: np.ndarray, vector: np.ndarray) -> tuple[float, float, float]:
    """Rotation matrix (9,), row by row, times vector (3,)."""
    x, y, z = vector[0], vector[1], vector[2]
    return (
        rotation[0] * x + rotation[1] * y + rotation[2] * z,
        rotation[3] * x + rotation[4] * y + rotation[5] * z,
        rotation[6] * x + rotation[7] * y + rotation[8] * z,
    )
