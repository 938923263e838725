from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from fresh_interpreter import run_code
from vector_helpers import (
    ABOVE_GOAL,
    COUNT,
    ENGINES,
    GOAL,
    assert_alike,
    lending,
    pressing_actions,
    single_envs,
)

from spatula_env.envs import PressVectorEnv
from spatula_env.installing import install_hint

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecMonitor, VecNormalize

from spatula_env.envs.sb3 import SpatulaVecEnv, make_sb3_vec_env

STILL = np.zeros((COUNT, 3), dtype=np.float32)


@pytest.fixture(scope="module", autouse=True)
def _lending() -> Iterator[None]:
    with lending():
        yield


def make(**options: Any) -> SpatulaVecEnv:
    return make_sb3_vec_env("Spatula/Press-v0", COUNT, **{"max_episode_steps": 4, **options})


@pytest.mark.parametrize(
    ("engine", "options"),
    [
        ("bullet", {}),
        ("batch", {}),
        ("batch", {"reward": "sparse"}),
        ("batch", {"obs_mode": "dict"}),
    ],
)
def test_all_is_as_with_environments_one_by_one(engine: str, options: dict[str, str]) -> None:
    assert engine in ENGINES
    envs = single_envs(engine, 4, **options)
    theirs = DummyVecEnv([lambda env=one: env for one in envs])
    mine = make(engine=engine, **options)
    assert mine.observation_space == theirs.observation_space
    assert mine.action_space == theirs.action_space
    assert mine.seed(7) == theirs.seed(7)
    tolerance = 0.0 if engine == "bullet" else 1e-5
    assert_close(mine.reset(), theirs.reset(), tolerance)
    assert_close(mine.reset_infos, theirs.reset_infos, tolerance)
    for k, action in enumerate(pressing_actions(6)):
        expected = theirs.step(action)
        assert_close(mine.step(action), expected, tolerance)
        assert expected[2].tolist() == [k == 3] * COUNT
        assert_close(mine.reset_infos, theirs.reset_infos, tolerance)
    # Seeds count once.
    assert_close(mine.reset(), theirs.reset(), tolerance)
    theirs.close()


def assert_close(mine: Any, theirs: Any, tolerance: float) -> None:
    """As `assert_alike`, where Python's own numbers may differ a little too."""
    if isinstance(theirs, dict):
        assert set(mine) == set(theirs)
        for name in theirs:
            assert_close(mine[name], theirs[name], tolerance)
    elif isinstance(theirs, list | tuple):
        assert len(mine) == len(theirs)
        for one, other in zip(mine, theirs, strict=True):
            assert_close(one, other, tolerance)
    elif isinstance(theirs, float):
        assert type(mine) is float
        assert mine == pytest.approx(theirs, rel=tolerance, abs=tolerance)
    else:
        assert type(mine) is type(theirs)
        assert_alike(mine, theirs, tolerance)


def test_infos_can_be_written_to_a_file() -> None:
    env = make()
    env.reset()
    for action in pressing_actions(4):
        _, _, dones, infos = env.step(action)
    assert dones.all()
    for info in infos:
        assert info.pop("terminal_observation").shape == (71,)
        assert json.loads(json.dumps(info)) == info
        assert info["TimeLimit.truncated"] is True
        assert info["is_success"] is False
        assert info["time"] == pytest.approx(0.2)


def test_an_end_by_success_is_no_truncation() -> None:
    # So wide a tolerance is met as soon as the organ gives way a little.
    task = {"depth_range": (0.0151, 0.0151), "depth_tolerance": 0.015, "place_tolerance": 0.1, "hold_time": 0.05}
    env = make(terminate_on_success=True, task=task, max_episode_steps=2)
    env.set_options({"tool_position": (0.0, 0.0, -0.0237)})
    env.reset()
    _, _, dones, infos = env.step(np.tile([0.0, 0.0, -0.5], (COUNT, 1)))
    assert dones.all()
    assert [info["is_success"] for info in infos] == [True] * COUNT
    assert [info["TimeLimit.truncated"] for info in infos] == [False] * COUNT


