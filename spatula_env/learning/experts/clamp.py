"""A scripted policy for Spatula/Clamp-v0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.arrays import FloatArray
from spatula_env.learning.experts.base import Expert

if TYPE_CHECKING:
    import gymnasium

WIDTH = 0.016
"""Width of the ridge [m]."""

SQUEEZE = 0.75
"""Free width between the jaws while gripping, as a share of the ridge's width."""

SQUEEZE_OF_TISSUE = 0.85
"""The same for engines whose organs are made of a material: their ridge resists more."""

TIGHTER, SLIPPING, SLIPPED = 0.1, 0.0007, 0.0012
"""Share by which the grip narrows if the ridge slips, and the slips at which this begins and is complete [m]."""

TIGHTER_ON_SOFT, WEAK, WEAKEST = 0.15, 0.13, 0.09
"""Share by which the grip narrows on a ridge that resists little, and the forces at which this begins and is complete
[N]."""

CLOSED = 0.0004
"""Greatest excess over that width at which the lift begins [m]."""

OPEN = 0.024
"""Free width of the jaws while they go down beside the ridge [m]."""

GAIN, FREE_SPEED = 9.0, 0.05
"""Speed per distance [1/s], and greatest speed [m/s]."""

LIFT_GAIN, LIFT_SPEED = 6.0, 0.03
"""Speed per missing lift [1/s], and greatest speed [m/s]."""

CLOSING_GAIN, CLOSING_SPEED, FREE_CLOSING_SPEED = 10.0, 0.022, 0.05
"""Speed of the jaws per width [1/s], and greatest speed [m/s] on the ridge, and before they touch it."""

TOUCHING = 0.0175
"""Free width between the jaws below which they may touch the ridge [m]."""

ABOVE, BESIDE = 0.024, 0.02
"""Heights of the grip above the ridge's middle [m]: where it waits until aligned, and below which it goes on down."""

AT, LOW = 0.006, 0.0025
"""Heights of the grip above the ridge's middle [m]: below which the jaws close, and where they grip."""

CLEARANCE = 0.004
"""How far the grip is below where the jaws are free of the organ when it goes on down [m]."""

ROOM = 0.008
"""Excess of the jaws' free width over that of a ridge of an organ of one's own while they go down [m]."""

WIDEST = 0.0315
"""Greatest free width of the jaws while they go down [m]."""

AIM, LEAST_AIM, FORCE_GAIN, FORCE_SPEED = 0.19, 0.15, 0.08, 0.008
"""On a ridge of an organ of one's own: force of the jaw that presses less that is aimed at, and from which on it lifts
[N]; speed of the jaws per force [m/(N s)], and greatest speed [m/s]."""

MOST_FORCE, ENOUGH_FORCE = 0.21, 0.17
"""Force of the jaw that presses less beyond which the grip widens, and from which on it lifts whatever its width: a
ridge may be stiffer or wider than usual [N]."""

IN_LINE, IN_PLACE = 0.0012, 0.002
"""Greatest misalignment with which the grip goes down: across and along the ridge [m]."""


