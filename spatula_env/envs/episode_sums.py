"""Sums over an episode: return, length, cost and others, in every autoreset mode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from spatula_env.envs.vector_wrapper import TransparentVectorWrapper


def values_of_step(infos: Mapping[str, Any], name: str) -> NDArray[Any]:
    """What a step of a vector environment led to, whether or not an episode ended in it.

    In the mode "same_step" `infos[name]` is of the next episode's beginning where one has ended: there it says
    nothing of the step that was taken, a cost is zero and a success is forgotten. What belongs to the step is in
    `infos["final_info"]`.

    Args:
        infos: Of a step, of an environment in any autoreset mode.
        name: Such as "cost".

    Returns:
        (W,) an array of its own.

    Raises:
        KeyError: If there is no such name.
    """
    if "final_info" not in infos:
        return np.array(infos[name])
    ended, final = infos["_final_info"], infos["final_info"]
    if name not in infos:
        return np.array(final[name])
    return np.asarray(np.where(ended, final[name], infos[name]))


class RecordEpisodeSums(TransparentVectorWrapper, RecordConstructorArgs):
    """Adds up return, length and any numbers of info over each episode, in every autoreset mode.

    In the step that ends an episode, `infos["episode"]` holds "r" (the return), "l" (the number of steps) and the sum
    under each name, (W,) each, and `infos["_episode"]` tells for which worlds: the layout of Gymnasium's
    `RecordEpisodeStatistics`, which knows of no cost. The step that begins an episode in the mode "next_step" counts
    for neither the old one nor the new one, and in the mode "same_step" the last step's numbers are taken from
    `infos["final_info"]`.

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
            env: In any autoreset mode; one of this package, or Gymnasium's own of several.
            names: Of numbers in info to add up.
            stats_key: Where the sums are in `infos`.

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
        """Begin new episodes, and sums of them; see the environment."""
        mask = (options or {}).get("reset_mask")
        # Gymnasium's vector environments take the mask out of the options that they are given.
        result = self.env.reset(seed=seed, options=None if options is None else dict(options))  # type: ignore[arg-type]
        self._begin(np.ones(self.num_envs, dtype=np.bool_) if mask is None else np.asarray(mask))
        return result

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step all worlds; see the environment, and the class for what infos tell besides.

        Raises:
            KeyError: If a name is not in infos.
            ValueError: If another wrapper has put something where the sums are to be.
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
        """Forget the sums of some worlds (W,)."""
        for values in (*self._sums.values(), self._lengths):
            values[worlds] = 0
        self._over = self._over & ~worlds
