"""A scripted policy for Spatula/Press-v0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from spatula_env.arrays import FloatArray
from spatula_env.learning.experts.base import Expert

PLACE_GAIN = 8.0
"""Horizontal speed per distance to the place [1/s]."""

DEPTH_GAIN = 6.0
"""Vertical speed per error of the depth [1/s]."""

FREE_SPEED = 0.06
"""Of the descent to the organ [m/s]."""

NEAR = 0.004
"""The spatula descends when it is closer to the place than this, horizontally [m]."""


class PressExpert(Expert):
    """Goes above the place, descends, and regulates the depth that it sees."""

    task = "press"

    def velocities(self, observation: Any) -> Mapping[str, FloatArray]:
        """See `Expert`."""
        x, y, depth = np.moveaxis(self.error(observation), -1, 0)
        touching = self.part(observation, "contact_share").max(axis=-1) > 0.0
        down = np.where(touching, DEPTH_GAIN * depth, FREE_SPEED)
        return {
            "velocity_x": PLACE_GAIN * x,
            "velocity_y": PLACE_GAIN * y,
            "velocity_z": -np.where(np.hypot(x, y) > NEAR, 0.0, down),
        }
