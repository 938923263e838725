"""LeRobot's names of observations, and the factory function for its EnvHub.

LeRobot itself (0.6, Python 3.12 or later) need not be installed for this module. When it evaluates policies, an
environment observes "pixels", one picture or a dictionary of cameras, and "agent_pos", the robot's own state; in its
datasets the same are called `observation.images.<camera>` and `observation.state`, the names that
`spatula_env.data.export_lerobot` writes.
"""

from __future__ import annotations

from typing import Any

import gymnasium
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space

from spatula_env.envs.vector_wrapper import TransparentVectorWrapper

CAMERA = "front"
"""Name of the camera in datasets written by `export_lerobot`."""


class LeRobotWrapper(gymnasium.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """One environment that observes "pixels" and "agent_pos".

    Example:
        >>> import gymnasium as gym
        >>> import spatula_env
        >>> from spatula_env.envs.adapters.lerobot import LeRobotWrapper
        >>> env = LeRobotWrapper(gym.make("Spatula/Press-v0", obs_mode="rgb"))
    """

    def __init__(self, env: gymnasium.Env[Any, Any], camera: str | None = CAMERA) -> None:
        """Wrap an environment.

        Args:
            env: An environment with `obs_mode="rgb"`, or `"state"` for no pictures, and `reward="dense"`.
            camera: Name of the camera in the dictionary "pixels"; None to make "pixels" the picture itself.

        Raises:
            ValueError: If the environment observes something that LeRobot has no name for.
        """
        RecordConstructorArgs.__init__(self, camera=camera)
        gymnasium.ObservationWrapper.__init__(self, env)
        self._camera = camera
        self.observation_space = _renamed_space(env.observation_space, camera)

    def observation(self, observation: Any) -> dict[str, Any]:
        """Rename an observation's entries."""
        return _renamed(observation, self._camera)


class LeRobotVectorWrapper(TransparentVectorWrapper, RecordConstructorArgs):
    """Many environments that observe "pixels" and "agent_pos".

    Example:
        >>> import gymnasium as gym
        >>> import spatula_env
        >>> from spatula_env.envs.adapters.lerobot import LeRobotVectorWrapper
        >>> envs = LeRobotVectorWrapper(gym.make_vec("Spatula/Press-v0", num_envs=4, obs_mode="rgb"))
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], camera: str | None = CAMERA) -> None:
        """Wrap an environment.

        Args:
            env: An environment with `obs_mode="rgb"`, or `"state"` for no pictures, and `reward="dense"`.
            camera: Name of the camera in the dictionary "pixels"; None to make "pixels" the pictures themselves.

        Raises:
            ValueError: If the environment observes something that LeRobot has no name for.
        """
        RecordConstructorArgs.__init__(self, camera=camera)
        TransparentVectorWrapper.__init__(self, env)
        self._camera = camera
        self.single_observation_space = _renamed_space(env.single_observation_space, camera)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin new episodes; see the environment."""
        observations, infos = self.env.reset(seed=seed, options=options)
        return _renamed(observations, self._camera), infos

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step all environments; the final observations of episodes are renamed as well."""
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        for world, last in enumerate(infos.get("final_obs", ())):
            if last is not None:
                infos["final_obs"][world] = _renamed(last, self._camera)
        return _renamed(observations, self._camera), rewards, terminations, truncations, infos


def make_hub_env(
    id: str, n_envs: int = 1, use_async_envs: bool = False, camera: str | None = CAMERA, **kwargs: Any
) -> LeRobotVectorWrapper:
    """Make environments as `make_env(n_envs, use_async_envs)` in an EnvHub repository's `env.py` has to return them.

    Args:
        id: Id as `gymnasium.make_vec` takes it.
        n_envs: Number of environments.
        use_async_envs: Whether each runs in a process of its own, with the engine "bullet"; else the batch engine steps
            all.
        camera: See `LeRobotVectorWrapper`.
        **kwargs: Further arguments of the environment; `obs_mode` is "rgb" by default.
    """
    options: dict[str, Any] = {"obs_mode": "rgb", "render_mode": "rgb_array", **kwargs}
    if use_async_envs:
        options["vectorization_mode"] = "async"
    return LeRobotVectorWrapper(gymnasium.make_vec(id, num_envs=n_envs, **options), camera)


def _renamed(observation: Any, camera: str | None) -> dict[str, Any]:
    """An observation or a batch under LeRobot's names."""
    if not isinstance(observation, dict):
        return {"agent_pos": observation}
    pictures = observation["image"]
    return {"pixels": pictures if camera is None else {camera: pictures}, "agent_pos": observation["state"]}


def _renamed_space(space: spaces.Space[Any], camera: str | None) -> spaces.Dict:
    """The space of renamed observations of one environment."""
    if isinstance(space, spaces.Box):
        return spaces.Dict({"agent_pos": space})
    if not isinstance(space, spaces.Dict) or set(space.spaces) != {"image", "state"}:
        raise ValueError(
            "env must observe pictures (obs_mode='rgb') or one vector (obs_mode='state'), with reward='dense'; "
            f"it observes {sorted(space.spaces) if isinstance(space, spaces.Dict) else space}"
        )
    picture, state = space["image"], space["state"]
    return spaces.Dict({"pixels": picture if camera is None else spaces.Dict({camera: picture}), "agent_pos": state})
