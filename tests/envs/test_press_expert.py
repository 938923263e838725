from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import spatula_env
from spatula_env.learning.experts import PressExpert

gym.register_envs(spatula_env)


def steps_to_success(env: gym.Env[Any, Any], expert: PressExpert, seed: int, limit: int = 60) -> int | None:
    observation, _ = env.reset(seed=seed)
    for step in range(limit):
        observation, _, _, _, info = env.step(expert(observation))
        if info["is_success"]:
            return step + 1
    return None


@pytest.mark.parametrize("options", [{}, {"obs_mode": "dict", "reward": "sparse"}])
def test_the_expert_succeeds_from_observations_alone(options: dict[str, str]) -> None:
    with gym.make("Spatula/Press-v0", **options) as env:
        expert = PressExpert(env)
        assert None not in [steps_to_success(env, expert, seed) for seed in range(100, 105)]


@pytest.mark.parametrize("options", [{"obs_mode": "dict"}, {"reward": "sparse"}])
def test_the_expert_reads_every_layout_alike(options: dict[str, str]) -> None:
    with gym.make("Spatula/Press-v0") as flat, gym.make("Spatula/Press-v0", **options) as other:
        experts = PressExpert(flat), PressExpert(other)
        first, second = flat.reset(seed=2)[0], other.reset(seed=2)[0]
        for _ in range(12):
            action = experts[0](first)
            assert action in flat.action_space
            # The error is a difference of rounded numbers where goals are entries of their own.
            assert experts[1](second) == pytest.approx(action, abs=1e-5)
            first, second = flat.step(action)[0], other.step(action)[0]


def test_chance_does_not_succeed() -> None:
    with gym.make("Spatula/Press-v0", control_frequency=60.0) as env:
        env.reset(seed=0)
        env.action_space.seed(0)
        infos = [env.step(env.action_space.sample())[-1] for _ in range(200)]
    assert not infos[-1]["is_success"]
    assert np.mean([info["within_tolerance"] for info in infos]) < 0.05


def test_other_environments_are_refused() -> None:
    with gym.make("CartPole-v1") as env, pytest.raises(ValueError, match="env must be a press environment"):
        PressExpert(env)
