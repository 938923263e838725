"""A scripted policy for Spatula/Fissure-v0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from spatula_env.arrays import FloatArray
from spatula_env.learning.experts.base import Expert

ARM = 0.02
"""From the grip down to the blade's edge [m]."""

GAIN, FREE_SPEED = 6.0, 0.05
"""Speed per distance [1/s], and the greatest [m/s]."""

TURN_GAIN, TURN_SPEED = 4.0, 0.4
"""Rate of rotation per angle [1/s], and the greatest [rad/s]."""

ABOVE, LIPS = 0.036, 0.027
"""Heights above the target [m]: where the blade waits until it is in line with the fissure, and where it is inside."""

LOW, DEEP = 0.004, 0.0035
"""Where the blade's edge is held, above the target, and how far above that the fissure begins to be opened [m]."""

IN_LINE, IN_PLACE, UPRIGHT = 0.0012, 0.004, 0.04
"""How far off the blade may be to enter: across and along the fissure [m], and its tilt [rad]."""

WALL, WALL_GAIN = 0.0033, 0.004
"""How far the edge is held from the target, towards the wall that is pushed [m]; and further for a missing share."""

BEYOND, BEYOND_GAIN = 0.015, 0.1
"""By how much the blade is tilted more than the line of sight [rad]; and more for a missing share."""

TILTED = 0.1
"""A blade with this tilt opens the fissure [rad]."""


class FissureExpert(Expert):
    """Goes above the fissure, enters it upright, and leans the blade against the wall until enough is seen.

    Attributes:
        low: Height above the target at which the blade's edge is held [m].
        wall: How far the edge is held from the target, towards the wall that is pushed [m].
    """

    task = "fissure"
    low: float = LOW
    wall: float = WALL

    def velocities(self, observation: Any) -> Mapping[str, FloatArray]:
        """See `Expert`."""
        along, across, down = np.moveaxis(self.part(observation, "target_offset"), -1, 0)
        tilt = self.part(observation, "tool_orientation")[..., 0]
        view, missing = self.goal(observation)[..., 1], self.error(observation)[..., 2]
        height = -down
        deep = height < self.low + DEEP
        ready = (np.abs(across) < IN_LINE) & (np.abs(along) < IN_PLACE) & (np.abs(tilt) < UPRIGHT)
        wanted_height = np.where(ready | (height < LIPS), self.low, ABOVE)

        # The wall is pushed on the side that the line of sight leans to; a positive angle leans towards negative y.
        opening = np.minimum(np.abs(tilt) / TILTED, 1.0)
        further = WALL_GAIN * np.clip(missing + 0.1, 0.0, 0.3) * (opening == 1.0)
        aside = np.where(deep, -np.sign(view) * (self.wall * opening + further), 0.0)
        more = BEYOND + BEYOND_GAIN * np.clip(missing + 0.05, 0.0, 0.3)
        wanted_tilt = np.where(deep, view + np.sign(view) * more, 0.0)
        rate = np.clip(TURN_GAIN * (wanted_tilt - tilt), -TURN_SPEED, TURN_SPEED)

        def towards(distance: FloatArray) -> FloatArray:
            return np.clip(GAIN * distance, -FREE_SPEED, FREE_SPEED)

        # The blade turns about the grip; its edge is to move as if it turned about the edge.
        return {
            "velocity_x": towards(along),
            "velocity_y": towards(across + aside) - ARM * np.cos(tilt) * rate,
            "velocity_z": towards(wanted_height - height) - ARM * np.sin(tilt) * rate,
            "rotation_x": rate,
        }
