"""Steering: tools that are told anew before every physics step how to move, as a hand on a haptic device wants it.

Learners act once in a control step. A hand that is read so seldom is followed late: what it feels comes a period
after what it does, and a late spring gives more energy than it took. What learners see of a steered step is the mean.
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
"""Under which `info` tells the track of a steered step, and datasets keep it."""

Pilot: TypeAlias = "Callable[[FloatArray], ArrayLike]"
"""Takes where the grip is (3,), workspace frame [m], and gives the action (A,) of the coming physics step."""


class Steered(Protocol):
    """What is steered: the `Episodes` of one world."""

    steps_per_action: int
    control: VelocityControl
    frames: Frames

    @property
    def grips(self) -> FloatArray:
        """(1, 3) where the middle of the tools is now, workspace frame [m]."""

    def delayed_within(self, action: FloatArray, step: int) -> FloatArray:
        """What is carried out in a physics step (A,), after what is asked in it (A,)."""

    def motion_now(self, action: FloatArray) -> Motion:
        """What the tools do in the coming physics step for an action (A,)."""


class Steering:
    """One control step of one world under a pilot.

    Attributes:
        track: (S, A) what was asked for in each of its physics steps.
    """

    def __init__(self, episodes: Steered, pilot: Pilot) -> None:
        """Prepare.

        Args:
            episodes: Of one world.
            pilot: Who is asked.
        """
        self.track: FloatArray = np.zeros((episodes.steps_per_action, episodes.control.size))
        self._episodes = episodes
        self._pilot = pilot
        self._motions: list[Motion] = []

    def velocities(self, world: int, step: int) -> tuple[FloatArray, FloatArray]:
        """How the tools move in a physics step: linear (N, 3) [u/s] and angular (N, 3) [rad/s]."""
        episodes = self._episodes
        asked = as_action(np.asarray(self._pilot(episodes.grips[world]), dtype=np.float32), episodes.control.size)
        self.track[step] = asked
        motion = episodes.motion_now(episodes.delayed_within(asked, step))
        self._motions.append(motion)
        linear = episodes.frames.velocities_to_scene(motion.linear)
        angular = episodes.frames.rates_to_scene(motion.angular)
        return np.ascontiguousarray(linear[world]), np.ascontiguousarray(angular[world])

    def motion(self) -> Motion:
        """What was asked for, on average."""
        fields = {name: [getattr(motion, name) for motion in self._motions] for name in vars(self._motions[0])}
        return Motion(**{name: np.mean(values, axis=0) for name, values in fields.items()})


def mean_of_track(track: FloatArray) -> FloatArray:
    """The mean (..., A) of tracks (..., S, A); exactly what all rows are, where all are the same."""
    first = track[..., 0, :]
    return np.asarray(first + (track - first[..., None, :]).mean(axis=-2))
