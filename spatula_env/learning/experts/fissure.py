"""A scripted policy for Spatula/Fissure-v0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from spatula_env.arrays import FloatArray
from spatula_env.learning.experts.base import Expert

ARM = 0.02
"""Distance from the grip down to the blade's edge [m]."""

GAIN, FREE_SPEED = 6.0, 0.05
"""Speed per distance [1/s], and greatest speed [m/s]."""

TURN_GAIN, TURN_SPEED = 4.0, 0.4
"""Rate of rotation per angle [1/s], and greatest rate [rad/s]."""

DEPTH = 0.03
"""Depth of the target in the fissure [m], where observations do not tell it."""

ABOVE, LIPS = 0.006, -0.003
"""Heights above the organ [m]: where the blade waits until aligned with the fissure, and below which it is inside."""

LOW, DEEP = 0.004, 0.0035
"""Height above the target at which the blade's edge is held, and height above that at which opening begins [m]."""

IN_LINE, IN_PLACE, UPRIGHT = 0.0012, 0.004, 0.04
"""Greatest misalignment with which the blade enters: across and along the fissure [m], and its tilt [rad]."""

WALL, WALL_GAIN = 0.0033, 0.004
"""Distance of the edge from the target, towards the wall that is pushed [m]; and further distance per missing share."""

BEYOND, BEYOND_GAIN = 0.015, 0.1
"""Tilt of the blade beyond the line of sight [rad]; and further tilt per missing share."""

TILTED = 0.1
"""Tilt from which on the blade opens the fissure [rad]."""


class FissureExpert(Expert):
    """Moves above the fissure, enters it upright, and leans the blade against the wall until enough is visible.

    Attributes:
        low: Height above the target at which the blade's edge is held [m].
        wall: Distance of the edge from the target, towards the wall that is pushed [m].
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
        depth = self.part(observation, "fissure_depth")[..., 0] if self.has_part("fissure_depth") else DEPTH
        wanted_height = np.where(ready | (height < depth + LIPS), self.low, depth + ABOVE)

        # Push the wall on the side to which the line of sight leans; a positive angle leans towards negative y.
        opening = np.minimum(np.abs(tilt) / TILTED, 1.0)
        further = WALL_GAIN * np.clip(missing + 0.1, 0.0, 0.3) * (opening == 1.0)
        aside = np.where(deep, -np.sign(view) * (self.wall * opening + further), 0.0)
        more = BEYOND + BEYOND_GAIN * np.clip(missing + 0.05, 0.0, 0.3)
        wanted_tilt = np.where(deep, view + np.sign(view) * more, 0.0)
        rate = np.clip(TURN_GAIN * (wanted_tilt - tilt), -TURN_SPEED, TURN_SPEED)

        def towards(distance: FloatArray) -> FloatArray:
            return np.clip(GAIN * distance, -FREE_SPEED, FREE_SPEED)

        # The blade rotates about the grip: compensate, so that it moves as if it rotated about its edge.
        return {
            "velocity_x": towards(along),
            "velocity_y": towards(across + aside) - ARM * np.cos(tilt) * rate,
            "velocity_z": towards(wanted_height - height) - ARM * np.sin(tilt) * rate,
            "rotation_x": rate,
        }
