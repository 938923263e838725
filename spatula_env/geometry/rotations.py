"""Vectorised rotations: quaternions xyzw along the last axis of arrays, whose other axes broadcast."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from spatula_env.arrays import FloatArray

SMALL_ANGLE = 1e-6
"""Below this half angle the quotient of sine and angle is computed by its series [rad]."""


def multiply(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """The rotation `second` followed by the rotation `first`.

    Args:
        first: (..., 4) quaternions.
        second: (..., 4).

    Returns:
        (..., 4).
    """
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    vector = a[..., 3:] * b[..., :3] + b[..., 3:] * a[..., :3] + np.cross(a[..., :3], b[..., :3])
    scalar = a[..., 3] * b[..., 3] - (a[..., :3] * b[..., :3]).sum(axis=-1)
    return np.concatenate([vector, scalar[..., None]], axis=-1)


def conjugate(rotation: ArrayLike) -> FloatArray:
    """The opposite rotation (..., 4) of unit quaternions (..., 4)."""
    return np.asarray(rotation, dtype=np.float64) * [-1.0, -1.0, -1.0, 1.0]


def turn(rotation: ArrayLike, vectors: ArrayLike) -> FloatArray:
    """Turn vectors.

    Args:
        rotation: (..., 4) unit quaternions.
        vectors: (..., 3).

    Returns:
        (..., 3).
    """
    q, v = np.asarray(rotation, dtype=np.float64), np.asarray(vectors, dtype=np.float64)
    across = 2.0 * np.cross(q[..., :3], v)
    return np.asarray(v + q[..., 3:] * across + np.cross(q[..., :3], across))


def from_rotation_vector(vector: ArrayLike) -> FloatArray:
    """Unit quaternions (..., 4) of rotation vectors (..., 3): axis times angle [rad]."""
    half = 0.5 * np.asarray(vector, dtype=np.float64)
    angle = np.sqrt((half**2).sum(axis=-1, keepdims=True))
    safe = np.maximum(angle, SMALL_ANGLE)
    factor = np.where(angle > SMALL_ANGLE, np.sin(safe) / safe, 1.0 - angle**2 / 6.0)
    return np.concatenate([factor * half, np.cos(angle)], axis=-1)


def to_rotation_vector(rotation: ArrayLike) -> FloatArray:
    """Rotation vectors (..., 3) no longer than pi [rad] of unit quaternions (..., 4)."""
    q = np.asarray(rotation, dtype=np.float64)
    q = np.where(q[..., 3:] < 0.0, -q, q)
    sine = np.sqrt((q[..., :3] ** 2).sum(axis=-1, keepdims=True))
    angle = 2.0 * np.arctan2(sine, q[..., 3:])
    factor = np.where(sine > SMALL_ANGLE, angle / np.maximum(sine, SMALL_ANGLE), 2.0)
    return np.asarray(factor * q[..., :3])
