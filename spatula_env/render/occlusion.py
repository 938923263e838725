"""Ambient occlusion, which makes, for example, the bottom of a fissure dark."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import FloatArray
from spatula_env.render import layout
from spatula_env.render.primitives import perpendicular_axes
from spatula_env.render.shadows import draw_flat

DIRECTIONS = 48
"""Number of directions from which visibility is tested."""

TEXELS = 160
"""Texels along a side of the depth map for each direction."""

LIFT = 0.6
"""Distance by which points are lifted off the surface before the test, in texels, so that triangles do not hide their
own points."""


def openness(points: FloatArray, normals: FloatArray, triangles: NDArray[np.int32]) -> FloatArray:
    """Share of the half-space before it that each point of a closed surface sees, weighted by the cosine to its normal.

    The surface is drawn in parallel projection from directions spread evenly over the sphere (a Fibonacci lattice).

    Args:
        points: (V, 3) [u].
        normals: (V, 3) unit vectors.
        triangles: (T, 3), counter-clockwise from outside.

    Returns:
        (V,) from 0 (nothing visible) to 1 (all of the half-space).
    """
    index = np.arange(DIRECTIONS) + 0.5
    height = 1.0 - 2.0 * index / DIRECTIONS
    turn = np.pi * (1.0 + 5.0**0.5) * index
    flat = np.sqrt(1.0 - height**2)
    directions = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), height])
    # Copies, because the kernel accepts only writable arrays.
    points, triangles = np.array(points, dtype=np.float64), np.array(triangles, dtype=np.int32)
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = max(float(np.sqrt(((points - middle) ** 2).sum(axis=1)).max()), 1e-9)
    texel = 2.0 * radius / (TEXELS - 4)
    lifted = points + LIFT * texel * normals
    owner = np.zeros(len(triangles), dtype=np.int32)
    flags = np.array([layout.CASTS], dtype=np.int32)
    parameters = np.zeros((1, layout.PARAMETERS))
    depth = np.empty((TEXELS, TEXELS), dtype=np.float32)
    shown = np.empty((TEXELS, TEXELS), dtype=np.int32)
    seen, total = np.zeros(len(points)), np.full(len(points), 1e-12)
    for direction in directions:
        facing = np.maximum(normals @ direction, 0.0)
        frame = np.stack(perpendicular_axes(direction))

        def project(places: FloatArray, frame: FloatArray = frame) -> FloatArray:
            local: FloatArray = (places - middle) @ frame.T
            local[:, :2] = local[:, :2] / texel + 0.5 * TEXELS
            return np.ascontiguousarray(local)

        depth[:] = -np.inf
        draw_flat(points, project(points), triangles, owner, len(triangles), flags, parameters, depth, shown)
        place = project(lifted)
        column, row = np.clip(place[:, :2].astype(np.intp), 0, TEXELS - 1).T
        seen += facing * (place[:, 2] > depth[row, column])
        total += facing
    return np.asarray(seen / total)
