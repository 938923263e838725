"""Crossings of organs with themselves or each other: find edges that go through triangles, and prevent new ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from spatula_env._kernels import ARRAYS, array_kernel, inline_kernel, kernel
from spatula_env.contact.motion import copy_points
from spatula_env.contact.near import find_cross_pairs, follow_motion, has_turned, measure_shifts
from spatula_env.contact.skin import ASKED_FOR, CROSS_IS_KNOWN, CROSS_PAIRS, CROSSINGS, NEAR, SKIN

MOST_ATTEMPTS = 12
"""Most attempts to resolve crossings. In all but the last, impact zones move as a whole and may grow; in the last one,
all vertices go back to where they were."""


@array_kernel
def crosses(points: np.ndarray, p: int, q: int, a: int, b: int, c: int) -> float:
    """Where an edge from p to q goes through a triangle, as a fraction of its length; negative if it does not."""
    ax, ay, az = points[a, 0], points[a, 1], points[a, 2]
    ux, uy, uz = points[b, 0] - ax, points[b, 1] - ay, points[b, 2] - az
    vx, vy, vz = points[c, 0] - ax, points[c, 1] - ay, points[c, 2] - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    px, py, pz = points[p, 0] - ax, points[p, 1] - ay, points[p, 2] - az
    qx, qy, qz = points[q, 0] - ax, points[q, 1] - ay, points[q, 2] - az
    first, second = nx * px + ny * py + nz * pz, nx * qx + ny * qy + nz * qz
    if (first > 0.0) == (second > 0.0) or first == second:
        return -1.0
    fraction = first / (first - second)
    x, y, z = px + fraction * (qx - px), py + fraction * (qy - py), pz + fraction * (qz - pz)
    squared = nx * nx + ny * ny + nz * nz
    # Barycentric weights, times the squared normal.
    wb = nx * (y * vz - z * vy) + ny * (z * vx - x * vz) + nz * (x * vy - y * vx)
    wc = nx * (uy * z - uz * y) + ny * (uz * x - ux * z) + nz * (ux * y - uy * x)
    if wb < 0.0 or wc < 0.0 or wb + wc > squared:
        return -1.0
    return float(fraction)


@array_kernel
def _root(parents: np.ndarray, vertex: int) -> int:
    """The root of a vertex's zone in the union-find forest `parents`."""
    while parents[vertex] != vertex:
        parents[vertex] = parents[parents[vertex]]
        vertex = parents[vertex]
    return vertex


@inline_kernel
def join_crossing(skin: Any, near: Any, points: np.ndarray, parents: np.ndarray, involved: np.ndarray) -> int:
    """Join the vertices of edges and triangles that cross each other into zones.

    Args:
        skin: `Skin`.
        near: `Near`, with the shifts of these vertices.
        points: (V, 3) vertices, within reach and no farther from `Near.placed` than their shifts [u].
        parents: (V,) union-find forest of the zones: a vertex of the same zone for each vertex, itself at the root;
            changed.
        involved: (V,) whether a vertex belongs to features that cross; entries are set.

    Returns:
        The number of pairs of an edge and a triangle that cross.
    """
    if near.counts[CROSS_IS_KNOWN] == 0:
        find_cross_pairs(skin, near)
    near.counts[CROSS_IS_KNOWN] = ASKED_FOR
    pairs, edges, triangles = near.cross_pairs, skin.edges, skin.triangles
    distances, shift = near.cross_distances, near.shift
    count = 0
    for m in range(near.counts[CROSS_PAIRS]):
        e, t = pairs[m, 0], pairs[m, 1]
        p, q, a, b, c = edges[e, 0], edges[e, 1], triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if max(shift[p], shift[q]) + max(shift[a], shift[b], shift[c]) < distances[m]:
            continue
        if crosses(points, p, q, a, b, c) >= 0.0:
            count += 1
            first = _root(parents, p)
            for vertex in (p, q, a, b, c):
                involved[vertex] = True
                other = _root(parents, vertex)
                parents[max(first, other)] = min(first, other)
                first = min(first, other)
    return count


