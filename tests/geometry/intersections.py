"""Whether a surface crosses itself."""

from __future__ import annotations

import numpy as np

from spatula_env.geometry.surface import edges


def self_intersections(vertices, triangles):
    """Pairs (k, 2) of an edge and a triangle that have no vertex in common and cross, the slow and certain way."""
    pairs = edges(triangles)
    low_edge, high_edge = np.sort(vertices[pairs], axis=1)[:, 0], np.sort(vertices[pairs], axis=1)[:, 1]
    corners = vertices[triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    # The triangles in slices, so that the table of pairs stays small.
    found = []
    for start in range(0, len(triangles), 256):
        part = slice(start, start + 256)
        near = np.ones((len(pairs), len(low[part])), dtype=bool)
        for axis in range(3):
            near &= low_edge[:, None, axis] <= high[None, part, axis]
            near &= high_edge[:, None, axis] >= low[None, part, axis]
        edge, triangle = np.nonzero(near)
        triangle += start
        apart = (pairs[edge][:, :, None] != triangles[triangle][:, None, :]).all(axis=(1, 2))
        found.append(np.column_stack([edge[apart], triangle[apart]]))
    edge, triangle = np.concatenate(found).T
    origin, direction = vertices[pairs[edge, 0]], vertices[pairs[edge, 1]] - vertices[pairs[edge, 0]]
    a, b, c = (corners[triangle, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    slope = np.einsum("ij,ij->i", normal, direction)
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = np.einsum("ij,ij->i", normal, a - origin) / slope
        point = origin + fraction[:, None] * direction
        inside = (fraction >= 0.0) & (fraction <= 1.0)
        for first, second in ((a, b), (b, c), (c, a)):
            inside &= np.einsum("ij,ij->i", np.cross(second - first, point - first), normal) >= 0.0
    return np.column_stack([edge[inside], triangle[inside]])
