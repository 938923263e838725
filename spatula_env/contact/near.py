"""Broad phase of self-contact: pairs of features of the organs' surfaces that may touch each other soon.

The pairs are a vertex and a triangle, or two edges. They are found once and stay valid while no vertex gets farther
than its reach from where it was then. The reach of a vertex is the distance by which the step throws it, plus a margin.

Boxes around patches of triangles rule out what is far apart. Patches that share a vertex always overlap; they are
considered only where the surface around one of them is folded: a connected surface whose normals are all within a cone
does not meet itself (Volino and Magnenat-Thalmann, Computer Graphics Forum 13(3), 1994). To test the two patches by
themselves is not enough: they may share just one vertex, and a fold beside both brings them together although neither
is folded. A vertex can fold the surface while it stays within its reach, so pairs also become invalid when a surface
that was taken to be flat folds; see `has_turned`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types

from spatula_env._kernels import ARRAYS, array_kernel, inline_kernel, kernel
from spatula_env.contact.corners import closest_weights
from spatula_env.contact.rigid_fit import fit_motion, move_back, move_points
from spatula_env.contact.skin import (
    ASKED_FOR,
    CALM_SPAN,
    CROSS_IS_KNOWN,
    CROSS_PAIRS,
    EDGE_PAIRS,
    EDGE_SPAN,
    FARTHEST,
    HELD_IS_KNOWN,
    IS_KNOWN,
    NEAR,
    PATCH_PAIRS,
    SKIN,
    TOO_MANY,
    VERTEX_PAIRS,
    VERTEX_SPAN,
)

MARGIN = 0.15
"""How far vertices reach beyond their motion in a step, in mean edges."""

SOON = 0.3
"""When some vertices have got out of reach, those that have used more than this part of theirs are updated, too."""

MOVING = 1.5
"""Factor on the margin of vertices that have got out of reach before, most of which go on moving. It is used only while
there are few pairs (see `FEW_PAIRS`), where it costs little."""

FEW_PAIRS = 2
"""Number of pairs for each vertex below which there are few pairs."""

MOST_PAIRS = 64
"""Most pairs of features for each vertex. Where there are more, an organ has collapsed into a lump, and the search is
given up."""

FLAT = math.radians(60.0)
"""Neighbouring patches are flat if a cone with this angle between its axis and its surface holds all their normals
[rad]."""


TURNED = math.radians(30.0)
"""Pairs are found anew where a triangle of a flat patch has turned out of the patch's cone by more than this; if two
flat patches have turned by less, their normals are still within a half-space [rad]."""

CALM = 0.2
"""Vertices that move by less than this part of a triangle's least height turn the triangle by less than `TURNED`."""


