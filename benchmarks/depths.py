"""Exact penetration depths between a tool and a surface, for the inspection; uses nothing that contact computes.

A point is inside a closed surface if its winding number is positive, and its depth is its distance from the nearest
triangle. The depth of the surface in a convex tool is taken over the whole surface, not only over its vertices: the
deepest point may lie anywhere on a triangle.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from spatula_env._kernels import inline_kernel, kernel

if TYPE_CHECKING:
    from benchmarks.probes import Points

GRAZE = 1e-12
"""A line passes too near an edge to tell the side if the triangle of the two, seen along the line, has a doubled area
of at most this [u2]."""

DOUBTFUL = -(2**40)
"""Stands for a winding number that could not be determined."""

BAND = 0.1
"""Triangles within this distance of a tool count as near it [u]."""


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


@inline_kernel
def _height_over(u: float, v: float, seen: np.ndarray, a: int, b: int, c: int) -> tuple[int, float]:
    """Intersect a line along w with a triangle.

    Args:
        u: First coordinate of the line.
        v: Second coordinate of the line.
        seen: (V, 3) coordinates of the vertices along u, v and w.
        a: Index of the first corner.
        b: Index of the second corner.
        c: Index of the third corner.

    Returns:
        1 where the line leaves the surface that the triangle is part of, -1 where it enters it, 0 where it misses the
        triangle, and `DOUBTFUL` if it passes too near an edge to tell; and the intersection's coordinate along w.
    """
    opposite_a = _doubled_area(u, v, seen[b, 0], seen[b, 1], seen[c, 0], seen[c, 1])
    opposite_b = _doubled_area(u, v, seen[c, 0], seen[c, 1], seen[a, 0], seen[a, 1])
    opposite_c = _doubled_area(u, v, seen[a, 0], seen[a, 1], seen[b, 0], seen[b, 1])
    least = min(opposite_a, opposite_b, opposite_c)
    most = max(opposite_a, opposite_b, opposite_c)
    if least > GRAZE or most < -GRAZE:
        area = opposite_a + opposite_b + opposite_c
        height = (opposite_a * seen[a, 2] + opposite_b * seen[b, 2] + opposite_c * seen[c, 2]) / area
        return (1 if area > 0.0 else -1), height
    if least >= -GRAZE or most <= GRAZE:
        return DOUBTFUL, np.inf
    return 0, -np.inf


@inline_kernel
def see(vertices: np.ndarray, seen: np.ndarray) -> None:
    """Write the coordinates of vertices (V, 3) along the axes u, v and w of `probes.LINES` into `seen` (V, 3)."""
    for i in range(vertices.shape[0]):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        seen[i, 0] = (3.0 * x - 6.0 * y + 2.0 * z) / 7.0
        seen[i, 1] = (6.0 * x + 2.0 * y - 3.0 * z) / 7.0
        seen[i, 2] = (2.0 * x + 3.0 * y + 6.0 * z) / 7.0


@inline_kernel
def is_inside(
    point: np.ndarray, line: np.ndarray, vertices: np.ndarray, seen: np.ndarray, triangles: np.ndarray
) -> bool:
    """Whether a closed surface's winding number about a point is positive.

    Args:
        point: (3,) [u].
        line: (3,) coordinates of the point along u, v and w.
        vertices: (V, 3) [u].
        seen: (V, 3) coordinates of the vertices along u, v and w.
        triangles: (T, 3), counter-clockwise from outside.
    """
    u, v, w = line[0], line[1], line[2]
    winding = 0
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if (
            max(seen[a, 2], seen[b, 2], seen[c, 2]) < w
            or min(seen[a, 0], seen[b, 0], seen[c, 0]) > u
            or max(seen[a, 0], seen[b, 0], seen[c, 0]) < u
            or min(seen[a, 1], seen[b, 1], seen[c, 1]) > v
            or max(seen[a, 1], seen[b, 1], seen[c, 1]) < v
        ):
            continue
        way, height = _height_over(u, v, seen, a, b, c)
        if way == DOUBTFUL:
            return _solid_angles(point, vertices, triangles) > 0.5
        if height > w:
            winding += way
    return winding > 0


@kernel()
def find_inside(
    points: Points, vertices: np.ndarray, seen: np.ndarray, triangles: np.ndarray, inside: np.ndarray
) -> bool:
    """Find the points that a closed surface encloses.

    The winding number of a point is the number of times that a ray from it leaves the surface, less the number of times
    that it enters it. Where the ray passes too near an edge to tell, the solid angles decide. The rays that a triangle
    may intersect are looked up in the grid of the points.

    Args:
        points: The points.
        vertices: (V, 3) of the surface [u].
        seen: (V, 3) coordinates of the vertices along u, v and w.
        triangles: (T, 3), counter-clockwise from outside.
        inside: (m,) output: whether the winding number is positive.

    Returns:
        Whether any point is inside.
    """
    count, cells = points.places.shape[0], points.cells
    low_u, low_v, dense_u, dense_v = points.grid[0], points.grid[1], points.grid[2], points.grid[3]
    lines, order, starts = points.seen, points.order, points.starts
    winding = np.zeros(count, np.int64)
    lowest = np.inf
    for i in range(count):
        lowest = min(lowest, lines[i, 2])
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        least_u, most_u = min(seen[a, 0], seen[b, 0], seen[c, 0]), max(seen[a, 0], seen[b, 0], seen[c, 0])
        least_v, most_v = min(seen[a, 1], seen[b, 1], seen[c, 1]), max(seen[a, 1], seen[b, 1], seen[c, 1])
        highest = max(seen[a, 2], seen[b, 2], seen[c, 2])
        from_u, to_u = (least_u - low_u) * dense_u, (most_u - low_u) * dense_u
        from_v, to_v = (least_v - low_v) * dense_v, (most_v - low_v) * dense_v
        if highest < lowest or to_u < 0.0 or to_v < 0.0 or from_u > cells + 1.0 or from_v > cells + 1.0:
            continue
        first_v, last_v = int(min(max(from_v, 0.0), cells - 1.0)), int(min(to_v, cells - 1.0))
        for row in range(int(min(max(from_u, 0.0), cells - 1.0)), int(min(to_u, cells - 1.0)) + 1):
            for k in range(starts[row * cells + first_v], starts[row * cells + last_v + 1]):
                i = order[k]
                u, v, w = lines[i, 0], lines[i, 1], lines[i, 2]
                if highest < w or u < least_u or u > most_u or v < least_v or v > most_v:
                    continue
                way, height = _height_over(u, v, seen, a, b, c)
                if way == DOUBTFUL:
                    winding[i] = DOUBTFUL
                elif height > w and winding[i] != DOUBTFUL:
                    winding[i] += way
    found = False
    for i in range(count):
        if winding[i] == DOUBTFUL:
            inside[i] = _solid_angles(points.places[i], vertices, triangles) > 0.5
        else:
            inside[i] = winding[i] > 0
        found = found or inside[i]
    return found


@inline_kernel
def _fill_ball(vertices: np.ndarray, corners: np.ndarray, ball: np.ndarray) -> None:
    """Write a triangle's bounding ball, its centroid and its greatest distance to a corner, into `ball` (4,)."""
    radius = 0.0
    for k in range(3):
        ball[k] = (vertices[corners[0], k] + vertices[corners[1], k] + vertices[corners[2], k]) / 3.0
    for corner in range(3):
        squared = 0.0
        for k in range(3):
            squared += (vertices[corners[corner], k] - ball[k]) ** 2
        radius = max(radius, squared)
    ball[3] = math.sqrt(radius)