def test_seeds_and_options_count_once() -> None:
    env = make(seed=3)
    first = env.reset()
    second = env.reset()
    assert (first != second).any()
    env.seed(3)
    assert (env.reset() == first).all()
    goals = env.env.observation_builder.slices["goal"]
    env.seed(3)
    env.set_options([{}, {"goal": GOAL}, {"goal": (0.0, 0.0, 0.01), "tool_position": ABOVE_GOAL}])
    observation = env.reset()
    assert (observation[0] == first[0]).all()
    assert observation[1:, goals] == pytest.approx(np.array([GOAL, (0.0, 0.0, 0.01)]))
    assert env.reset_infos[1]["time"] == 0.0
    assert (env.reset() == second).all()
    env.set_options({"goal": GOAL})
    assert env.reset()[:, goals] == pytest.approx(np.tile(GOAL, (COUNT, 1)))


def test_attributes_and_methods() -> None:
    env = make(reward="sparse")
    env.reset()
    assert env.get_attr("goal")[1].tolist() == env.env.goals[1].tolist()
    assert env.get_attr("steps_per_action", indices=[0, 2]) == [12, 12]
    assert env.get_attr("action_space", indices=1) == [env.action_space]
    assert env.has_attr("compute_reward")
    assert not env.has_attr("action_masks")
    assert not make().has_attr("compute_reward")
    goals = np.array([[0.0, 0.0, 0.01]] * 5)
    (rewards,) = env.env_method("compute_reward", goals, goals + np.array([0.0, 0.0, 0.002]), [{}] * 5, indices=[0])
    assert rewards.tolist() == [-1.0] * 5
    assert rewards.dtype == np.float32
    assert len(env.env_method("compute_reward", goals, goals, [{}] * 5)) == COUNT
    with pytest.raises(AttributeError, match=r"method_name must be one of \['compute_reward', 'save', 'restore'\]"):
        env.env_method("reset")
    env.set_attr("max_episode_steps", 1)
    assert env.step(STILL)[2].all()
    with pytest.raises(ValueError, match="indices must name all 3 worlds, which share 'max_episode_steps'"):
        env.set_attr("max_episode_steps", 5, indices=[1])
    assert env.env_is_wrapped(gym.Wrapper) == [False] * COUNT
    assert env.env_is_wrapped(gym.Wrapper, indices=1) == [False]
    assert env.metadata["render_fps"] == 20


@pytest.mark.parametrize("name", ["max_speed", "settings", "task", "goal", "reward", "render_mode", "colour"])
def test_what_has_no_effect_cannot_be_set(name: str) -> None:
    with pytest.raises(AttributeError, match=f"'{name}'"):
        make().set_attr(name, 0.5)


def test_worlds_tell_what_belongs_to_each() -> None:
    env = make()
    env.seed(3)
    env.reset()
    assert env.get_attr("task_description") == [env.env.task_description] * COUNT
    assert env.get_attr("_max_episode_steps", indices=[1]) == [env.env.max_episode_steps]
    assert env.get_attr("np_random_seed") == [3, 4, 5]
    assert not env.has_attr("num_envs")
    with pytest.raises(AttributeError, match="a world of PressVectorEnv has no attribute 'step'"):
        env.get_attr("step")


def test_worlds_are_saved_and_restored() -> None:
    env = make()
    env.seed(0)
    env.reset()
    env.step(STILL)
    (state,) = env.env_method("save", indices=1)
    expected = env.step(STILL)
    ((observation, info), _) = env.env_method("restore", state, indices=[0, 2])
    assert info["time"] == pytest.approx(0.05)
    assert observation.shape == env.observation_space.shape
    again = env.step(STILL)
    assert again[0][0].tolist() == again[0][2].tolist() == expected[0][1].tolist()
    assert again[1][0] == expected[1][1]


def test_pictures_are_laid_side_by_side() -> None:
    env = make(render_mode="rgb_array", width=32, height=24)
    env.reset()
    assert env.render_mode == "rgb_array"
    images = env.get_images()
    assert [np.shape(image) for image in images] == [(24, 32, 3)] * COUNT
    tiled = env.render()
    assert tiled is not None
    assert tiled.shape == (48, 64, 3)
    blind = make()
    blind.reset()
    with pytest.warns(UserWarning, match="there are no pictures with render_mode=None"):
        assert blind.get_images() == [None] * COUNT


