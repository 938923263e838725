"""Sums over an episode, such as return, length and cost, in every autoreset mode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from spatula_env.envs.vector_wrapper import TransparentVectorWrapper


def values_of_step(infos: Mapping[str, Any], name: str) -> NDArray[Any]:
    """The values of a step of a vector environment, whether or not episodes ended in it.

    In the mode "same_step", `infos[name]` belongs to the beginning of the next episode where one has ended: it says
    nothing about the step that was taken, so that its cost reads zero and its success is lost. The values of the step
    are in `infos["final_info"]`.

    Args:
        infos: Infos of a step of an environment in any autoreset mode.
        name: Name of a value, such as "cost".

    Returns:
        (W,) values, as a new array.

    Raises:
        KeyError: If there is no value of this name.
    """
    if "final_info" not in infos:
        return np.array(infos[name])
    ended, final = infos["_final_info"], infos["final_info"]
    if name not in infos:
        return np.array(final[name])
    return np.asarray(np.where(ended, final[name], infos[name]))


class RecordEpisodeSums(TransparentVectorWrapper, RecordConstructorArgs):
    """Sums return, length and any values of info over each episode, in every autoreset mode.

    In the step that ends an episode, `infos["episode"]` holds "r" (the return), "l" (the number of steps) and the sum
    under each name, (W,) each, and `infos["_episode"]` tells for which worlds: the layout of Gymnasium's
    `RecordEpisodeStatistics`, which does not sum costs. In the mode "next_step", the step that begins an episode counts
    for neither episode, and in the mode "same_step" the values of the last step are taken from `infos["final_info"]`.

    Example:
        >>> import gymnasium as gym
        >>> import spatula_env
        >>> from spatula_env.envs.episode_sums import RecordEpisodeSums
        >>> envs = RecordEpisodeSums(gym.make_vec("Spatula/Press-v0", num_envs=4, autoreset_mode="same_step"))
    """

    def __init__(
        self, env: VectorEnv[Any, Any, Any], names: Sequence[str] = ("cost",), stats_key: str = "episode"
    ) -> None:
        """Wrap an environment.

        Args:
            env: Environment in any autoreset mode, of this package or Gymnasium's own.
            names: Names of the values of info to sum.
            stats_key: Key of the sums in `infos`.

        Raises:
            ValueError: If a name is used twice, or is "r" or "l".
        """
        names = tuple(names)
        if len({"r", "l", *names}) != len(names) + 2:
            raise ValueError(f"names must differ, and from 'r' and 'l', got {list(names)}")
        RecordConstructorArgs.__init__(self, names=names, stats_key=stats_key)
        TransparentVectorWrapper.__init__(self, env)
        self._names, self._key = names, stats_key
        self._mode = env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)
        self._sums = {name: np.zeros(self.num_envs) for name in ("r", *names)}
        self._lengths = np.zeros(self.num_envs, dtype=np.int64)
        self._over = np.zeros(self.num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin new episodes and their sums; see the environment."""
        mask = (options or {}).get("reset_mask")
        # Copied because Gymnasium's vector environments remove the mask from the options that they are given.
        result = self.env.reset(seed=seed, options=None if options is None else dict(options))  # type: ignore[arg-type]
        self._begin(np.ones(self.num_envs, dtype=np.bool_) if mask is None else np.asarray(mask))
        return result

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step all worlds; see the environment, and the class for the additional infos.

        Raises:
            KeyError: If a name is missing in infos.
            ValueError: If another wrapper has already used the key of the sums.
        """
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        if self._key in infos:
            raise ValueError(f"infos hold {self._key!r} already; choose another stats_key")
        going = ~self._over
        self._sums["r"] += np.where(going, rewards, 0.0)
        for name in self._names:
            self._sums[name] += np.where(going, values_of_step(infos, name), 0.0)
        self._lengths += going
        self._begin(self._over)
        ended = np.asarray(terminations | truncations)
        if ended.any():
            sums = {**self._sums, "l": self._lengths}
            infos[self._key] = {name: np.where(ended, values, values.dtype.type(0)) for name, values in sums.items()}
            infos[f"_{self._key}"] = ended.copy()
        if self._mode is AutoresetMode.SAME_STEP:
            self._begin(ended)
        else:
            self._over = ended.copy()
        return observations, rewards, terminations, truncations, infos

    def _begin(self, worlds: NDArray[np.bool_]) -> None:
        """Reset the sums of some worlds (W,)."""
        for values in (*self._sums.values(), self._lengths):
            values[worlds] = 0
        self._over = self._over & ~worlds
