"""Rewards at the ends of episodes: no early end pays more than going on, and success pays as much as staying."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from spatula_env.envs import PressEnv, PressVectorEnv
from spatula_env.envs.settings import EnvSettings
from spatula_env.learning.experts import PressExpert

ID = "Spatula/Press-v0"
GOAL = (0.006, -0.004, 0.008)
ABOVE_GOAL = (0.006, -0.004, -0.016)
START = {"goal": GOAL, "tool_position": ABOVE_GOAL}
DOWN = np.array([0.0, 0.0, -1.0], dtype=np.float32)


def play(env: Any, policy: Any, steps: int) -> list[tuple[Any, float, bool, dict[str, Any]]]:
    """Play an episode; returns the result of each step."""
    observation, _ = env.reset(seed=0, options=START)
    shown = []
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        shown.append((observation, float(reward), terminated, info))
        if terminated or truncated:
            break
    return shown


def test_where_success_ends_an_episode_steps_pay_what_they_fall_short_by() -> None:
    with PressEnv(engine="batch") as going, PressEnv(engine="batch", terminate_on_success=True) as ending:
        assert ending.task.best_reward == pytest.approx(1.0)
        stayed, ended = play(going, PressExpert(going), 40), play(ending, PressExpert(ending), 40)
    assert len(ended) < len(stayed)
    assert ended[-1][2]
    rewards = np.array([reward for _, reward, _, _ in ended])
    assert (rewards <= 0.0).all()
    np.testing.assert_allclose(rewards, [reward - 1.0 for _, reward, _, _ in stayed[: len(ended)]], atol=1e-12)
    # What comes after success would have added no more than nothing.
    assert all(reward <= 1.0 for _, reward, _, _ in stayed[len(ended) :])


@pytest.mark.parametrize("reward", ["dense", "sparse"])
def test_damage_costs_what_an_episode_does_in_which_nothing_is_achieved(reward: str) -> None:
    with PressEnv(engine="batch", reward=reward, damage_limit=10.0, episode_time=3.0) as env:
        shown = play(env, lambda _: DOWN, 60)
        *_, (_, last, terminated, info) = shown
        assert terminated
        assert info["is_damaged"]
        # No less than 200 steps, for learners that look beyond the time limit.
        assert last == -200.0
        assert min(reward for _, reward, _, _ in shown[:-1]) >= -1.0
        # A later limit, a greater charge.
        env._max_episode_steps = 290
        assert play(env, lambda _: DOWN, 60)[-1][1] == -290.0


def test_the_charge_is_paid_to_goals_of_hindsight_too() -> None:
    with gym.make(ID, engine="batch", reward="sparse", damage_limit=10.0, max_episode_steps=30) as env:
        shown = play(env, lambda _: DOWN, 30)
        rewards, infos = [reward for _, reward, _, _ in shown], [info for *_, info in shown]
        assert rewards[-1] == -200.0
        achieved, desired = (
            np.stack([observation[name] for observation, *_ in shown]) for name in ("achieved_goal", "desired_goal")
        )
        compute: Any = env.get_wrapper_attr("compute_reward")
        assert compute(achieved, desired, infos).tolist() == rewards
        assert [float(compute(*pair)) for pair in zip(achieved, desired, infos, strict=True)] == rewards
        assert compute(achieved, achieved, infos)[-1] == -200.0
        together = {name: np.array([info[name] for info in infos]) for name in ("is_damaged", "tangled")}
        assert compute(achieved, desired, together).tolist() == rewards
        assert compute(achieved, desired, [{}] * len(infos))[-1] == -1.0


def test_each_world_pays_for_its_own_end() -> None:
    env = PressVectorEnv(2, engine="batch", damage_limit=10.0, episode_time=2.0, autoreset_mode="disabled")
    env.reset(seed=0, options=START)
    while True:
        _, rewards, terminated, _, infos = env.step(np.stack([DOWN, -DOWN]))
        if terminated.any():
            break
    assert terminated.tolist() == infos["is_damaged"].tolist() == [True, False]
    assert rewards[0] == -200.0
    assert rewards[1] > -1.0
    env.close()


@pytest.mark.parametrize("options", [{"damage_limit": 1.0}, {"terminate_on_tangle": True}])
def test_an_end_that_costs_an_episode_needs_one_that_ends(options: dict[str, Any]) -> None:
    message = f"episode_time must be a number with {next(iter(options))}, got None: an end by damage or by a tangle"
    for make in (
        lambda: PressEnv(engine="batch", **options),
        lambda: PressVectorEnv(1, **options),
        lambda: gym.make(ID, engine="batch", max_episode_steps=-1, **options),
        lambda: gym.make_vec(ID, num_envs=1, max_episode_steps=-1, **options),
    ):
        with pytest.raises(ValueError, match=message):
            make()
    env = PressVectorEnv(1, episode_time=1.0, **options)
    with pytest.raises(ValueError, match=message):
        env.max_episode_steps = None
    assert env.max_episode_steps == 20
    env.close()
    # Success may be waited for without end.
    PressVectorEnv(1, terminate_on_success=True).close()


def test_an_end_costs_nothing_where_nothing_can_be_gained() -> None:
    weights = dict.fromkeys(("reach", "depth", "hold"), 0.0)
    with pytest.raises(ValueError, match=r"^task.weights must have a positive one with damage_limit and reward="):
        PressEnv(engine="batch", damage_limit=1.0, episode_time=1.0, task={"weights": weights})


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"max_episode_steps": 50}, 50),
        ({"episode_time": 2.0}, 40),
        ({"max_episode_steps": 700, "control_frequency": 60.0}, 700),
        ({"control_frequency": 60.0}, 600),
        ({"max_episode_steps": -1}, None),
    ],
)
def test_the_charge_follows_the_time_limit_whoever_keeps_it(options: dict[str, Any], told: int | None) -> None:
    one = gym.make(ID, engine="batch", **options)
    assert one.unwrapped._episodes.horizon == told  # type: ignore[attr-defined]
    copy = pickle.loads(pickle.dumps(one.unwrapped))
    assert copy._episodes.horizon == told
    many: Any = gym.make_vec(ID, num_envs=1, **options)
    assert many.unwrapped._episodes.horizon == told
    for env in (one, copy, many):
        env.close()


@pytest.mark.parametrize("reward", ["dense", "sparse"])
def test_for_how_long_the_goal_has_been_held_is_observed(reward: str) -> None:
    with PressEnv(engine="batch", reward=reward, terminate_on_success=True) as env:
        part = env.observation_builder.slices["hold_progress"]
        shown = play(env, PressExpert(env), 40)
        vectors = [seen["observation"] if reward == "sparse" else seen for seen, *_ in shown]
        progress = np.array([float(vector[part][0]) for vector in vectors])
        np.testing.assert_allclose(progress, [info["hold_time"] / env.task.hold_time for *_, info in shown], rtol=1e-6)
        assert progress[0] == 0.0
        assert progress[-1] == 1.0


@pytest.mark.parametrize("reward", ["dense", "sparse"])
@pytest.mark.parametrize("limit", [0.0, 10.0])
def test_how_near_an_end_by_damage_is_is_observed(reward: str, limit: float) -> None:
    with PressEnv(engine="batch", reward=reward, damage_limit=limit, episode_time=3.0) as env:
        part = env.observation_builder.slices["dose_share"]
        assert not next(each for each in env.observation_builder.parts if each.name == "dose_share").sensed
        shown = play(env, lambda _: DOWN, 60)
        vectors = [seen["observation"] if reward == "sparse" else seen for seen, *_ in shown]
        share = np.array([float(vector[part][0]) for vector in vectors])
        doses = np.array([info["episode_dose"] for *_, info in shown])
        expected = np.minimum(doses / limit, 1.0) if limit else (doses > 0.0).astype(np.float64)
        np.testing.assert_allclose(share, expected, rtol=1e-6)
        assert share[0] == 0.0
        assert share[-1] == 1.0
    with PressEnv(engine="batch", reward=reward) as env:
        assert "dose_share" not in env.observation_builder.slices


@pytest.mark.parametrize("horizon", [1, 50, 200, 500])
def test_a_learner_that_looks_beyond_the_time_limit_does_not_want_damage(horizon: int) -> None:
    """It expects to pay for 1 / (1 - discount) more steps in which nothing is achieved."""
    with PressEnv(engine="batch", reward="sparse", damage_limit=10.0, episode_time=3.0) as env:
        for discount in (0.9, 0.99, 0.995, 1.0 - 1.0 / horizon):
            if 1.0 / (1.0 - discount) <= max(horizon, 200) + 1e-6:
                assert env._episodes.incentives.charge(horizon) >= 1.0 / (1.0 - discount) - 1e-6


def test_hindsight_sees_nothing_of_how_long_the_goal_has_been_held() -> None:
    with PressEnv(engine="batch", reward="sparse") as env:
        assert "hold_progress" not in env.observation_builder.slices


def test_a_tangle_costs_only_where_it_ends_episodes() -> None:
    from spatula_env.envs.incentives import Incentives

    with PressEnv(engine="batch") as env:
        for ends, charged in ((True, [True, False]), (False, [False, False])):
            settings = EnvSettings(reward="sparse", terminate_on_tangle=ends)
            incentives = Incentives(settings, env.task)
            infos = [{"tangled": True, "is_damaged": False}, {"tangled": False, "is_damaged": False}]
            assert incentives.charged(infos).tolist() == charged
            assert not incentives.charged(None).any()
