"""Experts read every layout of observations that they take, and refuse the others when they are made."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import spatula_env
from spatula_env.envs.settings import OBS_MODES
from spatula_env.learning.policies import make_expert


@pytest.mark.parametrize("task", spatula_env.TASKS)
@pytest.mark.parametrize("obs_mode", ["state", "dict"])
@pytest.mark.parametrize("reward", ["dense", "sparse"])
def test_histories_are_read_like_single_observations(task: str, obs_mode: str, reward: str) -> None:
    options: dict[str, Any] = {"engine": "batch", "obs_mode": obs_mode, "reward": reward}
    plain = gym.make(f"Spatula/{task}-v0", **options)
    stacked = gym.make(f"Spatula/{task}-v0", **options, observation={"history": 3})
    many = gym.make_vec(f"Spatula/{task}-v0", num_envs=2, **options, observation={"history": 3})
    experts = [make_expert(env) for env in (plain, stacked, many)]
    seen = [env.reset(seed=2)[0] for env in (plain, stacked, many)]
    for _ in range(5):
        actions = [expert(observation) for expert, observation in zip(experts, seen, strict=True)]
        assert stacked.action_space.contains(actions[1])
        assert many.action_space.contains(actions[2])
        assert actions[1].tolist() == actions[0].tolist()
        assert np.allclose(actions[2][0], actions[0], atol=1e-3)
        seen = [env.step(action)[0] for env, action in zip((plain, stacked, many), actions, strict=True)]
    for env in (plain, stacked, many):
        env.close()


@pytest.mark.parametrize("reward", ["dense", "sparse"])
def test_late_and_noisy_ones_too(reward: str) -> None:
    seeing = {"history": 2, "delay": 0.05, "noise": 0.5}
    env = gym.make("Spatula/Press-v0", engine="batch", reward=reward, observation=seeing)
    expert = make_expert(env)
    observation, info = env.reset(seed=0)
    for _ in range(60):
        observation, _, _, _, info = env.step(expert(observation))
    assert info["place_error"] < 0.004
    assert info["depth_error"] < 0.004
    env.close()


@pytest.mark.parametrize("obs_mode", [mode for mode in OBS_MODES if mode not in ("state", "dict")])
def test_what_they_cannot_read_is_refused(obs_mode: str) -> None:
    small = {"image_size": (36, 36), "organ_points": 8, "tool_points": 4}
    env = gym.make("Spatula/Press-v0", engine="batch", obs_mode=obs_mode, observation=small)
    with pytest.raises(ValueError, match=f"env must have obs_mode 'state' or 'dict', got '{obs_mode}'"):
        make_expert(env)
    env.close()