@array_kernel
def closest_on_edges(
    ux: float, uy: float, uz: float, vx: float, vy: float, vz: float, wx: float, wy: float, wz: float
) -> tuple[float, float]:
    """Closest points of two segments: fractions along u and along v; w leads from the start of v to the start of u.

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
def follow_motion(near: Any, points: np.ndarray) -> None:
    """Update `Near.placed` by the rigid motion that best takes the organs to their present vertices (V, 3) [u]."""
    fit_motion(near.found_at, points, near.rotation, near.motion)
    move_points(near.found_at, near.rotation, near.motion, near.placed)


@inline_kernel
def forget_gaps(near: Any) -> None:
    """Mark all gaps of pairs as not measured, after the pairs or the positions that vertices come from have changed."""
    for kind in range(2):
        count = near.counts[VERTEX_PAIRS if kind == 0 else EDGE_PAIRS]
        gaps = near.vertex_gaps if kind == 0 else near.edge_gaps
        if gaps.shape[0] < count or gaps.shape[0] > 4 * count + 64:
            gaps = np.empty(2 * count)
            if kind == 0:
                near.vertex_gaps = gaps
            else:
                near.edge_gaps = gaps
        for m in range(count):
            gaps[m] = -1.0


@inline_kernel
def mark_beyond(near: Any, held: np.ndarray, points: np.ndarray, beyond: np.ndarray) -> None:
    """Write which vertices are out of reach or soon will be, at `held` (V, 3) or at `points` (V, 3) [u]."""
    placed, reach = near.placed, near.reach
    for i in range(points.shape[0]):
        here, there = 0.0, 0.0
        for axis in range(3):
            here += (points[i, axis] - placed[axis, i]) ** 2
            there += (held[i, axis] - placed[axis, i]) ** 2
        beyond[i] = max(here, there) > (SOON * reach[i]) ** 2


@array_kernel
def _fill_held(placed: np.ndarray, held: np.ndarray, squared: np.ndarray) -> None:
    """Write the squared distances of vertices `held` (V, 3) from their positions `placed` (3, V)."""
    along_x, along_y, along_z = placed[0], placed[1], placed[2]
    for i in range(held.shape[0]):
        x, y, z = held[i, 0] - along_x[i], held[i, 1] - along_y[i], held[i, 2] - along_z[i]
        squared[i] = x * x + y * y + z * z


@array_kernel
def _fill_shifts(
    placed: np.ndarray, reach: np.ndarray, held: np.ndarray, points: np.ndarray, shift: np.ndarray
) -> bool:
    """Write the shifts of `measure_shifts`; `held` (V,) has the squared shifts of where the vertices come from."""
    # A plain loop with few arrays besides the one that is written, so that it is vectorised.
    along_x, along_y, along_z = placed[0], placed[1], placed[2]
    beyond = False
    for i in range(points.shape[0]):
        x, y, z = points[i, 0] - along_x[i], points[i, 1] - along_y[i], points[i, 2] - along_z[i]
        squared = max(x * x + y * y + z * z, held[i])
        beyond |= squared > reach[i] * reach[i]
        shift[i] = np.sqrt(squared)
    return not beyond


@array_kernel
def _greatest(values: np.ndarray) -> float:
    """The greatest of some numbers (n,), none of which is negative; 0 if there are none."""
    # Four running maxima, since each comparison with a single one would wait for the one before.
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    even = values.shape[0] // 4 * 4
    for i in range(0, even, 4):
        a, b, c, d = max(a, values[i]), max(b, values[i + 1]), max(c, values[i + 2]), max(d, values[i + 3])
    for i in range(even, values.shape[0]):
        a = max(a, values[i])
    return float(max(a, b, c, d))


@array_kernel
def _least(values: np.ndarray, count: int) -> float:
    """The least of the first `count` numbers of an array (.,); infinite if there are none."""
    least = np.inf
    for i in range(count):
        least = min(least, values[i])
    return least


@inline_kernel
def note_spans(near: Any) -> None:
    """Write the entries of `Near.spans` for pairs that have just been found, before anything has shifted."""
    spans, counts = near.spans, near.counts
    spans[FARTHEST], spans[CALM_SPAN] = 0.0, _least(near.calm, near.calm.shape[0])
    spans[VERTEX_SPAN] = _least(near.vertex_distances, counts[VERTEX_PAIRS])
    spans[EDGE_SPAN] = _least(near.edge_distances, counts[EDGE_PAIRS])


@inline_kernel
def _measure_from_held(near: Any, points: np.ndarray) -> bool:
    """Write the shifts of `measure_shifts`, given the squared distances in `Near.held`."""
    shift = near.shift
    within = _fill_shifts(near.placed, near.reach, near.held, points, shift)
    near.spans[FARTHEST] = _greatest(shift)
    return bool(within)


@inline_kernel
def measure_shifts(near: Any, held: np.ndarray, points: np.ndarray) -> bool:
    """Write how far vertices are from their positions at the time when the near pairs were found.

    Args:
        near: `Near`.
        held: (V, 3) positions that the vertices come from [u].
        points: (V, 3) their present positions [u].

    Returns:
        Whether all of them are within reach at both positions.
    """
    _fill_held(near.placed, held, near.held)
    near.counts[HELD_IS_KNOWN] = 0
    return bool(_measure_from_held(near, points))


@inline_kernel
def measure_shifts_again(near: Any, held: np.ndarray, points: np.ndarray, afresh: bool) -> bool:
    """Do the same as `measure_shifts`, but reuse the distances of `held` from an earlier pass unless `afresh`."""
    if afresh or near.counts[HELD_IS_KNOWN] == 0:
        _fill_held(near.placed, held, near.held)
        near.counts[HELD_IS_KNOWN] = 1
    return bool(_measure_from_held(near, points))


@inline_kernel
def _with_room(pairs: np.ndarray, distances: np.ndarray, count: int, wanted: int) -> tuple[np.ndarray, np.ndarray]:
    """Make room for `wanted` pairs and distances: the given arrays if they are large enough, or else larger copies."""
    if wanted <= pairs.shape[0] and wanted <= distances.shape[0]:
        return pairs, distances
    room = max(wanted + wanted // 4, 64)
    more, longer = np.empty((room, pairs.shape[1]), np.int32), np.empty(room)
    for p in range(count):
        longer[p] = distances[p]
        for column in range(pairs.shape[1]):
            more[p, column] = pairs[p, column]
    return more, longer


@inline_kernel
def _new_lists(pairs: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Empty arrays of pairs and distances, with room for about a quarter more than the last `count`."""
    room = max(count + count // 4, 64)
    return np.empty((room, pairs.shape[1]), np.int32), np.empty(room)


@array_kernel
def _write_pair(pairs: np.ndarray, distances: np.ndarray, count: int, first: int, second: int, distance: float) -> int:
    """Append a pair to `count` others; there must be room for it. Returns the new count."""
    for column in range(pairs.shape[1]):
        pairs[count, column] = 0
    pairs[count, 0], pairs[count, 1] = first, second
    distances[count] = distance
    return count + 1


@array_kernel
def _least_height(points: np.ndarray, a: int, b: int, c: int) -> float:
    """The least height of a triangle, that over its longest side, with vertices in points (3, V) [u]."""
    ux, uy, uz = points[0, b] - points[0, a], points[1, b] - points[1, a], points[2, b] - points[2, a]
    vx, vy, vz = points[0, c] - points[0, a], points[1, c] - points[1, a], points[2, c] - points[2, a]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    wx, wy, wz = vx - ux, vy - uy, vz - uz
    longest = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz)
    height: float = np.sqrt((nx * nx + ny * ny + nz * nz) / longest) if longest > 0.0 else 0.0
    return height


