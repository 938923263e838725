"""A scripted policy for Spatula/Retract-v0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from spatula_env.arrays import FloatArray
from spatula_env.learning.experts.base import Expert

HALF_THICKNESS = 0.0009
"""Half the thickness of the blade [m]."""

EDGE = 0.02
"""Distance from the blade's middle down to its lower edge [m]."""

TOP = -0.02
"""Height of the organ's top at rest, in the workspace frame [m]."""

CLEARANCE = 0.004
"""Clearance of the lower edge above the organ's top when it passes over the fold [m]."""

GAP = 0.005
"""Distance from the flank at which the blade goes down [m]."""

EDGE_DEPTH = 0.008
"""Depth below the patch's middle at which the lower edge pushes [m]."""

PLACE_GAIN = 8.0
"""Speed per distance to a place, in the air [1/s]."""

LIFT_SPEED, LEAST_DESCENT, PUSH_SPEED = 0.04, 0.005, 0.015
"""Speed upwards in the air, speed downwards where the wanted height is near, and speed against the fold [m/s]."""

SHIFT_GAIN = 6.0
"""Speed per error of the patch's displacement [1/s]."""

TOUCH = 0.005
"""Force from which on the blade counts as touching the fold [N]."""

LOW, BESIDE = 0.003, 0.002
"""Tolerances of the blade's position for pushing: in height, and beyond its place across the fold [m]."""

ACROSS, ALONG = 0.003, 0.004
"""Tolerances of the blade's position for going down: across the fold, and along it [m]."""


class RetractExpert(Expert):
    """Moves over to the patch's side of the fold, goes down, and pushes until the patch has the wanted displacement."""

    task = "retract"

    def velocities(self, observation: Any) -> Mapping[str, FloatArray]:
        """See `Expert`."""
        tool, force = self.part(observation, "tool_position"), self.part(observation, "contact_force")
        shift, error = self.part(observation, "patch_shift"), self.error(observation)
        rest = self.part(observation, "patch_position") - shift
        x, y, z = np.moveaxis(tool, -1, 0)
        side = np.sign(self.goal(observation)[..., 0])
        place_x = rest[..., 0] - side * (HALF_THICKNESS + GAP)
        height = rest[..., 2] - EDGE_DEPTH + EDGE

        low = z - height < LOW
        beside = side * (place_x - x) > -BESIDE
        lifting = ~low & ~beside & (z - EDGE < TOP + CLEARANCE)
        aligned = (np.abs(place_x - x) < ACROSS) & (np.abs(rest[..., 1] - y) < ALONG)
        touching = np.abs(force[..., 0]) > TOUCH

        over_x = np.where(lifting, 0.0, PLACE_GAIN * (place_x - x))
        over_y = np.where(lifting, 0.0, PLACE_GAIN * (rest[..., 1] - y))
        over_z = np.where(lifting, LIFT_SPEED, np.where(aligned, PLACE_GAIN * (height - z) - LEAST_DESCENT, 0.0))
        push = np.clip(SHIFT_GAIN * error, -PUSH_SPEED, PUSH_SPEED)
        push_x = np.where(touching, push[..., 0], side * PUSH_SPEED)
        push_y = np.where(touching, push[..., 1], PLACE_GAIN * (rest[..., 1] - y))
        return {
            "velocity_x": np.where(low, push_x, over_x),
            "velocity_y": np.where(low, push_y, over_y),
            "velocity_z": np.where(low, PLACE_GAIN * (height - z), over_z),
        }