def test_bad_actions_name_the_world() -> None:
    env = make()
    env.reset()
    actions = STILL.copy()
    actions[2, 1] = np.nan
    with pytest.raises(ValueError, match="for world 2"):
        env.step(actions)


def test_only_environments_of_this_package_in_the_right_mode_are_taken() -> None:
    with pytest.raises(ValueError, match="CartPole-v1 must be an environment of this package or built on it"):
        make_sb3_vec_env("CartPole-v1", 2)
    with pytest.raises(ValueError, match="env must be a vector environment of this package, got"):
        SpatulaVecEnv(gym.make_vec("CartPole-v1", num_envs=1))
    with pytest.raises(ValueError, match="env must have been made with autoreset_mode='same_step'"):
        SpatulaVecEnv(PressVectorEnv(COUNT))


# ----------------------------------------------------------------------------------------- learning


def test_ppo_learns_through_all_wrappers() -> None:
    env = VecNormalize(VecFrameStack(VecMonitor(make(seed=0)), 2))
    assert env.observation_space.shape == (142,)
    model = PPO("MlpPolicy", env, n_steps=6, batch_size=9, n_epochs=1, seed=0, device="cpu")
    model.learn(36)
    assert model.num_timesteps == 36
    assert [episode["l"] for episode in model.ep_info_buffer or ()] == [4] * 9
    assert list(model.ep_success_buffer or ()) == [False] * 9


def test_a_policy_can_be_evaluated() -> None:
    env = VecMonitor(make(seed=0))
    model = PPO("MlpPolicy", env, n_steps=2, batch_size=6, device="cpu")
    returns, lengths = evaluate_policy(model, env, n_eval_episodes=5, return_episode_rewards=True)
    assert lengths == [4] * 5
    assert np.isfinite(returns).all()


def test_sac_learns() -> None:
    env = VecMonitor(make(seed=0))
    model = SAC("MlpPolicy", env, learning_starts=6, batch_size=4, buffer_size=60, seed=0, device="cpu")
    model.learn(15)
    assert model.num_timesteps == 15
    # What follows an episode's last step is what was last seen, not how the next episode begins.
    buffer = model.replay_buffer
    assert buffer is not None
    assert buffer.dones[:5, 0].tolist() == [0.0, 0.0, 0.0, 1.0, 0.0]
    assert buffer.timeouts[:5, 0].tolist() == [0.0, 0.0, 0.0, 1.0, 0.0]
    position = env.unwrapped.env.observation_builder.slices["tool_position"]
    steps = buffer.next_observations[:5, :, position] - buffer.observations[:5, :, position]
    assert np.abs(steps).max() < 0.0051


@pytest.mark.parametrize("obs_mode", ["state", "dict"])
def test_sac_learns_from_hindsight(obs_mode: str) -> None:
    env = make(seed=0, reward="sparse", obs_mode=obs_mode)
    model = SAC(
        "MultiInputPolicy",
        VecMonitor(env),
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
        learning_starts=15,
        batch_size=64,
        buffer_size=90,
        seed=0,
        device="cpu",
    )
    model.learn(24)
    assert model.num_timesteps == 24
    assert model.replay_buffer is not None
    rewards = model.replay_buffer.sample(256).rewards
    # All goals were missed, but not those that were taken from what came later.
    assert set(rewards.ravel().tolist()) == {-1.0, 0.0}
    assert (model.replay_buffer.rewards[:8] == -1.0).all()


# ----------------------------------------------------------------------------------------- importing


def test_the_environments_do_not_need_it() -> None:
    code = "import sys, spatula_env.envs; print('stable_baselines3' in sys.modules, 'torch' in sys.modules)"
    assert run_code(code).split()[-2:] == ["False", "False"]


def test_without_it_there_is_word_of_the_extra() -> None:
    code = (
        "import sys; sys.modules['stable_baselines3'] = None\n"
        "try: import spatula_env.envs.sb3\n"
        "except ImportError as error: print(error)"
    )
    assert install_hint("train") in run_code(code)
