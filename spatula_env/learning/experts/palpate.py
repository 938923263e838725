"""A scripted policy for Spatula/Palpate-v0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from spatula_env.arrays import FloatArray
from spatula_env.learning.experts.base import Expert

RADIUS = 0.06
"""Radius of the organ, which is touched where its surface is as steep as the spatula's face [m]."""

NEAR = 0.003
"""Horizontal distance to the path below which the spatula descends [m]."""

PLACE_GAIN = 10.0
"""Horizontal speed per distance to the target position [1/s]."""

TURN_GAIN = 8.0
"""Rate of rotation per angle [1/s]."""

STEER, LATE_STEER = 1.5, 0.75
"""Rate of tilting for an offset centre of pressure, per tilt that a round organ requires for that offset [1/s]; and the
same where actions or observations are late."""

APPROACH_GAIN = 10.0
"""Speed of the descent per height above the path [1/s]."""

APPROACH_SPEEDS = (0.01, 0.05)
"""Least and greatest speed of the descent [m/s]."""

TOUCH = 0.01
"""Force from which on the spatula counts as touching the organ [N]."""

FORCE_GAIN, LATE_FORCE_GAIN = 0.12, 0.06
"""Speed per force error, and the same where actions or observations are late [m/(s N)]."""

FORCE_SPEED = 0.02
"""Greatest speed from the force error [m/s]."""

SAFE_ERROR = 0.025
"""Force error above which the spatula does not advance [N]."""

SAFE_PLACE = 0.003
"""Distance of the centre of pressure from the current point of the path above which it does not advance [m]."""

AHEAD, LATE_AHEAD, OWN_AHEAD = 0.0035, 0.0025, 0.002
"""Distance by which the centre of pressure leads the part of the path felt so far, and the same where actions or
observations are late, and on an organ of one's own [m]."""


class PalpateExpert(Expert):
    """Moves above the path, descends, and rolls and slides along it while regulating the force; it stays at the end.

    A flat face touches a round organ where both are equally steep. So the expert tilts the spatula as steeply as the
    organ is where it wants to press, corrects this by where it actually presses, and keeps the spatula's middle there.
    """

    task = "palpate"

    def velocities(self, observation: Any) -> Mapping[str, FloatArray]:
        """See `Expert`."""
        ahead = self.part(observation, "path_ahead")
        here, step = ahead[..., :3], ahead[..., 3:6] - ahead[..., :3]
        force = self.part(observation, "normal_force")[..., 0]
        goal, error = self.goal(observation), self.error(observation)
        middle = self.part(observation, "tool_position")
        length = np.sqrt((step**2).sum(axis=-1))[..., None]
        direction = step / np.maximum(length, 1e-9)

        touching = force > TOUCH
        # Centre of pressure relative to the current point of the path, seen from above.
        pressed = goal[..., 1:3] - error[..., 1:3] - middle[..., :2] - here[..., :2]
        sliding = (
            touching
            & (np.abs(error[..., 3]) < SAFE_ERROR)
            & (np.hypot(pressed[..., 0], pressed[..., 1]) < SAFE_PLACE)
            & (length[..., 0] > 1e-4)
        )
        lead = OWN_AHEAD if self.has_part("path_normals") else LATE_AHEAD if self.late else AHEAD
        feed = np.where(sliding, np.minimum(lead, length[..., 0]), 0.0)[..., None] * direction
        way = here + feed
        off = feed[..., :2] - pressed
        tilt = self.part(observation, "tool_orientation")
        steep = np.stack([tilt[..., 1], -tilt[..., 0]], axis=-1)
        wanted, bending = self._steepness(observation, middle + way, feed, length)
        steeper = np.where(
            touching[..., None],
            PLACE_GAIN * bending + (LATE_STEER if self.late else STEER) / RADIUS * off,
            TURN_GAIN * (wanted - steep),
        )
        rates = np.stack([-steeper[..., 1], steeper[..., 0]], axis=-1)

        near = np.hypot(here[..., 0], here[..., 1]) < NEAR
        down = np.clip(-APPROACH_GAIN * here[..., 2], *APPROACH_SPEEDS)
        gain = LATE_FORCE_GAIN if self.late else FORCE_GAIN
        pressing = np.clip(gain * error[..., 3], -FORCE_SPEED, FORCE_SPEED)
        # In contact, keep regulating the force even if the spatula has left the path.
        inwards = np.where(touching, pressing, np.where(near, down, 0.0))
        along = PLACE_GAIN * way
        slope = steep / np.sqrt(1.0 - (steep**2).sum(axis=-1, keepdims=True))
        return {
            "velocity_x": along[..., 0] - inwards * steep[..., 0] * touching,
            "velocity_y": along[..., 1] - inwards * steep[..., 1] * touching,
            "velocity_z": -inwards - np.where(touching, (along[..., :2] * slope).sum(axis=-1), 0.0),
            **{f"rotation_{axis}": rates[..., k] for k, axis in enumerate("xy")},
        }

    def _steepness(
        self, observation: Any, place: FloatArray, feed: FloatArray, step: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Horizontal part (..., 2) of the organ's normal, and how much it changes along the way.

        Args:
            observation: The observation.
            place: (..., 3) where the spatula is going [m].
            feed: (..., 3) by how much it is to go along the path [m].
            step: (..., 1) distance to the next observed point of the path [m].
        """
        if not self.has_part("path_normals"):
            return place[..., :2] / RADIUS, feed[..., :2] / RADIUS
        normals = self.part(observation, "path_normals")
        share = np.sqrt((feed**2).sum(axis=-1, keepdims=True)) / np.maximum(step, 1e-9)
        return normals[..., :2], share * (normals[..., 3:5] - normals[..., :2])
