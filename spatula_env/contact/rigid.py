"""Small vector helpers of the contact kernels."""

from __future__ import annotations

import numpy as np

from spatula_env._kernels import array_kernel

BEST_FACE_MARGIN = 0.1
"""A face opposes a triangle clearly better than another if the cosines differ by more than this."""


@array_kernel
def dot(a: np.ndarray, b: np.ndarray) -> float:
    """Scalar product of two vectors (3,)."""
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


@array_kernel
def turn(rotation: np.ndarray, vector: np.ndarray) -> tuple[float, float, float]:
    """Rotation matrix (9,), row by row, times vector (3,)."""
    x, y, z = vector[0], vector[1], vector[2]
    return (
        rotation[0] * x + rotation[1] * y + rotation[2] * z,
        rotation[3] * x + rotation[4] * y + rotation[5] * z,
        rotation[6] * x + rotation[7] * y + rotation[8] * z,
    )


@array_kernel
def opposes_best(normal: np.ndarray, face_normal: np.ndarray, face_normals: np.ndarray) -> bool:
    """Whether no face of a tool opposes a triangle clearly better than a given one.

    A plane that has come into a convex body is pushed out of it by the face that opposes the plane most: the body's
    outermost point on that side lies on this face.

    Args:
        normal: (3,) unit normal of the triangle, tool frame.
        face_normal: (3,) unit normal of the given face.
        face_normals: (F, 3) unit normals of the faces to compare it with.
    """
    opposition = -dot(normal, face_normal)
    for f in range(face_normals.shape[0]):
        if -dot(normal, face_normals[f]) > opposition + BEST_FACE_MARGIN:
            return False
    return True
