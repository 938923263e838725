"""A scripted policy for Spatula/Press-v0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from spatula_env.arrays import FloatArray
from spatula_env.learning.experts.base import Expert

PLACE_GAIN = 10.0
"""Horizontal speed per distance to the target place [1/s]."""

DEPTH_GAIN, PRESS_SPEED = 9.0, 0.035
"""Vertical speed per depth error [1/s], and greatest speed [m/s]; faster, the force would grow too quickly."""

APPROACH_GAIN, TOUCH_SPEED = 12.0, 0.03
"""Speed of the descent per height above the organ [1/s], and least speed [m/s]."""

TOP, RADIUS, HALF_THICKNESS = -0.025, 0.06, 0.00125
"""Height of the organ's top at rest, in the workspace frame, its radius, and half the spatula's thickness [m]."""

NEAR, WAITING = 0.004, 0.005
"""Horizontal distance to the target place below which the spatula touches the organ, and height above the organ at
which it waits until then [m]."""


class PressExpert(Expert):
    """Moves above the target place, descends carefully, and regulates the observed depth."""

    task = "press"

    def velocities(self, observation: Any) -> Mapping[str, FloatArray]:
        """See `Expert`."""
        x, y, depth = np.moveaxis(self.error(observation), -1, 0)
        touching = self.part(observation, "contact_share").max(axis=-1) > 0.0
        place = self.part(observation, "tool_position")
        surface = TOP - 0.5 * (place[..., :2] ** 2).sum(axis=-1) / RADIUS
        height = place[..., 2] - HALF_THICKNESS - surface
        near = np.hypot(x, y) < NEAR
        coming = np.where(
            near, np.maximum(APPROACH_GAIN * height, TOUCH_SPEED), APPROACH_GAIN * np.maximum(height - WAITING, 0.0)
        )
        pressing = np.where(near, np.clip(DEPTH_GAIN * depth, -PRESS_SPEED, PRESS_SPEED), 0.0)
        return {
            "velocity_x": PLACE_GAIN * x,
            "velocity_y": PLACE_GAIN * y,
            "velocity_z": -np.where(touching, pressing, coming),
        }
