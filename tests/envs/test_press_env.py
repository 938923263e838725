from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.utils.env_checker import check_env

import spatula_env
from spatula_env import scenes
from spatula_env.envs import PressEnv, SpatulaEnv
from spatula_env.sim.simulation import SimulationDiverged
from spatula_env.tasks import PressWeights

gym.register_envs(spatula_env)

INTERFACES = [(mode, reward) for mode in ("state", "dict") for reward in ("dense", "sparse")]
DOWN = np.array([0.0, 0.0, -1.0], dtype=np.float32)
STILL = np.zeros(3, dtype=np.float32)

GOAL = (0.006, -0.004, 0.008)
"""A shallow goal, and a start right above it: reached within a few steps."""
ABOVE_GOAL = (0.006, -0.004, -0.016)


@pytest.fixture(scope="module", params=["bullet", "batch"])
def engine(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def env(engine: str) -> Iterator[PressEnv]:
    with PressEnv(engine=engine) as made:
        yield made


@pytest.fixture(scope="module")
def sparse_env() -> Iterator[PressEnv]:
    with PressEnv(reward="sparse") as made:
        yield made


def random_actions(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 3)).astype(np.float32)


def rollout(env: PressEnv, actions: np.ndarray, seed: int | None) -> list[Any]:
    """Everything that an episode shows, bit by bit."""
    observation, info = env.reset(seed=seed)
    result: list[Any] = [(np.asarray(observation).tobytes(), info)]
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        result.append((np.asarray(observation).tobytes(), reward, terminated, truncated, info))
    return result


def press(env: PressEnv, steps: int = 40) -> list[tuple[Any, float, bool, dict[str, Any]]]:
    """Press to GOAL by what `info` tells, from right above it."""
    _, info = env.reset(seed=0, options={"goal": GOAL, "tool_position": ABOVE_GOAL})
    shown = []
    for _ in range(steps):
        down = 0.5 if info["force"] == 0.0 else 60.0 * (GOAL[2] - info["depth"])
        observation, reward, terminated, _, info = env.step(np.array([0.0, 0.0, -down]).clip(-1.0, 1.0))
        shown.append((observation, reward, terminated, info))
        if terminated:
            break
    return shown


# ----------------------------------------------------------------------------------------- interfaces


@pytest.mark.parametrize(("obs_mode", "reward"), INTERFACES)
def test_gymnasiums_checker_finds_nothing(obs_mode: str, reward: str) -> None:
    # Warnings are errors in all tests.
    with gym.make("Spatula/Press-v0", obs_mode=obs_mode, reward=reward) as made:
        # What can be rendered is tested elsewhere: a window needs a display.
        check_env(made.unwrapped, skip_render_check=True)


@pytest.mark.parametrize(("obs_mode", "reward"), INTERFACES)
def test_stable_baselines_checker_finds_nothing(obs_mode: str, reward: str) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with gym.make("Spatula/Press-v0", obs_mode=obs_mode, reward=reward) as made:
        checker.check_env(made.unwrapped)


def test_spaces(env: PressEnv, sparse_env: PressEnv) -> None:
    assert env.action_space == spaces.Box(-1.0, 1.0, (3,), np.float32)
    assert isinstance(env.observation_space, spaces.Box)
    assert env.observation_space.shape == (71,)
    assert isinstance(sparse_env.observation_space, spaces.Dict)
    assert set(sparse_env.observation_space) == {"observation", "achieved_goal", "desired_goal"}
    assert sparse_env.observation_space["observation"].shape == (64,)


def test_the_episode_is_cut_after_ten_seconds() -> None:
    with gym.make("Spatula/Press-v0", control_frequency=12.0) as made:
        made.reset(seed=0)
        ends = [made.step(STILL)[2:4] for _ in range(120)]
    assert ends == [(False, False)] * 119 + [(False, True)]


# ----------------------------------------------------------------------------------------- actions


@pytest.mark.parametrize("axis", range(3))
def test_each_action_moves_along_its_axis(env: PressEnv, axis: int) -> None:
    action = np.zeros(3, dtype=np.float32)
    action[axis] = 0.5
    before = env.reset(seed=0)[0][:3]
    observation = env.step(action)[0]
    moved = np.zeros(3)
    moved[axis] = 0.5 * 0.1 * 0.05
    assert observation[:3] - before == pytest.approx(moved, abs=1e-7)
    assert observation[3:6] == pytest.approx(moved / 0.05, abs=1e-6)


# ----------------------------------------------------------------------------------------- determinism


def test_equal_seeds_and_actions_give_equal_episodes_to_the_last_bit(engine: str, env: PressEnv) -> None:
    actions = random_actions(25)
    actions[:, 2] -= 0.5  # It must touch the organ.
    first = rollout(env, actions, seed=11)
    assert first[-1][-1]["force"] > 0.1
    with PressEnv(engine=engine) as other:
        assert rollout(other, actions, seed=11) == first
    assert rollout(env, actions, seed=11) == first


