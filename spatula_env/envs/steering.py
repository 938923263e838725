"""Steering: tools receive a new motion before every physics step, as the hand on a haptic device moves.

Learners act once per control step. A hand that is read that seldom is followed late: the force comes a period after the
motion, and a delayed spring gives out more energy than it took in. Learners see the mean of a steered step's actions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np

from spatula_env.arrays import FloatArray
from spatula_env.envs.control import Motion, as_action

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.envs.control import VelocityControl
    from spatula_env.envs.workspace_frames import Frames

STEERING = "steering"
"""Key of a steered step's track in `info` and in datasets."""

Pilot: TypeAlias = "Callable[[FloatArray], ArrayLike]"
"""Takes the grip's position (3,), workspace frame [m], and returns the action (A,) of the coming physics step."""


class Steered(Protocol):
    """The object that is steered: the `Episodes` of one world."""

    steps_per_action: int
    control: VelocityControl
    frames: Frames

    @property
    def grips(self) -> FloatArray:
        """(1, 3) present position of the grip, workspace frame [m]."""

    def delayed_within(self, action: FloatArray, step: int) -> FloatArray:
        """Action carried out in a physics step (A,), given that requested in it (A,)."""

    def motion_now(self, action: FloatArray) -> Motion:
        """Motion of the tools in the coming physics step for an action (A,)."""


class Steering:
    """One control step of one world, steered by a pilot.

    Attributes:
        track: (S, A) action requested in each of its physics steps.
    """

    def __init__(self, episodes: Steered, pilot: Pilot) -> None:
        """Prepare a control step.

        Args:
            episodes: Episodes of one world.
            pilot: Returns the action of each physics step.
        """
        self.track: FloatArray = np.zeros((episodes.steps_per_action, episodes.control.size))
        self._episodes = episodes
        self._pilot = pilot
        self._motions: list[Motion] = []

    def velocities(self, world: int, step: int) -> tuple[FloatArray, FloatArray]:
        """Motion of the tools in a physics step: linear (N, 3) [u/s] and angular (N, 3) [rad/s]."""
        episodes = self._episodes
        asked = as_action(np.asarray(self._pilot(episodes.grips[world]), dtype=np.float32), episodes.control.size)
        self.track[step] = asked
        motion = episodes.motion_now(episodes.delayed_within(asked, step))
        self._motions.append(motion)
        linear = episodes.frames.velocities_to_scene(motion.linear)
        angular = episodes.frames.rates_to_scene(motion.angular)
        return np.ascontiguousarray(linear[world]), np.ascontiguousarray(angular[world])

    def motion(self) -> Motion:
        """Mean of the requested motions."""
        fields = {name: [getattr(motion, name) for motion in self._motions] for name in vars(self._motions[0])}
        return Motion(**{name: np.mean(values, axis=0) for name, values in fields.items()})


def mean_of_track(track: FloatArray) -> FloatArray:
    """The mean (..., A) of tracks (..., S, A); exactly equal to the rows if all rows are the same."""
    first = track[..., 0, :]
    return np.asarray(first + (track - first[..., None, :]).mean(axis=-2))
