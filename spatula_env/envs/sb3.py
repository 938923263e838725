"""Adapter to Stable-Baselines3, which has its own interface for vector environments.

Needs the extra "train".
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from spatula_env.envs.attributes import read_in_worlds, set_in_worlds
from spatula_env.envs.observations import Observation
from spatula_env.envs.vector import SpatulaVectorEnv
from spatula_env.installing import install_hint
from spatula_env.naming import find_environment, vector_spec

try:
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv
except ImportError as error:
    raise ImportError(
        f"spatula_env.envs.sb3 needs Stable-Baselines3: {install_hint('train')}", name=error.name
    ) from error

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

WORLD_METHODS = ("compute_reward", "save", "restore")
"""Methods that can be called for a single world."""


class SpatulaVecEnv(VecEnv):
    """A `SpatulaVectorEnv` as a Stable-Baselines3 `VecEnv`.

    `infos` are plain dictionaries of Python numbers, one for each world. Where an episode has ended, they describe its
    last step, with the last observation as "terminal_observation"; the returned observation is the next episode's
    first, and `reset_infos` holds its info.

    Attributes:
        env: The vector environment.
    """

    def __init__(self, env: SpatulaVectorEnv) -> None:
        """Adapt an environment.

        Args:
            env: Environment with `autoreset_mode="same_step"`; closed by `close`.

        Raises:
            ValueError: If it has another autoreset mode.
        """
        if not isinstance(env, SpatulaVectorEnv):
            raise ValueError(f"env must be a vector environment of this package, got {env!r}")
        if env.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            raise ValueError(
                f"env must have been made with autoreset_mode='same_step', got {env.metadata['autoreset_mode']}"
            )
        self.env = env
        self._actions: NDArray[Any] = np.zeros(env.action_space.shape or (), dtype=np.float32)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.metadata = {name: env.metadata[name] for name in ("render_modes", "render_fps")}

    def reset(self) -> Observation:
        """Begin new episodes in all worlds, with the seeds and options set since the last reset."""
        if not any(self._options):
            observation, infos = self.env.reset(seed=self._seeds)
            self.reset_infos = _split(infos, self.num_envs)
        else:
            # Worlds may have different options.
            for world, options in enumerate(self._options):
                mask = np.arange(self.num_envs) == world
                observation, infos = self.env.reset(seed=self._seeds, options={**options, "reset_mask": mask})
                self.reset_infos[world] = _split(infos, self.num_envs)[world]
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions (W, A) for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Observation, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Step all worlds.

        Returns:
            Observations, rewards (W,), whether episodes have ended (W,), and infos.

        Raises:
            ValueError: If the actions have the wrong shape or are not finite; nothing is changed in this case.
        """
        observation, rewards, terminated, truncated, infos = self.env.step(self._actions)
        dones = terminated | truncated
        now = _split(infos, self.num_envs)
        if dones.any():
            final = _split(infos["final_info"], self.num_envs)
            for world in np.flatnonzero(dones).tolist():
                self.reset_infos[world] = now[world]
                now[world] = {**final[world], "terminal_observation": infos["final_obs"][world]}
        for info, cut in zip(now, (truncated & ~terminated).tolist(), strict=True):
            info["TimeLimit.truncated"] = cut
        return observation, rewards.astype(np.float32), dones, now

    def close(self) -> None:
        """Close the vector environment."""
        self.env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A picture of each world, or None for each if the environment draws none."""
        if self.render_mode != "rgb_array":
            warnings.warn(
                f"there are no pictures with render_mode={self.render_mode!r}; make the environment with 'rgb_array'",
                stacklevel=2,
            )
            return [None] * self.num_envs
        return list(self.env.render() or ())

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of each world; attributes that do not belong to single worlds are shared by all.

        Args:
            attr_name: Name of the attribute.
            indices: Worlds to read; None for all.

        Raises:
            AttributeError: If there is none.
        """
        values = read_in_worlds(self.env, attr_name)
        return [values[world] for world in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the environment, for all worlds.

        Args:
            attr_name: "_max_episode_steps", a property with a setter, or an attribute that a subclass has added.
            value: The new value.
            indices: All worlds, or None.

        Raises:
            AttributeError: If there is no such attribute, or setting it would have no effect.
            ValueError: If only some worlds are given, as worlds share their attributes.
        """
        worlds = sorted(self._get_indices(indices))
        if worlds != list(range(self.num_envs)):
            raise ValueError(f"indices must name all {self.num_envs} worlds, which share {attr_name!r}; got {worlds}")
        set_in_worlds(self.env, attr_name, [value] * self.num_envs)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method for some worlds.

        Args:
            method_name: "compute_reward"; "save", which returns the state of each world; or "restore", which sets each
                of them to one state. Worlds cannot be reset or stepped one by one.
            *method_args: Arguments of the method.
            indices: Worlds to call it for; None for all.
            **method_kwargs: Keyword arguments of the method.

        Returns:
            Result of each call; for "restore", the observation and the info of each world.

        Raises:
            AttributeError: If it is another method, or the environment has no goal interface.
        """
        if method_name not in WORLD_METHODS:
            raise AttributeError(f"method_name must be one of {list(WORLD_METHODS)}, got {method_name!r}")
        worlds = list(self._get_indices(indices))
        if method_name == "save":
            return [self.env.save([world], *method_args, **method_kwargs) for world in worlds]
        if method_name == "restore":
            state = method_args[0] if method_args else method_kwargs["state"]
            observation, infos = self.env.restore(state, worlds)
            told = _split(infos, self.num_envs)
            return [(_row(observation, world), told[world]) for world in worlds]
        method = getattr(self.env, method_name)
        return [method(*method_args, **method_kwargs) for _ in worlds]

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """False for each world, as single worlds are never wrapped."""
        return [False for _ in self._get_indices(indices)]


def make_sb3_vec_env(id: str, num_envs: int, *, seed: int | None = None, **kwargs: Any) -> SpatulaVecEnv:
    """Make an environment of this package for Stable-Baselines3.

    Example:
        >>> from stable_baselines3 import PPO
        >>> from stable_baselines3.common.vec_env import VecMonitor
        >>> from spatula_env.envs.sb3 import make_sb3_vec_env
        >>> env = VecMonitor(make_sb3_vec_env("Spatula/Press-v0", 64, seed=0))
        >>> model = PPO("MlpPolicy", env)

    Args:
        id: See `spatula_env.naming.find_environment`; may be a user's own environment, "module:id".
        num_envs: Number of worlds.
        seed: World k's first episode is drawn from seed + k; None for a random seed.
        **kwargs: Further arguments of the environment, such as `engine` and `max_episode_steps`.

    Returns:
        The environment. It does not record returns and lengths: wrap it in `VecMonitor` for that.

    Raises:
        ImportError: If the module of `id` cannot be imported.
        ValueError: If `id` is not that of an environment of this package or built on it, or an argument is out of its
            range.
    """
    spec = vector_spec(find_environment(id))
    made = gymnasium.make_vec(spec, num_envs=num_envs, autoreset_mode="same_step", **kwargs)
    env = SpatulaVecEnv(cast("SpatulaVectorEnv", made.unwrapped))
    if seed is not None:
        env.seed(seed)
    return env


def _row(observation: Observation, world: int) -> Observation:
    """The observation of one world."""
    if isinstance(observation, dict):
        return {name: values[world] for name, values in observation.items()}
    return np.asarray(observation[world])


def _split(infos: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """Split infos of arrays (W,) into a dictionary of plain Python values for each world; masks are left out."""
    names = [name for name in infos if not name.startswith("_") and not name.startswith("final_")]
    if not names:
        return [{} for _ in range(count)]
    columns = [infos[name].tolist() for name in names]
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]
