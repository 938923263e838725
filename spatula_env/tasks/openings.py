"""Fissures of an organ of any shape: whether an upright blade gets in, and what of the floor is seen.

Lengths are in metres, points in the workspace frame. The fissure runs along x.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spatula_env.contact.raycast import cast_ray
from spatula_env.contact.structures import NO_HIT
from spatula_env.geometry.overlap import overlaps
from spatula_env.geometry.rotations import turn

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray
    from spatula_env.tasks.situation import Setting

RISE = 0.004
"""Distance of the heights at which the blade is looked at on its way down, and at which walls are looked for [m]."""

FARTHEST_WALL = 0.02
"""Distance from the middle of a fissure at which a wall is no wall of it any more [m]."""

GREATEST_OPENING = 0.013
"""Greatest distance by which a wall may have to be moved aside, a little more than in the preset fissure [m]."""

HELD_ROOM = 1.5
"""Least distance of a wall from nodes that are held, by the distance that it has to be moved."""


def lowest_free_edge(setting: Setting, point: FloatArray) -> float:
    """How deep the first tool gets into a fissure, straight down from above the organ.

    Args:
        setting: The setting.
        point: (3,) where the middle of its lower edge is wanted.

    Returns:
        The least height of the edge above the point from which on the tool overlaps nothing, 0 if it gets there.
    """
    tool = setting.tools[0]
    corners = turn(tool.orientation, tool.vertices)
    under, top = float(corners[:, 2].min()), float(setting.rest_nodes[:, 2].max()) - point[2]
    heights = np.append(np.arange(0.0, top, RISE), max(top, 0.0))
    free = float(heights[-1])
    for height in heights[::-1]:
        at = point + np.array([0.0, 0.0, height - under])
        if overlaps(setting.rest_nodes, setting.triangles, corners + at, tool.triangles):
            break
        free = float(height)
    return free


def walls_beside(setting: Setting, point: FloatArray, side: float) -> FloatArray:
    """Where a wall of a fissure is.

    Args:
        setting: The setting.
        point: (3,) in the fissure, above its floor.
        side: 1 for the wall towards positive y, -1 for the other.

    Returns:
        (K, 2) heights above the point, ascending, and distances of the wall there, up to its lip.
    """
    nodes, triangles = setting.rest_nodes, np.array(setting.triangles)
    direction = np.array([0.0, side, 0.0])
    found = []
    for height in np.arange(0.0, float(nodes[:, 2].max()) - point[2], RISE):
        hit, distance, _, _, facing = cast_ray(point + np.array([0.0, 0.0, height]), direction, nodes, triangles)
        if hit == NO_HIT or facing > 0.0 or distance > FARTHEST_WALL:
            break
        found.append((float(height), float(distance)))
    return np.array(found).reshape(-1, 2)


def opening_needed(walls: FloatArray, view: float, thickness: float) -> FloatArray:
    """How far a wall has to be moved aside, so that a point is seen past a blade that leans against it.

    Args:
        walls: (K, 2) heights above the point and distances, from `walls_beside`.
        view: Angle between the line of sight and the vertical [rad].
        thickness: Thickness of the blade.

    Returns:
        (K,) distances at each of the heights.
    """
    return np.asarray(np.maximum(walls[:, 0] * np.tan(view) + thickness - walls[:, 1], 0.0))
