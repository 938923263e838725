"""Which features of organs' surfaces may touch each other soon: vertices and triangles, edges and edges.

They are found once and stay valid while no vertex gets farther than its reach from where it was then. How far a vertex
reaches is how far the step throws it, and a margin. Boxes around patches of triangles tell what is far apart. Patches
that share a vertex overlap always; they are looked at only where the surface is folded: a surface whose normals all are
within a cone does not meet itself (Volino and Magnenat-Thalmann, Computer Graphics Forum 13(3), 1994).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types

from spatula_env._kernels import ARRAYS, inline_kernel, kernel
from spatula_env.contact.corners import closest_weights
from spatula_env.contact.skin import (
    CROSS_IS_KNOWN,
    CROSS_PAIRS,
    EDGE_PAIRS,
    IS_KNOWN,
    NEAR,
    PATCH_PAIRS,
    SKIN,
    TOO_MANY,
    VERTEX_PAIRS,
)

MARGIN = 0.15
"""How far vertices reach beyond what a step moves them by, in mean edges."""

MOST_PAIRS = 64
"""For so many pairs of features for each vertex there is no use in looking: an organ has collapsed into a lump."""

FLAT = math.radians(60.0)
"""Neighbouring patches whose normals are within a cone of half this opening are flat [rad]."""


@inline_kernel
def closest_on_edges(
    ux: float, uy: float, uz: float, vx: float, vy: float, vz: float, wx: float, wy: float, wz: float
) -> tuple[float, float]:
    """Where two segments are closest to each other: fractions along u and v; w leads from v's start to u's.

    C. Ericson, Real-Time Collision Detection, 2005, section 5.1.9.
    """
    a, e = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
    b, c, f = ux * vx + uy * vy + uz * vz, ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    denominator = a * e - b * b
    s = min(max((b * f - c * e) / denominator, 0.0), 1.0) if denominator > 1e-12 * a * e else 0.5
    t = (b * s + f) / e
    if t < 0.0:
        t, s = 0.0, min(max(-c / a, 0.0), 1.0)
    elif t > 1.0:
        t, s = 1.0, min(max((b - c) / a, 0.0), 1.0)
    return s, t


@inline_kernel
def within_reach(near: Any, points: np.ndarray) -> bool:
    """Whether all vertices (V, 3) are within reach of where they were when what is near was found."""
    found_at, reach = near.found_at, near.reach
    beyond = False
    for i in range(points.shape[0]):
        x, y, z = points[i, 0] - found_at[0, i], points[i, 1] - found_at[1, i], points[i, 2] - found_at[2, i]
        beyond |= x * x + y * y + z * z > reach[i] * reach[i]
    return not beyond


@inline_kernel
def measure_shifts(near: Any, held: np.ndarray, points: np.ndarray) -> None:
    """Write how far vertices have got from where they were when what is near was found.

    Args:
        near: `Near`.
        held: (V, 3) where they come from [u].
        points: (V, 3) where they are [u].
    """
    found_at, shift = near.found_at, near.shift
    for i in range(points.shape[0]):
        u, v, w = found_at[0, i], found_at[1, i], found_at[2, i]
        x, y, z = points[i, 0] - u, points[i, 1] - v, points[i, 2] - w
        r, s, t = held[i, 0] - u, held[i, 1] - v, held[i, 2] - w
        shift[i] = np.sqrt(max(x * x + y * y + z * z, r * r + s * s + t * t))


@inline_kernel
def _with_pair(
    pairs: np.ndarray, distances: np.ndarray, count: int, first: int, second: int, distance: float
) -> tuple[np.ndarray, np.ndarray]:
    """The pairs and their distances with one more after `count`, in longer arrays if there is no room."""
    if count >= pairs.shape[0] or count >= distances.shape[0]:
        room = max(2 * count, 64)
        more, longer = np.zeros((room, pairs.shape[1]), np.int32), np.empty(room)
        for p in range(count):
            longer[p] = distances[p]
            for column in range(pairs.shape[1]):
                more[p, column] = pairs[p, column]
        pairs, distances = more, longer
    for column in range(pairs.shape[1]):
        pairs[count, column] = 0
    pairs[count, 0], pairs[count, 1] = first, second
    distances[count] = distance
    return pairs, distances


@inline_kernel
def _apart(boxes: np.ndarray, i: int, others: np.ndarray, j: int) -> bool:
    """Whether two boxes (., 6), least and greatest coordinates, have no point in common."""
    apart: bool = (
        (boxes[i, 0] > others[j, 3]) | (boxes[i, 3] < others[j, 0])
        | (boxes[i, 1] > others[j, 4]) | (boxes[i, 4] < others[j, 1])
        | (boxes[i, 2] > others[j, 5]) | (boxes[i, 5] < others[j, 2])
    )  # fmt: skip
    return apart


@inline_kernel
def _fill_feature_boxes(points: np.ndarray, reach: np.ndarray, features: np.ndarray, boxes: np.ndarray) -> None:
    """Write the boxes (n, 6) around what the vertices of edges (n, 2) or triangles (n, 3) can reach."""
    corners = features.shape[1]
    for axis in range(3):
        of_axis = points[axis]
        for f in range(features.shape[0]):
            v = features[f, 0]
            low, high = of_axis[v] - reach[v], of_axis[v] + reach[v]
            for corner in range(1, corners):
                v = features[f, corner]
                low, high = min(low, of_axis[v] - reach[v]), max(high, of_axis[v] + reach[v])
            boxes[f, axis], boxes[f, 3 + axis] = low, high


@inline_kernel
def _fill_normals(points: np.ndarray, triangles: np.ndarray, normals: np.ndarray) -> None:
    """Write the unit normals (T, 3) of triangles with vertices (V, 3)."""
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
        vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        scale = 1.0 / length if length > 0.0 else 0.0
        normals[t, 0], normals[t, 1], normals[t, 2] = scale * nx, scale * ny, scale * nz


@inline_kernel
def _fill_cones(
    triangle_starts: np.ndarray, triangle_order: np.ndarray, normals: np.ndarray, cones: np.ndarray
) -> None:
    """Write a cone around the normals of each patch's triangles: axis, and half its opening (P, 4) [rad].

    Args:
        triangle_starts: (P + 1,) of a `Skin`.
        triangle_order: (T,).
        normals: (2, T, 3) before and after a step.
        cones: Written.
    """
    for p in range(cones.shape[0]):
        x, y, z = 0.0, 0.0, 0.0
        for m in range(triangle_starts[p], triangle_starts[p + 1]):
            t = triangle_order[m]
            x, y, z = x + normals[0, t, 0], y + normals[0, t, 1], z + normals[0, t, 2]
        length = np.sqrt(x * x + y * y + z * z)
        least = -1.0
        if length > 0.0:
            x, y, z, least = x / length, y / length, z / length, 1.0
            for m in range(triangle_starts[p], triangle_starts[p + 1]):
                t = triangle_order[m]
                for time in range(2):
                    along = normals[time, t, 0] * x + normals[time, t, 1] * y + normals[time, t, 2] * z
                    least = min(least, along)
        cones[p, 0], cones[p, 1], cones[p, 2], cones[p, 3] = x, y, z, np.arccos(max(least, -1.0))


@inline_kernel
def _is_flat(cones: np.ndarray, p: int, q: int) -> bool:
    """Whether the normals of two patches' triangles are in a cone."""
    if max(cones[p, 3], cones[q, 3]) > FLAT:
        return False
    along = cones[p, 0] * cones[q, 0] + cones[p, 1] * cones[q, 1] + cones[p, 2] * cones[q, 2]
    return bool(np.arccos(min(max(along, -1.0), 1.0)) + cones[p, 3] + cones[q, 3] <= 2.0 * FLAT)