@inline_kernel
def _search_nearest(
    point: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, chosen: np.ndarray, balls: np.ndarray, nearest: int
) -> tuple[float, int]:
    """Squared distance of a point from the nearest of some triangles, and which of them it is.

    Args:
        point: (3,).
        vertices: (V, 3).
        triangles: (T, 3).
        chosen: (n,) indices of the triangles to search.
        balls: (n, 4) bounding balls of these triangles.
        nearest: Index into `chosen` of a first guess. If it is near, most other triangles are rejected by their balls.
    """
    t = chosen[nearest]
    best = _squared_distance_to_triangle(
        point, vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
    )
    reach = math.sqrt(best)
    for index in range(chosen.shape[0]):
        squared = 0.0
        for k in range(3):
            squared += (point[k] - balls[index, k]) ** 2
        if squared < (reach + balls[index, 3]) ** 2:
            t = chosen[index]
            squared = _squared_distance_to_triangle(
                point, vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
            )
            if squared < best:
                best, nearest, reach = squared, index, math.sqrt(squared)
    return best, nearest


@kernel()
def measure_depths(
    points: np.ndarray,
    vertices: np.ndarray,
    triangles: np.ndarray,
    near: np.ndarray,
    inside: np.ndarray,
    depths: np.ndarray,
) -> None:
    """Measure how deep points are inside a surface.

    Args:
        points: (m, 3) [u].
        vertices: (V, 3) of the surface [u].
        triangles: (T, 3).
        near: (n,) all triangles that are within `BAND` of any of the points, and possibly others. All triangles are
            searched for a point whose distance from these is greater than `BAND`.
        inside: (m,) which points are inside.
        depths: (m,) output: distance of each inside point from the nearest triangle, 0 for the others [u].
    """
    balls = np.empty((near.shape[0], 4))
    for k in range(near.shape[0]):
        _fill_ball(vertices, triangles[near[k]], balls[k])
    everything, all_balls = near[:0], balls[:0]
    nearest, nearest_of_all = 0, 0
    for i in range(points.shape[0]):
        depths[i] = 0.0
        if not inside[i]:
            continue
        best = np.inf
        if near.shape[0] > 0:
            best, nearest = _search_nearest(points[i], vertices, triangles, near, balls, nearest)
        if best > BAND * BAND:
            if everything.shape[0] == 0:
                everything = np.arange(triangles.shape[0])
                all_balls = np.empty((triangles.shape[0], 4))
                for t in range(triangles.shape[0]):
                    _fill_ball(vertices, triangles[t], all_balls[t])
            best, nearest_of_all = _search_nearest(
                points[i], vertices, triangles, everything, all_balls, nearest_of_all
            )
        depths[i] = math.sqrt(best)


