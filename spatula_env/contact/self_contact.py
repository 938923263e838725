"""Contact of organs with themselves and with each other: surfaces that came near stay on the side that they came from.

Surfaces are kept apart by pairs of features: a vertex and a triangle, or two edges. The side is that on which the
features were at the last query. A pair that pushed in the last step remembers its side, as contact nodes of a tool
remember their flags, because a solve may leave the features slightly on the wrong side. Surfaces are kept a small
distance apart for the same reason.

A pair makes one constraint of four vertices: the point of one feature stays on one side of the point of the other. The
weights of one point are positive and those of the other negative, and all sum to zero, so the solve conserves momentum
even if it has not converged. See `response` for the solve, and `near` for the broad phase that finds the pairs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types

from spatula_env._kernels import ARRAYS, array_kernel, inline_kernel, kernel
from spatula_env.contact.corners import closest_weights
from spatula_env.contact.meeting import fill_volume, find_roots, has_no_root
from spatula_env.contact.near import (
    MARGIN,
    closest_on_edges,
    find_near,
    follow_motion,
    forget_gaps,
    has_turned,
    mark_beyond,
    mark_turned,
    measure_shifts,
    measure_shifts_again,
)
from spatula_env.contact.rows import ON_EDGES, ON_TRIANGLE, constraint_name
from spatula_env.contact.skin import (
    CROSSINGS,
    EDGE_PAIRS,
    EDGE_SPAN,
    FARTHEST,
    HELD_IS_KNOWN,
    IS_KNOWN,
    NEAR,
    SKIN,
    TOO_MANY,
    VERTEX_PAIRS,
    VERTEX_SPAN,
)
from spatula_env.contact.structures import (
    CONSTRAINTS,
    DISPLACEMENT,
    FOURTH,
    FRICTION,
    IMPULSE,
    NORMAL,
    ORGANS,
    ORIGIN,
    OWNER,
    PLANE,
    POINT,
    VELOCITY,
    WEIGHTS,
    make_constraints,
    reserve,
)
from spatula_env.contact.tangles import find_crossings, hold_back

SEPARATION = 0.03
"""How far apart surfaces are kept, in mean edges of the organ with the smallest mean edge."""

TOUCHING = 2.0
"""Pairs no farther apart than this, as a multiple of the distance at which they are kept, make a constraint, so that
they are stopped if they come closer in the step."""

OUTSIDE = 0.02
"""How far outside of a triangle or beyond the end of an edge a point may be and still count as on it, relative to the
size of the feature."""

PARALLEL = 1e-3
"""Squared sine of the angle between edges below which they are parallel; vertices then keep them apart."""

DEEPEST = 0.5
"""A pair that is farther on its wrong side than this, in mean edges, is not pushed back: it has come there some other
way than through each other."""

SPREAD = 0x1E3779B97F4A7C15
"""Multiplier of the hash function of names: odd, with set bits all over; that of the golden ratio, without its highest
bit."""

SIDE_BIT = 1 << 40
"""Added to a pair's name if the second feature, or the vertex, is on the inner side."""


@array_kernel
def _fill_sides(points: np.ndarray, a: int, b: int, c: int, d: int, is_edges: bool, sides: np.ndarray) -> None:
    """Write the vectors u, v and w (9,) of a pair of features.

    For a triangle a, b, c and a vertex d: u = b - a, v = c - a, w = d - a. For edges a, b and c, d: u = b - a,
    v = d - c, w = c - a.
    """
    for axis in range(3):
        start = points[a, axis]
        sides[axis] = points[b, axis] - start
        if is_edges:
            sides[3 + axis] = points[d, axis] - points[c, axis]
            sides[6 + axis] = points[c, axis] - start
        else:
            sides[3 + axis] = points[c, axis] - start
            sides[6 + axis] = points[d, axis] - start