@inline_kernel
def _sort_along_x(order: np.ndarray, boxes: np.ndarray) -> None:
    """Sort patches by where their boxes begin; they are nearly in order from the last time."""
    for place in range(1, order.shape[0]):
        patch = order[place]
        k = place
        while k > 0 and boxes[order[k - 1], 0] > boxes[patch, 0]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = patch


@inline_kernel
def _close_patches(skin: Any, near: Any, boxes: np.ndarray, cones: np.ndarray) -> np.ndarray:
    """Pairs of patches that may meet, as first x P + second, ascending: the same whatever else is near."""
    order, starts, neighbours = near.order, skin.neighbour_starts, skin.neighbours
    patches = order.shape[0]
    _sort_along_x(order, boxes)
    found, count = np.empty(64, np.int64), 0
    for i in range(patches):
        for k in range(i, patches):
            p, q = min(order[i], order[k]), max(order[i], order[k])
            if boxes[order[k], 0] > boxes[order[i], 3]:
                break
            if p != q and _apart(boxes, p, boxes, q):
                continue
            shares = False
            for m in range(starts[p], starts[p + 1]):
                shares |= neighbours[m] == q
            if shares and _is_flat(cones, p, q):
                continue
            if count == found.shape[0]:
                more = np.empty(2 * count, np.int64)
                for e in range(count):
                    more[e] = found[e]
                found = more
            found[count] = np.int64(p) * patches + q
            count += 1
    return np.sort(found[:count])


