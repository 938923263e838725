from __future__ import annotations

from contextlib import closing
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import spatula_env
from spatula_env.learning.experts import PalpateExpert, PressExpert, RetractExpert

gym.register_envs(spatula_env)

WORLDS = 8
CASES = [("Retract", RetractExpert, 75), ("Palpate", PalpateExpert, 140)]


def make(name: str, **options: Any) -> gym.vector.VectorEnv[Any, Any, Any]:
    return gym.make_vec(f"Spatula/{name}-v0", num_envs=WORLDS, vectorization_mode=None, **options)


@pytest.mark.parametrize(("name", "kind", "steps"), CASES)
def test_experts_succeed_from_observations_alone(name: str, kind: type[Any], steps: int) -> None:
    with closing(make(name)) as env:
        expert = kind(env)
        observation, _ = env.reset(seed=100)
        for _ in range(steps):
            observation, _, _, _, info = env.step(expert(observation))
    assert info["is_success"].all()
    assert not info["diverged"].any()
    assert (info["episode_peak_force"] < 0.5).all()


@pytest.mark.parametrize(("name", "kind"), [case[:2] for case in CASES])
@pytest.mark.parametrize("options", [{"obs_mode": "dict"}, {"reward": "sparse"}])
def test_experts_read_every_layout_alike(name: str, kind: type[Any], options: dict[str, str]) -> None:
    with closing(make(name)) as flat, closing(make(name, **options)) as other:
        experts = kind(flat), kind(other)
        first, second = flat.reset(seed=2)[0], other.reset(seed=2)[0]
        for _ in range(20):
            action = experts[0](first)
            assert action.shape == flat.action_space.shape
            assert action in flat.action_space
            # The error is a difference of rounded numbers where goals are entries of their own.
            assert experts[1](second) == pytest.approx(action, abs=1e-5)
            first, second = flat.step(action)[0], other.step(action)[0]


@pytest.mark.parametrize(("name", "kind"), [case[:2] for case in CASES])
def test_an_expert_treats_one_world_as_it_treats_many(name: str, kind: type[Any]) -> None:
    with closing(make(name)) as env:
        expert = kind(env)
        observation, _ = env.reset(seed=3)
        for _ in range(10):
            actions = expert(observation)
            observation, *_ = env.step(actions)
        together = expert(observation)
        assert np.array([expert(one) for one in observation]).tolist() == together.tolist()


@pytest.mark.parametrize("name", [case[0] for case in CASES])
def test_chance_does_not_succeed(name: str) -> None:
    with closing(make(name)) as env:
        env.reset(seed=0)
        env.action_space.seed(0)
        shares = []
        for _ in range(60):
            *_, info = env.step(env.action_space.sample())
            shares.append(info["within_tolerance"].mean())
    assert not info["is_success"].any()
    assert np.mean(shares) < 0.05


@pytest.mark.parametrize("kind", [case[1] for case in CASES])
def test_environments_of_other_tasks_are_refused(kind: type[Any]) -> None:
    with gym.make("Spatula/Press-v0", engine="batch") as env:
        PressExpert(env)
        with pytest.raises(ValueError, match="env must be a"):
            kind(env)