@array_kernel
def _gap(sides: np.ndarray, is_edges: bool, corners: np.ndarray) -> float:
    """The distance between two features [u].

    Args:
        sides: (9,) see `_fill_sides`.
        is_edges: Whether they are two edges, or else a triangle and a vertex.
        corners: (3, 3) workspace, with zeros in its first column.
    """
    x, y, z = sides[6], sides[7], sides[8]
    if is_edges:
        ux, uy, uz, vx, vy, vz = sides[0], sides[1], sides[2], sides[3], sides[4], sides[5]
        s, t = closest_on_edges(ux, uy, uz, vx, vy, vz, -x, -y, -z)
        x, y, z = x + t * vx - s * ux, y + t * vy - s * uy, z + t * vz - s * uz
    else:
        for axis in range(3):
            corners[axis, 1], corners[axis, 2] = sides[axis], sides[3 + axis]
        _, b, c = closest_weights(corners, 0, 1, 2, x, y, z)
        x, y, z = x - b * sides[0] - c * sides[3], y - b * sides[1] - c * sides[4], z - b * sides[2] - c * sides[5]
    gap: float = np.sqrt(x * x + y * y + z * z)
    return gap


@array_kernel
def _fill_place(sides: np.ndarray, is_edges: bool, place: np.ndarray) -> None:
    """Write where a triangle's plane is closest to a vertex, or two edges' lines to each other, into place (3,).

    The first two numbers are the weights of the triangle's corners b and c, or the fractions along both edges. The
    third is how far outside of the features that is, as a fraction of their size: negative inside, and infinite if the
    features have no extent or the edges are parallel.
    """
    uu, uv, vv, uw, vw = 0.0, 0.0, 0.0, 0.0, 0.0
    for axis in range(3):
        u, v, w = sides[axis], sides[3 + axis], sides[6 + axis]
        uu, uv, vv, uw, vw = uu + u * u, uv + u * v, vv + v * v, uw + u * w, vw + v * w
    squared = uu * vv - uv * uv
    if not squared > (PARALLEL if is_edges else 0.0) * uu * vv:
        place[2] = np.inf
    elif is_edges:
        s, t = (vv * uw - uv * vw) / squared, (uv * uw - uu * vw) / squared
        place[0], place[1], place[2] = s, t, -min(min(s, t), min(1.0 - s, 1.0 - t))
    else:
        b, c = (vv * uw - uv * vw) / squared, (uu * vw - uv * uw) / squared
        place[0], place[1], place[2] = b, c, -min(b, c, 1.0 - b - c)


@array_kernel
def _fill_normal(sides: np.ndarray, normal: np.ndarray) -> float:
    """Write the unit vector along u x v (3,), or zeros if that vanishes. Returns the component of w along it."""
    ux, uy, uz, vx, vy, vz = sides[0], sides[1], sides[2], sides[3], sides[4], sides[5]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    scale = 1.0 / length if length > 0.0 else 0.0
    normal[0], normal[1], normal[2] = scale * nx, scale * ny, scale * nz
    distance: float = normal[0] * sides[6] + normal[1] * sides[7] + normal[2] * sides[8]
    return distance


@array_kernel
def _side_held(
    before: np.ndarray,
    now: np.ndarray,
    is_edges: bool,
    known: int,
    touching: float,
    deepest: float,
    normal: np.ndarray,
    place: np.ndarray,
    room: np.ndarray,
) -> int:
    """Decide on which side of each other two features are to be held, if they have met or are close.

    Args:
        before: (9,) u, v, w at the last query, see `_fill_sides` [u].
        now: (9,) the same now [u].
        is_edges: Whether they are two edges, or else a triangle and a vertex.
        known: The side on which they were held in the last step; 0 if they were not held.
        touching: Greatest distance at which features touch [u].
        deepest: Greatest distance on the wrong side at which features are still held on the known side if no meeting
            between the two times was found [u].
        normal: (3,) written: unit vector along u x v now.
        place: (3,) written: where on the features they are held, see `_fill_place`.
        room: (3, 9) workspace.

    Returns:
        1 if w is to point along the normal, -1 if against it, 0 if the features are not held.
    """
    distance = _fill_normal(now, normal)
    if known * distance > touching:
        return 0
    if known != 0:
        # Forget the side of features that have slid off each other: they may come back from the other side.
        _fill_place(before, is_edges, place)
        if not place[2] <= OUTSIDE:
            known = 0
    volume, roots, between = room[0], room[1], room[2]
    fill_volume(before, now, volume)
    if not has_no_root(volume):
        for k in range(find_roots(volume, roots)):
            for entry in range(9):
                between[entry] = before[entry] + roots[k] * (now[entry] - before[entry])
            _fill_place(between, is_edges, place)
            if place[2] <= OUTSIDE:
                # The cubic has the sign of its first value up to its first root, and changes it at each root.
                side = 1 if (volume[0] > 0.0) == (k % 2 == 0) else -1
                side = known if known != 0 else side
                return side if side * distance <= touching else 0
    if abs(distance) > touching and known == 0:
        return 0
    side = known
    if known == 0:
        side = 1 if distance >= 0.0 else -1
    elif side * distance < -deepest:
        return 0
    _fill_place(now, is_edges, place)
    return side if place[2] <= OUTSIDE else 0