@array_kernel
def _apart(boxes: np.ndarray, i: int, others: np.ndarray, j: int) -> bool:
    """Whether two boxes (., 6), least and greatest coordinates, have no point in common."""
    apart: bool = (
        (boxes[i, 0] > others[j, 3]) | (boxes[i, 3] < others[j, 0])
        | (boxes[i, 1] > others[j, 4]) | (boxes[i, 4] < others[j, 1])
        | (boxes[i, 2] > others[j, 5]) | (boxes[i, 5] < others[j, 2])
    )  # fmt: skip
    return apart


@array_kernel
def _fill_feature_boxes(
    points: np.ndarray, reach: np.ndarray, features: np.ndarray, order: np.ndarray, first: int, end: int,
    boxes: np.ndarray,
) -> None:  # fmt: skip
    """Write the bounding boxes (n, 6) of edges (n, 2) or triangles (n, 3), enlarged by the reach of their vertices."""
    corners = features.shape[1]
    for m in range(first, end):
        f = order[m]
        for axis in range(3):
            v = features[f, 0]
            low, high = points[axis, v] - reach[v], points[axis, v] + reach[v]
            for corner in range(1, corners):
                v = features[f, corner]
                low, high = min(low, points[axis, v] - reach[v]), max(high, points[axis, v] + reach[v])
            boxes[f, axis], boxes[f, 3 + axis] = low, high


@inline_kernel
def _fill_box(skin: Any, near: Any, p: int, boxes: np.ndarray) -> None:
    """Write the bounding box of patch `p`, enlarged by the reach of its vertices, into boxes (P, 6)."""
    points, reach, triangles, order = near.found_at, near.reach, skin.triangles, skin.triangle_order
    for axis in range(3):
        low, high = np.inf, -np.inf
        for m in range(skin.triangle_starts[p], skin.triangle_starts[p + 1]):
            for corner in range(3):
                v = triangles[order[m], corner]
                low, high = min(low, points[axis, v] - reach[v]), max(high, points[axis, v] + reach[v])
        boxes[p, axis], boxes[p, 3 + axis] = low, high


@inline_kernel
def _fill_calm(skin: Any, near: Any, p: int) -> None:
    """Write `Near.calm` and `Near.steep` of patch `p`: when its triangles are to be checked, and for which angle."""
    points, triangles, order = near.found_at, skin.triangles, skin.triangle_order
    least = np.inf
    for m in range(skin.triangle_starts[p], skin.triangle_starts[p + 1]):
        a, b, c = triangles[order[m], 0], triangles[order[m], 1], triangles[order[m], 2]
        least = min(least, _least_height(points, a, b, c))
    near.calm[p], near.steep[p] = CALM * least, np.cos(near.cones[p, 3] + TURNED)


@inline_kernel
def _fill_cone(skin: Any, p: int, start: np.ndarray, thrown: np.ndarray, cones: np.ndarray) -> None:
    """Write a cone around the normals of a patch's triangles into cones (P, 4): its axis, and half its opening [rad].

    Args:
        skin: `Skin`.
        p: The patch.
        start: (V, 3) vertices before a step [u].
        thrown: (V, 3) vertices after it [u].
        cones: Written.
    """
    first, end = skin.triangle_starts[p], skin.triangle_starts[p + 1]
    normals = np.empty((2, end - first, 3))
    for time in range(2):
        points = start if time == 0 else thrown
        for m in range(first, end):
            t = skin.triangle_order[m]
            a, b, c = skin.triangles[t, 0], skin.triangles[t, 1], skin.triangles[t, 2]
            ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
            vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            scale = 1.0 / length if length > 0.0 else 0.0
            normals[time, m - first, 0], normals[time, m - first, 1] = scale * nx, scale * ny
            normals[time, m - first, 2] = scale * nz
    x, y, z = 0.0, 0.0, 0.0
    for m in range(end - first):
        x, y, z = x + normals[0, m, 0], y + normals[0, m, 1], z + normals[0, m, 2]
    length = np.sqrt(x * x + y * y + z * z)
    least = -1.0
    if length > 0.0:
        x, y, z, least = x / length, y / length, z / length, 1.0
        for time in range(2):
            for m in range(end - first):
                least = min(least, normals[time, m, 0] * x + normals[time, m, 1] * y + normals[time, m, 2] * z)
    cones[p, 0], cones[p, 1], cones[p, 2], cones[p, 3] = x, y, z, np.arccos(max(least, -1.0))


