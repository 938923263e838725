"""Measurements on an organ's surface."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spatula_env._kernels import kernel
from spatula_env.contact.raycast import cast_ray
from spatula_env.contact.structures import NO_HIT
from spatula_env.geometry.surface import triangle_areas, triangle_normals

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from spatula_env.arrays import FloatArray, IndexArray, IntArray


@kernel("f8[::1](f8[:,:,::1], i4[:,::1], f8[:,::1], f8)")
def surface_heights(nodes: np.ndarray, triangles: np.ndarray, places: np.ndarray, ground_height: float) -> np.ndarray:
    """Height of surfaces, seen vertically from above.

    Args:
        nodes: (W, V, 3) nodes of the surfaces, or (1, V, 3) if the surface is the same for all places.
        triangles: (T, 3) of all of them.
        places: (W, 2) x and y of the place on each surface.
        ground_height: Height to return where there is no surface.

    Returns:
        (W,) the greatest z of the surface at each place, in the unit of `nodes`.
    """
    heights = np.full(places.shape[0], ground_height)
    origin, down = np.empty(3), np.array([0.0, 0.0, -1.0])
    top = nodes[:, :, 2].max() + 1.0
    for w in range(places.shape[0]):
        origin[0], origin[1], origin[2] = places[w, 0], places[w, 1], top
        hit, distance, _, _, _ = cast_ray(origin, down, nodes[w if nodes.shape[0] > 1 else 0], triangles)
        if hit != NO_HIT:
            heights[w] = top - distance
    return heights


def points_on_top(nodes: FloatArray, triangles: NDArray[np.int32], places: FloatArray) -> tuple[IntArray, FloatArray]:
    """Find the triangles of a surface on which places lie, seen vertically from above.

    Args:
        nodes: (V, 3) nodes of the surface.
        triangles: (T, 3) its triangles.
        places: (K, 2) x and y, or (K, 3).

    Returns:
        Nodes (K, 3) of the highest triangle at each place, and their weights (K, 3): the weighted sum of the nodes is
        the place. Zeros where there is no triangle.
    """
    a, b, c = (nodes[triangles[:, corner]] for corner in range(3))
    first, second, away = b - a, c - a, places[:, None, :2] - a[:, :2]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    flat = np.abs(area) < 1e-15
    by = np.where(flat, 1.0, area)
    v = (away[..., 0] * second[:, 1] - away[..., 1] * second[:, 0]) / by
    w = (first[:, 0] * away[..., 1] - first[:, 1] * away[..., 0]) / by
    inside = (v >= -1e-9) & (w >= -1e-9) & (v + w <= 1.0 + 1e-9) & ~flat
    height = np.where(inside, a[:, 2] + v * first[:, 2] + w * second[:, 2], -np.inf)
    best, row = height.argmax(axis=1), np.arange(len(places))
    v, w, found = v[row, best], w[row, best], inside[row, best]
    weights = np.where(found[:, None], np.stack([1.0 - v - w, v, w], axis=1), 0.0)
    return np.where(found[:, None], triangles[best], 0).astype(np.int64), weights


def average_normals(
    nodes: FloatArray, triangles: IndexArray, points: FloatArray, radius: float, facing: ArrayLike | None = None
) -> FloatArray:
    """Unit normals of a surface near some of its points, weighted by area.

    Args:
        nodes: (V, 3) of the surface.
        triangles: (T, 3).
        points: (K, 3) on it, or NaN.
        radius: Distance within which triangles count; the nearest always does, and those that face away never.
        facing: (3,) direction from which triangles face away; None: the normal of the nearest one.

    Returns:
        (K, 3); NaN where the point is.
    """
    middles, normals = nodes[triangles].mean(axis=1), triangle_normals(nodes, triangles)
    vectors = normals * triangle_areas(nodes, triangles)[:, None]
    found = np.full_like(points, np.nan)
    for row in np.flatnonzero(np.isfinite(points).all(axis=1)):
        distance = np.sqrt(((middles - points[row]) ** 2).sum(axis=1))
        towards = normals[distance.argmin()] if facing is None else np.asarray(facing, dtype=np.float64)
        near = (distance <= max(radius, float(distance.min()))) & (normals @ towards > 0.0)
        total = vectors[near].sum(axis=0)
        length = np.sqrt(total @ total)
        if length > 0.0:
            found[row] = total / length
    return found


def farthest_points(points: ArrayLike, count: int) -> NDArray[np.int64]:
    """Choose points that are spread out: first the highest, then repeatedly the farthest from those chosen.

    After Y. Eldar et al., The farthest point strategy for progressive image sampling, IEEE Transactions on
    Image Processing 6(9), 1997.

    Args:
        points: (V, 3) points; the choice is deterministic, and takes the first of equal candidates.
        count: Number of points to choose.

    Returns:
        (count,) indices, in the order of the choice.

    Raises:
        ValueError: If there are fewer points than `count`.
    """
    positions = np.asarray(points, dtype=np.float64)
    if not 1 <= count <= len(positions):
        raise ValueError(f"count must be from 1 to {len(positions)}, the number of points, got {count!r}")
    chosen = np.empty(count, dtype=np.int64)
    chosen[0] = np.argmax(positions[:, 2])
    distance = np.full(len(positions), np.inf)
    for k in range(1, count):
        distance = np.minimum(distance, np.linalg.norm(positions - positions[chosen[k - 1]], axis=1))
        chosen[k] = np.argmax(distance)
    return chosen


def surface_samples(vertices: ArrayLike, triangles: ArrayLike, count: int) -> tuple[NDArray[np.int64], FloatArray]:
    """Sample points spread evenly over a surface, deterministically.

    They follow a low-discrepancy sequence, whose steps are powers of the reciprocal of the generalised plastic number,
    in the cumulative area and the two coordinates within a triangle (M. Roberts, The unreasonable effectiveness of
    quasirandom sequences, 2018).

    Args:
        vertices: (V, 3).
        triangles: (T, 3).
        count: Number of points.

    Returns:
        The triangle of each point (count,), and the weights of its corners (count, 3).
    """
    corners = np.asarray(vertices, dtype=np.float64)[np.asarray(triangles)]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    share = np.cumsum(areas) / areas.sum()
    index = np.arange(1, count + 1)
    # The generalised plastic number for three dimensions, the root of x^4 = x + 1.
    steps = 1.2207440846057596 ** -np.arange(1.0, 4.0)
    along, u, v = (0.5 + index[:, None] * steps).T % 1.0
    chosen = np.minimum(np.searchsorted(share, along), len(areas) - 1)
    root = np.sqrt(u)
    return chosen, np.column_stack([1.0 - root, root * (1.0 - v), root * v])
