"""Lines on a finished surface that are named by points: along the floor of a fissure, or along the crest of a ridge."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry.prepared import FISSURE
from spatula_env.geometry.surface import edges, triangle_areas, triangle_normals

if TYPE_CHECKING:
    from collections.abc import Sequence

    from spatula_env.arrays import BoolArray, FloatArray, IndexArray, IntArray

FARTHEST = 3.0
"""Greatest distance of a point from the nearest node, in mean edges of that node; also the least half width of the
strip in which a way lies, seen from above, in mean edges of the surface."""

NEAR = 0.5
"""By how much farther than the nearest node one may be that is lower or higher and taken for a point, in such edges."""

PENALTY = 1.5
"""By how many mean edges a way is off the floor or the crest when it costs e times as much."""

BEYOND = 2.0
"""How often e times less a way costs at the least that is lower than the ends on a floor, or higher on a crest."""

CORRIDOR = 0.2
"""How far a way may be from the straight one, seen from above, as a part of the distance of its ends."""

LEAST_UP = -0.3
"""Least vertical component of the normals of nodes on a way: it does not lead around below the organ."""


def traced(
    vertices: FloatArray, triangles: IndexArray, points: Sequence[Sequence[float]], name: str
) -> tuple[int, ...]:
    """Find the nodes along a line: on the lowest way between the points for a fissure, on the highest for a ridge.

    Args:
        vertices: (V, 3) positions, as posed [m].
        triangles: (T, 3).
        points: The points, in their order along the line, three numbers each [m].
        name: "fissure" or "ridge", also for messages.

    Returns:
        The nodes, from one end to the other; each is connected with the next by an edge.

    Raises:
        ValueError: If a point is far from the surface, two points become the same node, or nothing connects them.
    """
    pairs = edges(np.asarray(triangles, dtype=np.int32)).astype(np.int64)
    lengths = np.sqrt(((vertices[pairs[:, 0]] - vertices[pairs[:, 1]]) ** 2).sum(axis=1))
    # What is off the line is higher than it beside a fissure, and lower beside a ridge.
    off = vertices[:, 2] if name == FISSURE else -vertices[:, 2]
    stops = [_node_at(vertices, pairs, lengths, off, point, name) for point in np.asarray(points, dtype=np.float64)]
    upwards = _upwards(vertices, triangles)[pairs].all(axis=1)
    pairs, lengths = pairs[upwards], lengths[upwards]
    nodes = [stops[0]]
    for first, last in pairwise(stops):
        nodes += _way(vertices, pairs, lengths, off, first, last, name)[1:]
    if len(set(nodes)) != len(nodes):
        raise ValueError(
            f"{name} must be points in their order along it, but the way through {len(points)} crosses itself"
        )
    return tuple(nodes)


def length_of(points: FloatArray) -> float:
    """Length of a line through points (K, 3), in their unit."""
    return float(np.sqrt((np.diff(points, axis=0) ** 2).sum(axis=1)).sum())


def _upwards(vertices: FloatArray, triangles: IndexArray) -> BoolArray:
    """(V,) which nodes look upwards or aside, by the normals of the triangles around them, weighted by area."""
    vectors = triangle_normals(vertices, triangles)[:, 2] * triangle_areas(vertices, triangles)
    areas = triangle_areas(vertices, triangles)
    up, around = (
        np.bincount(triangles.ravel(), weights=np.repeat(weights, 3), minlength=len(vertices))
        for weights in (vectors, areas)
    )
    return np.asarray(up >= LEAST_UP * around)


def _node_at(
    vertices: FloatArray, pairs: IntArray, lengths: FloatArray, off: FloatArray, point: FloatArray, name: str
) -> int:
    """The node nearest to a point, or one about as near that is lower on a floor, or higher on a crest."""
    distance = np.sqrt(((vertices - point) ** 2).sum(axis=1))
    nearest = float(distance.min())
    edge = float(lengths[(pairs == distance.argmin()).any(axis=1)].mean())
    if nearest > FARTHEST * edge:
        low, high = (np.round(limit, 4).tolist() for limit in (vertices.min(axis=0), vertices.max(axis=0)))
        raise ValueError(
            f"{name} must be points on the surface: {np.round(point, 4).tolist()} is {1e3 * nearest:.1f} mm from its "
            f"nearest node, {1e3 * FARTHEST * edge:.1f} mm are allowed; the organ spans {low} to {high} m"
        )
    near = np.flatnonzero(distance <= nearest + NEAR * edge)
    return int(near[off[near].argmin()])


def _way(
    vertices: FloatArray, pairs: IntArray, lengths: FloatArray, off: FloatArray, first: int, last: int, name: str
) -> list[int]:
    """Nodes of the cheapest way from one node to another along edges (E, 2) with lengths (E,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    if first == last:
        raise ValueError(
            f"{name} must be points that are farther apart: two of them have the same node, {first}, in common"
        )
    edge = float(lengths.mean())
    start, way = vertices[first, :2], vertices[last, :2] - vertices[first, :2]
    straight = max(float(np.hypot(*way)), 1e-9)
    x, y = way / straight
    along, aside = np.moveaxis((vertices[:, :2] - start) @ np.array([[x, -y], [y, x]]), -1, 0)
    within = (np.abs(aside) <= max(CORRIDOR * straight, FARTHEST * edge)) & (
        np.abs(along - 0.5 * straight) <= 0.5 * straight + edge
    )
    kept = within[pairs].all(axis=1)
    over = (off[pairs].mean(axis=1) - min(off[first], off[last])) / (PENALTY * edge)
    cost = lengths * np.exp(np.clip(over, -BEYOND, 20.0))
    graph = coo_array((cost[kept], (pairs[kept, 0], pairs[kept, 1])), shape=(len(off), len(off))).tocsr()
    distance, before = dijkstra(graph, directed=False, indices=first, return_predecessors=True)
    if not np.isfinite(distance[last]):
        raise ValueError(f"{name} must be points on one piece of the surface: nothing near connects two of them")
    nodes = [last]
    while nodes[-1] != first:
        nodes.append(int(before[nodes[-1]]))
    return nodes[::-1]