@inline_kernel
def _pair_vertices(
    near: Any, skin: Any, of_vertices: int, of_triangles: int, points: np.ndarray, triangle_boxes: np.ndarray,
    patch_boxes: np.ndarray,
) -> None:  # fmt: skip
    """Add the vertices of one patch that are near triangles of another."""
    triangles, reach = skin.triangles, near.reach
    pairs, count, distances = near.vertex_pairs, near.counts[VERTEX_PAIRS], near.vertex_distances
    box = np.empty((1, 6))
    for m in range(skin.vertex_starts[of_vertices], skin.vertex_starts[of_vertices + 1]):
        v = skin.vertex_order[m]
        x, y, z = points[0, v], points[1, v], points[2, v]
        for axis in range(3):
            box[0, axis], box[0, 3 + axis] = points[axis, v] - reach[v], points[axis, v] + reach[v]
        if _apart(box, 0, patch_boxes, of_triangles):
            continue
        for e in range(skin.triangle_starts[of_triangles], skin.triangle_starts[of_triangles + 1]):
            t = skin.triangle_order[e]
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            if v == a or v == b or v == c or _apart(box, 0, triangle_boxes, t):
                continue
            wa, wb, wc = closest_weights(points, a, b, c, x, y, z)
            dx = x - wa * points[0, a] - wb * points[0, b] - wc * points[0, c]
            dy = y - wa * points[1, a] - wb * points[1, b] - wc * points[1, c]
            dz = z - wa * points[2, a] - wb * points[2, b] - wc * points[2, c]
            limit = reach[v] + max(reach[a], reach[b], reach[c])
            squared = dx * dx + dy * dy + dz * dz
            if squared > limit * limit:
                continue
            pairs, distances = _with_pair(pairs, distances, count, v, t, np.sqrt(squared))
            count += 1
    near.vertex_pairs, near.counts[VERTEX_PAIRS], near.vertex_distances = pairs, count, distances


@inline_kernel
def _pair_edges(
    near: Any, skin: Any, p: int, q: int, points: np.ndarray, edge_boxes: np.ndarray, patch_boxes: np.ndarray
) -> None:
    """Add the edges of one patch that are near edges of another, or of the same one."""
    edges, reach, order = skin.edges, near.reach, skin.edge_order
    pairs, count, distances = near.edge_pairs, near.counts[EDGE_PAIRS], near.edge_distances
    first_second, end = skin.edge_starts[q], skin.edge_starts[q + 1]
    for m in range(skin.edge_starts[p], skin.edge_starts[p + 1]):
        e = order[m]
        if _apart(edge_boxes, e, patch_boxes, q):
            continue
        a, b = edges[e, 0], edges[e, 1]
        ux, uy, uz = points[0, b] - points[0, a], points[1, b] - points[1, a], points[2, b] - points[2, a]
        for k in range(m + 1 if p == q else first_second, end):
            f = order[k]
            if _apart(edge_boxes, e, edge_boxes, f):
                continue
            c, d = edges[f, 0], edges[f, 1]
            if a == c or a == d or b == c or b == d:
                continue
            vx, vy, vz = points[0, d] - points[0, c], points[1, d] - points[1, c], points[2, d] - points[2, c]
            wx, wy, wz = points[0, a] - points[0, c], points[1, a] - points[1, c], points[2, a] - points[2, c]
            s, t = closest_on_edges(ux, uy, uz, vx, vy, vz, wx, wy, wz)
            dx, dy, dz = wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz
            limit = max(reach[a], reach[b]) + max(reach[c], reach[d])
            squared = dx * dx + dy * dy + dz * dz
            if squared > limit * limit:
                continue
            pairs, distances = _with_pair(pairs, distances, count, e, f, np.sqrt(squared))
            count += 1
    near.edge_pairs, near.counts[EDGE_PAIRS], near.edge_distances = pairs, count, distances


