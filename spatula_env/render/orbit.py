"""A camera that orbits its target, controlled by hand."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from spatula_env.render.camera import Camera

LEAST_ELEVATION, GREATEST_ELEVATION = -5.0, 89.0
"""Limits of the eye's elevation [degrees]: from below, the ground is not drawn."""

CLOSEST, FARTHEST = 0.25, 4.0
"""Limits of the eye's distance from the target, by that at the start."""


class Orbit:
    """Turns, shifts and moves a camera, and can return to its first pose.

    Attributes:
        camera: The present camera.
    """

    def __init__(self, camera: Camera) -> None:
        """Begin with a camera."""
        self._home = camera
        self.camera = camera

    def reset(self) -> None:
        """Return to the first camera."""
        self.camera = self._home

    def turn(self, right: float, up: float) -> None:
        """Turn the scene as if dragged to the right and up, by angles in degrees."""
        target, distance, azimuth, elevation = self._pose()
        elevation = min(max(elevation - up, LEAST_ELEVATION), GREATEST_ELEVATION)
        self._set(target, distance, azimuth - right, elevation)

    def shift(self, right: float, up: float) -> None:
        """Shift the scene to the right and up, by fractions of the picture's height."""
        target, distance, azimuth, elevation = self._pose()
        height = 2.0 * distance * math.tan(math.radians(0.5 * self.camera.vertical_field_of_view))
        axes = self.camera.axes()
        self._set(target - height * (right * axes[0] + up * axes[1]), distance, azimuth, elevation)

    def move(self, steps: float) -> None:
        """Move closer by a number of steps, each a tenth of the remaining distance; if negative, move away."""
        target, distance, azimuth, elevation = self._pose()
        start = math.dist(self._home.position, self._home.target)
        distance = min(max(distance * 0.9**steps, CLOSEST * start), FARTHEST * start)
        self._set(target, distance, azimuth, elevation)

    def _pose(self) -> tuple[NDArray[np.float64], float, float, float]:
        target = np.array(self.camera.target)
        away = np.array(self.camera.position) - target
        distance = float(np.linalg.norm(away))
        azimuth = math.degrees(math.atan2(away[1], away[0]))
        return target, distance, azimuth, math.degrees(math.asin(away[2] / distance))

    def _set(self, target: NDArray[np.float64], distance: float, azimuth: float, elevation: float) -> None:
        home = self._home
        self.camera = Camera.orbit(
            target,
            distance,
            azimuth,
            elevation,
            vertical_field_of_view=home.vertical_field_of_view,
            near=home.near,
            far=home.far,
        )
