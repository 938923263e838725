"""Experts that open a fissure and lift a ridge, and what they need for it."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import spatula_env
from spatula_env.learning.experts.clamp import ClampExpert
from spatula_env.learning.experts.fissure import FissureExpert

gym.register_envs(spatula_env)

EXPERTS = {"Fissure": FissureExpert, "Clamp": ClampExpert}


def run(name: str, seeds: list[int], steps: int, act: Any = None, **options: Any) -> tuple[np.ndarray, dict[str, Any]]:
    """Whether each of some episodes has succeeded after some steps, and their final infos."""
    env = gym.make_vec(f"Spatula/{name}-v0", num_envs=len(seeds), **options)
    expert = EXPERTS[name](env) if act is None else act
    observation, info = env.reset(seed=seeds)
    for _ in range(steps):
        observation, _, _, _, info = env.step(expert(observation))
    env.close()
    return info["is_success"], info


@pytest.mark.parametrize("name", EXPERTS)
def test_the_expert_succeeds_from_observations_alone(name: str) -> None:
    success, info = run(name, list(range(8)), 70)
    assert success.all()
    # Without harm, as far as the limits that are counted say.
    assert np.median(info["episode_peak_pressure"]) < 2670.0
    assert (info["episode_peak_force"] > 0.03).all()


@pytest.mark.parametrize("name", EXPERTS)
def test_the_expert_reads_sparse_dictionaries_alike(name: str) -> None:
    assert run(name, [3, 4], 70, obs_mode="dict", reward="sparse")[0].all()


def test_a_blade_that_is_merely_in_the_fissure_shows_nothing() -> None:
    env = gym.make_vec("Spatula/Fissure-v0", num_envs=4)
    expert = FissureExpert(env)
    observation, info = env.reset(seed=[0, 1, 2, 3])
    for _ in range(60):
        action = expert(observation)
        # Down to where the expert would begin to open, and no further.
        deep = expert.part(observation, "target_offset")[:, 2] > -0.009
        observation, _, _, _, info = env.step(np.where(deep[:, None], np.float32(0.0), action))
        assert (info["exposure"] <= 0.3).all()
    assert (expert.part(observation, "target_offset")[:, 2] > -0.01).all()
    env.close()


def test_a_light_grip_lets_the_ridge_slip(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("spatula_env.learning.experts.clamp.SQUEEZE", 0.93)
    monkeypatch.setattr("spatula_env.learning.experts.clamp.ClampExpert.minds_force", False)
    success, info = run("Clamp", [0, 1, 2, 3], 70)
    assert not success.any()
    # The jaws go up, and the ridge stays behind.
    assert (info["lift"] < 0.5 * 0.004).all()


@pytest.mark.parametrize("name", EXPERTS)
def test_chance_does_not_succeed(name: str) -> None:
    generator = np.random.default_rng(0)
    success, _ = run(name, list(range(8)), 80, lambda _: generator.uniform(-1.0, 1.0, (8, 4)).astype(np.float32))
    assert not success.any()


def test_other_environments_are_refused() -> None:
    with gym.make("CartPole-v1") as env, pytest.raises(ValueError, match="env must be a fissure environment"):
        FissureExpert(env)