def test_without_a_seed_random_numbers_go_on(env: PressEnv) -> None:
    first = [env.reset(seed=5)[0].tolist(), env.reset()[0].tolist(), env.reset()[0].tolist()]
    assert first[0] != first[1] != first[2]
    again = [env.reset(seed=5)[0].tolist(), env.reset()[0].tolist(), env.reset()[0].tolist()]
    assert again == first


def test_goals_and_starts_vary(env: PressEnv) -> None:
    starts = np.array([env.reset(seed=seed)[0] for seed in range(8)])
    slices = env.observation_builder.slices
    for name in ("tool_position", "goal"):
        assert (np.ptp(starts[:, slices[name]], axis=0) > 1e-3).all()


def test_options_choose_goal_and_start_and_change_nothing_else(env: PressEnv) -> None:
    _, following = env.reset(seed=9), env.reset()[0].tolist()
    observation, info = env.reset(seed=9, options={"goal": GOAL, "tool_position": ABOVE_GOAL})
    slices = env.observation_builder.slices
    assert observation[slices["goal"]] == pytest.approx(GOAL)
    assert observation[slices["tool_position"]] == pytest.approx(ABOVE_GOAL)
    assert info["place_error"] == pytest.approx(0.0, abs=1e-7)
    assert env.reset()[0].tolist() == following


@pytest.mark.parametrize("seed", ["x", 1.5, (1, 2), -1])
def test_a_seed_that_is_none_is_an_error(env: PressEnv, seed: Any) -> None:
    with pytest.raises(ValueError, match=r"seed must .*, got "):
        env.reset(seed=seed)


# ----------------------------------------------------------------------------------------- the task


def test_a_press_held_for_ten_steps_is_a_success(env: PressEnv) -> None:
    infos = [info for *_, info in press(env)]
    within = [info["within_tolerance"] for info in infos]
    success = [info["is_success"] for info in infos]
    assert any(success)
    first = success.index(True)
    assert within[first - 9 : first + 1] == [True] * 10
    assert all(within[k : k + 10] != [True] * 10 for k in range(first - 9))
    assert infos[first]["hold_time"] == pytest.approx(0.5)
    assert all(success[first:])
    assert infos[first]["depth"] == pytest.approx(GOAL[2], abs=0.001)
    assert 0.3 < infos[first]["force"] <= infos[first]["peak_force"] < 10.0


def test_success_is_kept_until_the_next_reset(env: PressEnv) -> None:
    press(env)
    up = [env.step(-DOWN)[-1] for _ in range(8)]
    assert not up[-1]["within_tolerance"]
    assert up[-1]["hold_time"] == 0.0
    assert up[-1]["is_success"]
    assert not env.reset()[1]["is_success"]


def test_an_episode_begins_with_nothing_held(env: PressEnv) -> None:
    assert press(env)[-1][-1]["hold_time"] > 0.0
    assert env.reset()[1]["hold_time"] == 0.0


def test_a_press_goes_on_after_success_unless_told_otherwise(engine: str, env: PressEnv) -> None:
    assert not any(terminated for _, _, terminated, _ in press(env))
    with PressEnv(engine=engine, terminate_on_success=True) as ending:
        shown = press(ending)
    assert [info["is_success"] for *_, info in shown] == [False] * (len(shown) - 1) + [True]
    assert shown[-1][2]


def test_the_dense_reward_is_the_weighted_sum_of_what_info_tells(env: PressEnv) -> None:
    weights = vars(PressWeights())
    rewards = []
    for _, reward, _, info in press(env, steps=25):
        terms = {name: info[f"reward/{name}"] for name in weights}
        assert reward == pytest.approx(sum(weights[name] * terms[name] for name in weights))
        rewards.append(reward)
    assert rewards[-1] > rewards[0] + 0.5


def test_weights_can_be_configured() -> None:
    with PressEnv(task={"weights": {"reach": 0.0, "depth": 0.0, "hold": 0.0, "action": -2.0}}) as made:
        made.reset(seed=0)
        assert made.step(np.array([0.5, 0.0, 0.5]))[1] == pytest.approx(-1.0)


def test_info_has_the_same_keys_at_reset_and_at_every_step(env: PressEnv) -> None:
    _, first = env.reset(seed=0)
    kinds = {name: type(value) for name, value in first.items()}
    assert set(kinds.values()) == {bool, np.float64}
    for _, _, _, info in press(env, steps=12):
        assert {name: type(value) for name, value in info.items()} == kinds


