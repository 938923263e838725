"""The criteria shown to a person agree with the task's verdict."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import spatula_env
from spatula_env.tasks.base import Task, as_seen

gym.register_envs(spatula_env)


@pytest.fixture(scope="module")
def tasks():
    """Each task, and the goals of some of its episodes."""
    found = {}
    for name in spatula_env.TASKS:
        env = gym.make(f"Spatula/{name}-v0", engine="batch")
        goals = []
        for seed in range(5):
            env.reset(seed=seed)
            goals.append(as_seen(env.unwrapped.goal))
        found[name] = env.unwrapped.task, goals
        env.close()
    return found


@pytest.mark.parametrize("name", spatula_env.TASKS)
@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_all_criteria_are_met_exactly_when_the_goal_is(tasks, name, data):
    task, goals = tasks[name]
    goal = data.draw(st.sampled_from(goals))
    # Near the goal, where verdicts differ: within a few millimetres, degrees and tenths.
    scale = np.array([{"m": 2e-3, "rad": 0.1, "1": 0.1, "N": 0.03}[unit] for unit in task.goal_units])
    offset = data.draw(st.lists(st.floats(-1.5, 1.5), min_size=len(goal), max_size=len(goal)))
    achieved = as_seen(np.clip(goal + scale * offset, task.goal_low, task.goal_high))
    criteria = task.criteria(achieved, goal)
    assert all(criterion.within for criterion in criteria) == bool(task.fulfils(achieved, goal))
    for criterion in criteria:
        # What is shown as the range is what counts, but for the last digit.
        margin = 1e-6 * max(1.0, abs(criterion.present))
        if criterion.low + margin < criterion.present < criterion.high - margin:
            assert criterion.within
        if criterion.present < criterion.low - margin or criterion.present > criterion.high + margin:
            assert not criterion.within


@pytest.mark.parametrize("name", spatula_env.TASKS)
def test_the_goal_itself_is_within(tasks, name):
    task, goals = tasks[name]
    for goal in goals:
        assert task.fulfils(goal, goal) and all(criterion.within for criterion in task.criteria(goal, goal))


def test_a_task_that_says_nothing_has_one_criterion_for_each_number(tasks):
    task, goals = tasks["Press"]
    criteria = Task.criteria(task, goals[0], goals[1])
    assert [(each.name, each.unit) for each in criteria] == [("x", "m"), ("y", "m"), ("depth", "m")]
    assert [each.present for each in criteria] == goals[0].tolist()
    assert [each.low for each in criteria] == goals[1].tolist()
    assert not any(each.within for each in criteria)


def test_what_is_not_gripped_is_said_so(tasks):
    task, goals = tasks["Clamp"]
    _, slip = task.criteria(np.array([0.0, task.goal_high[1]]), goals[0])
    assert slip.note.startswith("no grip") and not slip.within
    _, slip = task.criteria(np.array([0.0, 0.0005]), goals[0])
    assert slip.note == "" and slip.within