@array_kernel
def append_pair(
    table: Any,
    count: int,
    vertices: tuple[int, int, int, int],
    weights: tuple[float, float, float],
    normal: tuple[float, float, float],
    separation: float,
    reference: np.ndarray,
    friction: float,
    name: int,
) -> int:
    """Append a constraint between two points of organs; the fourth vertex's weight makes the weights sum to zero."""
    i, j, k, fourth = vertices
    row, features = table.rows[count], table.features[count]
    features[0], features[1], features[2], features[FOURTH] = i, j, k, fourth
    features[OWNER], features[PLANE] = ORGANS, 0
    table.names[count] = name
    a, b, c = weights
    d = -(a + b + c)
    row[WEIGHTS], row[WEIGHTS + 1], row[WEIGHTS + 2] = a, b, c
    row[NORMAL], row[NORMAL + 1], row[NORMAL + 2] = normal
    for axis in range(3):
        row[POINT + axis] = separation * row[NORMAL + axis]
        row[VELOCITY + axis] = 0.0
        row[ORIGIN + axis] = (
            a * reference[i, axis] + b * reference[j, axis] + c * reference[k, axis] + d * reference[fourth, axis]
        )
        row[DISPLACEMENT + axis] = 0.0
        row[IMPULSE + axis] = 0.0
    row[FRICTION] = friction
    return count + 1


@array_kernel
def _is_left_out(left_out: np.ndarray, name: int) -> bool:
    """Whether a name without a side is among `left_out` (.,), which is sorted."""
    place = np.searchsorted(left_out, name)
    return bool(place < left_out.shape[0] and left_out[place] == name)


class _Pairs(NamedTuple):
    """Pairs of features of one kind.

    Attributes:
        pairs: (., 3) `vertex_pairs` or `edge_pairs` of `skin.Near`.
        distances: (.,) `vertex_distances` or `edge_distances` of `skin.Near` [u].
        gaps: (.,) `vertex_gaps` or `edge_gaps` of `skin.Near`; negative ones are still to be measured [u].
        edges: (E, 2) of `skin.Skin`.
        triangles: (T, 3) of `skin.Skin`.
        left_out: (.,) of `skin.Skin`.
    """

    pairs: np.ndarray
    distances: np.ndarray
    gaps: np.ndarray
    edges: np.ndarray
    triangles: np.ndarray
    left_out: np.ndarray


class _Vertices(NamedTuple):
    """The V vertices of all organs.

    Attributes:
        held: (V, 3) as in `gather_organs` [u].
        vertices: (V, 3) as in `gather_organs` [u].
        reference: (V, 3) as in `gather_organs` [u].
        placed: (3, V) of `skin.Near` [u].
        shift: (V,) of `skin.Near` [u].
        tangled: (V,) of `skin.Near`.
    """

    held: np.ndarray
    vertices: np.ndarray
    reference: np.ndarray
    placed: np.ndarray
    shift: np.ndarray
    tangled: np.ndarray


@array_kernel
def _shift_of_both(of: np.ndarray, a: int, b: int, c: int, d: int, is_edges: bool) -> float:
    """The greatest shift of a vertex of one feature plus the greatest of the other, from shifts `of` (V,) [u]."""
    if is_edges:
        return float(max(of[a], of[b]) + max(of[c], of[d]))
    return float(max(of[a], of[b], of[c]) + of[d])


@array_kernel
def _squared_way(organs: Any, i: int) -> float:
    """The squared distance of a vertex from its last position on its right side [u2]."""
    squared = 0.0
    for axis in range(3):
        placed = organs.placed[axis, i]
        way = (organs.vertices[i, axis] - placed) - (organs.held[i, axis] - placed)
        squared += way * way
    return squared


