"""Adapter to rl_games, which has its own interface for vector environments.

By itself, rl_games would run each environment in a process of its own; registered as here, all worlds are stepped by
the batch engine. Needs `pip install rl-games`.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from spatula_env.envs.episode_sums import values_of_step

try:
    from rl_games.common import env_configurations, vecenv
    from rl_games.common.ivecenv import IVecEnv
except ImportError as error:
    raise ImportError(
        "spatula_env.envs.adapters.rl_games needs rl_games: pip install rl-games", name=error.name
    ) from error

VECENV_TYPE = "SPATULA"
"""Name of `RlGamesVecEnv` in rl_games."""


class RlGamesVecEnv(IVecEnv):  # type: ignore[misc]
    """Many environments behind rl_games' `IVecEnv`.

    `infos` of a step are those of `gymnasium.make_vec`, with two additions: "time_outs" (W,), whether an episode was
    truncated rather than terminated, with which rl_games bootstraps the value (`value_bootstrap: True`); and "scores"
    (W,), one where an ended episode was a success, whose mean rl_games reports.

    Attributes:
        envs: The vector environment.
    """

    def __init__(self, num_envs: int, id: str, *, seed: int | None = None, **kwargs: Any) -> None:
        """Make an environment.

        Args:
            num_envs: Number of worlds, W; rl_games' `num_actors`.
            id: Id as `gymnasium.make_vec` takes it.
            seed: World k's first episode is drawn from seed + k; None for a random seed, or the one set by the method
                `seed`.
            **kwargs: Further arguments of the environment.
        """
        self.envs = gymnasium.make_vec(id, num_envs=num_envs, autoreset_mode="same_step", **kwargs)
        self._seed = seed

    def seed(self, seed: int | None) -> None:
        """Set the seed for the next `reset`."""
        self._seed = seed

    def reset(self) -> Any:
        """Begin new episodes in all worlds.

        Returns:
            Observations.
        """
        observations, _ = self.envs.reset(seed=self._seed)
        self._seed = None
        return observations

    def step(self, actions: NDArray[Any]) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], dict[str, Any]]:
        """Step all worlds.

        Args:
            actions: (W, A).

        Returns:
            Observations, rewards (W,), whether episodes are over (W,) and infos.
        """
        observations, rewards, terminations, truncations, infos = self.envs.step(actions)
        infos["time_outs"] = truncations & ~terminations
        infos["scores"] = values_of_step(infos, "is_success").astype(np.float32)
        return observations, np.asarray(rewards, dtype=np.float32), terminations | truncations, infos

    def get_env_info(self) -> dict[str, spaces.Space[Any]]:
        """The spaces of one world."""
        return {
            "observation_space": self.envs.single_observation_space,
            "action_space": self.envs.single_action_space,
        }

    def close(self) -> None:
        """Free the engine."""
        self.envs.close()


def register_rl_games(name: str = "spatula") -> None:
    """Register the environments with rl_games; calling it again is allowed.

    Args:
        name: Name in rl_games' configurations (`env_name`), whose `env_config` holds `id` and further arguments.
    """

    def make_many(config_name: str, num_actors: int, **kwargs: Any) -> RlGamesVecEnv:
        return RlGamesVecEnv(num_actors, **kwargs)

    def make_one(**kwargs: Any) -> gymnasium.Env[Any, Any]:
        options = {name: value for name, value in kwargs.items() if name != "seed"}
        return gymnasium.make(**options)

    vecenv.register(VECENV_TYPE, make_many)
    env_configurations.register(name, {"vecenv_type": VECENV_TYPE, "env_creator": make_one})