def test_the_organ_is_pressed_where_the_observation_says(env: PressEnv) -> None:
    observation = press(env, steps=25)[-1][0]
    slices = env.observation_builder.slices
    assert observation[slices["contact_force"]][2] > 0.3
    # Of the lower face: nothing is told of the upper one, which a level spatula's organ does not touch.
    (lower,) = observation[slices["contact_share"]]
    assert 0.6 < lower <= 1.0
    landmarks = observation[slices["landmarks"]].reshape(-1, 3)
    # The first landmark is the organ's top, 7 mm from the place pressed.
    assert -0.02 < landmarks[0, 2] < -0.003


def test_observations_stay_in_their_space_when_the_agent_rages(env: PressEnv) -> None:
    generator = np.random.default_rng(1)
    for seed in range(3):
        env.reset(seed=seed)
        for _ in range(10):
            action = np.sign(generator.normal(size=3)) * [1.0, 1.0, 0.0] + DOWN
            for _ in range(2):
                observation, reward, _, _, _ = env.step(action)
                assert env.observation_space.contains(observation)
                assert np.isfinite(reward)


def test_the_tool_stays_in_its_workspace(env: PressEnv) -> None:
    env.reset(seed=0)
    for _ in range(25):
        observation = env.step(np.array([1.0, -1.0, 1.0]))[0]
    assert observation[:3] == pytest.approx([0.0508, -0.0508, 0.0508], abs=1e-7)
    assert observation[3:6] == pytest.approx(np.zeros(3), abs=1e-7)


def test_time_advances_by_the_control_period(env: PressEnv) -> None:
    _, info = env.reset(seed=0)
    assert info["time"] == 0.0
    assert env.step(STILL)[-1]["time"] == pytest.approx(1 / 20)
    assert env.steps_per_action == 12
    assert env.metadata["render_fps"] == 20


@pytest.mark.parametrize("contact", ["second_step", "bullet"])
def test_other_contact_models_run(contact: str) -> None:
    with PressEnv(contact=contact) as made:
        made.reset(seed=0, options={"goal": GOAL, "tool_position": ABOVE_GOAL})
        for _ in range(5):
            observation, _, _, _, info = made.step(0.5 * DOWN)
        assert made.observation_space.contains(observation)
        assert info["force"] > 0.05


# ----------------------------------------------------------------------------------------- sparse reward


def test_the_sparse_reward_is_that_of_compute_reward(sparse_env: PressEnv) -> None:
    shown = press(sparse_env, steps=30)
    rewards = [reward for _, reward, _, _ in shown]
    assert set(rewards) == {-1.0, 0.0}
    assert [reward == 0.0 for reward in rewards] == [info["within_tolerance"] for *_, info in shown]
    achieved = np.array([observation["achieved_goal"] for observation, *_ in shown])
    desired = np.array([observation["desired_goal"] for observation, *_ in shown])
    again = sparse_env.compute_reward(achieved, desired, [{} for _ in shown])
    assert isinstance(again, np.ndarray)
    assert again.tolist() == rewards
    # Relabelled with what was achieved, a step is a success; with what the end achieved, the start is none.
    assert (sparse_env.compute_reward(achieved, achieved, None) == 0.0).all()
    relabelled = sparse_env.compute_reward(achieved, np.broadcast_to(achieved[-1], achieved.shape), None)
    assert relabelled[-1] == 0.0
    assert relabelled[0] == -1.0


def test_only_the_goal_interface_has_compute_reward(env: PressEnv, sparse_env: PressEnv) -> None:
    assert not hasattr(env, "compute_reward")
    assert hasattr(sparse_env, "compute_reward")
    with pytest.raises(AttributeError, match="reward='sparse'"):
        _ = env.compute_reward