@array_kernel
def _way_of_both(organs: Any, a: int, b: int, c: int, d: int, is_edges: bool) -> float:
    """The greatest distance of `_squared_way` of a vertex of one feature plus the greatest of the other [u]."""
    of_a, of_b, of_c, of_d = (
        _squared_way(organs, a), _squared_way(organs, b), _squared_way(organs, c), _squared_way(organs, d),
    )  # fmt: skip
    if is_edges:
        return float(np.sqrt(max(of_a, of_b)) + np.sqrt(max(of_c, of_d)))
    return float(np.sqrt(max(of_a, of_b, of_c)) + np.sqrt(of_d))


@array_kernel
def _append_pairs(
    is_edges: bool,
    first_pair: int,
    end: int,
    of: Any,
    organs: Any,
    is_tangled: bool,
    mean_edge: float,
    friction: float,
    room: np.ndarray,
    table: Any,
    count: int,
) -> tuple[int, int]:
    """Append constraints of some pairs of features while there is room for them, and measure their unknown gaps.

    Args:
        is_edges: Whether they are pairs of edges, or of a vertex and a triangle.
        first_pair: Index of the first pair.
        end: Index after the last one.
        of: `_Pairs`.
        organs: `_Vertices`.
        is_tangled: Whether organs cross.
        mean_edge: As in `gather_organs` [u].
        friction: As in `gather_organs`.
        room: (10, 9) workspace, with zeros where nothing has been written yet.
        table: `ConstraintTable`.
        count: Number of constraints so far.

    Returns:
        The new number of constraints, and the index of the first pair that was left for want of room (`end` if none).
    """
    before, now, normal, place, corners = room[0], room[1], room[2], room[3], room[4:7, :3]
    separation, deepest, gaps, tangled = SEPARATION * mean_edge, DEEPEST * mean_edge, of.gaps, organs.tangled
    touching, pairs, edges, triangles = TOUCHING * separation, of.pairs, of.edges, of.triangles
    for m in range(first_pair, end):
        first, second = pairs[m, 0], pairs[m, 1]
        if is_edges:
            a, b, c, d = edges[first, 0], edges[first, 1], edges[second, 0], edges[second, 1]
        else:
            a, b, c, d = triangles[second, 0], triangles[second, 1], triangles[second, 2], first
        # Features that were farther apart than they have moved since do not touch.
        if _shift_of_both(organs.shift, a, b, c, d, is_edges) < of.distances[m] - touching:
            continue
        way = _way_of_both(organs, a, b, c, d, is_edges)
        if way < gaps[m] - touching:
            continue
        # The side of features that cross is unknown: it is left to the springs to pull them apart.
        if is_tangled and tangled[d] and (tangled[a] or tangled[b] or tangled[c]):
            continue
        _fill_sides(organs.held, a, b, c, d, is_edges, before)
        if gaps[m] < 0.0:
            gaps[m] = _gap(before, is_edges, corners)
            if way < gaps[m] - touching:
                continue
        _fill_sides(organs.vertices, a, b, c, d, is_edges, now)
        side = _side_held(before, now, is_edges, pairs[m, 2], touching, deepest, normal, place, room[7:10])
        if side == 0:
            continue
        name = constraint_name(ON_EDGES if is_edges else ON_TRIANGLE, 0, first, second)
        if _is_left_out(of.left_out, name):
            continue
        if count == table.names.shape[0]:
            return count, m
        # The fourth vertex is the end of the first edge, or the vertex that has come to the triangle.
        if is_edges:
            s, t = min(max(place[0], 0.0), 1.0), min(max(place[1], 0.0), 1.0)
            a, b, c, d = c, d, a, b
            weights = (1.0 - t, t, s - 1.0)
        else:
            weights = (place[0] + place[1] - 1.0, -place[0], -place[1])
        count = append_pair(
            table, count, (a, b, c, d), weights, (side * normal[0], side * normal[1], side * normal[2]), separation,
            organs.reference, friction, name | SIDE_BIT if side < 0 else name,
        )  # fmt: skip
    return count, end


