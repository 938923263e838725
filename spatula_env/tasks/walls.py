"""Walls of an organ of any shape that an upright blade gets beside, and can push.

Lengths are in metres, points in the workspace frame.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry.overlap import overlaps
from spatula_env.geometry.rotations import from_rotation_vector, multiply, turn
from spatula_env.tasks.places import CANDIDATES, MARGIN, Spots
from spatula_env.tasks.surface import average_normals, surface_samples

if TYPE_CHECKING:
    from spatula_env.arrays import BoolArray, FloatArray
    from spatula_env.tasks.situation import Setting

STEEP = 0.4
"""Greatest vertical component of the normal of a wall, up or down."""

ROOMS = (0.005, 0.003, 0.0015)
"""Distances from a wall at which a blade goes down beside it; the first is taken with which it is free [m]."""

RISE = 0.004
"""Distance of the heights at which the blade is looked at on its way down [m]."""

ABOVE_STOP = 0.016
"""Least height of the blade's lower edge above the ground, or above the organ's lowest node without ground [m]."""

FROM_HELD = 0.012
"""Least distance of a wall from nodes that are held [m]."""


@dataclass(frozen=True, eq=False)
class Walls:
    """Walls that a blade can push.

    Attributes:
        spots: The K points that are pushed.
        outwards: (K, 2) horizontal unit normals on the organ as it is in the setting.
        rooms: (K,) distance from the wall at which the blade goes down [m].
    """

    spots: Spots
    outwards: FloatArray
    rooms: FloatArray


def upright_blade(outwards: FloatArray, orientation: FloatArray) -> FloatArray:
    """Turn a blade about the vertical from where it faces along x to where it faces along horizontal directions.

    Args:
        outwards: (..., 2) unit vectors.
        orientation: (4,) of the blade that faces along x, quaternion xyzw.

    Returns:
        (..., 4) orientations.
    """
    vector = np.zeros((*np.shape(outwards)[:-1], 3))
    vector[..., 2] = np.arctan2(outwards[..., 1], outwards[..., 0])
    turned = from_rotation_vector(vector)
    return multiply(turned, np.broadcast_to(orientation, turned.shape))


def find_walls(setting: Setting, radius: float, edge_depth: float) -> tuple[Walls, str]:
    """Find the walls that the first tool, an upright blade, can push.

    It comes straight down beside the wall from above the organ, without meeting it, until its lower edge is below the
    point that is pushed.

    Args:
        setting: The setting; nodes that its organ names as `held` do not move.
        radius: Distance around a point over which the normal is averaged [m].
        edge_depth: How far below the point the lower edge gets [m].

    Returns:
        The walls, and a sentence on how many points were tried and why most of them are no walls.
    """
    nodes, triangles, tool = setting.rest_nodes, setting.triangles, setting.tools[0]
    chosen, weights = surface_samples(nodes, triangles, CANDIDATES)
    spots = Spots(triangles[chosen].astype(np.int64), weights)
    points = spots.on(nodes)
    normals = average_normals(nodes, triangles, points, radius)
    held = nodes[list(getattr(setting.organ, "held", ()))]
    corners = turn(tool.orientation, tool.vertices)
    low_edge, half_thickness = float(corners[:, 2].min()), float(corners[:, 0].max())
    floor = max(setting.ground_height, float(nodes[:, 2].min())) + ABOVE_STOP
    level = np.maximum(np.hypot(normals[:, 0], normals[:, 1]), 1e-9)
    outwards = normals[:, :2] / level[:, None]
    rooms, reasons = np.zeros(len(points)), []
    for row, point in enumerate(points):
        beside = point[:2] + outwards[row] * (ROOMS[0] + half_thickness)
        grip = np.array([*beside, point[2] - edge_depth - low_edge])
        if abs(normals[row, 2]) > STEEP:
            reasons.append("are no steep walls")
        elif (grip < setting.workspace_low + MARGIN).any() or (grip > setting.workspace_high - MARGIN).any():
            reasons.append("are not within the workspace")
        elif point[2] - edge_depth < floor:
            reasons.append("are too low")
        elif len(held) and ((held - point) ** 2).sum(axis=1).min() < FROM_HELD**2:
            reasons.append("are held")
        else:
            rooms[row] = _room(setting, point, outwards[row], edge_depth)
            reasons.append("" if rooms[row] > 0.0 else "have no room beside them")
    kept: BoolArray = np.array([not reason for reason in reasons], dtype=np.bool_)
    counts = Counter(reason for reason in reasons if reason).most_common()
    told = (
        f"organ {getattr(setting.organ, 'name', '')!r} has {int(kept.sum())} places that a blade can push from the "
        f"side: of {len(points)}, {', '.join(f'{count} {reason}' for reason, count in counts)}"
    )
    return Walls(spots.some(kept), outwards[kept], rooms[kept]), told


def _room(setting: Setting, point: FloatArray, outwards: FloatArray, edge_depth: float) -> float:
    """Distance from a wall at which a blade can go down beside it [m]; 0 if there is none."""
    tool = setting.tools[0]
    corners = turn(upright_blade(outwards, tool.orientation), tool.vertices)
    half_thickness = float(turn(tool.orientation, tool.vertices)[:, 0].max())
    lowest, top = point[2] - edge_depth, float(setting.rest_nodes[:, 2].max())
    edges = np.append(np.arange(lowest, top, RISE), top)
    for room in ROOMS:
        beside = point[:2] + outwards * (room + half_thickness)
        poses = [np.array([*beside, edge - corners[:, 2].min()]) for edge in edges]
        if not any(overlaps(setting.rest_nodes, setting.triangles, corners + at, tool.triangles) for at in poses):
            return room
    return 0.0
