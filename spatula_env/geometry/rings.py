"""Surfaces lofted through rings: horizontal closed curves, stacked along a profile and joined by triangles.

A ring is a superellipse |x / a|^p + |y / b|^p = 1. With p = 3 it is a rounded rectangle, or, where b is much less than
a, a slit with nearly parallel sides. Rings are placed evenly along the profile, nodes are spread along each of them as
a row, and the strip between two rows is filled with triangles. The number of nodes on a ring follows its length, so the
triangles keep their size and shape where the rings shrink or grow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import FloatArray, Int32Array
from spatula_env.geometry.surface import canonical_order

ROUNDNESS = 3.0
"""Exponent p of the superellipses. A slit keeps four fifths of its width over four fifths of its length."""

ANGLES = 721
"""Number of points that represent half a ring when it is measured: odd, so that one is at the middle."""

NARROWEST, WIDEST = 0.6, 1.6
"""Limits of the distance of nodes along a ring, relative to its mean, where neighbouring rings are closer or farther
away."""

LEAST_EDGES = 2
"""Edges on half a ring: with one, the two halves would be the same edge."""

MOST_NODES = 100_000
"""Greatest number of nodes: more are refused, as the edge length is then probably mistaken."""

TIE = 1e-9
"""Two diagonals whose lengths differ by less than this part count as equal, so that the choice between them is the same
on every machine."""


@dataclass(frozen=True)
class Loft:
    """A closed surface through rings.

    Attributes:
        vertices: Positions of the nodes, shape (V, 3) [u], row by row.
        triangles: Node indices, shape (T, 3), wound outwards.
        profile_index: Fractional index of the point of the profile that each node's row goes through, shape (V,).
    """

    vertices: FloatArray
    triangles: Int32Array
    profile_index: FloatArray


def loft(profile: FloatArray, edge_lengths: FloatArray, creases: tuple[int, ...] = ()) -> Loft:
    """Join rings along a profile into a closed surface.

    The profile begins and ends with a ring of zero width, a line. It leads from the line in a hollow or on a crest
    outwards, over the top, down to the base, and inwards to the line in the middle of the base. Drawn with the half
    width to the right and z upwards, the outside of the surface is on the left of the profile. The surface is its own
    mirror image in the plane y = 0.

    Args:
        profile: Half length a, half width b and height z of rings, shape (m, 3) [u]; enough of them for a smooth
            profile. The half width is zero at both ends and only there.
        edge_lengths: Target length of the edges at each of these points, shape (m,) [u].
        creases: Indices of points of the profile that a row of nodes must go through, ascending.

    Returns:
        The surface, its nodes in rows along the profile, each row counter-clockwise from the positive x axis.

    Raises:
        ValueError: If there would be very many nodes.
    """
    unit = _unit_half_ring()
    distance, spread = _measure(profile, unit, edge_lengths)
    if distance[-1] > MOST_NODES:
        raise ValueError(f"edge_length must not make more than {MOST_NODES} nodes, this makes as many rows of them")
    rows = _place_rows(distance, (0, *creases, len(profile) - 1))
    middles = 0.5 * (distance[1:] + distance[:-1])
    halves: list[FloatArray] = []
    count = 0
    for row in rows.tolist():
        half_length, half_width, height = (float(np.interp(row, distance, column)) for column in profile.T)
        wanted = np.interp(row, distance, edge_lengths) * spread[np.abs(middles - row).argmin()]
        ring = np.column_stack([half_length * unit[:, 0], half_width * unit[:, 1], np.full(ANGLES, height)])
        halves.append(_spread_nodes(ring, wanted, len(halves[-1]) - 1 if halves else 0))
        count += 2 * len(halves[-1])
        if count > MOST_NODES:
            raise ValueError(f"edge_length must not make more than {MOST_NODES} nodes, this makes {count} and more")
    vertices, upper, lower = _mirror(halves)
    triangles: list[tuple[int, int, int]] = []
    for row, (inner, outer) in enumerate(pairwise(halves)):
        for i, j, on_inner in _zip_strip(inner, outer):
            end = (row, i + 1) if on_inner else (row + 1, j + 1)
            # The lower half is a mirror image, so its triangles run the other way around.
            triangles.append((upper[row][i], upper[row + 1][j], upper[end[0]][end[1]]))
            triangles.append((lower[row][i], lower[end[0]][end[1]], lower[row + 1][j]))
    index = np.interp(rows, distance, np.arange(len(profile)))
    sizes = [2 * len(half) - 2 for half in halves]
    sizes[0], sizes[-1] = len(halves[0]), len(halves[-1])
    return Loft(vertices, canonical_order(np.array(triangles)), np.repeat(index, sizes))


def _unit_half_ring() -> FloatArray:
    """Points of the ring of half length and half width 1, from the positive to the negative x axis, (ANGLES, 2)."""
    angle = np.linspace(0.0, np.pi, ANGLES)
    x, y = np.cos(angle), np.sin(angle)
    x[ANGLES // 2] = y[-1] = 0.0
    radius = (np.abs(x) ** ROUNDNESS + y**ROUNDNESS) ** (-1.0 / ROUNDNESS)
    return np.column_stack([x * radius, y * radius])


def _measure(profile: FloatArray, unit: FloatArray, edge_lengths: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances of rings: along the profile, counted in rows (m,), and around each, relative to its mean (m - 1, n)."""
    rings = np.empty((len(profile), len(unit), 3))
    rings[:, :, :2] = profile[:, None, :2] * unit
    rings[:, :, 2] = profile[:, 2:]
    along = np.diff(rings, axis=1)
    length = np.linalg.norm(along, axis=2)
    tangent = along / np.maximum(length, np.finfo(np.float64).tiny)[:, :, None]
    across = np.diff(rings, axis=0)
    # Taken at the middles of the rings' segments, between neighbouring rings; only the part perpendicular to the rings
    # counts.
    tangent = 0.5 * (tangent[1:] + tangent[:-1])
    length = 0.5 * (length[1:] + length[:-1])
    across = 0.5 * (across[:, 1:] + across[:, :-1])
    across -= np.einsum("ijk,ijk->ij", across, tangent)[:, :, None] * tangent
    gap = np.linalg.norm(across, axis=2)
    mean = (gap * length).sum(axis=1) / length.sum(axis=1)
    # Rows of equilateral triangles are closer together than their nodes.
    rows = mean / (0.5 * math.sqrt(3.0) * 0.5 * (edge_lengths[1:] + edge_lengths[:-1]))
    return np.concatenate([[0.0], np.cumsum(rows)]), gap / mean[:, None]


