"""A scripted policy for Spatula/Palpate-v0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from spatula_env.arrays import FloatArray
from spatula_env.learning.experts.base import Expert

NEAR = 0.002
"""The spatula goes down when it is closer to the path than this, horizontally [m]."""

PLACE_GAIN = 6.0
"""Horizontal speed per distance to where the spatula has got to on the path [1/s]."""

APPROACH_GAIN = 4.0
"""Speed of the descent per height above the path [1/s]."""

APPROACH_SPEEDS = (0.004, 0.03)
"""Least and greatest speed of the descent [m/s]."""

TOUCH = 0.01
"""Force that tells that the spatula touches the organ [N]."""

FORCE_GAIN = 0.12
"""Speed per error of the force [m/(s N)]."""

FORCE_SPEED = 0.012
"""Greatest speed that the error of the force leads to [m/s]."""

SAFE_ERROR = 0.02
"""With a greater error of the force the spatula does not go on [N]."""

SLIDE_SPEED = 0.009
"""Along the path [m/s]."""


class PalpateExpert(Expert):
    """Goes above the path, descends, and slides along it while it regulates the force; it stays at the path's end."""

    task = "palpate"

    def velocities(self, observation: Any) -> Mapping[str, FloatArray]:
        """See `Expert`."""
        ahead = self.part(observation, "path_ahead")
        here, step = ahead[..., :3], ahead[..., 3:6] - ahead[..., :3]
        force = self.part(observation, "normal_force")[..., 0]
        error = self.goal(observation)[..., 3] - force
        length = np.sqrt((step**2).sum(axis=-1))
        direction = step / np.maximum(length, 1e-9)[..., None]

        near = np.hypot(here[..., 0], here[..., 1]) < NEAR
        touching = force > TOUCH
        sliding = near & touching & (np.abs(error) < SAFE_ERROR) & (length > 1e-4)
        speed = np.where(sliding, SLIDE_SPEED, 0.0)
        down = np.clip(-APPROACH_GAIN * here[..., 2], *APPROACH_SPEEDS)
        pressing = np.clip(FORCE_GAIN * error, -FORCE_SPEED, FORCE_SPEED)
        # In contact the spatula keeps its force, also where it has come off the path.
        inwards = np.where(touching, pressing, np.where(near, down, 0.0))
        return {
            "velocity_x": PLACE_GAIN * here[..., 0] + speed * direction[..., 0],
            "velocity_y": PLACE_GAIN * here[..., 1] + speed * direction[..., 1],
            "velocity_z": -inwards + speed * direction[..., 2],
        }
