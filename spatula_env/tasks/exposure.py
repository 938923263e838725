"""The share of a target that is visible along parallel lines of sight, past an organ and tools."""

from __future__ import annotations

import numpy as np

from spatula_env._kernels import array_kernel, kernel
from spatula_env.contact.raycast import line_meets_triangle


@array_kernel
def turn_of(au: float, av: float, bu: float, bv: float, cu: float, cv: float) -> float:
    """Twice the signed area of the triangle (a, b, c) in the plane: positive if it turns to the left."""
    return (bu - au) * (cv - av) - (bv - av) * (cu - au)


@array_kernel
def fill_outline(u: np.ndarray, v: np.ndarray, outline: np.ndarray) -> int:
    """The convex hull of points in the plane, counter-clockwise.

    After A. M. Andrew, Another efficient algorithm for convex hulls in two dimensions, Information Processing
    Letters 9(5), 1979.

    Args:
        u: (K,) first coordinates; reordered.
        v: (K,) second coordinates; reordered.
        outline: (2 K + 1,) int64, filled with indices into the reordered points.

    Returns:
        Number of points of the hull.
    """
    count = u.shape[0]
    for i in range(1, count):
        pu, pv = u[i], v[i]
        k = i
        while k > 0 and (u[k - 1] > pu or (u[k - 1] == pu and v[k - 1] > pv)):
            u[k], v[k] = u[k - 1], v[k - 1]
            k -= 1
        u[k], v[k] = pu, pv
    size, least = 0, 2
    for step in range(2 * count - 1):
        # Along the lower side from left to right, then back along the upper side.
        i = step if step < count else 2 * count - 2 - step
        if step == count:
            least = size + 1
        while size >= least:
            a, b = outline[size - 2], outline[size - 1]
            if turn_of(u[a], v[a], u[b], v[b], u[i], v[i]) > 0.0:
                break
            size -= 1
        outline[size] = i
        size += 1
    return size - 1


@kernel()
def visible_points(
    nodes: np.ndarray, triangles: np.ndarray, corners: np.ndarray, points: np.ndarray, directions: np.ndarray
) -> np.ndarray:
    """Determine which points are visible from far away.

    A point is visible if the ray from it towards the eye meets neither a triangle of the organ nor a tool. As all rays
    of a world are parallel, they are points in a plane perpendicular to them: only those triangles of the organ matter
    whose bounding box in that plane meets that of the points, and a convex tool is the outline of its corners. A tool
    counts if it is on the line of sight at all, on whichever side of the point, because it does not get below a surface
    point.

    Args:
        nodes: (W, V, 3) nodes of the organ.
        triangles: (T, 3).
        corners: (W, N, K, 3) of N convex tools.
        points: (W, P, 3) points; those on the organ's surface must be slightly above it.
        directions: (W, 3) unit vectors towards the eye; not along x.

    Returns:
        (W, P) whether each point is visible.
    """
    worlds, node_count, point_count = nodes.shape[0], nodes.shape[1], points.shape[1]
    tool_count, corner_count = corners.shape[1], corners.shape[2]
    seen = np.ones((worlds, point_count), dtype=np.bool_)
    u, v, depth = np.empty(node_count), np.empty(node_count), np.empty(node_count)
    point_u, point_v, point_depth = np.empty(point_count), np.empty(point_count), np.empty(point_count)
    corner_u, corner_v = np.empty(corner_count), np.empty(corner_count)
    outline = np.empty(2 * corner_count + 1, dtype=np.int64)
    for w in range(worlds):
        dx, dy, dz = directions[w, 0], directions[w, 1], directions[w, 2]
        # Two directions perpendicular to the rays: u is x without its component along the ray, v = d x u.
        ux, uy, uz = 1.0 - dx * dx, -dx * dy, -dx * dz
        size = np.sqrt(ux * ux + uy * uy + uz * uz)
        ux, uy, uz = ux / size, uy / size, uz / size
        vx, vy, vz = dy * uz - dz * uy, dz * ux - dx * uz, dx * uy - dy * ux
        least_u, greatest_u, least_v, greatest_v = np.inf, -np.inf, np.inf, -np.inf
        for p in range(point_count):
            x, y, z = points[w, p, 0], points[w, p, 1], points[w, p, 2]
            point_u[p], point_v[p] = ux * x + uy * y + uz * z, vx * x + vy * y + vz * z
            point_depth[p] = dx * x + dy * y + dz * z
            least_u, greatest_u = min(least_u, point_u[p]), max(greatest_u, point_u[p])
            least_v, greatest_v = min(least_v, point_v[p]), max(greatest_v, point_v[p])
        for i in range(node_count):
            x, y, z = nodes[w, i, 0], nodes[w, i, 1], nodes[w, i, 2]
            u[i] = ux * x + uy * y + uz * z
            v[i] = vx * x + vy * y + vz * z
            depth[i] = dx * x + dy * y + dz * z
        for k in range(triangles.shape[0]):
            a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
            low_u, high_u = min(u[a], u[b], u[c]), max(u[a], u[b], u[c])
            if low_u > greatest_u or high_u < least_u:
                continue
            low_v, high_v = min(v[a], v[b], v[c]), max(v[a], v[b], v[c])
            if low_v > greatest_v or high_v < least_v:
                continue
            for p in range(point_count):
                pu, pv = point_u[p], point_v[p]
                if not seen[w, p] or pu < low_u or pu > high_u or pv < low_v or pv > high_v:
                    continue
                facing, wa, wb, wc = line_meets_triangle(pu, pv, u[a], v[a], u[b], v[b], u[c], v[c])
                if facing != 0 and wa * depth[a] + wb * depth[b] + wc * depth[c] > point_depth[p]:
                    seen[w, p] = False
        for n in range(tool_count):
            for i in range(corner_count):
                x, y, z = corners[w, n, i, 0], corners[w, n, i, 1], corners[w, n, i, 2]
                corner_u[i], corner_v[i] = ux * x + uy * y + uz * z, vx * x + vy * y + vz * z
            edges = fill_outline(corner_u, corner_v, outline)
            for p in range(point_count):
                inside = edges >= 3
                for i in range(edges):
                    a, b = outline[i], outline[i + 1]
                    if turn_of(corner_u[a], corner_v[a], corner_u[b], corner_v[b], point_u[p], point_v[p]) < 0.0:
                        inside = False
                        break
                if inside:
                    seen[w, p] = False
    return seen
