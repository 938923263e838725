"""How far a surface has come from another one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spatula_env.anatomy.remeshing import NearestSurface
from spatula_env.anatomy.topology import edge_lengths

if TYPE_CHECKING:
    from spatula_env.anatomy.topology import Surface

MOST_POINTS = 20_000
"""Most points of a surface whose distances are measured."""


def greatest_distance(first: Surface, second: Surface, *, both: bool = True) -> float:
    """Greatest distance of a point of either surface from the other one, looked at in steps of an edge [m].

    Args:
        first: One of them; the steps are its median edges.
        second: The other.
        both: Whether points of either are looked at, not of the first alone.
    """
    length = float(np.median(edge_lengths(first.vertices, first.triangles)))
    one, other = NearestSurface(first, length), NearestSurface(second, length)
    greatest = 0.0
    for points, surface in ((one.middles, other), (other.middles, one))[: 1 + both]:
        chosen = points[:: -(-len(points) // MOST_POINTS)]
        distances = np.linalg.norm(surface.nearest(chosen) - chosen, axis=1)
        greatest = max(greatest, float(distances.max()))
    return greatest
