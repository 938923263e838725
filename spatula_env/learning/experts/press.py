"""A scripted policy for Spatula/Press-v0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from spatula_env.arrays import FloatArray
from spatula_env.geometry.rotations import conjugate, turn
from spatula_env.learning.experts.base import Expert
from spatula_env.tasks.places import upright

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
    """Moves above the target place, descends carefully, and regulates the observed depth.

    On an organ of one's own it does so in the direction of the normal at the place, which is observed there.
    """

    task = "press"

    def velocities(self, observation: Any) -> Mapping[str, FloatArray]:
        """See `Expert`."""
        place = self.part(observation, "tool_position")
        if not self.has_part("place_normal"):
            surface = TOP - 0.5 * (place[..., :2] ** 2).sum(axis=-1) / RADIUS
            across, along = self._steer(observation, place[..., 2] - HALF_THICKNESS - surface)
            return {"velocity_x": across[..., 0], "velocity_y": across[..., 1], "velocity_z": along}
        normal = self.part(observation, "place_normal")
        height = ((place - self.part(observation, "place_position")) * normal).sum(axis=-1) - HALF_THICKNESS
        across, along = self._steer(observation, height)
        velocity = turn(conjugate(upright(normal)), np.concatenate([across, along[..., None]], axis=-1))
        return {f"velocity_{axis}": velocity[..., k] for k, axis in enumerate("xyz")}

    def _steer(self, observation: Any, height: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Velocities (..., 2) across the normal and (...) along it, for heights (...) above the surface [m]."""
        x, y, depth = np.moveaxis(self.error(observation), -1, 0)
        touching = self.part(observation, "contact_share").max(axis=-1) > 0.0
        near = np.hypot(x, y) < NEAR
        coming = np.where(
            near, np.maximum(APPROACH_GAIN * height, TOUCH_SPEED), APPROACH_GAIN * np.maximum(height - WAITING, 0.0)
        )
        pressing = np.where(near, np.clip(DEPTH_GAIN * depth, -PRESS_SPEED, PRESS_SPEED), 0.0)
        return PLACE_GAIN * np.stack([x, y], axis=-1), -np.where(touching, pressing, coming)
