"""Where the organ is, measured with rays that share nothing with the contact detector but the ray test itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import FloatArray
from spatula_env.contact.raycast import cast_ray

GRID = 20
"""Rays along each edge of the footprint."""


def footprint(low: FloatArray, high: FloatArray, count: int = GRID) -> FloatArray:
    """Points over a rectangle: the middles of `count` by `count` equal cells.

    Args:
        low: (2,) lower corner of the rectangle (x, y) [u].
        high: (2,) upper corner [u].
        count: Cells along each edge.

    Returns:
        (count * count, 2) points [u].
    """
    share = (np.arange(count) + 0.5) / count
    x, y = np.meshgrid(*(low + share[:, None] * (high - low)).T, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel()])


def surface_heights(points: FloatArray, vertices: FloatArray, triangles: NDArray[np.int32]) -> FloatArray:
    """Height of a surface over points of the plane: where vertical rays from above first meet it.

    Args:
        points: (P, 2) as (x, y) [u].
        vertices: (V, 3) [u].
        triangles: (T, 3).

    Returns:
        (P,) z of the surface [u]; NaN where a ray meets nothing.
    """
    above = float(vertices[:, 2].max()) + 1.0
    down = np.array([0.0, 0.0, -1.0])
    heights = np.full(len(points), np.nan)
    vertices, triangles = _writable(vertices, triangles)
    for index, (x, y) in enumerate(points):
        triangle, distance, _, _, _ = cast_ray(np.array([x, y, above]), down, vertices, triangles)
        if triangle >= 0:
            heights[index] = above - distance
    return heights


def is_inside(point: FloatArray, vertices: FloatArray, triangles: NDArray[np.int32]) -> bool:
    """Whether a point is inside a closed surface: the first triangle that a ray upwards meets, it leaves through.

    Args:
        point: (3,) [u].
        vertices: (V, 3) [u].
        triangles: (T, 3), counter-clockwise from outside.
    """
    up = np.array([0.0, 0.0, 1.0])
    triangle, _, _, _, facing = cast_ray(np.array(point), up, *_writable(vertices, triangles))
    return bool(triangle >= 0 and facing > 0.0)


def _writable(vertices: FloatArray, triangles: NDArray[np.int32]) -> tuple[FloatArray, NDArray[np.int32]]:
    """Copies: the ray kernel takes no read-only arrays, and those of an organ are read-only."""
    return np.array(vertices, dtype=np.float64), np.array(triangles, dtype=np.int32)
