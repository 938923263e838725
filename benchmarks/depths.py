"""How deep a tool and a surface are in each other, for the inspection: exact, and from nothing that contact computes.

Points are inside a closed surface by its winding number, and their depth is the distance to the nearest triangle. The
surface is looked at as a whole, not at its vertices: what of it is deepest in a convex tool may lie anywhere on a
triangle.
"""

from __future__ import annotations

import math

import numpy as np

from spatula_env._kernels import inline_kernel, kernel

GRAZE = 1e-12
"""A line passes so near an edge that the side is in doubt, if the triangle of edge and line has no more area [u2]."""


@inline_kernel
def _doubled_area(au: float, av: float, bu: float, bv: float, cu: float, cv: float) -> float:
    """Twice the signed area of a triangle in the plane."""
    return (bu - au) * (cv - av) - (bv - av) * (cu - au)


@inline_kernel
def _solid_angles(point: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Winding number of a closed surface about a point (3,), from the solid angles of all its triangles.

    A. van Oosterom and J. Strackee, The solid angle of a plane triangle, IEEE Transactions on Biomedical Engineering
    30(2), 1983.
    """
    total = 0.0
    for t in range(triangles.shape[0]):
        ax = vertices[triangles[t, 0], 0] - point[0]
        ay = vertices[triangles[t, 0], 1] - point[1]
        az = vertices[triangles[t, 0], 2] - point[2]
        bx = vertices[triangles[t, 1], 0] - point[0]
        by = vertices[triangles[t, 1], 1] - point[1]
        bz = vertices[triangles[t, 1], 2] - point[2]
        cx = vertices[triangles[t, 2], 0] - point[0]
        cy = vertices[triangles[t, 2], 1] - point[1]
        cz = vertices[triangles[t, 2], 2] - point[2]
        a = math.sqrt(ax * ax + ay * ay + az * az)
        b = math.sqrt(bx * bx + by * by + bz * bz)
        c = math.sqrt(cx * cx + cy * cy + cz * cz)
        volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        rest = (
            a * b * c
            + (ax * bx + ay * by + az * bz) * c
            + (bx * cx + by * cy + bz * cz) * a
            + (cx * ax + cy * ay + cz * az) * b
        )
        total += math.atan2(volume, rest)
    return total / (2.0 * math.pi)


@inline_kernel
def _squared_distance_to_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """Squared distance of a point from a segment, all (3,)."""
    along, length = 0.0, 0.0
    for k in range(3):
        along += (p[k] - a[k]) * (b[k] - a[k])
        length += (b[k] - a[k]) ** 2
    fraction = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
    total = 0.0
    for k in range(3):
        total += (a[k] + fraction * (b[k] - a[k]) - p[k]) ** 2
    return total


@inline_kernel
def _squared_distance_to_triangle(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Squared distance of a point from a triangle, all (3,)."""
    nx = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    ny = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    nz = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    squared = nx * nx + ny * ny + nz * nz
    within = squared > 0.0
    if within:
        corners = (a, b, c)
        for k in range(3):
            start, end = corners[k], corners[(k + 1) % 3]
            ex, ey, ez = end[0] - start[0], end[1] - start[1], end[2] - start[2]
            px, py, pz = p[0] - start[0], p[1] - start[1], p[2] - start[2]
            if nx * (ey * pz - ez * py) + ny * (ez * px - ex * pz) + nz * (ex * py - ey * px) < 0.0:
                within = False
    if within:
        height = nx * (p[0] - a[0]) + ny * (p[1] - a[1]) + nz * (p[2] - a[2])
        result: float = height * height / squared
        return result
    return min(
        _squared_distance_to_segment(p, a, b),
        _squared_distance_to_segment(p, b, c),
        _squared_distance_to_segment(p, c, a),
    )


@kernel("void(f8[:,::1], f8[:,::1], i4[:,::1], b1[::1], f8[::1])")
def locate_points(
    points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, inside: np.ndarray, depths: np.ndarray
) -> None:
    """Say which points a closed surface encloses, and how deep they are.

    A point's winding number is the number of times that a line from it leaves the surface, less the number of times
    that it enters. Where the line passes too near an edge to tell, the solid angles decide.

    Args:
        points: (m, 3) [u].
        vertices: (V, 3) of the surface [u].
        triangles: (T, 3), counter-clockwise from outside.
        inside: (m,) is filled: whether the winding number is positive.
        depths: (m,) is filled: distance of each point inside from the nearest triangle, 0 for the others [u].
    """
    count, size = points.shape[0], triangles.shape[0]
    # All lines run along w of the right-handed frame (3, -6, 2) / 7, (6, 2, -3) / 7, (2, 3, 6) / 7, a direction that no
    # face or lattice of a box lies along: surfaces that rest on a face are met at an angle.
    seen = np.empty((vertices.shape[0], 3))
    for v in range(vertices.shape[0]):
        x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        seen[v, 0] = (3.0 * x - 6.0 * y + 2.0 * z) / 7.0
        seen[v, 1] = (6.0 * x + 2.0 * y - 3.0 * z) / 7.0
        seen[v, 2] = (2.0 * x + 3.0 * y + 6.0 * z) / 7.0
    lines = np.empty((count, 3))
    low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
    for i in range(count):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        lines[i, 0] = (3.0 * x - 6.0 * y + 2.0 * z) / 7.0
        lines[i, 1] = (6.0 * x + 2.0 * y - 3.0 * z) / 7.0
        lines[i, 2] = (2.0 * x + 3.0 * y + 6.0 * z) / 7.0
        low_u, high_u = min(low_u, lines[i, 0]), max(high_u, lines[i, 0])
        low_v, high_v = min(low_v, lines[i, 1]), max(high_v, lines[i, 1])
    near = np.empty(size, dtype=np.int32)
    near_count = 0
    for t in range(size):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if (
            min(seen[a, 0], seen[b, 0], seen[c, 0]) <= high_u
            and max(seen[a, 0], seen[b, 0], seen[c, 0]) >= low_u
            and min(seen[a, 1], seen[b, 1], seen[c, 1]) <= high_v
            and max(seen[a, 1], seen[b, 1], seen[c, 1]) >= low_v
        ):
            near[near_count] = t
            near_count += 1
    found = False
    for i in range(count):
        u, v, w = lines[i, 0], lines[i, 1], lines[i, 2]
        winding = 0
        doubtful = False
        for k in range(near_count):
            a, b, c = triangles[near[k], 0], triangles[near[k], 1], triangles[near[k], 2]
            opposite_a = _doubled_area(u, v, seen[b, 0], seen[b, 1], seen[c, 0], seen[c, 1])
            opposite_b = _doubled_area(u, v, seen[c, 0], seen[c, 1], seen[a, 0], seen[a, 1])
            opposite_c = _doubled_area(u, v, seen[a, 0], seen[a, 1], seen[b, 0], seen[b, 1])
            least = min(opposite_a, opposite_b, opposite_c)
            most = max(opposite_a, opposite_b, opposite_c)
            if least > GRAZE or most < -GRAZE:
                area = opposite_a + opposite_b + opposite_c
                if (opposite_a * seen[a, 2] + opposite_b * seen[b, 2] + opposite_c * seen[c, 2]) / area > w:
                    winding += 1 if area > 0.0 else -1
            elif least >= -GRAZE or most <= GRAZE:
                doubtful = True
                break
        inside[i] = _solid_angles(points[i], vertices, triangles) > 0.5 if doubtful else winding > 0
        depths[i] = 0.0
        found = found or inside[i]
    if not found:
        return
    middles = np.empty((size, 3))
    radii = np.empty(size)
    for t in range(size):
        radius = 0.0
        for k in range(3):
            middles[t, k] = (
                vertices[triangles[t, 0], k] + vertices[triangles[t, 1], k] + vertices[triangles[t, 2], k]
            ) / 3.0
        for corner in range(3):
            squared = 0.0
            for k in range(3):
                squared += (vertices[triangles[t, corner], k] - middles[t, k]) ** 2
            radius = max(radius, squared)
        radii[t] = math.sqrt(radius)
    nearest = 0
    for i in range(count):
        if not inside[i]:
            continue
        # The triangle that was nearest to the point before is near this one too: the others are then mostly too far.
        best = _squared_distance_to_triangle(
            points[i],
            vertices[triangles[nearest, 0]],
            vertices[triangles[nearest, 1]],
            vertices[triangles[nearest, 2]],
        )
        reach = math.sqrt(best)
        for t in range(size):
            squared = 0.0
            for k in range(3):
                squared += (points[i, k] - middles[t, k]) ** 2
            if squared < (reach + radii[t]) ** 2:
                squared = _squared_distance_to_triangle(
                    points[i], vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
                )
                if squared < best:
                    best, nearest, reach = squared, t, math.sqrt(squared)
        depths[i] = reach


@inline_kernel
def _clip(polygon: np.ndarray, count: int, heights: np.ndarray, clipped: np.ndarray) -> int:
    """Cut off what of a convex polygon has a negative height.

    Args:
        polygon: (m, 3) weights of a triangle's corners, of which the first `count` are the polygon's.
        count: How many.
        heights: (3,) at the triangle's corners.
        clipped: (m, 3) written.

    Returns:
        How many corners are left, one more than there were at most.
    """
    left = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        here, there = 0.0, 0.0
        for k in range(3):
            here += polygon[i, k] * heights[k]
            there += polygon[j, k] * heights[k]
        if here >= 0.0:
            for k in range(3):
                clipped[left, k] = polygon[i, k]
            left += 1
        if (here >= 0.0) != (there >= 0.0):
            part = here / (here - there)
            for k in range(3):
                clipped[left, k] = polygon[i, k] + part * (polygon[j, k] - polygon[i, k])
            left += 1
    return left


@inline_kernel
def _deepest(heights: np.ndarray, known: float, polygons: np.ndarray) -> float:
    """Greatest depth of a triangle's points in a convex body, or `known` if that is more.

    The depth is the least of the heights under the faces: of linear functions, so it is concave, and linear where one
    face is the nearest. On that part of the triangle, a polygon, it is greatest at a corner.

    Args:
        heights: (F, 3) of the triangle's corners under each face.
        known: A depth that there is elsewhere, not negative.
        polygons: (3, F + 4, 3) workspace.
    """
    faces = heights.shape[0]
    difference = np.empty(3)
    whole, first, second = polygons[0], polygons[1], polygons[2]
    # Only what is deeper than what is known already.
    for i in range(3):
        for k in range(3):
            first[i, k] = 1.0 if i == k else 0.0
    count = 3
    for f in range(faces):
        for k in range(3):
            difference[k] = heights[f, k] - known
        count = _clip(first, count, difference, second)
        if count == 0:
            return known
        first, second = second, first
    for i in range(count):
        for k in range(3):
            whole[i, k] = first[i, k]
    greatest = known
    for nearest in range(faces):
        left = count
        for i in range(count):
            for k in range(3):
                first[i, k] = whole[i, k]
        for f in range(faces):
            if f == nearest:
                continue
            for k in range(3):
                difference[k] = heights[f, k] - heights[nearest, k]
            left = _clip(first, left, difference, second)
            if left == 0:
                break
            first, second = second, first
        for i in range(left):
            depth = 0.0
            for k in range(3):
                depth += first[i, k] * heights[nearest, k]
            greatest = max(greatest, depth)
    return greatest


@kernel("f8(f8[:,::1], i4[:,::1], f8[:,::1], f8[::1])")
def depth_of_surface(vertices: np.ndarray, triangles: np.ndarray, normals: np.ndarray, offsets: np.ndarray) -> float:
    """Greatest depth of any point of a surface in a convex body: its distance from the nearest of the body's faces.

    Args:
        vertices: (V, 3) of the surface, in the body's frame [u].
        triangles: (T, 3).
        normals: (F, 3) outward unit normals of the body's faces.
        offsets: (F,) of the faces' planes [u].

    Returns:
        The depth, 0 if the surface does not meet the body [u].
    """
    count, faces = vertices.shape[0], normals.shape[0]
    under = np.empty((count, faces))
    greatest = 0.0
    for v in range(count):
        depth = np.inf
        for f in range(faces):
            under[v, f] = offsets[f]
            for k in range(3):
                under[v, f] -= normals[f, k] * vertices[v, k]
            depth = min(depth, under[v, f])
        greatest = max(greatest, depth)
    heights, polygons = np.empty((faces, 3)), np.empty((3, 2 * faces + 4, 3))
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        apart = False
        for f in range(faces):
            if max(under[a, f], under[b, f], under[c, f]) <= greatest:
                apart = True
                break
        if apart:
            continue
        for f in range(faces):
            heights[f, 0], heights[f, 1], heights[f, 2] = under[a, f], under[b, f], under[c, f]
        greatest = _deepest(heights, greatest, polygons)
    return greatest
