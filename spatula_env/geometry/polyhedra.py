"""Flat faces of convex polyhedra, and lattices of points on them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import FloatArray, Int32Array
from spatula_env.geometry.surface import triangle_areas, triangle_normals

COPLANAR = 1e-6
"""Triangles belong to one face if they deviate from its plane by at most this fraction of the extent.

Coordinates from files are often in single precision, whose rounding is a tenth of that.
"""


def cell_count(length: float, spacing: float) -> int:
    """The least number of equal cells, none longer than ``spacing`` by more than a millionth, that make up a length.

    Args:
        length: The length to divide [u].
        spacing: Greatest length of a cell [u].

    Returns:
        The number of cells, at least 1.
    """
    # The factor makes 1 / 0.2 five cells whichever way it rounds, in single precision, too.
    return max(1, math.ceil(length / spacing * (1.0 - 1e-6)))


@dataclass(frozen=True, eq=False)
class Face:
    """A flat face of a convex polyhedron.

    Attributes:
        normal: Outward unit normal, shape (3,).
        offset: Distance of the face's plane from the origin along the normal [u].
        area: Area [u2].
        centroid: Centre of area, shape (3,) [u].
        rim: Start and end of every edge of the rim, shape (k, 2, 3), counter-clockwise seen from outside [u].
    """

    normal: FloatArray
    offset: float
    area: float
    centroid: FloatArray
    rim: FloatArray

    def lattice(self, spacing: float) -> FloatArray:
        """Points spread evenly over the face, none of them on its rim.

        The face is cut across its longest edge into strips of equal width, and the line along the middle of
        each strip into equal parts; the points are the middles of the parts. On a rectangle this is a grid of
        cells, and a narrow tip still gets its points. A point on the rim would not do: the ray inwards from
        it would run in a neighbouring face's plane.

        Args:
            spacing: Greatest width of a strip and length of a part [u].

        Returns:
            Points of shape (m, 3) with m >= 1 [u].
        """
        direction = self.rim[:, 1] - self.rim[:, 0]
        length = np.linalg.norm(direction, axis=1)
        # Among edges of equal length, up to rounding, take the first.
        longest = int(np.argmax(length >= length.max() * (1.0 - COPLANAR)))
        along = direction[longest] / length[longest]
        across = np.cross(self.normal, along)
        plane = np.column_stack([along, across])
        corners = (self.rim[:, 0] - self.centroid) @ plane
        low, width = float(corners[:, 0].min()), float(np.ptp(corners[:, 0]))
        strips = cell_count(width, spacing)
        x = low + (np.arange(strips) + 0.5) * (width / strips)

        # The face lies where inward . (point - corner) >= 0 for every edge of its rim. Edges straight across
        # the strips bound none of the lines.
        inward = np.cross(self.normal, direction / length[:, None]) @ plane
        level = np.einsum("ij,ij->i", inward, corners)
        lower, upper = inward[:, 1] > 1e-9, inward[:, 1] < -1e-9
        y = (level[:, None] - np.outer(inward[:, 0], x)) / np.where(lower | upper, inward[:, 1], 1.0)[:, None]
        start, end = y[lower].max(axis=0), y[upper].min(axis=0)
        points = []
        for strip in range(strips):
            parts = cell_count(float(end[strip] - start[strip]), spacing)
            fraction = (np.arange(parts) + 0.5) / parts
            heights = start[strip] + fraction * (end[strip] - start[strip])
            points.append(self.centroid + x[strip] * along + heights[:, None] * across)
        return np.concatenate(points)


def polyhedron_faces(vertices: FloatArray, triangles: Int32Array) -> list[Face]:
    """Join the triangles of a convex polyhedron into its flat faces.

    Args:
        vertices: Positions, shape (K, 3) [u].
        triangles: Vertex indices, shape (M, 3), of the polyhedron's surface, wound outwards.

    Returns:
        The faces from the largest to the smallest, those of equal area in the order of their vertices.
    """
    normals, areas = triangle_normals(vertices, triangles), triangle_areas(vertices, triangles)
    label = _face_labels(vertices, triangles, normals, areas)
    middles = vertices[triangles].mean(axis=1)
    start, end = triangles.ravel().astype(np.int64), np.roll(triangles, -1, axis=1).ravel().astype(np.int64)
    faces: list[tuple[float, list[int], Face]] = []
    for index in range(int(label.max()) + 1):
        own = label == index
        area = float(areas[own].sum())
        normal = areas[own] @ normals[own]
        normal /= np.linalg.norm(normal)
        edge_start, edge_end = start[np.repeat(own, 3)], end[np.repeat(own, 3)]
        base = len(vertices)
        outer = ~np.isin(edge_start * base + edge_end, edge_end * base + edge_start)
        order = np.argsort(edge_start[outer])
        rim = np.column_stack([edge_start[outer][order], edge_end[outer][order]])
        face = Face(
            normal=normal,
            offset=float((vertices[rim[:, 0]] @ normal).max()),
            area=area,
            centroid=areas[own] @ middles[own] / area,
            rim=vertices[rim],
        )
        faces.append((area, rim[:, 0].tolist(), face))
    # Areas that differ by rounding alone must not decide the order.
    unit = max(area for area, _, _ in faces) * COPLANAR
    faces.sort(key=lambda entry: (-round(entry[0] / unit), entry[1]))
    return [face for _, _, face in faces]


def _face_labels(
    vertices: FloatArray, triangles: Int32Array, normals: FloatArray, areas: FloatArray
) -> NDArray[np.int64]:
    """Number of the face each triangle belongs to, shape (M,)."""
    near = COPLANAR * float(np.ptp(vertices, axis=0).max())
    label = np.full(len(triangles), -1)
    count = 0
    # The largest remaining triangle defines a plane, and its face consists of all triangles in that plane.
    # Joining neighbours one by one instead would join two faces of a box across a sliver at their common edge,
    # which lies in both planes.
    for seed in np.argsort(-areas, kind="stable"):
        if label[seed] < 0:
            heights = (vertices - vertices[triangles[seed, 0]]) @ normals[seed]
            flat = (np.abs(heights) <= near)[triangles].all(axis=1) & (normals @ normals[seed] > 0.0)
            flat[seed] = True
            label[flat & (label < 0)] = count
            count += 1
    return label
