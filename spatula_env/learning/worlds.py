"""Training environments for Stable-Baselines3.

Needs the extra "train".
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecMonitor, VecNormalize

from spatula_env.envs.sb3 import SpatulaVecEnv, make_sb3_vec_env
from spatula_env.learning.configuration import TrainingConfig
from spatula_env.learning.networks import keep_pictures, vector_names
from spatula_env.learning.threads import numba_threads
from spatula_env.policies import PartSelection

Observation = Any


class OverlappedVecEnv(VecEnvWrapper):
    """Steps its worlds in a second thread, and runs a function meanwhile.

    The compiled code that steps the worlds releases the GIL, so both really run in parallel. The function must not
    touch the environment. The results are the same as one after the other.

    Attributes:
        meanwhile: Function to run while worlds are stepped; None for none.
    """

    def __init__(self, venv: VecEnv) -> None:
        """Wrap an environment."""
        super().__init__(venv)
        self.meanwhile: Callable[[], None] | None = None
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="worlds")
        self._stepping: Future[Any] | None = None

    def reset(self) -> Observation:
        """Begin new episodes in all worlds."""
        return self._thread.submit(self.venv.reset).result()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Start stepping the worlds."""
        self._stepping = self._thread.submit(self.venv.step, np.array(actions))

    def step_wait(self) -> Any:
        """Run `meanwhile`, and wait for the worlds."""
        assert self._stepping is not None, "step_async was not called"
        try:
            if self.meanwhile is not None:
                self.meanwhile()
        finally:
            # Whatever happened here, do not leave the worlds in the middle of a step.
            result = self._stepping.result()
        return result

    def close(self) -> None:
        """Wait for the worlds, and close them."""
        self._thread.shutdown(wait=True)
        super().close()


class PartsVecEnv(VecEnvWrapper):
    """Reduces the observation to some parts.

    Attributes:
        selection: Selected parts.
    """

    def __init__(self, venv: VecEnv, selection: PartSelection) -> None:
        """Wrap an environment.

        Args:
            venv: Environment whose observations are one vector, or a dictionary with one under "observation".
            selection: Selected parts.
        """
        super().__init__(venv, observation_space=selection.space(venv.observation_space))
        self.selection = selection

    def reset(self) -> Observation:
        """Begin new episodes in all worlds."""
        return self.selection(self.venv.reset())

    def step_wait(self) -> Any:
        """Wait for the worlds to finish their step."""
        observation, rewards, dones, infos = self.venv.step_wait()
        for info in infos:
            if "terminal_observation" in info:
                info["terminal_observation"] = self.selection(info["terminal_observation"])
        return self.selection(observation), rewards, dones, infos


def make_training_env(config: TrainingConfig, seed: int, discount: float) -> tuple[VecNormalize | VecEnv, VecEnv]:
    """Make the worlds that an agent learns in.

    Args:
        config: Training configuration.
        seed: World k's first episode is drawn from seed + k.
        discount: Discount factor of the returns by which rewards are normalised.

    Returns:
        The outermost wrapper, which normalises if that is configured, and the `OverlappedVecEnv`.
    """
    environment = config.environment
    overlapped = config.overlap and config.algorithm != "ppo"
    # With one thread, the version of the compiled code is used that can overlap with Python.
    threads = max(1, (os.cpu_count() or 1) - 1) if overlapped else (os.cpu_count() or 1)
    with numba_threads(1 if overlapped and threads == 1 else threads):
        base = make_sb3_vec_env(
            environment.id, environment.num_envs, seed=seed, engine=environment.engine, **environment.kwargs
        )
    overlap = OverlappedVecEnv(base)
    env: VecEnv = overlap
    selection = PartSelection.of(base.env, environment.parts)
    if selection is not None:
        env = PartsVecEnv(env, selection)
    env = VecMonitor(keep_pictures(env))
    normalization = config.normalization
    if normalization.observations or normalization.rewards:
        env = VecNormalize(
            env,
            norm_obs=normalization.observations,
            norm_obs_keys=_normalized(env.observation_space) if normalization.observations else None,
            norm_reward=normalization.rewards,
            clip_obs=normalization.clip,
            clip_reward=normalization.clip,
            gamma=discount,
        )
    return env, overlap


def base_of(env: VecEnv) -> SpatulaVecEnv:
    """The environment below all wrappers."""
    while isinstance(env, VecEnvWrapper):
        env = env.venv
    assert isinstance(env, SpatulaVecEnv)
    return env


def _normalized(space: spaces.Space[Any]) -> list[str] | None:
    """Entries of observations that running estimates normalise; None if observations are one vector."""
    return vector_names(space) if isinstance(space, spaces.Dict) else None
