"""Adapter to Tianshou, whose collectors need a base class of its own.

Needs `pip install tianshou`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

try:
    from tianshou.env import BaseVectorEnv
except ImportError as error:
    raise ImportError(
        "spatula_env.envs.adapters.tianshou needs Tianshou: pip install tianshou", name=error.name
    ) from error

Worlds = int | Sequence[int] | NDArray[np.int64] | None


class TianshouVectorEnv(BaseVectorEnv):  # type: ignore[misc]
    """Many environments behind Tianshou's `BaseVectorEnv`; `len` is their number W.

    Collectors reset the worlds whose episodes are over, and towards the end step only some of them. The batch engine
    always steps all: worlds that were left out have moved on meanwhile, and must be reset before they are stepped
    again, as collectors do.

    Example:
        >>> from spatula_env.envs.adapters.tianshou import TianshouVectorEnv
        >>> envs = TianshouVectorEnv("Spatula/Press-v0", 64)

    Attributes:
        envs: The vector environment.
    """

    def __init__(self, id: str, num_envs: int, **kwargs: Any) -> None:
        """Make an environment.

        Args:
            id: Id as `gymnasium.make_vec` takes it.
            num_envs: Number of worlds, W.
            **kwargs: Further arguments of the environment.
        """
        # Do not call the base class's constructor, which would make W workers.
        self.envs: VectorEnv[Any, Any, Any] = gymnasium.make_vec(
            id, num_envs=num_envs, autoreset_mode="next_step", **kwargs
        )
        self.env_num = num_envs
        self.is_async = False
        self.is_closed = False
        self._seeds: list[int | None] = [None] * num_envs
        self._passed_over = np.zeros(num_envs, dtype=np.bool_)
        self._over = np.zeros(num_envs, dtype=np.bool_)
        self._begun = False

    def reset(self, env_id: Worlds = None, **kwargs: Any) -> tuple[Any, NDArray[np.object_]]:
        """Begin new episodes in all worlds, or in some.

        Args:
            env_id: (n,) worlds to reset; None for all.
            **kwargs: "seed" and "options", as Gymnasium's `reset` takes them.

        Returns:
            Observations of these worlds, and (n,) dictionaries of info.
        """
        self._assert_is_not_closed()
        worlds = self._indices(env_id)
        mask = np.zeros(self.env_num, dtype=np.bool_)
        mask[worlds] = True
        if not (self._begun or mask.all()):
            raise RuntimeError("reset all worlds before some of them")
        seed = kwargs.get("seed", [one if chosen else None for one, chosen in zip(self._seeds, mask, strict=True)])
        options = {**(kwargs.get("options") or {}), "reset_mask": mask}
        observations, infos = self.envs.reset(seed=seed, options=options)
        self._seeds = [None if chosen else one for one, chosen in zip(self._seeds, mask, strict=True)]
        self._begun = True
        self._over[worlds] = self._passed_over[worlds] = False
        return _rows(observations, worlds), self._infos(infos, worlds)

    def step(self, action: Any, id: Worlds = None) -> tuple[Any, Any, Any, Any, NDArray[np.object_]]:
        """Step some worlds.

        Args:
            action: (n, A) actions.
            id: (n,) worlds to step; None for all.

        Returns:
            Observations, rewards (n,), terminations (n,), truncations (n,), and (n,) dictionaries of info.

        Raises:
            RuntimeError: If a world's episode is over, or others were stepped without it since its last step.
        """
        self._assert_is_not_closed()
        worlds = self._indices(id)
        for which, what in ((self._over, "are over"), (self._passed_over, "went on while others were stepped")):
            if which[worlds].any():
                raise RuntimeError(f"the episodes of worlds {worlds[which[worlds]].tolist()} {what}: reset them first")
        space = self.envs.single_action_space
        actions = np.zeros((self.env_num, *(space.shape or ())), dtype=space.dtype)
        actions[worlds] = np.asarray(action)
        observations, rewards, terminations, truncations, infos = self.envs.step(actions)
        rest = np.ones(self.env_num, dtype=np.bool_)
        rest[worlds] = False
        self._passed_over |= rest
        self._over = np.where(rest, self._over, terminations | truncations)
        return (
            _rows(observations, worlds),
            rewards[worlds],
            terminations[worlds],
            truncations[worlds],
            self._infos(infos, worlds),
        )

    def seed(self, seed: int | Sequence[int] | None = None) -> list[int | None]:
        """Set the seeds for the next `reset`: seed + k for world k, or element k of a sequence.

        Returns:
            The seeds of the worlds.
        """
        self._assert_is_not_closed()
        if seed is None:
            self._seeds = [None] * self.env_num
        elif isinstance(seed, int):
            self._seeds = [seed + world for world in range(self.env_num)]
        else:
            self._seeds = list(seed)
        return list(self._seeds)

    def render(self, **kwargs: Any) -> list[Any]:
        """A picture of each world, with `render_mode="rgb_array"`."""
        self._assert_is_not_closed()
        return list(self.envs.render() or [None] * self.env_num)

    def close(self) -> None:
        """Free the engine."""
        self._assert_is_not_closed()
        self.envs.close()
        self.is_closed = True

    def get_env_attr(self, key: str, id: Worlds = None) -> list[Any]:
        """An attribute of each world; attributes that do not belong to single worlds are shared by all.

        Raises:
            AttributeError: If there is none.
        """
        self._assert_is_not_closed()
        name = f"single_{key}" if key in ("observation_space", "action_space") else key
        value = (-np.inf, np.inf) if key == "reward_range" else getattr(self.envs, name)
        return [value for _ in self._indices(id)]

    def set_env_attr(self, key: str, value: Any, id: Worlds = None) -> None:
        """Raise an error: worlds share their attributes, which are set on construction.

        Raises:
            AttributeError: Always.
        """
        raise AttributeError(f"{key!r} cannot be set for single worlds; make the environment with it")

    def _indices(self, id: Worlds) -> NDArray[np.int64]:
        return np.arange(self.env_num) if id is None else np.atleast_1d(np.asarray(id, dtype=np.int64))

    def _infos(self, infos: dict[str, Any], worlds: NDArray[np.int64]) -> NDArray[np.object_]:
        """(n,) dictionaries of Python numbers."""
        names = [name for name in infos if not name.startswith("_")]
        result = np.empty(len(worlds), dtype=object)
        result[:] = [{**{name: infos[name][world].item() for name in names}, "env_id": world} for world in worlds]
        return result


def _rows(observations: Any, worlds: NDArray[np.int64]) -> Any:
    """Observations of some worlds (n,); dictionaries become an array of one dictionary each, which Tianshou stacks."""
    if not isinstance(observations, dict):
        return observations[worlds]
    result = np.empty(len(worlds), dtype=object)
    result[:] = [{name: values[world] for name, values in observations.items()} for world in worlds]
    return result
