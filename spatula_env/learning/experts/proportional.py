"""Proportional controllers: the tools move towards their target positions at a speed proportional to the distance.

They serve for comparison: a task is harder than straight motion where they fail. Each has one gain for distances and no
phases, so that it neither avoids obstacles nor slows down before contact.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.learning.experts.base import Expert
from spatula_env.learning.experts.clamp import AT, SQUEEZE, WIDTH
from spatula_env.learning.experts.fissure import ARM, LOW, WALL
from spatula_env.learning.experts.palpate import FORCE_GAIN, RADIUS
from spatula_env.learning.experts.retract import EDGE, EDGE_DEPTH, HALF_THICKNESS

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray

GAIN = 8.0
"""Speed per distance, rate of rotation per angle, and speed of jaws per width [1/s]."""


class ProportionalPress(Expert):
    """Moves horizontally towards the place, and vertically by the depth error, which in the air is the full depth."""

    task = "press"

    def velocities(self, observation: Any) -> Mapping[str, FloatArray]:
        """See `Expert`."""
        x, y, depth = np.moveaxis(self.error(observation), -1, 0)
        return {"velocity_x": GAIN * x, "velocity_y": GAIN * y, "velocity_z": -GAIN * depth}


class ProportionalRetract(Expert):
    """Moves towards the patch, from the side from which it is pushed, and on by the displacement that is missing."""

    task = "retract"

    def velocities(self, observation: Any) -> Mapping[str, FloatArray]:
        """See `Expert`."""
        patch, goal = self.part(observation, "patch_position"), self.goal(observation)
        away = patch - self.part(observation, "tool_position")
        missing = goal - self.part(observation, "patch_shift")[..., :2]
        return {
            "velocity_x": GAIN * (away[..., 0] - np.sign(goal[..., 0]) * HALF_THICKNESS + missing[..., 0]),
            "velocity_y": GAIN * (away[..., 1] + missing[..., 1]),
            "velocity_z": GAIN * (away[..., 2] + EDGE - EDGE_DEPTH),
        }


class ProportionalFissure(Expert):
    """Moves the edge beside the target, and tilts the blade to the line of sight."""

    task = "fissure"

    def velocities(self, observation: Any) -> Mapping[str, FloatArray]:
        """See `Expert`."""
        along, across, down = np.moveaxis(self.part(observation, "target_offset"), -1, 0)
        view = self.goal(observation)[..., 1]
        tilt = self.part(observation, "tool_orientation")[..., 0]
        rate = GAIN * (view - tilt)
        # The blade rotates about its middle: compensate, so that its edge moves straight.
        return {
            "velocity_x": GAIN * along,
            "velocity_y": GAIN * (across - np.sign(view) * WALL) - ARM * np.cos(tilt) * rate,
            "velocity_z": GAIN * (down + LOW) - ARM * np.sin(tilt) * rate,
            "rotation_x": rate,
        }


class ProportionalClamp(Expert):
    """Moves towards the ridge until it is between the jaws; then closes the jaws and lifts by the error of the lift."""

    task = "clamp"

    def velocities(self, observation: Any) -> Mapping[str, FloatArray]:
        """See `Expert`."""
        along, across, down = np.moveaxis(self.part(observation, "ridge_offset"), -1, 0)
        between = -down < AT
        opening = self.part(observation, "jaw_opening")[..., 0]
        lift = np.where(opening < WIDTH, self.error(observation)[..., 0], 0.0)
        return {
            "velocity_x": GAIN * along,
            "velocity_y": GAIN * across,
            "velocity_z": GAIN * np.where(between, lift, down),
            "jaw_speed": GAIN * np.where(between, SQUEEZE * WIDTH - opening, 0.0),
        }


class ProportionalPalpate(Expert):
    """Moves towards the next point of the path, tilted as a round organ is there, and presses by the force error."""

    task = "palpate"

    def velocities(self, observation: Any) -> Mapping[str, FloatArray]:
        """See `Expert`."""
        way = self.part(observation, "path_ahead")[..., 3:6]
        place = self.part(observation, "tool_position") + way
        tilt = self.part(observation, "tool_orientation")
        inwards = FORCE_GAIN * self.error(observation)[..., 3]
        return {
            "velocity_x": GAIN * way[..., 0],
            "velocity_y": GAIN * way[..., 1],
            "velocity_z": GAIN * way[..., 2] - inwards,
            "rotation_x": GAIN * (-place[..., 1] / RADIUS - tilt[..., 0]),
            "rotation_y": GAIN * (place[..., 0] / RADIUS - tilt[..., 1]),
        }
