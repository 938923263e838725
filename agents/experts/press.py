"""A scripted policy for Spatula/Press-v0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spatula_env.envs.press import PressEnv

if TYPE_CHECKING:
    import gymnasium

PLACE_GAIN = 8.0
"""Horizontal speed per distance to the place [1/s]."""

DEPTH_GAIN = 6.0
"""Vertical speed per error of the depth [1/s]."""

FREE_SPEED = 0.06
"""Of the descent to the organ [m/s]."""

NEAR = 0.004
"""The spatula descends when it is closer to the place than this, horizontally [m]."""


class PressExpert:
    """Goes above the place, descends, and regulates the depth that it sees.

    It has no memory: the action follows from the observation. It sees no more than an agent does.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        """Learn how the observations of an environment are laid out.

        Args:
            env: A press environment, wrapped or not, in any observation mode and with any reward.

        Raises:
            ValueError: If it is not one.
        """
        if not isinstance(env.unwrapped, PressEnv):
            raise ValueError(f"env must be a press environment, got {env}")
        builder = env.unwrapped.observation_builder
        self._slices = builder.slices
        self._max_speed = float(next(part.high[0] for part in builder.parts if part.name == "tool_velocity"))

    def __call__(self, observation: Any) -> NDArray[np.float32]:
        """The action (3,) for an observation."""
        if isinstance(observation, Mapping) and "desired_goal" in observation:
            error = observation["desired_goal"] - observation["achieved_goal"]
        else:
            error = self._part(observation, "error")
        x, y, depth = (float(number) for number in error)
        share = float(self._part(observation, "contact_share").max())
        if np.hypot(x, y) > NEAR:
            down = 0.0
        elif share == 0.0:
            down = FREE_SPEED
        else:
            down = DEPTH_GAIN * depth
        velocity = np.array([PLACE_GAIN * x, PLACE_GAIN * y, -down])
        return np.clip(velocity / self._max_speed, -1.0, 1.0).astype(np.float32)

    def _part(self, observation: Any, name: str) -> NDArray[np.float32]:
        if isinstance(observation, Mapping):
            if name in observation:
                return np.asarray(observation[name])
            observation = observation["observation"]
        return np.asarray(observation)[self._slices[name]]
