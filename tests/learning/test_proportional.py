"""Proportional controllers, which serve as baselines for other policies."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import spatula_env
from spatula_env.learning.evaluation import Plan, evaluate
from spatula_env.learning.finding import find_policy
from spatula_env.learning.policies import make_proportional

IDS = tuple(f"Spatula/{name}-v0" for name in spatula_env.TASKS)


@pytest.mark.parametrize("env_id", IDS)
def test_tools_go_towards_where_they_are_to_be(env_id: str) -> None:
    """In the air: the farther away, the less the reward for being near; it grows while nothing is in the way."""
    env: Any = gym.make_vec(env_id, num_envs=4, engine="batch").unwrapped
    try:
        controller = make_proportional(env)
        observation, _ = env.reset(seed=3)
        assert set(controller.velocities(observation)) <= set(env.control.names)
        near = []
        for _ in range(5):
            actions = controller(observation)
            assert actions.shape == (4, env.control.size)
            observation, _, _, _, infos = env.step(actions)
            near.append(infos["reward/reach"])
        assert (near[-1] > near[0]).all()
    finally:
        env.close()


@pytest.mark.parametrize(
    ("env_id", "part", "name"),
    [
        ("Spatula/Press-v0", "error", "velocity_x"),
        ("Spatula/Fissure-v0", "target_offset", "velocity_x"),
        ("Spatula/Clamp-v0", "ridge_offset", "velocity_x"),
    ],
)
def test_half_the_way_is_gone_with_half_the_speed(env_id: str, part: str, name: str) -> None:
    env: Any = gym.make_vec(env_id, num_envs=2, engine="batch").unwrapped
    try:
        controller = make_proportional(env)
        observation, _ = env.reset(seed=3)
        nearer = observation.copy()
        nearer[:, env.observation_builder.slices[part]] *= 0.5
        one, other = (controller.velocities(each)[name] for each in (observation, nearer))
        np.testing.assert_allclose(other, 0.5 * one, rtol=1e-5)
        assert (one != 0.0).all()
    finally:
        env.close()


def test_a_press_takes_no_more() -> None:
    episodes, _ = evaluate(find_policy("proportional", IDS[0]), Plan(IDS[0], {}, "batch", 8, 40))
    assert episodes["success"].mean() >= 0.75


def test_it_is_for_tasks_of_this_package() -> None:
    with pytest.raises(ValueError, match="env must be of one of the tasks"):
        make_proportional(gym.make("CartPole-v1"))