@inline_kernel
def _move_zones(
    parents: np.ndarray,
    involved: np.ndarray,
    pushed: np.ndarray,
    inverse_mass: np.ndarray,
    start: np.ndarray,
    goal: np.ndarray,
    points: np.ndarray,
) -> None:
    """Translate each zone by the mass-weighted mean displacement of its pushed vertices, or of all if none is pushed.

    A zone that holds a fixed vertex stays where it was.
    """
    count = points.shape[0]
    ways, weights, holds = np.zeros((count, 3)), np.zeros((count, 2)), np.zeros(count, np.bool_)
    for i in range(count):
        if involved[i]:
            root = _root(parents, i)
            holds[root] |= inverse_mass[i] == 0.0
            weights[root, 0] += pushed[i]
    for i in range(count):
        if involved[i]:
            root = _root(parents, i)
            if holds[root] or (weights[root, 0] > 0.0 and not pushed[i]):
                continue
            mass = 1.0 / inverse_mass[i]
            weights[root, 1] += mass
            for axis in range(3):
                ways[root, axis] += mass * (goal[i, axis] - start[i, axis])
    for i in range(count):
        if involved[i]:
            root = _root(parents, i)
            scale = 1.0 / weights[root, 1] if weights[root, 1] > 0.0 else 0.0
            for axis in range(3):
                points[i, axis] = start[i, axis] + scale * ways[root, axis]


@inline_kernel
def _note_crossings(near: Any, crossings: int, involved: np.ndarray) -> None:
    """Write into `near` the number of crossings, and which vertices (V,) are involved in them."""
    near.crossing[CROSSINGS] = crossings
    for i in range(involved.shape[0]):
        near.tangled[i] = involved[i]


@kernel(types.boolean(SKIN, NEAR, ARRAYS["f8_2"], types.boolean))
def place(skin: Any, near: Any, points: np.ndarray, is_free: bool) -> bool:
    """Find what crosses after vertices have been put somewhere, if the known near pairs are still valid there.

    Args:
        skin: `Skin`.
        near: `Near`, written.
        points: (V, 3) positions of the vertices [u].
        is_free: Whether no node is held, so that organs may have moved as a whole.

    Returns:
        Whether all vertices are within their reach and the surface has not folded since the pairs were found. If not,
        crossings are not looked for.
    """
    if is_free:
        follow_motion(near, points)
    if not measure_shifts(near, points, points) or has_turned(skin, near, points):
        return False
    find_crossings(skin, near, points)
    return True


@inline_kernel
def find_crossings(skin: Any, near: Any, points: np.ndarray) -> None:
    """Find the crossings of organs that have just been put somewhere, with vertices (V, 3) within reach [u]."""
    count = points.shape[0]
    involved = np.zeros(count, np.bool_)
    crossings = join_crossing(skin, near, points, np.arange(count), involved)
    _note_crossings(near, crossings, involved)


@kernel(types.boolean(SKIN, NEAR, ARRAYS["f8"], ARRAYS["b1"], ARRAYS["f8_2"], ARRAYS["f8_2"]))
def hold_back(
    skin: Any, near: Any, inverse_mass: np.ndarray, pushed: np.ndarray, start: np.ndarray, points: np.ndarray
) -> bool:
    """Prevent organs from crossing themselves or each other.

    A solve that has not converged, or whose constraints contradict each other, may leave surfaces crossed. At the
    positions that they came from they did not cross, so the vertices that cross are moved from there together, as a
    rigid impact zone (Provot, Graphics Interface 1997; Bridson et al., ACM Transactions on Graphics 21(3), 2002,
    section 7.5). A zone follows those of its vertices that a tool pushes. If zones keep meeting others, all vertices
    stay where they were. Only positions are changed, not momentum.

    Args:
        skin: `Skin`.
        near: `Near`; all vertices must be within reach at `start` and at `points`. The number of crossings that remain
            is written into it: none, unless organs crossed at the start already. In that case nothing is moved.
        inverse_mass: (V,) [1/kg].
        pushed: (V,) vertices that a tool has pushed.
        start: (V, 3) positions at which nothing crosses [u].
        points: (V, 3) present positions of the vertices; changed [u].

    Returns:
        Whether anything was changed.
    """
    count = points.shape[0]
    parents, involved = np.arange(count), np.zeros(count, np.bool_)
    crossings = join_crossing(skin, near, points, parents, involved)
    # Organs that crossed already were put so: there are no positions without crossings to go back to.
    if crossings == 0 or near.crossing[CROSSINGS] > 0:
        _note_crossings(near, crossings, involved)
        return False
    goal = points.copy()
    for attempt in range(MOST_ATTEMPTS):
        if attempt < MOST_ATTEMPTS - 1:
            _move_zones(parents, involved, pushed, inverse_mass, start, goal, points)
        # A zone may take a vertex out of its reach; then, as in the last attempt, all vertices go back.
        if attempt == MOST_ATTEMPTS - 1 or not measure_shifts(near, points, points):
            copy_points(start, points)
        measure_shifts(near, start, points)
        crossings = join_crossing(skin, near, points, parents, involved)
        if crossings == 0:
            break
    involved[:] = False
    _note_crossings(near, join_crossing(skin, near, points, parents, involved) if crossings > 0 else 0, involved)
    return True
