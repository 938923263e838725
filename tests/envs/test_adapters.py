"""Wrappers for libraries that need not be installed: six values, labels, LeRobot's names."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

import spatula_env
from spatula_env.envs.adapters.lerobot import LeRobotVectorWrapper, LeRobotWrapper, make_hub_env
from spatula_env.envs.adapters.masa import LABELS, LabelsWrapper
from spatula_env.envs.adapters.safety_gymnasium import SafetyGymnasiumVectorWrapper, SafetyGymnasiumWrapper

assert spatula_env.TASKS
ID = "Spatula/Press-v0"
DOWN = np.float32([0.0, 0.0, -1.0])
SMALL = {"observation": {"image_size": (16, 24)}}


def test_step_returns_six_values_with_the_cost() -> None:
    env = SafetyGymnasiumWrapper(gym.make(ID, engine="batch", max_episode_steps=12), cost_scale=2.0)
    env.reset(seed=0)
    costs, truncated = [], False
    while not truncated:
        _, reward, cost, terminated, truncated, info = env.step(DOWN)
        assert isinstance(reward, float)
        assert isinstance(cost, float)
        assert cost == 2.0 * info["cost"]
        assert not terminated
        costs.append(cost)
    assert sum(costs) == pytest.approx(2.0 * info["episode_cost"])
    assert sum(costs) > 0.0
    env.close()


@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
def test_many_return_the_costs_of_the_step_that_was_taken(mode: str) -> None:
    envs = SafetyGymnasiumVectorWrapper(
        gym.make_vec(ID, num_envs=2, autoreset_mode=mode, max_episode_steps=12), cost_scale=0.5
    )
    envs.reset(seed=0)
    total = np.zeros(2)
    for _ in range(12):
        _, _, costs, _, truncations, infos = envs.step(np.tile(DOWN, (2, 1)))
        total += costs
    assert truncations.all()
    assert (total > 0.0).all()
    last = infos["final_info"] if mode == "same_step" else infos
    np.testing.assert_allclose(total, 0.5 * last["episode_cost"])
    assert ("final_observation" in infos) == (mode == "same_step")
    envs.close()


def test_the_cost_scale_is_checked() -> None:
    env = gym.make(ID, engine="batch")
    with pytest.raises(ValueError, match="cost_scale must be positive and finite, got 0"):
        SafetyGymnasiumWrapper(env, cost_scale=0.0)
    env.close()


def test_labels_are_what_holds_in_the_step() -> None:
    env = LabelsWrapper(gym.make(ID, engine="batch"))
    _, info = env.reset(seed=0)
    assert info["labels"] == set()
    seen: set[str] = set()
    for _ in range(14):
        observation, *_, info = env.step(DOWN)
        assert info["labels"] == {label for label, name in LABELS.items() if info[name]}
        assert env.label_fn(observation) == info["labels"]
        seen |= info["labels"]
    assert {"contact", "cost"} <= seen
    env.reset(seed=0)
    assert env.label_fn(None) == set()
    env.close()


@pytest.mark.parametrize("camera", ["front", None])
def test_observations_have_lerobots_names(camera: str | None) -> None:
    env = LeRobotWrapper(gym.make(ID, engine="batch", obs_mode="rgb", **SMALL), camera)
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    assert set(observation) == {"pixels", "agent_pos"}
    picture = observation["pixels"] if camera is None else observation["pixels"][camera]
    assert picture.shape == (16, 24, 3)
    assert picture.dtype == np.uint8
    observation, *_ = env.step(DOWN)
    assert observation in env.observation_space
    env.close()


def test_without_pictures_there_is_what_the_robot_knows() -> None:
    env = LeRobotWrapper(gym.make(ID, engine="batch"))
    observation, _ = env.reset(seed=0)
    assert set(observation) == {"agent_pos"}
    assert observation in env.observation_space
    env.close()


def test_what_lerobot_has_no_name_for_is_refused() -> None:
    env = gym.make(ID, engine="batch", reward="sparse")
    with pytest.raises(ValueError, match=r"env must observe pictures .* it observes \['achieved_goal'"):
        LeRobotWrapper(env)
    env.close()


def test_many_observe_the_same_as_one_and_so_do_last_observations() -> None:
    envs = make_hub_env(ID, n_envs=2, autoreset_mode="same_step", max_episode_steps=2, **SMALL)
    assert isinstance(envs, LeRobotVectorWrapper)
    observations, _ = envs.reset(seed=0)
    assert observations in envs.observation_space
    env = LeRobotWrapper(gym.make(ID, engine="batch", obs_mode="rgb", **SMALL))
    single, _ = env.reset(seed=1)
    np.testing.assert_allclose(observations["agent_pos"][1], single["agent_pos"], atol=1e-6)
    for _ in range(2):
        observations, _, _, truncations, infos = envs.step(np.tile(DOWN, (2, 1)))
        single, *_ = env.step(DOWN)
    assert truncations.all()
    np.testing.assert_allclose(infos["final_obs"][1]["agent_pos"], single["agent_pos"], atol=1e-5)
    assert infos["final_obs"][1] in envs.single_observation_space
    assert observations in envs.observation_space
    env.close()
    envs.close()


@pytest.mark.parametrize(
    "wrapper", [SafetyGymnasiumWrapper, LabelsWrapper, LeRobotWrapper], ids=lambda wrapper: wrapper.__name__
)
def test_a_wrapped_environment_can_be_made_again_from_its_specification(wrapper: type[gym.Wrapper]) -> None:
    env = wrapper(gym.make(ID, engine="batch", max_episode_steps=7))
    assert env.spec is not None
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert type(again) is wrapper
    assert again.spec == env.spec
    again.close()
    env.close()


def test_what_libraries_ask_vector_environments_is_answered_through_wrappers() -> None:
    plain = gym.make_vec(ID, num_envs=2, autoreset_mode="same_step", max_episode_steps=7)
    envs = LeRobotVectorWrapper(SafetyGymnasiumVectorWrapper(plain))
    assert envs.call("_max_episode_steps") == (7, 7)
    assert envs.get_attr("task_description") == plain.get_attr("task_description")
    assert envs.autoreset_mode is plain.autoreset_mode
    assert not hasattr(envs, "nothing_of_the_kind")
    envs.close()