@inline_kernel
def _gather_pairs(
    constraints: Any,
    count: int,
    skin: Any,
    near: Any,
    is_edges: bool,
    held: np.ndarray,
    vertices: np.ndarray,
    reference: np.ndarray,
    mean_edge: float,
    friction: float,
    room: np.ndarray,
) -> int:
    """Append the constraints of pairs of one kind (`is_edges`); arguments as in `gather_organs`."""
    # If even the closest pair was farther apart than any two vertices have moved since, no pair touches.
    nearest = near.spans[EDGE_SPAN if is_edges else VERTEX_SPAN] - TOUCHING * (SEPARATION * mean_edge)
    if 2.0 * near.spans[FARTHEST] < nearest:
        return count
    of = _Pairs(
        near.edge_pairs if is_edges else near.vertex_pairs,
        near.edge_distances if is_edges else near.vertex_distances,
        near.edge_gaps if is_edges else near.vertex_gaps,
        skin.edges, skin.triangles, skin.left_out,
    )  # fmt: skip
    organs = _Vertices(held, vertices, reference, near.placed, near.shift, near.tangled)
    done, end = 0, near.counts[EDGE_PAIRS if is_edges else VERTEX_PAIRS]
    while done < end:
        reserve(constraints, count, count + 1)
        count, done = _append_pairs(
            is_edges, done, end, of, organs, near.crossing[CROSSINGS] > 0, mean_edge, friction, room,
            constraints.table, count,
        )  # fmt: skip
    return count


@kernel(
    types.int64(
        CONSTRAINTS, types.int64, SKIN, NEAR, ARRAYS["f8_2"], ARRAYS["f8_2"], ARRAYS["f8_2"], ARRAYS["f8_2"],
        types.float64, types.float64, types.boolean,
    )
)  # fmt: skip
def gather_organs(
    constraints: Any,
    count: int,
    skin: Any,
    near: Any,
    held: np.ndarray,
    vertices: np.ndarray,
    thrown: np.ndarray,
    reference: np.ndarray,
    mean_edge: float,
    friction: float,
    afresh: bool,
) -> int:
    """Append constraints where organs have come near themselves or each other, making room for them.

    Args:
        constraints: `Constraints`.
        count: Number of constraints so far.
        skin: `Skin`.
        near: `Near`; its pairs are found anew if a vertex has got out of reach.
        held: (V, 3) last positions of the vertices on their right sides [u].
        vertices: (V, 3) their present positions [u].
        thrown: (V, 3) their positions without contact [u].
        reference: (V, 3) their positions at the last query, from which slip is measured for friction [u].
        mean_edge: Mean edge of the organ with the smallest mean edge [u].
        friction: Coefficient of friction between organs.
        afresh: Whether `held` has changed since the last call.

    Returns:
        The new count.
    """
    see_near(skin, near, held, vertices, thrown, mean_edge, afresh)
    if near.counts[IS_KNOWN] == TOO_MANY:
        # Nothing keeps the organ from crossing itself, so it is reported as crossing.
        near.crossing[CROSSINGS] = 1.0
        return count
    if near.counts[VERTEX_PAIRS] + near.counts[EDGE_PAIRS] == 0:
        return count
    if afresh:
        forget_gaps(near)
    room = near.room
    for kind in range(2):
        if near.counts[EDGE_PAIRS if kind == 1 else VERTEX_PAIRS] > 0:
            count = _gather_pairs(
                constraints, count, skin, near, kind == 1, held, vertices, reference, mean_edge, friction, room
            )
    return count


@inline_kernel
def prepare_pairs(
    skin: Any, near: Any, start: np.ndarray, thrown: np.ndarray, mean_edge: float, is_free: bool, known: int, warm: Any
) -> None:
    """Prepare the pairs for a step: find them if they are not known, and set the sides held in the last step.

    Args:
        skin: `Skin`.
        near: `Near`.
        start: (V, 3) vertices at the start of the step [u].
        thrown: (V, 3) positions at which the first query looks for contact [u].
        mean_edge: Mean edge of the organ with the smallest mean edge [u].
        is_free: Whether no node is held, so that organs may roll and slide as a whole.
        known: Number of constraints kept from the last step.
        warm: `ConstraintTable` of them.
    """
    if near.counts[IS_KNOWN] != 1:
        # If there were too many pairs before, there may be fewer now.
        find_near(skin, near, start, thrown, MARGIN * mean_edge, near.tangled)
        near.shift[:] = 0.0
        if near.counts[IS_KNOWN] != TOO_MANY:
            find_crossings(skin, near, start)
    elif is_free:
        follow_motion(near, start)
    remember_sides(near, known, warm)