class ClampExpert(Expert):
    """Moves above the ridge, goes down beside it with open jaws, closes them, and lifts.

    Attributes:
        squeeze: Free width between the jaws while gripping, as a share of the ridge's width; one number, or (W,).
        minds_force: Whether the grip widens or narrows where its force is not as it should be.
    """

    task = "clamp"
    squeeze: float | FloatArray
    minds_force: bool = True

    def __init__(self, env: gymnasium.Env[Any, Any] | gymnasium.vector.VectorEnv[Any, Any, Any]) -> None:
        """See `Expert`; the width while gripping depends on the engine."""
        super().__init__(env)
        made: Any = env.unwrapped
        self.squeeze = SQUEEZE_OF_TISSUE if made.settings.engine in ("tissue", "mujoco") else SQUEEZE

    def velocities(self, observation: Any) -> Mapping[str, FloatArray]:
        """See `Expert`."""
        if self.has_part("ridge_shape"):
            return self._by_force(observation)
        along, across, down = np.moveaxis(self.part(observation, "ridge_offset"), -1, 0)
        opening = self.part(observation, "jaw_opening")[..., 0]
        error, height = self.error(observation), -down
        missing, slip = error[..., 0], self.goal(observation)[..., 1] - error[..., 1]
        gripping = height < AT
        forces = self.part(observation, "contact_force")
        force = np.minimum(-forces[..., 1], forces[..., 4])
        enough = (force > ENOUGH_FORCE) & self.minds_force
        holding = gripping & ((opening < self.squeeze * WIDTH + CLOSED) | enough)
        ready = (np.abs(across) < IN_LINE) & (np.abs(along) < IN_PLACE) & (opening > WIDTH + 0.5 * (OPEN - WIDTH))
        wanted_height = np.where(ready | (height < BESIDE), LOW, ABOVE)

        def towards(distance: FloatArray) -> FloatArray:
            return np.where(gripping, 0.0, np.clip(GAIN * distance, -FREE_SPEED, FREE_SPEED))

        going = np.clip(GAIN * (wanted_height - height), -FREE_SPEED, FREE_SPEED)
        lifting = np.clip(LIFT_GAIN * missing, -LIFT_SPEED, LIFT_SPEED)
        tighter = TIGHTER * np.clip((slip - SLIPPING) / (SLIPPED - SLIPPING), 0.0, 1.0) * holding
        weakly = np.clip((WEAK - force) / (WEAK - WEAKEST), 0.0, 1.0) * self.minds_force
        tighter += TIGHTER_ON_SOFT * weakly * holding
        width = (self.squeeze - tighter) * WIDTH
        fastest = np.where(opening > TOUCHING, FREE_CLOSING_SPEED, CLOSING_SPEED)
        closing = np.clip(CLOSING_GAIN * (width - opening), -fastest, fastest)
        widening = np.clip(FORCE_GAIN * (force - MOST_FORCE), 0.0, FORCE_SPEED)
        closing = np.where((force > MOST_FORCE) & self.minds_force, widening, closing)
        return {
            "velocity_x": towards(along),
            "velocity_y": towards(across),
            "velocity_z": np.where(holding, lifting, going),
            "jaw_speed": np.where(gripping, closing, CLOSING_GAIN * (OPEN - opening)),
        }

    def _by_force(self, observation: Any) -> Mapping[str, FloatArray]:
        """On a ridge of an organ of one's own, whose width and stiffness differ: closes until the jaws press enough."""
        along, across, down = np.moveaxis(self.part(observation, "ridge_offset"), -1, 0)
        width, low, free = np.moveaxis(self.part(observation, "ridge_shape"), -1, 0)
        opening, height = self.part(observation, "jaw_opening")[..., 0], -down
        forces = self.part(observation, "contact_force")
        force = np.minimum(-forces[..., 1], forces[..., 4])
        open_width = np.minimum(width + ROOM, WIDEST)
        gripping = height < low + AT - LOW
        holding = gripping & (force > LEAST_AIM)
        ready = (np.abs(across) < IN_LINE) & (np.abs(along) < IN_PLACE) & (opening > 0.5 * (width + open_width))
        wanted_height = np.where(ready | (height < free - CLEARANCE), low, free)

        def towards(distance: FloatArray) -> FloatArray:
            return np.where(gripping, 0.0, np.clip(GAIN * distance, -FREE_SPEED, FREE_SPEED))

        going = np.clip(GAIN * (wanted_height - height), -FREE_SPEED, FREE_SPEED)
        lifting = np.clip(LIFT_GAIN * self.error(observation)[..., 0], -LIFT_SPEED, LIFT_SPEED)
        closing = np.clip(FORCE_GAIN * (force - AIM), -FORCE_SPEED, FORCE_SPEED)
        closing = np.where(opening > width + TOUCHING - WIDTH, -CLOSING_SPEED, closing)
        return {
            "velocity_x": towards(along),
            "velocity_y": towards(across),
            "velocity_z": np.where(holding, lifting, going),
            "jaw_speed": np.where(gripping, closing, CLOSING_GAIN * (open_width - opening)),
        }