@inline_kernel
def _height_range(
    points: np.ndarray, normals: np.ndarray, t: int, a: int, first: int, second: int
) -> tuple[float, float]:
    """Least and greatest height of an edge over the plane of a triangle t with a corner a; normals are (T, 3)."""
    heights = np.empty(2)
    for k in range(2):
        v = first if k == 0 else second
        heights[k] = 0.0
        for axis in range(3):
            heights[k] += normals[t, axis] * (points[axis, v] - points[axis, a])
    return min(heights[0], heights[1]), max(heights[0], heights[1])


@inline_kernel
def _pair_crossings(
    near: Any, skin: Any, of_edges: int, of_triangles: int, points: np.ndarray, edge_boxes: np.ndarray,
    triangle_boxes: np.ndarray, patch_boxes: np.ndarray, normals: np.ndarray,
) -> None:  # fmt: skip
    """Add the edges of one patch that may cross triangles of another."""
    edges, triangles, reach = skin.edges, skin.triangles, near.reach
    pairs, count, distances = near.cross_pairs, near.counts[CROSS_PAIRS], near.cross_distances
    for m in range(skin.edge_starts[of_edges], skin.edge_starts[of_edges + 1]):
        e = skin.edge_order[m]
        if _apart(edge_boxes, e, patch_boxes, of_triangles):
            continue
        a, b = edges[e, 0], edges[e, 1]
        for k in range(skin.triangle_starts[of_triangles], skin.triangle_starts[of_triangles + 1]):
            t = skin.triangle_order[k]
            if _apart(edge_boxes, e, triangle_boxes, t):
                continue
            first, second, third = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            if a == first or a == second or a == third or b == first or b == second or b == third:
                continue
            low, high = _height_range(points, normals, t, first, a, b)
            distance = max(low, -high, 0.0)
            if distance > max(reach[a], reach[b]) + max(reach[first], reach[second], reach[third]):
                continue
            pairs, distances = _with_pair(pairs, distances, count, e, t, distance)
            count += 1
    near.cross_pairs, near.counts[CROSS_PAIRS], near.cross_distances = pairs, count, distances


@inline_kernel
def _fill_boxes(
    skin: Any, near: Any, points: np.ndarray, edge_boxes: np.ndarray, triangle_boxes: np.ndarray, boxes: np.ndarray
) -> None:
    """Write the boxes around what edges (E, 6), triangles (T, 6) and patches (P, 6) can reach."""
    starts, order, reach = skin.triangle_starts, skin.triangle_order, near.reach
    _fill_feature_boxes(points, reach, skin.edges, edge_boxes)
    _fill_feature_boxes(points, reach, skin.triangles, triangle_boxes)
    for p in range(boxes.shape[0]):
        for axis in range(3):
            boxes[p, axis], boxes[p, 3 + axis] = np.inf, -np.inf
        for m in range(starts[p], starts[p + 1]):
            for axis in range(3):
                boxes[p, axis] = min(boxes[p, axis], triangle_boxes[order[m], axis])
                boxes[p, 3 + axis] = max(boxes[p, 3 + axis], triangle_boxes[order[m], 3 + axis])


@kernel(types.void(SKIN, NEAR))
def find_cross_pairs(skin: Any, near: Any) -> None:
    """Find which edges and triangles may cross, among the patches that have been found to be near.

    Args:
        skin: `Skin`.
        near: `Near`, written.
    """
    points, triangles = near.found_at, skin.triangles
    patch_count = near.order.shape[0]
    triangle_boxes, boxes = np.empty((triangles.shape[0], 6)), np.empty((patch_count, 6))
    edge_boxes = np.empty((skin.edges.shape[0], 6))
    _fill_boxes(skin, near, points, edge_boxes, triangle_boxes, boxes)
    normals = np.empty((triangles.shape[0], 3))
    _fill_normals(np.ascontiguousarray(points.T), triangles, normals)
    near.counts[CROSS_PAIRS] = 0
    near.counts[CROSS_IS_KNOWN] = 1
    patch_pairs = near.patch_pairs
    for k in range(near.counts[PATCH_PAIRS]):
        p, q = patch_pairs[k] // patch_count, patch_pairs[k] % patch_count
        _pair_crossings(near, skin, p, q, points, edge_boxes, triangle_boxes, boxes, normals)
        if p != q:
            _pair_crossings(near, skin, q, p, points, edge_boxes, triangle_boxes, boxes, normals)


