"""Convex hulls of points in space.

The hull grows from a tetrahedron by the point that stands out farthest, as in Quickhull (C. B. Barber, D. P.
Dobkin and H. Huhdanpaa, The Quickhull algorithm for convex hulls, ACM Transactions on Mathematical Software
22(4), 1996). Points that stand out less than a tolerance are left out. Taking the farthest point first keeps
the triangles well shaped, which makes the use of a tolerance safe; the result is checked nevertheless.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spatula_env.arrays import FloatArray, Int32Array
from spatula_env.geometry.surface import canonical_order, triangle_normals

FACTORS = (1.0, 0.1, 10.0, 0.01, 100.0, 0.001)
"""Factors on the tolerance, tried in turn: where points stand out by just about one tolerance, another one may work."""


def convex_hull(points: ArrayLike, tolerance: float = 1e-10) -> Int32Array:
    """Triangles of the convex hull of a set of points.

    Points that stand out of the hull of the others by no more than the tolerance, such as points in the
    middle of a face or an edge, may be left out. A flat face of more than three corners is divided into
    triangles, in a way that is not specified.

    Args:
        points: Positions, shape (n, 3) with n >= 4 [u].
        tolerance: How far a point may stand out and still be left out, as a fraction of the points' extent. Up
            to a hundred times as much is used where distances between points are of just that size.

    Returns:
        Indices into ``points`` of shape (T, 3), int32, counter-clockwise seen from outside, in the order of
        :func:`~spatula_env.geometry.surface.canonical_order`.

    Raises:
        ValueError: If there are fewer than four points, or they are not finite, or lie in a plane.
    """
    positions = np.array(points, dtype=np.float64)
    if positions.ndim != 2 or positions.shape[1] != 3 or len(positions) < 4:
        raise ValueError(f"points must have shape (n, 3) with n >= 4, got {positions.shape}")
    if not np.isfinite(positions).all():
        raise ValueError("points must be finite")
    largest = float(np.abs(positions).max())
    positions -= 0.5 * (positions.min(axis=0) + positions.max(axis=0))
    extent = float(np.abs(positions).max())
    # Points far from the origin carry rounding errors of their distance, not of their extent.
    distance = max(tolerance * extent, 16.0 * float(np.finfo(np.float64).eps) * largest)
    start = _largest_tetrahedron(positions, distance)
    for factor in FACTORS:
        triangles = _grow(positions, start, factor * distance)
        if _is_hull(positions, triangles, factor * distance):
            return canonical_order(triangles)
    raise ValueError(
        f"no hull of the {len(positions)} points was found within {max(FACTORS) * distance:g} u: "
        "leave out points that all but coincide with the hull of the others"
    )


def _largest_tetrahedron(points: FloatArray, tolerance: float) -> NDArray[np.int64]:
    """Four points far apart, shape (4,), the last above the plane of the others; ValueError if all are in a plane."""
    first = int(np.argmin(points[:, np.argmax(np.ptp(points, axis=0))]))
    offset = points - points[first]
    second = int(np.argmax(np.linalg.norm(offset, axis=1)))
    along = offset[second] / max(float(np.linalg.norm(offset[second])), np.finfo(np.float64).tiny)
    across = offset - np.outer(offset @ along, along)
    third = int(np.argmax(np.linalg.norm(across, axis=1)))
    sideways = across[third] / max(float(np.linalg.norm(across[third])), np.finfo(np.float64).tiny)
    height = offset @ np.cross(along, sideways)
    fourth = int(np.argmax(np.abs(height)))
    if abs(height[fourth]) <= tolerance:
        raise ValueError(f"points must span a volume, got {len(points)} that lie in a plane within {tolerance:.3g} u")
    if height[fourth] < 0.0:
        second, third = third, second
    return np.array([first, second, third, fourth])


def _grow(points: FloatArray, start: NDArray[np.int64], tolerance: float) -> NDArray[np.int64]:
    """Grow the tetrahedron ``start`` until no point stands out above the tolerance; triangles (T, 3)."""
    a, b, c, apex = start.tolist()
    triangles = np.array([[a, c, b], [a, b, apex], [b, c, apex], [c, a, apex]])
    normals, offsets = _planes(points, triangles)
    # Every waiting point is assigned to the triangle above which it is highest. Only the points of removed
    # triangles must be assigned anew, and only to the triangles that replace these.
    waiting = np.setdiff1d(np.arange(len(points)), start)
    heights = points[waiting] @ normals.T - offsets
    owner, height = heights.argmax(axis=1), heights.max(axis=1)
    while True:
        outside = height > tolerance
        waiting, owner, height = waiting[outside], owner[outside], height[outside]
        if not waiting.size:
            return triangles
        slot = int(np.argmax(height))
        apex = int(waiting[slot])
        visible = normals @ points[apex] - offsets > tolerance
        visible[owner[slot]] = True  # even if this product rounds otherwise than the one before
        rim = _rim(triangles[visible], len(points))
        fresh = np.column_stack([rim, np.full(len(rim), apex)])
        fresh_normals, fresh_offsets = _planes(points, fresh)

        orphan = np.flatnonzero(visible[owner])
        kept = ~visible
        owner = (np.cumsum(kept) - 1)[owner]
        heights = points[waiting[orphan]] @ fresh_normals.T - fresh_offsets
        owner[orphan] = kept.sum() + heights.argmax(axis=1)
        height[orphan] = heights.max(axis=1)
        height[slot] = -np.inf  # it is a corner now, whatever rounding says
        triangles = np.concatenate([triangles[kept], fresh])
        normals = np.concatenate([normals[kept], fresh_normals])
        offsets = np.concatenate([offsets[kept], fresh_offsets])


def _rim(triangles: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Directed edges (k, 2) of the triangles whose reverse is not an edge of another of the triangles."""
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    outer = ~np.isin(start * count + end, end * count + start)
    return np.column_stack([start[outer], end[outer]])


def _planes(points: FloatArray, triangles: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Outward unit normals (T, 3) and offsets (T,) of the planes of the triangles."""
    normals = triangle_normals(points, triangles)
    return normals, np.einsum("ij,ij->i", normals, points[triangles].mean(axis=1))


def _is_hull(points: FloatArray, triangles: NDArray[np.int64], tolerance: float) -> bool:
    """Whether the triangles form a closed surface like a sphere, with every point inside it to ten tolerances."""
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    forward = np.unique(start * len(points) + end)
    backward = np.unique(end * len(points) + start)
    if len(forward) != len(start) or not np.array_equal(forward, backward):
        return False
    # Euler's formula V - E + F = 2, where a closed surface has E = 3 F / 2.
    if len(np.unique(triangles)) - len(triangles) // 2 != 2:
        return False
    normals, offsets = _planes(points, triangles)
    if not normals.any(axis=1).all():
        return False
    return all(
        (points @ normal <= offset + 10.0 * tolerance).all() for normal, offset in zip(normals, offsets, strict=True)
    )
