"""Holes of a surface, filled with triangles of the least total area.

The triangulation is that of G. Barequet and M. Sharir, Filling gaps in the boundary of a polyhedron, Computer Aided
Geometric Design 12(2), 1995.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.anatomy.topology import Surface, boundary_loops

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray, IntArray

MOST_CORNERS = 400
"""Longest border of a hole that is filled: the work grows with the cube of it."""


@dataclass(frozen=True)
class Hole:
    """A hole in a surface.

    Attributes:
        width: Diagonal of the bounding box of its border [m].
        place: Middle of its border [m].
        edges: Edges of its border.
    """

    width: float
    place: tuple[float, float, float]
    edges: int


def fill_holes(surface: Surface, widest: float) -> tuple[Surface, list[Hole], list[Hole]]:
    """Fill the holes that are not too wide.

    Args:
        surface: Wound consistently, no edge in more than two triangles.
        widest: Greatest width of a hole that is filled [m].

    Returns:
        The surface, the holes that were filled, and those that are left.
    """
    filled, left, added = [], [], [surface.triangles]
    for loop in boundary_loops(surface):
        border = surface.vertices[loop]
        middle = border.mean(axis=0).tolist()
        hole = Hole(float(np.linalg.norm(np.ptp(border, axis=0))), (middle[0], middle[1], middle[2]), len(loop))
        simple = 3 <= len(loop) <= MOST_CORNERS and len(np.unique(loop)) == len(loop)
        if simple and hole.width <= widest:
            added.append(loop[_smallest_cover(border)])
            filled.append(hole)
        else:
            left.append(hole)
    return Surface(surface.vertices, np.concatenate(added)), filled, left


def _smallest_cover(border: FloatArray) -> IntArray:
    """(n - 2, 3) triangles of a closed polygon (n, 3) whose areas have the least sum, as indices along it."""
    count = len(border)
    cost = np.zeros((count, count))
    choice = np.zeros((count, count), dtype=np.int64)
    for span in range(2, count):
        for first in range(count - span):
            last = first + span
            between = np.arange(first + 1, last)
            areas = np.linalg.norm(np.cross(border[between] - border[first], border[last] - border[first]), axis=1)
            totals = cost[first, between] + cost[between, last] + areas
            best = int(np.argmin(totals))
            cost[first, last], choice[first, last] = totals[best], between[best]
    triangles, open_spans = [], [(0, count - 1)]
    while open_spans:
        first, last = open_spans.pop()
        if last - first < 2:
            continue
        middle = int(choice[first, last])
        triangles.append((first, middle, last))
        open_spans += [(first, middle), (middle, last)]
    return np.array(triangles, dtype=np.int64)