@inline_kernel
def see_near(
    skin: Any, near: Any, held: np.ndarray, vertices: np.ndarray, thrown: np.ndarray, mean_edge: float, afresh: bool
) -> None:
    """Make sure that the near pairs are valid for vertices at `held` and at `vertices`, and measure their shifts.

    This does not check whether the surface has folded meanwhile; that is done after a solve, see `keep_uncrossed`.
    """
    if measure_shifts_again(near, held, vertices, afresh):
        return
    find_again(skin, near, held, vertices, thrown, mean_edge)
    measure_shifts(near, held, vertices)
    if near.counts[IS_KNOWN] == TOO_MANY:
        # The organ is thrown far; from where solves have put it its vertices need less reach.
        find_again(skin, near, held, vertices, vertices, mean_edge)
        measure_shifts(near, held, vertices)


@inline_kernel
def find_again(
    skin: Any, near: Any, reference: np.ndarray, vertices: np.ndarray, thrown: np.ndarray, mean_edge: float
) -> None:
    """Find the near pairs anew, keeping the known sides.

    Shifts must have been measured before, and must be measured again afterwards.
    """
    names, sides = _known_sides(near)
    farthest, beyond = vertices.copy(), np.empty(vertices.shape[0], np.bool_)
    mark_beyond(near, reference, vertices, beyond)
    mark_turned(skin, near, vertices, beyond)
    for i in range(vertices.shape[0]):
        here, there = 0.0, 0.0
        for axis in range(3):
            here += (vertices[i, axis] - reference[i, axis]) ** 2
            there += (thrown[i, axis] - reference[i, axis]) ** 2
        if there > here:
            for axis in range(3):
                farthest[i, axis] = thrown[i, axis]
    find_near(skin, near, reference, farthest, MARGIN * mean_edge, beyond)
    _tell_sides(near, names, sides, names.shape[0])


@inline_kernel
def keep_uncrossed(
    skin: Any,
    near: Any,
    inverse_mass: np.ndarray,
    known: int,
    solved: Any,
    held: np.ndarray,
    vertices: np.ndarray,
    mean_edge: float,
) -> bool:
    """Hold vertices back so that no organ crosses itself or another; see `tangles.hold_back`.

    Args:
        skin: `Skin`.
        near: `Near`; its pairs are found anew if a vertex has got out of reach or the surface has folded.
        inverse_mass: (V,) [1/kg].
        known: Number of constraints that pushed in the last solve.
        solved: `ConstraintTable` of them.
        held: (V, 3) last positions of the vertices on their right sides [u].
        vertices: (V, 3) their present positions; changed [u].
        mean_edge: Mean edge of the organ with the smallest mean edge [u].

    Returns:
        Whether any vertex has been held back.
    """
    see_near(skin, near, held, vertices, vertices, mean_edge, True)
    # The next caller may pass another `held`.
    near.counts[HELD_IS_KNOWN] = 0
    if near.counts[IS_KNOWN] != 1 or has_turned(skin, near, vertices):
        find_again(skin, near, held, vertices, vertices, mean_edge)
        measure_shifts(near, held, vertices)
    if near.counts[IS_KNOWN] == TOO_MANY:
        # Nothing keeps the organ from crossing itself, so it is reported as crossing.
        near.crossing[CROSSINGS] = 1.0
        return False
    pushed = np.zeros(vertices.shape[0], np.bool_)
    for c in range(known):
        if solved.features[c, OWNER] >= 0:
            for corner in range(3):
                pushed[solved.features[c, corner]] = True
    return bool(hold_back(skin, near, inverse_mass, pushed, held, vertices))