@array_kernel
def _mark_stirred(
    shift: np.ndarray, starts: np.ndarray, around: np.ndarray, calm: np.ndarray, stirred: np.ndarray
) -> None:
    """Write which patches have a vertex that has moved farther than `Near.calm`; see `skin.Skin` and `skin.Near`."""
    least = np.inf
    for p in range(calm.shape[0]):
        stirred[p] = False
        least = min(least, calm[p])
    for i in range(shift.shape[0]):
        if shift[i] > least:
            for m in range(starts[i], starts[i + 1]):
                stirred[around[m]] |= shift[i] > calm[around[m]]


@array_kernel
def _first_turned(
    first: int,
    triangles: np.ndarray,
    order: np.ndarray,
    starts: np.ndarray,
    cones: np.ndarray,
    calm: np.ndarray,
    stirred: np.ndarray,
    steep: np.ndarray,
    rotation: np.ndarray,
    shift: np.ndarray,
    points: np.ndarray,
) -> int:
    """The first patch, from index `first` on, of which a triangle has turned far out of its cone.

    Args:
        first: The patch to begin with.
        triangles: `triangles` of `skin.Skin`.
        order: `triangle_order` of `skin.Skin`.
        starts: `triangle_starts` of `skin.Skin`.
        cones: `cones` of `skin.Near`.
        calm: `calm` of `skin.Near`.
        stirred: `stirred` of `skin.Near`.
        steep: `steep` of `skin.Near`.
        rotation: `rotation` of `skin.Near`.
        shift: `shift` of `skin.Near`.
        points: (V, 3) present positions of the vertices [u].

    Returns:
        Its index; the number of patches if there is none.
    """
    for p in range(first, calm.shape[0]):
        # A patch whose normals are in no such cone counts as folded anyway.
        if not stirred[p] or cones[p, 3] > FLAT:
            continue
        x, y, z = cones[p, 0], cones[p, 1], cones[p, 2]
        along_x = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z
        along_y = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z
        along_z = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z
        for m in range(starts[p], starts[p + 1]):
            a, b, c = triangles[order[m], 0], triangles[order[m], 1], triangles[order[m], 2]
            if max(shift[a], shift[b], shift[c]) <= calm[p]:
                continue
            ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
            vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            if nx * along_x + ny * along_y + nz * along_z < length * steep[p]:
                return p
    return int(calm.shape[0])


@inline_kernel
def has_turned(skin: Any, near: Any, points: np.ndarray) -> bool:
    """Whether a triangle has turned so far that its patch may be folded; shifts of vertices (V, 3) must be measured."""
    if near.spans[FARTHEST] <= near.spans[CALM_SPAN]:
        return False
    calm, stirred, shift = near.calm, near.stirred, near.shift
    _mark_stirred(shift, skin.around_starts, skin.around, calm, stirred)
    patch = _first_turned(
        0, skin.triangles, skin.triangle_order, skin.triangle_starts, near.cones, calm, stirred, near.steep,
        near.rotation, shift, points,
    )  # fmt: skip
    return bool(patch < calm.shape[0])


@inline_kernel
def mark_turned(skin: Any, near: Any, points: np.ndarray, beyond: np.ndarray) -> None:
    """Set the entries of `beyond` (V,) for the vertices of patches that may be folded; see `has_turned`."""
    triangles, order, starts, patches = skin.triangles, skin.triangle_order, skin.triangle_starts, near.calm.shape[0]
    calm, stirred, shift = near.calm, near.stirred, near.shift
    _mark_stirred(shift, skin.around_starts, skin.around, calm, stirred)
    patch = -1
    while patch < patches:
        patch = _first_turned(
            patch + 1, triangles, order, starts, near.cones, calm, stirred, near.steep, near.rotation, shift, points
        )
        if patch < patches:
            for m in range(starts[patch], starts[patch + 1]):
                for corner in range(3):
                    beyond[triangles[order[m], corner]] = True


@array_kernel
def _is_flat(cones: np.ndarray, p: int, q: int) -> bool:
    """Whether one cone of half-opening `FLAT` holds the normals of two patches' triangles."""
    if max(cones[p, 3], cones[q, 3]) > FLAT:
        return False
    along = cones[p, 0] * cones[q, 0] + cones[p, 1] * cones[q, 1] + cones[p, 2] * cones[q, 2]
    return bool(np.arccos(min(max(along, -1.0), 1.0)) + cones[p, 3] + cones[q, 3] <= 2.0 * FLAT)


@inline_kernel
def _find_folded(skin: Any, near: Any, moved: np.ndarray) -> None:
    """Write which patches are not flat with all of their neighbours, and mark those that were flat before as moved."""
    starts, neighbours, cones, folded = skin.neighbour_starts, skin.neighbours, near.cones, near.folded
    for p in range(moved.shape[0]):
        is_known, is_folded = True, False
        for m in range(starts[p], starts[p + 1]):
            is_known &= not moved[neighbours[m]]
        if is_known:
            # Neither its cone nor theirs has changed.
            continue
        for m in range(starts[p], starts[p + 1]):
            is_folded |= not _is_flat(cones, p, neighbours[m])
        # Pairs with its neighbours were left out while it was flat, and must be found now.
        moved[p] |= is_folded and not folded[p]
        folded[p] = is_folded


