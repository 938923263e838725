"""Ridges of an organ of any shape, which two upright jaws grip from either side.

Lengths are in metres, points in the workspace frame. The ridge runs along x, and the jaws face each other along y.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.contact.raycast import cast_ray
from spatula_env.contact.structures import NO_HIT
from spatula_env.geometry.overlap import overlaps
from spatula_env.geometry.rotations import turn
from spatula_env.geometry.surface import winding_numbers

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray
    from spatula_env.tasks.situation import Setting

STATIONS = 5
"""Number of places along the jaws at which a ridge is measured."""

STEP = 0.001
"""Distance of the depths at which it is measured, below the crest [m]."""

DEPTHS = (0.008, 0.018)
"""Least and greatest depth of the jaws' lower edges below the crest [m]."""

ROOM = 0.001
"""Room between each jaw and the ridge on the way down [m]."""

RISE = 0.004
"""Distance of the heights at which the jaws are looked at on their way down [m]."""


@dataclass(frozen=True, eq=False)
class Profile:
    """What a ridge is like between the jaws.

    Attributes:
        top: Height of the crest, the lowest along the jaws.
        depths: (K,) depths below it, ascending.
        low: (K, STATIONS) y of the flank towards negative y; NaN where there is none.
        high: (K, STATIONS) y of the flank towards positive y.
    """

    top: float
    depths: FloatArray
    low: FloatArray
    high: FloatArray

    def sides(self, depth: float) -> tuple[float, float]:
        """Y of what is outermost on either side down to a depth; infinite if a flank is missing there."""
        within = self.depths <= depth + 0.5 * STEP
        low, high = self.low[within], self.high[within]
        if np.isnan(low).any() or np.isnan(high).any():
            return -np.inf, np.inf
        return float(low.min()), float(high.max())

    def lean(self, depth: float) -> float:
        """By how much either flank leans per height between half a depth and the depth, the greater of the two."""
        deep, half = (int(np.abs(self.depths - at).argmin()) for at in (depth, 0.5 * depth))
        wider = [np.mean(self.low[half] - self.low[deep]), np.mean(self.high[deep] - self.high[half])]
        return float(max(wider) / (self.depths[deep] - self.depths[half]))


def profile_of(setting: Setting, line: FloatArray, half_length: float) -> Profile:
    """Measure a ridge around the middle of its line.

    Args:
        setting: The setting.
        line: (K, 3) points of its crest.
        half_length: Half the length of the jaws.

    Returns:
        The profile, down to the greatest depth that jaws use.
    """
    nodes, triangles = setting.rest_nodes, np.array(setting.triangles)
    order = np.argsort(line[:, 0])
    middle = 0.5 * (line[0, 0] + line[-1, 0])
    stations = middle + half_length * np.linspace(-1.0, 1.0, STATIONS)
    across = np.interp(stations, line[order, 0], line[order, 1])
    heights = setting.surface_heights(nodes[None], np.column_stack([stations, across]))
    top = float(heights.min())
    depths = np.arange(0.5 * STEP, DEPTHS[1] + STEP, STEP)
    sides = np.full((2, len(depths), STATIONS), np.nan)
    for station, (x, y) in enumerate(zip(stations, across, strict=True)):
        points = np.column_stack([np.full(len(depths), x), np.full(len(depths), y), top - depths])
        inside = winding_numbers(points, nodes, triangles) > 0.5
        for row in np.flatnonzero(inside):
            for side, direction in enumerate((-1.0, 1.0)):
                hit, distance, _, _, _ = cast_ray(points[row], np.array([0.0, direction, 0.0]), nodes, triangles)
                if hit != NO_HIT:
                    sides[side, row, station] = y + direction * distance
    return Profile(top, depths, sides[0], sides[1])


def jaws_fit(setting: Setting, grip: FloatArray, opening: float, top: float) -> bool:
    """Whether the two jaws come straight down to a place without meeting the organ.

    Args:
        setting: The setting.
        grip: (3,) the middle between them at the lowest.
        opening: Free width between them.
        top: Height above which their lower edges are free.
    """
    lowest = float(grip[2] + setting.tool_low[2])
    for edge in np.append(np.arange(lowest, top, RISE), max(top, lowest)):
        for side, tool in zip((-1.0, 1.0), setting.tools, strict=True):
            corners = turn(tool.orientation, tool.vertices)
            inner = float(side * (side * corners[:, 1]).min())
            at = np.array([grip[0], grip[1] + side * 0.5 * opening - inner, edge - corners[:, 2].min()])
            if overlaps(setting.rest_nodes, setting.triangles, corners + at, tool.triangles):
                return False
    return True
