"""Policies that evade the tasks earn less than the expert, and computed returns equal those that environments pay."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

from benchmarks import cheaters
from benchmarks.cheaters import Played

SEEDS = (0, 1, 2)
STEPS = 70


@pytest.fixture(scope="module")
def played() -> Any:
    """What the expert and a delaying policy do in Press, and the task."""
    env = gymnasium.make_vec("Spatula/Press-v0", num_envs=3, autoreset_mode="disabled", max_episode_steps=STEPS)
    acts = {
        "expert": cheaters.act_of(cheaters.expert_of(env, "Press")),
        "delay": cheaters.cheaters_of(env, "Press", 0)["delay"],
    }
    yield {name: cheaters.play(env, act, SEEDS) for name, act in acts.items()}, env.unwrapped.task
    env.close()


def test_who_delays_success_earns_less_whatever_ends_an_episode(played: Any) -> None:
    both, task = played
    for options in cheaters.options_of("Press"):
        earned = {name: cheaters.earnings(each, options, task, STEPS) for name, each in both.items()}
        for key, values in earned["expert"].items():
            assert (values > earned["delay"][key]).all(), (options, key)


def test_earnings_are_what_the_environment_pays(played: Any) -> None:
    both, task = played
    options = {"reward": "dense", "terminate_on_success": True, "damage_limit": 60e3}
    env = gymnasium.make_vec(
        "Spatula/Press-v0", num_envs=3, autoreset_mode="disabled", max_episode_steps=STEPS, **options
    )
    expert = cheaters.expert_of(env, "Press")
    observation, _ = env.reset(seed=list(SEEDS))
    paid, over = np.zeros(3), np.zeros(3, dtype=np.bool_)
    while not over.all():
        observation, rewards, terminated, _, _ = env.step(expert(observation))
        paid += np.where(over, 0.0, rewards)
        over |= terminated
        if terminated.any() and not over.all():
            env.reset(options={"reset_mask": terminated})
    env.close()
    np.testing.assert_allclose(cheaters.earnings(both["expert"], options, task, STEPS)["1"], paid, atol=1e-9)


def test_who_hovers_beside_an_organ_that_is_pushed_aside_achieves_nothing() -> None:
    env = cheaters.make("Press", 4, "batch")
    hover = cheaters.cheaters_of(env, "Press", 5)["hover"]
    found = cheaters.play(env, hover, range(4))
    assert not found.success.any()
    assert (found.sparse[cheaters.PUSHING + 20 :] == -1.0).all()
    env.close()


def test_one_cheater_can_be_counted_alone() -> None:
    found = cheaters.count_successes("Press", "batch", "still", episodes=3, seed=7, worlds=2)
    assert found == {"episodes": 3, "successes": 0, "within": 0, "at_reset": 0}
    with pytest.raises(ValueError, match=r"Press must have the cheater, one of .*'hover'.*; got 'drag'"):
        cheaters.count_successes("Press", "batch", "drag", episodes=1, seed=0)


def played_in(dense: list[float], success: list[bool], dose: list[float]) -> Played:
    column = np.array(dense)[:, None]
    return Played(column, -np.ones_like(column), np.array(success)[:, None], np.array(dose)[:, None])


def test_nothing_is_paid_after_an_end(played: Any) -> None:
    _, task = played
    each = played_in([0.5, 0.5, 0.5], [False, True, True], [0.0, 0.0, 99e3])
    options = {"reward": "dense", "terminate_on_success": True, "damage_limit": 60e3}
    assert cheaters.earnings(each, options, task, 3)["1"] == pytest.approx([-1.0])
    staying = {**options, "terminate_on_success": False}
    found = cheaters.earnings(each, staying, task, 3)
    # Damage costs 200 steps, and what was earned before is kept.
    assert found["1"] == pytest.approx([0.5 + 0.5 - 200.0])
    assert found["0.97"] == pytest.approx([0.5 + 0.97 * 0.5 - 0.97**2 * 200.0])
    assert found["success"].tolist() == [True]


def test_the_best_cheater_is_told_in_each_respect() -> None:
    earned = {"expert": {"success": 1.0, "1": 5.0}, "a": {"success": 0.5, "1": 1.0}, "b": {"success": 0.0, "1": 6.0}}
    row = cheaters.compared(earned)
    assert row["best"] == {"success": {"policy": "a", "value": 0.5}, "1": {"policy": "b", "value": 6.0}}
    assert not row["ahead"]
