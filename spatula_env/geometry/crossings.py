"""Self-intersections of a triangle surface."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry.surface import edges

if TYPE_CHECKING:
    from collections.abc import Iterator

    from spatula_env.arrays import BoolArray, FloatArray, IndexArray, Int32Array, IntArray

MOST_PAIRS = 500_000
"""About how many pairs of an edge and a triangle have their boxes compared at once, which bounds the memory."""


def self_crossings(vertices: FloatArray, triangles: IndexArray) -> Int32Array:
    """Find the edges of a surface that go through triangles with which they share no vertex.

    Candidate pairs are found by their bounding boxes, along the axis on which the surface is longest (sweep and prune).
    An edge goes through a triangle if its ends are on different sides of the triangle's plane, where an end on the
    plane counts as below it, and if the point at which it meets the plane is in the triangle or on its border. A
    surface that merely touches itself may therefore be reported as crossing, but two triangles in one plane never are.

    Args:
        vertices: (V, 3) positions [u].
        triangles: (T, 3) vertex indices.

    Returns:
        (k, 5) vertex indices, int32: the two of the edge, then the three of the triangle.
    """
    pairs = edges(triangles)
    found = [np.zeros((0, 5), dtype=np.int32)]
    for edge, triangle in _near_pairs(vertices, pairs, triangles):
        apart = (pairs[edge][:, :, None] != triangles[triangle][:, None, :]).all(axis=(1, 2))
        corners = np.concatenate([pairs[edge[apart]], triangles[triangle[apart]]], axis=1).astype(np.int32)
        found.append(corners[_crosses(vertices[corners])])
    return np.concatenate(found)


def _near_pairs(vertices: FloatArray, pairs: IndexArray, triangles: IndexArray) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield the edges (n,) and triangles (n,) whose bounding boxes have a point in common, in batches."""
    axes = np.argsort(-np.ptp(vertices, axis=0))
    # One row for each axis, beginning with the axis of the sweep.
    edge_low, edge_high, low, high = (
        np.ascontiguousarray(reduce(vertices[corners], axis=1)[:, axes].T)
        for corners in (pairs, triangles)
        for reduce in (np.min, np.max)
    )
    order = np.argsort(low[0], kind="stable")
    low, high = low[:, order], high[:, order]
    # A triangle whose box overlaps that of an edge begins no farther below the edge than the longest box is long.
    longest = (high[0] - low[0]).max()
    first = np.searchsorted(low[0], np.nextafter(edge_low[0] - longest, -np.inf), side="left")
    counts = np.searchsorted(low[0], edge_high[0], side="right") - first
    parts = np.cumsum(counts) // MOST_PAIRS
    for part in np.unique(parts):
        own = np.flatnonzero(parts == part)
        edge = np.repeat(own, counts[own])
        place = np.arange(len(edge)) + np.repeat(first[own] - np.cumsum(counts[own]) + counts[own], counts[own])
        for other in (1, 2, 0):
            near = edge_low[other][edge] <= high[other][place]
            near &= edge_high[other][edge] >= low[other][place]
            edge, place = edge[near], place[near]
        yield edge, order[place]


def _crosses(points: FloatArray) -> BoolArray:
    """(n,) whether edges go through triangles, from the positions (n, 5, 3) of the ends and the corners."""
    p, q, a, b, c = np.moveaxis(points, 1, 0)
    u, v = b - a, c - a
    normal = np.cross(u, v)
    first, second = ((normal * (end - a)).sum(axis=1) for end in (p, q))
    passing = (first > 0.0) != (second > 0.0)
    p, q, a, u, v, normal, first, second = (values[passing] for values in (p, q, a, u, v, normal, first, second))
    meeting = p + (first / (first - second))[:, None] * (q - p) - a
    # Barycentric weights of the second and the third corner, times the squared normal.
    weights = [(normal * np.cross(*sides)).sum(axis=1) for sides in ((meeting, v), (u, meeting))]
    inside = (weights[0] >= 0.0) & (weights[1] >= 0.0) & (weights[0] + weights[1] <= (normal**2).sum(axis=1))
    crossing = np.zeros(len(points), dtype=np.bool_)
    crossing[passing] = inside
    return crossing
