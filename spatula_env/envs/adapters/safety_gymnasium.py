"""Safety-Gymnasium's interface: `step` returns six values, the third of which is the cost.

Safety-Gymnasium itself (1.0.0, 2023) is not needed, and cannot be installed together with Gymnasium 1.
Interface: https://safety-gymnasium.readthedocs.io.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from spatula_env.envs.episode_sums import values_of_step
from spatula_env.envs.vector_wrapper import TransparentVectorWrapper
from spatula_env.geometry.checks import check_positive

StepWithCost = tuple[Any, float, float, bool, bool, dict[str, Any]]
VectorStepWithCost = tuple[Any, NDArray[Any], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]


class SafetyGymnasiumWrapper(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """One environment whose `step` returns observation, reward, cost, terminated, truncated and info.

    Example:
        >>> import gymnasium as gym
        >>> import spatula_env
        >>> from spatula_env.envs.adapters.safety_gymnasium import SafetyGymnasiumWrapper
        >>> env = SafetyGymnasiumWrapper(gym.make("Spatula/Press-v0"))
    """

    def __init__(self, env: gymnasium.Env[Any, Any], cost_scale: float = 1.0) -> None:
        """Wrap an environment.

        Args:
            env: An environment whose info holds "cost" [s].
            cost_scale: Factor on the cost [1/s]; `info["cost"]` is not scaled.

        Raises:
            ValueError: If the factor is not positive.
        """
        check_positive(cost_scale, "cost_scale")
        RecordConstructorArgs.__init__(self, cost_scale=cost_scale)
        gymnasium.Wrapper.__init__(self, env)
        self._scale = float(cost_scale)

    def step(self, action: Any) -> StepWithCost:  # type: ignore[override]
        """Step the environment.

        Returns:
            Observation, reward, cost, terminated, truncated and info.
        """
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, float(reward), self._scale * float(info["cost"]), terminated, truncated, info


class SafetyGymnasiumVectorWrapper(TransparentVectorWrapper, RecordConstructorArgs):
    """Many environments whose `step` returns observations, rewards, costs, terminations, truncations and infos.

    In the autoreset mode "same_step", which is Safety-Gymnasium's own, costs are those of the step taken even if it
    ended an episode, and `infos["final_observation"]` is an alias of `infos["final_obs"]`.

    Example:
        >>> import gymnasium as gym
        >>> import spatula_env
        >>> from spatula_env.envs.adapters.safety_gymnasium import SafetyGymnasiumVectorWrapper
        >>> envs = gym.make_vec("Spatula/Press-v0", num_envs=4, autoreset_mode="same_step")
        >>> envs = SafetyGymnasiumVectorWrapper(envs)
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], cost_scale: float = 1.0) -> None:
        """Wrap an environment.

        Args:
            env: A vector environment whose infos hold "cost" [s].
            cost_scale: Factor on the costs [1/s]; `infos["cost"]` is not scaled.

        Raises:
            ValueError: If the factor is not positive.
        """
        check_positive(cost_scale, "cost_scale")
        RecordConstructorArgs.__init__(self, cost_scale=cost_scale)
        TransparentVectorWrapper.__init__(self, env)
        self._scale = float(cost_scale)

    def step(self, actions: Any) -> VectorStepWithCost:  # type: ignore[override]
        """Step all environments.

        Returns:
            Observations, rewards (W,), costs (W,), terminations (W,), truncations (W,) and infos.
        """
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        costs = self._scale * np.asarray(values_of_step(infos, "cost"), dtype=np.float64)
        if "final_obs" in infos:
            infos["final_observation"], infos["_final_observation"] = infos["final_obs"], infos["_final_obs"]
        return observations, rewards, costs, terminations, truncations, infos
