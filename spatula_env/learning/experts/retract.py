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
        shift = self.part(observation, "patch_shift")
        inwards, room = self._wall(observation)
        # Along and across the direction into the wall.
        x, y = in_frame(tool, inwards)
        rest_x, rest_y = in_frame(self.part(observation, "patch_position") - shift, inwards)
        error = np.stack(in_frame(self.error(observation), inwards), axis=-1)
        z, height = tool[..., 2], self.part(observation, "patch_position")[..., 2] - shift[..., 2] - EDGE_DEPTH + EDGE
        place_x = rest_x - (HALF_THICKNESS + room)

        low = z - height < LOW
        beside = place_x - x > -BESIDE
        lifting = ~low & ~beside & (z - EDGE < TOP + CLEARANCE)
        aligned = (np.abs(place_x - x) < ACROSS) & (np.abs(rest_y - y) < ALONG)
        touching = np.abs(in_frame(force, inwards)[0]) > TOUCH

        over_x = np.where(lifting, 0.0, PLACE_GAIN * (place_x - x))
        over_y = np.where(lifting, 0.0, PLACE_GAIN * (rest_y - y))
        over_z = np.where(lifting, LIFT_SPEED, np.where(aligned, PLACE_GAIN * (height - z) - LEAST_DESCENT, 0.0))
        push = np.clip(SHIFT_GAIN * error, -PUSH_SPEED, PUSH_SPEED)
        push_x = np.where(touching, push[..., 0], PUSH_SPEED)
        push_y = np.where(touching, push[..., 1], PLACE_GAIN * (rest_y - y))
        speed_x, speed_y = np.where(low, push_x, over_x), np.where(low, push_y, over_y)
        return {
            "velocity_x": speed_x * inwards[..., 0] - speed_y * inwards[..., 1],
            "velocity_y": speed_x * inwards[..., 1] + speed_y * inwards[..., 0],
            "velocity_z": np.where(low, PLACE_GAIN * (height - z), over_z),
        }

    def _wall(self, observation: Any) -> tuple[FloatArray, FloatArray]:
        """Horizontal directions (..., 2) into the walls that are pushed, and the room (...) for going down [m]."""
        if self.has_part("patch_outwards"):
            return -self.part(observation, "patch_outwards"), self.part(observation, "patch_room")[..., 0]
        side = np.sign(self.goal(observation)[..., 0])
        return np.stack([side, np.zeros_like(side)], axis=-1), np.full_like(side, GAP)


def in_frame(vectors: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Components (...) of vectors (..., 2 or more), seen from above, along directions (..., 2) and to the left."""
    along = vectors[..., 0] * direction[..., 0] + vectors[..., 1] * direction[..., 1]
    return along, vectors[..., 1] * direction[..., 0] - vectors[..., 0] * direction[..., 1]
