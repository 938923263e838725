"""What docs/rl-libraries.md says of Gymnasium's wrappers for vector environments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import vector

import spatula_env

assert spatula_env.TASKS
MODES = ("next_step", "same_step", "disabled")
WRAPPERS: dict[str, Callable[[gym.vector.VectorEnv], gym.vector.VectorEnv]] = {
    "statistics": vector.RecordEpisodeStatistics,
    "rewards": vector.NormalizeReward,
    "lists": vector.DictInfoToList,
}


def make(mode: str) -> Any:
    return gym.make_vec("Spatula/Press-v0", num_envs=2, max_episode_steps=2, autoreset_mode=mode)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", WRAPPERS)
def test_a_wrapper_goes_through_episodes_in_every_mode(name: str, mode: str) -> None:
    envs = WRAPPERS[name](make(mode))
    envs.reset(seed=0)
    ends = 0
    for _ in range(5):
        _, _, terminations, truncations, _ = envs.step(np.zeros((2, 3), dtype=np.float32))
        ended = terminations | truncations
        ends += int(ended.sum())
        if mode == "disabled" and ended.any():
            envs.reset(options={"reset_mask": ended})
    assert ends == 4
    envs.close()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("wrap", [vector.FlattenObservation, lambda envs: vector.TransformObservation(envs, np.copy)])
def test_what_changes_observations_refuses_same_step_autoreset(
    wrap: Callable[[gym.vector.VectorEnv], gym.vector.VectorEnv], mode: str
) -> None:
    envs = make(mode)
    if mode == "same_step":
        with pytest.raises(ValueError, match="NEXT_STEP or DISABLED"):
            wrap(envs)
    else:
        observations, _ = wrap(envs).reset(seed=0)
        assert observations.shape == envs.observation_space.shape
    envs.close()


def test_normalising_observations_is_for_next_step_autoreset() -> None:
    envs = make("next_step")
    vector.NormalizeObservation(envs).reset(seed=0)
    envs.close()
    for mode in ("same_step", "disabled"):
        envs = make(mode)
        with pytest.raises(ValueError, match="NEXT_STEP"):
            vector.NormalizeObservation(envs)
        envs.close()
