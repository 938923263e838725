"""Kernels on vertices: affine maps, normals, refinement and colours."""

from __future__ import annotations

import math

import numpy as np

from spatula_env._kernels import kernel
from spatula_env.render.layout import Floats, Indices, inlined


@kernel("void(f8[:,::1], i8, i8, f8[:,::1], f8[:,::1])")
def place(points: Floats, first: int, last: int, matrix: Floats, out: Floats) -> None:
    """Apply an affine map (3, 4) to the points first..last."""
    for i in range(first, last):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for k in range(3):
            out[i, k] = matrix[k, 0] * x + matrix[k, 1] * y + matrix[k, 2] * z + matrix[k, 3]


@inlined
def triangle_normal(points: Floats, triangles: Indices, t: int) -> tuple[float, float, float]:
    """Normal of triangle t, with a length of twice its area."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@kernel("void(f8[:,::1], i4[:,::1], i8, i8, i8, i8, f8[:,::1])")
def vertex_normals(
    points: Floats,
    triangles: Indices,
    first_point: int,
    last_point: int,
    first_triangle: int,
    last_triangle: int,
    normals: Floats,
) -> None:
    """Mean of the normals of the triangles around each vertex, weighted by area, of unit length."""
    for i in range(first_point, last_point):
        normals[i, 0] = normals[i, 1] = normals[i, 2] = 0.0
    for t in range(first_triangle, last_triangle):
        nx, ny, nz = triangle_normal(points, triangles, t)
        for k in range(3):
            i = triangles[t, k]
            normals[i, 0] += nx
            normals[i, 1] += ny
            normals[i, 2] += nz
    for i in range(first_point, last_point):
        length = math.sqrt(normals[i, 0] ** 2 + normals[i, 1] ** 2 + normals[i, 2] ** 2)
        if length > 0.0:
            for k in range(3):
                normals[i, k] /= length


@inlined
def _before(points: Floats, a: int, b: int) -> bool:
    """Whether point a comes before point b, in an order that does not depend on which is named first."""
    for k in range(3):
        if points[a, k] != points[b, k]:
            return bool(points[a, k] < points[b, k])
    return a < b


@kernel("i8(i4[:,::1], i8, i8, i4[:,::1], i8, i8, f8, f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1])")
def refine(
    triangles: Indices,
    first: int,
    last: int,
    out: Indices,
    out_first: int,
    vertex: int,
    floor: float,
    points: Floats,
    normals: Floats,
    colors: Floats,
    texture: Floats,
) -> int:
    """Split each triangle in four along a curved surface that follows from the vertex normals.

    The middle of an edge is moved half the way to the mean of its projections onto the tangent planes of the edge's
    ends (after T. Boubekeur and M. Alexa, "Phong tessellation", 2008; half the way lands on the circle through the
    ends, up to the fourth order of the angle between the normals). Both triangles of an edge compute the same middle to
    the last bit, so no seam opens.

    Args:
        triangles: (T, 3).
        first: first triangle to split.
        last: end of the triangles to split.
        out: (T', 3), where four triangles for each are written.
        out_first: first row of `out` to write.
        vertex: first free vertex; three are added for each triangle.
        floor: z below which no middle is moved if the edge's ends are above, such as the ground.
        points: (N, 3).
        normals: vertex normals (N, 3), of unit length.
        colors: linear colours (N, 3).
        texture: texture coordinates (N, 3).

    Returns:
        The next free vertex.
    """
    row = out_first
    middle = np.empty(3, dtype=np.int64)
    for t in range(first, last):
        for k in range(3):
            a, b = triangles[t, k], triangles[t, (k + 1) % 3]
            if not _before(points, a, b):
                a, b = b, a
            # Half an edge along each normal is how far the middle is off each tangent plane.
            off_a = off_b = 0.0
            for j in range(3):
                half = 0.5 * (points[b, j] - points[a, j])
                off_a += half * normals[a, j]
                off_b -= half * normals[b, j]
            off_a *= 0.25
            off_b *= 0.25
            total = 0.0
            for j in range(3):
                na, nb = normals[a, j], normals[b, j]
                points[vertex, j] = 0.5 * (points[a, j] + points[b, j]) - off_a * na - off_b * nb
                normals[vertex, j] = na + nb
                total += (na + nb) * (na + nb)
            lowest = min(floor, points[a, 2], points[b, 2])
            points[vertex, 2] = max(points[vertex, 2], lowest)
            scale = 1.0 / math.sqrt(max(total, 1e-300))
            for j in range(3):
                normals[vertex, j] *= scale
                colors[vertex, j] = 0.5 * (colors[a, j] + colors[b, j])
                texture[vertex, j] = 0.5 * (texture[a, j] + texture[b, j])
            middle[k] = vertex
            vertex += 1
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ab, bc, ca = middle[0], middle[1], middle[2]
        out[row, 0], out[row, 1], out[row, 2] = a, ab, ca
        out[row + 1, 0], out[row + 1, 1], out[row + 1, 2] = b, bc, ab
        out[row + 2, 0], out[row + 2, 1], out[row + 2, 2] = c, ca, bc
        out[row + 3, 0], out[row + 3, 1], out[row + 3, 2] = ab, bc, ca
        row += 4
    return vertex


@kernel("void(f8[:,::1], i8, i8, f8[:,::1])")
def to_linear(colors: Floats, first: int, last: int, out: Floats) -> None:
    """Decode sRGB (IEC 61966-2-1) into out[first..last]."""
    for i in range(first, last):
        for k in range(3):
            value = colors[i - first, k]
            if value <= 0.04045:
                out[i, k] = value / 12.92
            else:
                out[i, k] = ((value + 0.055) / 1.055) ** 2.4