def _place_rows(distance: FloatArray, stops: tuple[int, ...]) -> FloatArray:
    """Positions of the rows, in the unit of the distances (m,): at all stops, and evenly spaced between them."""
    rows = [0.0]
    for start, end in pairwise(distance[list(stops)].tolist()):
        rows += np.linspace(start, end, max(1, round(end - start)) + 1)[1:].tolist()
    return np.array(rows)


def _spread_nodes(ring: FloatArray, wanted: FloatArray, before: int) -> FloatArray:
    """Spread nodes on half a ring (n, 3), at the target distances ``wanted`` (n - 1,) along its segments.

    Two neighbouring rings with the same number of nodes would have them side by side, with right-angled triangles in
    between. So if the number of edges would equal that of the last ring, ``before``, there is one more or one less,
    which shifts the nodes against each other.
    """
    local = wanted.clip(NARROWEST * wanted.mean(), WIDEST * wanted.mean())
    position = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1) / local)])
    total = float(position[-1])
    edges = max(LEAST_EDGES, round(total))
    if edges == before:
        edges += 1 if total > edges or edges == LEAST_EDGES else -1
    at = np.linspace(0.0, total, edges + 1)
    nodes = np.column_stack([np.interp(at, position, column) for column in ring.T])
    nodes[[0, -1], 1] = 0.0
    return nodes


def _mirror(halves: list[FloatArray]) -> tuple[FloatArray, list[NDArray[np.int64]], list[NDArray[np.int64]]]:
    """Complete the half rings: all nodes (V, 3), and the indices of each row's upper half and of its mirror image."""
    parts: list[FloatArray] = []
    upper: list[NDArray[np.int64]] = []
    lower: list[NDArray[np.int64]] = []
    start = 0
    for row, half in enumerate(halves):
        edges = len(half) - 1
        index = np.arange(edges + 1)
        parts.append(half)
        upper.append(start + index)
        if row in (0, len(halves) - 1):
            # A line is its own mirror image.
            lower.append(start + index)
            start += edges + 1
        else:
            parts.append(half[-2:0:-1] * [1.0, -1.0, 1.0])
            lower.append(start + (2 * edges - index) % (2 * edges))
            start += 2 * edges
    return np.concatenate(parts), upper, lower


def _zip_strip(inner: FloatArray, outer: FloatArray) -> list[tuple[int, int, bool]]:
    """Divide the strip between two half rows (n, 3) and (k, 3) into triangles, by the shorter diagonal where allowed.

    The ends of a row are in the plane y = 0, and so are all nodes of a line. A diagonal between two such nodes would be
    in that plane, too. It would coincide with its mirror image and be an edge of four triangles. Where the walls of a
    fissure are nearly in that plane, such a diagonal can be the shorter one, but it is never used. There always is an
    alternative, as a half row that is not a line has an interior node.

    Returns:
        For each triangle the node of the inner row and the node of the outer row that it begins with, and whether its
        third corner is the inner row's next node or the outer row's.
    """
    first, second = inner.tolist(), outer.tolist()
    last = (len(first) - 1, len(second) - 1)

    def may_join(i: int, j: int) -> bool:
        if i > last[0] or j > last[1]:
            return False
        return (i, j) == last or first[i][1] != 0.0 or second[j][1] != 0.0

    strip: list[tuple[int, int, bool]] = []
    i = j = 0
    while (i, j) != last:
        on_inner = may_join(i + 1, j)
        if on_inner and may_join(i, j + 1):
            forward = math.dist(first[i + 1], second[j])
            on_inner = forward <= math.dist(first[i], second[j + 1]) * (1.0 + TIE)
        strip.append((i, j, on_inner))
        if on_inner:
            i += 1
        else:
            j += 1
    return strip