@inline_kernel
def _known_sides(near: Any) -> tuple[np.ndarray, np.ndarray]:
    """Names, without sides, of the pairs whose sides are known, and those sides."""
    total = near.counts[VERTEX_PAIRS] + near.counts[EDGE_PAIRS] if near.counts[IS_KNOWN] else 0
    names, sides, known = np.empty(total, np.int64), np.empty(total, np.int32), 0
    for kind in range(2):
        pairs = near.vertex_pairs if kind == 0 else near.edge_pairs
        for m in range(near.counts[VERTEX_PAIRS if kind == 0 else EDGE_PAIRS] if total > 0 else 0):
            if pairs[m, 2] != 0:
                names[known] = constraint_name(ON_TRIANGLE if kind == 0 else ON_EDGES, 0, pairs[m, 0], pairs[m, 1])
                sides[known] = pairs[m, 2]
                known += 1
    return names[:known], sides[:known]


@array_kernel
def _place_of(name: int, size: int) -> int:
    """Place of a name in a hash table whose size is a power of two.

    Multiplicative hashing, which puts names that differ a little far apart (Knuth, vol. 3, section 6.4).
    """
    return ((name * SPREAD) >> 40) & (size - 1)


@inline_kernel
def _tell_sides(near: Any, names: np.ndarray, sides: np.ndarray, known: int) -> None:
    """Set the sides of the pairs with `known` names (.,) to `sides` (.,)."""
    if known == 0:
        return
    # There are many pairs, and few known names: in a hash table that is at most half full most look-ups end at once.
    size = 2
    while size < 2 * known:
        size *= 2
    table = np.full(size, -1)
    for k in range(known):
        place = _place_of(names[k], size)
        while table[place] >= 0:
            place = (place + 1) & (size - 1)
        table[place] = k
    for kind in range(2):
        pairs = near.vertex_pairs if kind == 0 else near.edge_pairs
        for m in range(near.counts[VERTEX_PAIRS if kind == 0 else EDGE_PAIRS]):
            name = constraint_name(ON_TRIANGLE if kind == 0 else ON_EDGES, 0, pairs[m, 0], pairs[m, 1])
            place = _place_of(name, size)
            while table[place] >= 0:
                if names[table[place]] == name:
                    pairs[m, 2] = sides[table[place]]
                    break
                place = (place + 1) & (size - 1)


@inline_kernel
def remember_sides(near: Any, known: int, warm: Any) -> None:
    """Set the sides on which pairs were held in the last solve, from its constraints that pushed.

    Args:
        near: `Near`, written.
        known: Number of constraints kept from that solve.
        warm: `ConstraintTable` of them.
    """
    vertex_pairs, edge_pairs = near.vertex_pairs, near.edge_pairs
    for m in range(near.counts[VERTEX_PAIRS]):
        vertex_pairs[m, 2] = 0
    for m in range(near.counts[EDGE_PAIRS]):
        edge_pairs[m, 2] = 0
    held = 0
    while held < known and warm.features[held, OWNER] == ORGANS:
        held += 1
    if held == 0:
        return
    names, sides = np.empty(held, np.int64), np.empty(held, np.int32)
    for e in range(held):
        inner = warm.names[e] & SIDE_BIT
        names[e] = warm.names[e] - inner
        sides[e] = -1 if inner else 1
    _tell_sides(near, names, sides, held)


@kernel(ARRAYS["i8"](SKIN, NEAR, ARRAYS["f8_2"], types.float64))
def touching_pairs(skin: Any, near: Any, vertices: np.ndarray, mean_edge: float) -> np.ndarray:
    """Names, without a side, of the pairs within one organ that touch where the vertices (V, 3) are; sorted."""
    find_near(skin, near, vertices, vertices, MARGIN * mean_edge, near.tangled)
    constraints = make_constraints(64)
    count = gather_organs(constraints, 0, skin, near, vertices, vertices, vertices, vertices, mean_edge, 0.0, True)
    names, touching = np.empty(count, np.int64), 0
    table = constraints.table
    for c in range(count):
        features = table.features[c]
        if skin.organs[features[0]] == skin.organs[features[FOURTH]]:
            names[touching] = table.names[c] & ~SIDE_BIT
            touching += 1
    return np.sort(names[:touching])


@kernel(types.void(SKIN, ARRAYS["i8"]))
def leave_out(skin: Any, names: np.ndarray) -> None:
    """Exclude pairs of features from contact, given their sorted names without a side."""
    skin.left_out = names