@array_kernel
def _sort_along_x(order: np.ndarray, boxes: np.ndarray) -> None:
    """Sort patches by the lower x of their boxes, by insertion: they are nearly in order from the last time."""
    for place in range(1, order.shape[0]):
        patch = order[place]
        k = place
        while k > 0 and boxes[order[k - 1], 0] > boxes[patch, 0]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = patch


@inline_kernel
def _close_patches(skin: Any, near: Any, moved: np.ndarray) -> np.ndarray:
    """Pairs of patches that may meet and of which at least one has moved (P,), as first x P + second, ascending."""
    order, starts, neighbours, boxes, folded = (
        near.order, skin.neighbour_starts, skin.neighbours, near.boxes, near.folded,
    )  # fmt: skip
    patches = order.shape[0]
    _sort_along_x(order, boxes)
    found, count = np.empty(64, np.int64), 0
    for i in range(patches):
        for k in range(i, patches):
            p, q = min(order[i], order[k]), max(order[i], order[k])
            if boxes[order[k], 0] > boxes[order[i], 3]:
                break
            if not (moved[p] or moved[q]) or (p != q and _apart(boxes, p, boxes, q)):
                continue
            shares = False
            for m in range(starts[p], starts[p + 1]):
                shares |= neighbours[m] == q
            if shares and not (folded[p] or folded[q]):
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
def _merged(kept: np.ndarray, moved: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Merge the known pairs of patches, except those of which one has moved (P,), with those found; all ascending."""
    patches = moved.shape[0]
    pairs, count, place = np.empty(kept.shape[0] + found.shape[0], np.int64), 0, 0
    for pair in kept:
        if moved[pair // patches] or moved[pair % patches]:
            continue
        while place < found.shape[0] and found[place] < pair:
            pairs[count] = found[place]
            place, count = place + 1, count + 1
        pairs[count] = pair
        count += 1
    while place < found.shape[0]:
        pairs[count] = found[place]
        place, count = place + 1, count + 1
    return pairs[:count].copy()


@array_kernel
def _listed(
    order: np.ndarray, first: int, end: int, boxes: np.ndarray, patch_boxes: np.ndarray, patch: int, listed: np.ndarray
) -> int:
    """List the features of a patch whose boxes meet another patch's. Returns how many there are."""
    count = 0
    for m in range(first, end):
        if not _apart(boxes, order[m], patch_boxes, patch):
            listed[count] = order[m]
            count += 1
    return count


@inline_kernel
def _pair_vertices(near: Any, skin: Any, of_vertices: int, of_triangles: int, triangle_boxes: np.ndarray) -> None:
    """Add the vertices of one patch that are near triangles of another."""
    patch_boxes, first, end = near.boxes, skin.triangle_starts[of_triangles], skin.triangle_starts[of_triangles + 1]
    listed = np.empty(end - first, np.int32)
    close = _listed(skin.triangle_order, first, end, triangle_boxes, patch_boxes, of_vertices, listed)
    if close == 0:
        return
    triangles, vertex_order, reach, points = skin.triangles, skin.vertex_order, near.reach, near.found_at
    pairs, count, distances, box = near.vertex_pairs, near.counts[VERTEX_PAIRS], near.vertex_distances, np.empty((1, 6))
    begin, stop = skin.vertex_starts[of_vertices], skin.vertex_starts[of_vertices + 1]
    # Reserve room for all before the loop: an array that may be replaced within it has its references counted there.
    pairs, distances = _with_room(pairs, distances, count, count + close * (stop - begin))
    for m in range(begin, stop):
        v = vertex_order[m]
        x, y, z = points[0, v], points[1, v], points[2, v]
        for axis in range(3):
            box[0, axis], box[0, 3 + axis] = points[axis, v] - reach[v], points[axis, v] + reach[v]
        if _apart(box, 0, patch_boxes, of_triangles):
            continue
        for e in range(close):
            t = listed[e]
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
            count = _write_pair(pairs, distances, count, v, t, np.sqrt(squared))
    near.vertex_pairs, near.counts[VERTEX_PAIRS], near.vertex_distances = pairs, count, distances


@inline_kernel
def _pair_edges(near: Any, skin: Any, p: int, q: int, edge_boxes: np.ndarray) -> None:
    """Add the edges of one patch that are near edges of another, or of the same one."""
    order, patch_boxes, first, end = skin.edge_order, near.boxes, skin.edge_starts[q], skin.edge_starts[q + 1]
    others = np.empty(end - first, np.int32)
    close = _listed(order, first, end, edge_boxes, patch_boxes, p, others)
    if close == 0:
        return
    edges, reach, points = skin.edges, near.reach, near.found_at
    pairs, count, distances = near.edge_pairs, near.counts[EDGE_PAIRS], near.edge_distances
    begin, stop = skin.edge_starts[p], skin.edge_starts[p + 1]
    pairs, distances = _with_room(pairs, distances, count, count + close * (stop - begin))
    for m in range(begin, stop):
        e = order[m]
        if _apart(edge_boxes, e, patch_boxes, q):
            continue
        a, b = edges[e, 0], edges[e, 1]
        ux, uy, uz = points[0, b] - points[0, a], points[1, b] - points[1, a], points[2, b] - points[2, a]
        for k in range(m + 1 - first if p == q else 0, close):
            f = others[k]
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
            count = _write_pair(pairs, distances, count, e, f, np.sqrt(squared))
    near.edge_pairs, near.counts[EDGE_PAIRS], near.edge_distances = pairs, count, distances


@array_kernel
def _distance_to_edge(points: np.ndarray, corners: tuple[int, int, int], first: int, second: int) -> float:
    """Lower bound on the distance of an edge from a triangle: along its normal, or across one of its sides [u]."""
    a, b, c = corners
    ux, uy, uz = points[0, b] - points[0, a], points[1, b] - points[1, a], points[2, b] - points[2, a]
    vx, vy, vz = points[0, c] - points[0, a], points[1, c] - points[1, a], points[2, c] - points[2, a]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    squared = nx * nx + ny * ny + nz * nz
    if not squared > 0.0:
        return 0.0
    scale = 1.0 / np.sqrt(squared)
    nx, ny, nz = scale * nx, scale * ny, scale * nz
    distance = 0.0
    for side in range(4):
        # The planes through the sides, upright on the triangle's plane, and last that plane itself.
        start = a if side == 3 else (a if side == 0 else (b if side == 1 else c))
        mx, my, mz = nx, ny, nz
        if side < 3:
            end = b if side == 0 else (c if side == 1 else a)
            sx, sy, sz = (
                points[0, end] - points[0, start], points[1, end] - points[1, start], points[2, end] - points[2, start],
            )  # fmt: skip
            mx, my, mz = sy * nz - sz * ny, sz * nx - sx * nz, sx * ny - sy * nx
            scale = 1.0 / np.sqrt(mx * mx + my * my + mz * mz)
            mx, my, mz = scale * mx, scale * my, scale * mz
        x, y, z = points[0, start], points[1, start], points[2, start]
        one = mx * (points[0, first] - x) + my * (points[1, first] - y) + mz * (points[2, first] - z)
        other = mx * (points[0, second] - x) + my * (points[1, second] - y) + mz * (points[2, second] - z)
        distance = max(distance, min(one, other))
        if side == 3:
            distance = max(distance, -max(one, other))
    return distance


@inline_kernel
def _pair_crossings(
    near: Any, skin: Any, of_edges: int, of_triangles: int, edge_boxes: np.ndarray, triangle_boxes: np.ndarray
) -> None:
    """Add the edges of one patch that may cross triangles of another."""
    patch_boxes, first, end = near.boxes, skin.triangle_starts[of_triangles], skin.triangle_starts[of_triangles + 1]
    listed = np.empty(end - first, np.int32)
    close = _listed(skin.triangle_order, first, end, triangle_boxes, patch_boxes, of_edges, listed)
    if close == 0:
        return
    edges, edge_order, triangles, reach, points = (
        skin.edges, skin.edge_order, skin.triangles, near.reach, near.found_at,
    )  # fmt: skip
    pairs, count, distances = near.cross_pairs, near.counts[CROSS_PAIRS], near.cross_distances
    begin, stop = skin.edge_starts[of_edges], skin.edge_starts[of_edges + 1]
    pairs, distances = _with_room(pairs, distances, count, count + close * (stop - begin))
    for m in range(begin, stop):
        e = edge_order[m]
        if _apart(edge_boxes, e, patch_boxes, of_triangles):
            continue
        a, b = edges[e, 0], edges[e, 1]
        for k in range(close):
            t = listed[k]
            if _apart(edge_boxes, e, triangle_boxes, t):
                continue
            first, second, third = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            if a == first or a == second or a == third or b == first or b == second or b == third:
                continue
            distance = _distance_to_edge(points, (first, second, third), a, b)
            if distance > max(reach[a], reach[b]) + max(reach[first], reach[second], reach[third]):
                continue
            count = _write_pair(pairs, distances, count, e, t, distance)
    near.cross_pairs, near.counts[CROSS_PAIRS], near.cross_distances = pairs, count, distances


@inline_kernel
def _fill_features(
    skin: Any, near: Any, p: int, filled: np.ndarray, edge_boxes: np.ndarray, triangle_boxes: np.ndarray
) -> None:
    """Write the boxes of a patch's edges and triangles, see `_fill_feature_boxes`, and mark it as filled (P,)."""
    filled[p] = True
    _fill_feature_boxes(
        near.found_at, near.reach, skin.edges, skin.edge_order, skin.edge_starts[p], skin.edge_starts[p + 1],
        edge_boxes,
    )  # fmt: skip
    _fill_feature_boxes(
        near.found_at, near.reach, skin.triangles, skin.triangle_order, skin.triangle_starts[p],
        skin.triangle_starts[p + 1], triangle_boxes,
    )  # fmt: skip


@inline_kernel
def _copied(
    pairs: np.ndarray, distances: np.ndarray, count: int, old: np.ndarray, apart: np.ndarray, first: int, end: int
) -> tuple[np.ndarray, np.ndarray]:
    """Append the old pairs from `first` to `end`, with their distances and sides; returns arrays with room for them."""
    pairs, distances = _with_room(pairs, distances, count, count + end - first)
    for m in range(first, end):
        distances[count + m - first] = apart[m]
        for column in range(pairs.shape[1]):
            pairs[count + m - first, column] = old[m, column]
    return pairs, distances


@inline_kernel
def _pair_features(skin: Any, near: Any, patch_pairs: np.ndarray, moved: np.ndarray, with_crossings: bool) -> None:
    """Find the pairs of features in pairs of patches, ascending; keep those of patches that have not moved (P,)."""
    patch_count, total = near.order.shape[0], patch_pairs.shape[0]
    old_pairs, old_ends = near.patch_pairs, near.ends
    vertex_pairs, vertex_distances = near.vertex_pairs, near.vertex_distances
    edge_pairs, edge_distances = near.edge_pairs, near.edge_distances
    cross_pairs, cross_distances = near.cross_pairs, near.cross_distances
    ends, filled, counts = np.zeros((total, 3), np.int64), np.zeros(patch_count, np.bool_), near.counts
    near.vertex_pairs, near.vertex_distances = _new_lists(vertex_pairs, counts[VERTEX_PAIRS])
    near.edge_pairs, near.edge_distances = _new_lists(edge_pairs, counts[EDGE_PAIRS])
    near.cross_pairs, near.cross_distances = _new_lists(cross_pairs, counts[CROSS_PAIRS])
    edge_boxes, triangle_boxes = np.empty((skin.edges.shape[0], 6)), np.empty((skin.triangles.shape[0], 6))
    counts[VERTEX_PAIRS], counts[EDGE_PAIRS], counts[CROSS_PAIRS] = 0, 0, 0
    counts[IS_KNOWN], counts[CROSS_IS_KNOWN], counts[PATCH_PAIRS] = 1, 1 if with_crossings else 0, total
    place = 0
    for k in range(total):
        p, q = patch_pairs[k] // patch_count, patch_pairs[k] % patch_count
        if moved[p] or moved[q]:
            if not filled[p]:
                _fill_features(skin, near, p, filled, edge_boxes, triangle_boxes)
            if not filled[q]:
                _fill_features(skin, near, q, filled, edge_boxes, triangle_boxes)
            for way in range(1 if p == q else 2):
                one, other = (p, q) if way == 0 else (q, p)
                _pair_vertices(near, skin, one, other, triangle_boxes)
                if with_crossings:
                    _pair_crossings(near, skin, one, other, edge_boxes, triangle_boxes)
            _pair_edges(near, skin, p, q, edge_boxes)
        else:
            while old_pairs[place] != patch_pairs[k]:
                place += 1
            first = 0 if place == 0 else old_ends[place - 1, VERTEX_PAIRS]
            end = old_ends[place, VERTEX_PAIRS]
            near.vertex_pairs, near.vertex_distances = _copied(
                near.vertex_pairs, near.vertex_distances, counts[VERTEX_PAIRS], vertex_pairs, vertex_distances, first,
                end,
            )  # fmt: skip
            counts[VERTEX_PAIRS] += end - first
            first = 0 if place == 0 else old_ends[place - 1, EDGE_PAIRS]
            end = old_ends[place, EDGE_PAIRS]
            near.edge_pairs, near.edge_distances = _copied(
                near.edge_pairs, near.edge_distances, counts[EDGE_PAIRS], edge_pairs, edge_distances, first, end
            )
            counts[EDGE_PAIRS] += end - first
            if with_crossings:
                first = 0 if place == 0 else old_ends[place - 1, CROSS_PAIRS]
                end = old_ends[place, CROSS_PAIRS]
                near.cross_pairs, near.cross_distances = _copied(
                    near.cross_pairs, near.cross_distances, counts[CROSS_PAIRS], cross_pairs, cross_distances, first,
                    end,
                )  # fmt: skip
                counts[CROSS_PAIRS] += end - first
        for kind in range(3):
            ends[k, kind] = counts[kind]
        if counts[VERTEX_PAIRS] + counts[EDGE_PAIRS] > MOST_PAIRS * near.reach.shape[0]:
            counts[:] = 0
            counts[IS_KNOWN] = TOO_MANY
            note_spans(near)
            return
    near.patch_pairs, near.ends = patch_pairs, ends
    note_spans(near)
    forget_gaps(near)


@kernel(types.void(SKIN, NEAR))
def find_cross_pairs(skin: Any, near: Any) -> None:
    """Find the pairs of an edge and a triangle that may cross, among the pairs of patches that are near.

    Args:
        skin: `Skin`.
        near: `Near`, written.
    """
    patch_count, ends = near.order.shape[0], near.ends
    triangle_boxes, edge_boxes = np.empty((skin.triangles.shape[0], 6)), np.empty((skin.edges.shape[0], 6))
    filled = np.zeros(patch_count, np.bool_)
    near.counts[CROSS_PAIRS] = 0
    near.counts[CROSS_IS_KNOWN] = ASKED_FOR
    patch_pairs = near.patch_pairs
    for k in range(near.counts[PATCH_PAIRS]):
        p, q = patch_pairs[k] // patch_count, patch_pairs[k] % patch_count
        if not filled[p]:
            _fill_features(skin, near, p, filled, edge_boxes, triangle_boxes)
        if not filled[q]:
            _fill_features(skin, near, q, filled, edge_boxes, triangle_boxes)
        _pair_crossings(near, skin, p, q, edge_boxes, triangle_boxes)
        if p != q:
            _pair_crossings(near, skin, q, p, edge_boxes, triangle_boxes)
        ends[k, CROSS_PAIRS] = near.counts[CROSS_PAIRS]


@kernel(types.void(SKIN, NEAR, ARRAYS["f8_2"], ARRAYS["f8_2"], types.float64, ARRAYS["b1"]))
def find_near(skin: Any, near: Any, start: np.ndarray, thrown: np.ndarray, margin: float, beyond: np.ndarray) -> None:
    """Find the pairs of features that are near each other.

    Args:
        skin: `Skin`.
        near: `Near`, written.
        start: (V, 3) present positions of the vertices [u].
        thrown: (V, 3) positions to which they may move at once [u].
        margin: How far they reach beyond that [u].
        beyond: (V,) vertices that have got out of their reach since the pairs were last found. The others count as
            not having moved, and only patches with such vertices are searched anew.
    """
    points, placed, reach, patch_count = near.found_at, near.placed, near.reach, near.order.shape[0]
    whole, few = near.counts[IS_KNOWN] != 1, FEW_PAIRS * start.shape[0]
    if not whole and near.counts[VERTEX_PAIRS] + near.counts[EDGE_PAIRS] < few:
        margin = MOVING * margin
    if whole:
        near.rotation[:], near.motion[:] = np.eye(3), 0.0
    # Undo the rigid motion of the organs since all pairs were last found.
    unmoved, ahead = np.empty_like(start), np.empty_like(start)
    move_back(start, near.rotation, near.motion, unmoved)
    move_back(thrown, near.rotation, near.motion, ahead)
    for i in range(start.shape[0]):
        if whole or beyond[i]:
            squared = 0.0
            for axis in range(3):
                points[axis, i], placed[axis, i] = unmoved[i, axis], start[i, axis]
                squared += (thrown[i, axis] - start[i, axis]) ** 2
            reach[i] = margin + np.sqrt(squared)
    moved = np.zeros(patch_count, np.bool_)
    for p in range(patch_count):
        has_moved = whole
        for m in range(skin.triangle_starts[p], skin.triangle_starts[p + 1]):
            t = skin.triangle_order[m]
            for corner in range(3):
                has_moved |= beyond[skin.triangles[t, corner]]
        if has_moved:
            moved[p] = True
            _fill_cone(skin, p, unmoved, ahead, near.cones)
            _fill_box(skin, near, p, near.boxes)
            _fill_calm(skin, near, p)
    _find_folded(skin, near, moved)
    known = near.patch_pairs[: 0 if whole else near.counts[PATCH_PAIRS]]
    pairs = _merged(known, moved, _close_patches(skin, near, moved))
    # Pairs that may cross are kept up to date while they are in use, and otherwise found when they are asked for.
    _pair_features(skin, near, pairs, moved, not whole and near.counts[CROSS_IS_KNOWN] == ASKED_FOR)


@kernel(types.void(SKIN, NEAR, ARRAYS["f8_2"], ARRAYS["f8"], ARRAYS["f8_2"], ARRAYS["i8"]))
def find_as_before(
    skin: Any, near: Any, found_at: np.ndarray, reach: np.ndarray, cones: np.ndarray, patch_pairs: np.ndarray
) -> None:
    """Find the same pairs as at an earlier time.

    Which neighbouring patches were flat then cannot be told from their present positions: without this, a simulation
    would continue differently from a restored state than it did from the original one.

    Args:
        skin: `Skin`.
        near: `Near`, written.
        found_at: (3, V) positions of the vertices then [u].
        reach: (V,) their reach [u].
        cones: (P, 4) around the patches' normals.
        patch_pairs: (.,) pairs of patches that might meet.
    """
    near.found_at[:], near.placed[:], near.reach[:], near.cones[:] = found_at, found_at, reach, cones
    near.rotation[:], near.motion[:] = np.eye(3), 0.0
    near.shift[:] = 0.0
    patches = near.order.shape[0]
    for p in range(patches):
        _fill_box(skin, near, p, near.boxes)
        _fill_calm(skin, near, p)
    moved = np.ones(patches, np.bool_)
    _find_folded(skin, near, moved)
    _pair_features(skin, near, patch_pairs.copy(), moved, False)