# ----------------------------------------------------------------------------------------- misuse


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"obs_mode": "smell"},
            r"obs_mode must be one of \['state', 'dict', 'rgb', 'rgbd', 'pointcloud'\], got 'smell'",
        ),
        ({"control": "force"}, r"control must be one of \['velocity', 'velocity_6d'\], got 'force'"),
        ({"engine": "magic"}, "engine must be one of .* got 'magic'"),
        ({"contact": "magic"}, r"contact must be one of \['flags', 'second_step', 'bullet', 'mujoco'\], got 'magic'"),
        ({"reward": "shaped"}, r"reward must be one of \['dense', 'sparse'\], got 'shaped'"),
        ({"render_mode": "ansi"}, r"render_mode must be one of \[None, 'rgb_array', 'human'\], got 'ansi'"),
        (
            {"control_frequency": 50.0},
            "control_frequency must go a whole number of times into .* 240 Hz; got 50.0",
        ),
        ({"control_frequency": 1000.0}, "control_frequency must go a whole number of times"),
        ({"control_frequency": 0.0}, "control_frequency must be positive"),
        ({"max_speed": -0.1}, "max_speed must be positive"),
        ({"task": {"colour": 1}}, "task has no colour; allowed are center, cost_budget, depth_range, depth_scale"),
        ({"task": "deep"}, "task must be a mapping or a PressConfig"),
        ({"task": {"depth_range": (0.005, 0.05)}}, "depth_range must end at 0.0"),
        ({"damage_limit": -1.0}, "damage_limit must be None, or zero or more and finite, got -1.0"),
        ({"observation": {"blur": 1}}, "observation has no blur; allowed are delay, history, image_size"),
        ({"randomization": "some"}, "randomization must be 'none', 'default' or a mapping, got 'some'"),
        ({"randomization": {"colour": (0, 1)}}, "randomization has no colour; allowed are action_delay, breathing"),
        ({"randomization": {"stiffness": (0, 1)}}, r"randomization.stiffness must lie in 0.05 to 20, got \(0, 1\)"),
        ({"randomization": {"friction": (2, 1)}}, "randomization.friction must be two finite numbers in ascending"),
        ({"randomization": {"action_delay": 2}}, "randomization.action_delay must lie in 0 to 0.5, got 2"),
    ],
)
def test_options_that_do_not_exist_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PressEnv(**options)


def test_unknown_options_are_refused() -> None:
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'colour'.* are contact, control, control_freq"):
        PressEnv(colour=1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"goals": (0.0, 0.0, 0.01)}, "options has no 'goals'; did you mean 'goal'"),
        ({"goal": (0.0, 0.0)}, r"options\['goal'\] must be 3 finite numbers"),
        ({"goal": (0.0, 0.0, np.nan)}, r"options\['goal'\] must be 3 finite numbers"),
        ({"goal": (0.0, 0.0, 0.03)}, "goal must have a depth from 0.005 to 0.018 m, got 0.03"),
        ({"goal": (0.1, 0.0, 0.01)}, "goal must be at a place from"),
        ({"tool_position": (0.0, 0.0, 0.06)}, r"options\['tool_position'\] must lie in"),
    ],
)
def test_reset_options_are_checked(env: PressEnv, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        env.reset(options=options)


def test_a_bad_action_changes_nothing(env: PressEnv) -> None:
    actions = random_actions(4, seed=2)
    expected = rollout(env, actions, seed=3)
    env.reset(seed=3)
    for bad in ([np.nan, 0.0, 0.0], [0.0, 0.0], "left", [[0.0] * 3] * 2):
        with pytest.raises(ValueError, match="action must"):
            env.step(bad)
    shown = [env.step(action) for action in actions]
    assert [np.asarray(observation).tobytes() for observation, *_ in shown] == [step[0] for step in expected[1:]]


def test_actions_beyond_the_bounds_act_like_the_bounds(env: PressEnv) -> None:
    env.reset(seed=3)
    beyond = env.step(np.array([5.0, -7.0, 1.5]))[0].tolist()
    env.reset(seed=3)
    assert env.step(np.array([1.0, -1.0, 1.0]))[0].tolist() == beyond


def test_the_life_of_an_environment_is_watched() -> None:
    made = PressEnv(render_mode="rgb_array")
    with pytest.raises(ResetNeeded, match=r"call reset\(\) before step\(\)"):
        made.step(STILL)
    with pytest.raises(ResetNeeded, match=r"call reset\(\) before render\(\)"):
        made.render()
    made.reset(seed=0)
    made.step(STILL)
    made.close()
    made.close()
    for call in (made.reset, lambda: made.step(STILL), made.render):
        with pytest.raises(ClosedEnvironmentError, match="closed; make a new one"):
            call()


def test_a_breakdown_of_physics_asks_for_a_reset(env: PressEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    def break_down(positions: np.ndarray, velocities: np.ndarray, diverged: np.ndarray) -> None:
        diverged[:] = True

    expected = rollout(env, random_actions(2), seed=1)
    env.reset(seed=0)
    with monkeypatch.context() as patch:
        patch.setattr(env.simulation.worlds, "_blocks", None)
        patch.setattr(env.simulation.worlds.engine, "advance", break_down)
        with pytest.raises(SimulationDiverged, match=r"physics broke down within 0.05 s after 0.0000 s; call reset"):
            env.step(STILL)
    with pytest.raises(ResetNeeded):
        env.step(STILL)
    assert rollout(env, random_actions(2), seed=1) == expected


def test_a_scene_must_have_one_organ() -> None:
    scene = scenes.seed()

    class TwoOrgans(SpatulaEnv):
        definition = replace(PressEnv.definition, scene=lambda: replace(scene, organs=scene.organs * 2))

    with pytest.raises(ValueError, match="scene must have one organ, got 2"):
        TwoOrgans()