@inline_kernel
def _clip(polygon: np.ndarray, count: int, heights: np.ndarray, clipped: np.ndarray) -> int:
    """Clip the part of a convex polygon where a linear function, the height, is negative.

    Args:
        polygon: (m, 3) barycentric coordinates in a triangle; the first `count` rows are the polygon's corners.
        count: Number of corners.
        heights: (3,) heights at the triangle's corners.
        clipped: (m, 3) output: the clipped polygon.

    Returns:
        Number of corners of the clipped polygon, at most `count` + 1.
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

    The depth of a point is the least of its depths under the faces' planes, which are linear functions. Where one
    given face is the nearest, which is a convex polygon of the triangle, the depth is linear and greatest at a corner.

    Args:
        heights: (F, 3) depth of the triangle's corners under the plane of each face.
        known: Greatest depth found so far, not negative; what is not deeper is clipped away first.
        polygons: (3, F + 4, 3) workspace.
    """
    faces = heights.shape[0]
    difference = np.empty(3)
    whole, first, second = polygons[0], polygons[1], polygons[2]
    # Keep only the part of the triangle that is deeper than `known`.
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


@kernel()
def depth_of_surface(
    vertices: np.ndarray, triangles: np.ndarray, near: np.ndarray, normals: np.ndarray, offsets: np.ndarray
) -> float:
    """Greatest depth of any point of a surface in a convex body: its distance from the nearest plane of a face.

    Args:
        vertices: (V, 3) of the surface, in the body's frame [u].
        triangles: (T, 3).
        near: (n,) all triangles that intersect the body, and possibly others.
        normals: (F, 3) outward unit normals of the body's faces.
        offsets: (F,) of the faces' planes [u].

    Returns:
        The depth, 0 if the surface does not intersect the body [u].
    """
    count, faces = near.shape[0], normals.shape[0]
    under = np.empty((count, faces, 3))
    greatest = 0.0
    for index in range(count):
        for corner in range(3):
            v = triangles[near[index], corner]
            depth = np.inf
            for f in range(faces):
                height = offsets[f]
                for k in range(3):
                    height -= normals[f, k] * vertices[v, k]
                under[index, f, corner] = height
                depth = min(depth, height)
            greatest = max(greatest, depth)
    polygons = np.empty((3, 2 * faces + 4, 3))
    for index in range(count):
        apart = False
        for f in range(faces):
            if max(under[index, f, 0], under[index, f, 1], under[index, f, 2]) <= greatest:
                apart = True
                break
        if not apart:
            greatest = _deepest(under[index], greatest, polygons)
    return greatest
