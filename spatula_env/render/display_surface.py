"""The organ's surface for display: finer than in the physics, with smooth curved parts and sharp edges."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import FloatArray, Int32Array
from spatula_env.render import vertices as kernels

CREASE_ANGLE = 62.0
"""Two triangles that meet at a greater angle form a sharp edge; otherwise the surface is curved there [degrees]."""

FINE_ENOUGH = 0.3
"""Triangles whose edges are shorter than this on average are not split [u]."""

MOST_LEVELS = 2
"""Greatest number of times that triangles are split in four."""


@dataclass(frozen=True, eq=False)
class _Level:
    """Splitting of each triangle in four.

    Attributes:
        triangles: (T, 3) before.
        first: (E,) one end of each edge.
        second: (E,) its other end.
        curved: (E, 1) 1 where the edge's middle is moved onto the curved surface, 0 along creases.
    """

    triangles: Int32Array
    first: NDArray[np.intp]
    second: NDArray[np.intp]
    curved: FloatArray


class DisplaySurface:
    """Computes the vertices to draw from the nodes of the physics.

    Vertices are the nodes, repeated along creases, followed by the middles of split edges. Creases and splitting are
    determined on the surface at rest, so that nothing flickers as it deforms.

    Attributes:
        triangles: (T', 3) that are drawn, counter-clockwise from outside.
        rest: (V', 3) vertices at rest [u].
        source: (K,) node that each of the first K vertices is; all vertices, if no triangle is split.
    """

    def __init__(self, nodes: FloatArray, triangles: Int32Array, levels: int | None = None) -> None:
        """Find creases and split triangles.

        Args:
            nodes: (V, 3) at rest [u].
            triangles: (T, 3), counter-clockwise from outside.
            levels: How many times to split each triangle in four; None: until edges are short.
        """
        nodes = np.ascontiguousarray(nodes, dtype=np.float64)
        self.source, current = _split_at_creases(nodes, np.asarray(triangles, dtype=np.int32))
        count = len(self.source)
        if levels is None:
            corners = nodes[triangles]
            length = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())
            levels = 0
            while length > FINE_ENOUGH and levels < MOST_LEVELS:
                length, levels = 0.5 * length, levels + 1
        self._levels: list[_Level] = []
        for _ in range(levels):
            level, current = _split_edges(current, count)
            self._levels.append(level)
            count += len(level.first)
        self.triangles = current
        self.rest = self.place(nodes)

    def place(self, nodes: FloatArray) -> FloatArray:
        """(V', 3) positions of the vertices, for nodes at (V, 3) [u].

        The middle of an edge lies halfway from the edge to the mean of its projections onto the tangent planes of the
        edge's ends (after T. Boubekeur and M. Alexa, "Phong tessellation", 2008); on a crease, on the edge itself.
        """
        points: FloatArray = np.asarray(nodes)[self.source]
        for level in self._levels:
            normals = vertex_normals(points, level.triangles)
            first, second = level.first, level.second
            half = 0.5 * (points[second] - points[first])
            toward_first, toward_second = normals[first], normals[second]
            off = (half * toward_first).sum(axis=1, keepdims=True) * toward_first
            off -= (half * toward_second).sum(axis=1, keepdims=True) * toward_second
            middles = points[first] + half - 0.25 * level.curved * off
            points = np.concatenate([points, middles])
        return points

    def interpolate(self, values: FloatArray) -> FloatArray:
        """Interpolate values (V, ...) at the nodes to values (V', ...) at the vertices, linearly along edges."""
        result: FloatArray = np.asarray(values, dtype=np.float64)[self.source]
        for level in self._levels:
            result = np.concatenate([result, 0.5 * (result[level.first] + result[level.second])])
        return result


def vertex_normals(points: FloatArray, triangles: Int32Array) -> FloatArray:
    """Unit normals (V, 3) of a surface, weighted by the areas of the triangles around each vertex."""
    normals = np.empty((len(points), 3))
    if not (points.flags.c_contiguous and points.flags.writeable):
        points = np.array(points)
    if not triangles.flags.writeable:
        triangles = np.array(triangles)
    kernels.vertex_normals(points, triangles, 0, len(points), 0, len(triangles), normals)
    return normals


def _edges(triangles: Int32Array) -> tuple[NDArray[np.int64], NDArray[np.intp], NDArray[np.intp]]:
    """Edges (E, 2), lower index first; the edge that begins at each corner (3 T,); triangles of each edge (E,)."""
    pairs = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    edges, of_corner, uses = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    return edges.astype(np.int64), of_corner.reshape(-1), uses


def _split_edges(triangles: Int32Array, count: int) -> tuple[_Level, Int32Array]:
    """Split each triangle in four at the middles of its edges, which follow the `count` vertices."""
    edges, of_corner, uses = _edges(triangles)
    a, b, c = triangles.T
    ab, bc, ca = (count + of_corner.reshape(-1, 3)).T
    fine = np.stack([a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca], axis=1).reshape(-1, 3)
    level = _Level(triangles, edges[:, 0], edges[:, 1], (uses == 2).astype(np.float64)[:, None])
    return level, np.ascontiguousarray(fine, dtype=np.int32)


def _split_at_creases(nodes: FloatArray, triangles: Int32Array) -> tuple[NDArray[np.intp], Int32Array]:
    """Repeat the nodes on creases, once for each smooth piece of the surface around them.

    Returns:
        The node (V',) that each vertex is, and the triangles (T, 3) of vertices.
    """
    a, b, c = (nodes[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    _, of_corner, uses = _edges(triangles)
    order = np.argsort(of_corner, kind="stable")
    starts = np.concatenate([[0], np.cumsum(uses)[:-1]])[uses == 2]
    one, other = order[starts], order[starts + 1]
    cosine = (normals[one // 3] * normals[other // 3]).sum(axis=1)
    smooth = cosine >= math.cos(math.radians(CREASE_ANGLE))
    one, other = one[smooth], other[smooth]
    # Corner i begins an edge, and the next corner of the same triangle ends it. Two triangles of the same orientation
    # name their common edge in opposite directions.
    flat = triangles.reshape(-1)
    ends = [(one, other // 3 * 3 + (other + 1) % 3), (one // 3 * 3 + (one + 1) % 3, other)]
    left, right = (np.concatenate(part) for part in zip(*ends, strict=True))
    same = flat[left] == flat[right]
    left, right = left[same], right[same]
    label = np.arange(len(flat))
    while True:
        before = label.copy()
        np.minimum.at(label, left, label[right])
        np.minimum.at(label, right, label[left])
        if (label == before).all():
            break
    corners, vertex = np.unique(label, return_inverse=True)
    return flat[corners].astype(np.intp), vertex.reshape(-1, 3).astype(np.int32)