@kernel(types.void(SKIN, NEAR, ARRAYS["f8_2"], ARRAYS["f8_2"], types.float64))
def find_near(skin: Any, near: Any, start: np.ndarray, thrown: np.ndarray, margin: float) -> None:
    """Find which features are near each other.

    Args:
        skin: `Skin`.
        near: `Near`, written.
        start: (V, 3) where the vertices are [u].
        thrown: (V, 3) to where they may move at once [u].
        margin: How far they reach beyond that [u].
    """
    points, reach, triangles = near.found_at, near.reach, skin.triangles
    for i in range(start.shape[0]):
        squared = 0.0
        for axis in range(3):
            points[axis, i] = start[i, axis]
            squared += (thrown[i, axis] - start[i, axis]) ** 2
        reach[i] = margin + np.sqrt(squared)
    near.counts[:] = 0
    near.counts[IS_KNOWN] = 1
    patch_count = near.order.shape[0]
    triangle_boxes, boxes = np.empty((triangles.shape[0], 6)), np.empty((patch_count, 6))
    edge_boxes = np.empty((skin.edges.shape[0], 6))
    normals, cones = np.empty((2, triangles.shape[0], 3)), np.empty((patch_count, 4))
    _fill_normals(start, triangles, normals[0])
    _fill_normals(thrown, triangles, normals[1])
    _fill_cones(skin.triangle_starts, skin.triangle_order, normals, cones)
    _fill_boxes(skin, near, points, edge_boxes, triangle_boxes, boxes)
    near.patch_pairs = _close_patches(skin, near, boxes, cones)
    _pair_features(skin, near, edge_boxes, triangle_boxes, boxes)


@inline_kernel
def _pair_features(skin: Any, near: Any, edge_boxes: np.ndarray, triangle_boxes: np.ndarray, boxes: np.ndarray) -> None:
    """Find the pairs of features in the pairs of patches that are known, between boxes of what they can reach."""
    points, patch_count = near.found_at, near.order.shape[0]
    near.counts[PATCH_PAIRS] = near.patch_pairs.shape[0]
    for pair in near.patch_pairs:
        p, q = pair // patch_count, pair % patch_count
        _pair_vertices(near, skin, p, q, points, triangle_boxes, boxes)
        _pair_edges(near, skin, p, q, points, edge_boxes, boxes)
        if p != q:
            _pair_vertices(near, skin, q, p, points, triangle_boxes, boxes)
        if near.counts[VERTEX_PAIRS] + near.counts[EDGE_PAIRS] > MOST_PAIRS * points.shape[1]:
            near.counts[:] = 0
            near.counts[IS_KNOWN] = TOO_MANY
            return


@kernel(types.void(SKIN, NEAR, ARRAYS["f8_2"], ARRAYS["f8"], ARRAYS["i8"]))
def find_as_before(skin: Any, near: Any, found_at: np.ndarray, reach: np.ndarray, patch_pairs: np.ndarray) -> None:
    """Find the same pairs as another time.

    Which neighbouring patches were flat then is not to be told from where they are now: without this, a state that is
    restored would not go on as it did.

    Args:
        skin: `Skin`.
        near: `Near`, written.
        found_at: (3, V) where the vertices were then [u].
        reach: (V,) how far they reached [u].
        patch_pairs: (.,) the patches that might meet.
    """
    near.found_at[:], near.reach[:], near.patch_pairs = found_at, reach, patch_pairs.copy()
    near.shift[:] = 0.0
    near.counts[:] = 0
    near.counts[IS_KNOWN] = 1
    patch_count = near.order.shape[0]
    triangle_boxes, boxes = np.empty((skin.triangles.shape[0], 6)), np.empty((patch_count, 6))
    edge_boxes = np.empty((skin.edges.shape[0], 6))
    _fill_boxes(skin, near, near.found_at, edge_boxes, triangle_boxes, boxes)
    _pair_features(skin, near, edge_boxes, triangle_boxes, boxes)
