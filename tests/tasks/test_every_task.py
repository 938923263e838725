"""What holds for every task: how it can be configured, what it refuses, and the form of its answers."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
from task_helpers import DEFINITIONS, setting_of_task

from spatula_env.tasks import Evaluation, Situation, Start, Task

every_task = pytest.mark.parametrize("name", DEFINITIONS)


def make_task(name: str, **changes: Any) -> Task:
    definition = DEFINITIONS[name]
    return definition.task(definition.config(**changes), setting_of_task(name))


def begin(task: Task, count: int) -> tuple[Start, Evaluation]:
    """The beginnings of episodes, and what the task makes of them."""
    start = task.sample(np.random.default_rng(8), count, task.setting)
    memory = task.new_memory(count)
    task.begin_memory(memory, np.arange(count), start, [task.setting] * count)
    situation = Situation.at_rest(task.setting, start.tool_position, start.tool_orientation)
    return start, task.evaluate(situation, start.goal, memory)


@every_task
def test_terms_and_parts_are_as_announced(name: str) -> None:
    task = make_task(name)
    start, found = begin(task, 2)
    assert set(found.terms) == set(task.weights) == set(asdict(DEFINITIONS[name].config().weights))
    assert {part.name: (2, part.size) for part in task.extra_parts} == {
        part: values.shape for part, values in found.parts.items()
    }
    assert all(values.shape == (2,) for values in (*found.terms.values(), *found.measures.values()))
    assert len(task.goal_names) == len(task.goal_units) == found.achieved.shape[1] == len(task.goal_low)
    assert start.goal.shape == found.achieved.shape == found.error.shape
    assert not found.within_tolerance.any()


@every_task
def test_equal_generators_give_equal_samples(name: str) -> None:
    task = make_task(name)
    first, second = (begin(task, 3)[0] for _ in range(2))
    for values, others in zip(vars(first).values(), vars(second).values(), strict=True):
        np.testing.assert_array_equal(values, others)
    assert len(np.unique(first.goal, axis=0)) == 3


@every_task
def test_sparse_reward_takes_one_goal_or_many(name: str) -> None:
    task = make_task(name)
    goal = begin(task, 1)[0].goal[0]
    one = task.compute_reward(goal, goal)
    assert one.shape == ()
    assert one == 0.0
    many = task.compute_reward(np.tile(task.goal_low, (2, 4, 1)), np.tile(goal, (2, 4, 1)))
    assert many.shape == (2, 4)
    assert many.dtype == np.float32
    assert (many == -1.0).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"hold_time": 0.0}, "hold_time must be positive"),
        ({"hold_time": float("nan")}, "hold_time must be positive"),
        ({"reach_scale": -1.0}, "reach_scale must be positive"),
        ({"start_height_range": 0.01}, "start_height_range must be two numbers"),
        ({"start_height_range": (0.02, 0.01)}, "start_height_range must be two finite numbers in ascending order"),
        ({"start_height_range": (-0.01, 0.01)}, "start_height_range must not be negative"),
        ({"weights": {"speed": 1.0}}, "weights has no speed; allowed are {weights}"),
        ({"weights": {"hold": float("inf")}}, "weights.hold must be finite"),
        ({"weights": 3.0}, "weights must be a mapping or a {kind}"),
    ],
)
@every_task
def test_what_all_configurations_have_is_checked(name: str, changes: dict[str, Any], message: str) -> None:
    config = DEFINITIONS[name].config
    weights = config().weights
    message = message.format(weights=", ".join(sorted(asdict(weights))), kind=type(weights).__name__)
    with pytest.raises(ValueError, match=message):
        config(**changes)


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("press", {"place_radius": -1.0}, "place_radius must be zero or more"),
        ("press", {"depth_tolerance": 0.0}, "depth_tolerance must be positive"),
        ("press", {"depth_range": (0.01, 0.005)}, "depth_range must be two finite numbers in ascending order"),
        ("press", {"depth_range": (0.0005, 0.01)}, "depth_range must begin above depth_tolerance, 0.001"),
        ("retract", {"place_limit": -1.0}, "place_limit must be zero or more"),
        ("retract", {"tolerance": 0.0}, "tolerance must be positive"),
        ("retract", {"shift_range": (0.01, 0.005)}, "shift_range must be two finite numbers in ascending order"),
        ("retract", {"shift_range": (0.0005, 0.01)}, "shift_range must begin above tolerance, 0.001"),
        ("retract", {"shift_range": (0.004, 0.05)}, "and end at 0.03 at most"),
        ("retract", {"height_range": (0.2, 1.2)}, "height_range must lie in 0 to 1"),
        ("retract", {"angle_limit": 2.0}, "angle_limit must be less than pi/2"),
        ("retract", {"start_offset": 0.01}, "start_offset must be two numbers"),
        ("retract", {"start_offset": (0.01, -0.01)}, "start_offset must be two finite numbers of zero or more"),
        ("fissure", {"place_limit": -1.0}, "place_limit must be zero or more"),
        ("fissure", {"target_height": float("nan")}, "target_height must be positive"),
        ("fissure", {"view_range": (0.3, 0.2)}, "view_range must be two finite numbers in ascending order"),
        ("fissure", {"view_range": (0.1, 1.0)}, "view_range must lie in 0 to 0.6"),
        ("fissure", {"exposure_range": (0.0, 0.5)}, "exposure_range must lie above 0 and end at 1"),
        ("fissure", {"exposure_range": (0.5, 1.1)}, "exposure_range must lie above 0 and end at 1"),
        ("fissure", {"start_tilt": 2.0}, "start_tilt must be 0.6 at most"),
        ("fissure", {"target_size": 0.01}, "target_size must be two numbers"),
        ("fissure", {"target_size": (0.01, 0.0)}, "target_size must be positive"),
        ("fissure", {"target_grid": (5, 1)}, "target_grid must be an integer of at least 2"),
        ("clamp", {"start_offset": -1.0}, "start_offset must be zero or more"),
        ("clamp", {"lift_tolerance": 0.0}, "lift_tolerance must be positive"),
        ("clamp", {"lift_range": (0.01, 0.005)}, "lift_range must be two finite numbers in ascending order"),
        ("clamp", {"lift_range": (0.0005, 0.01)}, "lift_range must begin above lift_tolerance, 0.001"),
        ("clamp", {"lift_range": (0.01, 0.2)}, "lift_range must end at 0.08 m at most"),
        ("clamp", {"slip_range": (0.0, 0.02)}, "slip_range must lie from 0 to below 0.02 m"),
        ("clamp", {"start_opening_range": (-0.01, 0.01)}, "start_opening_range must not be negative"),
        ("palpate", {"middle_radius": -1.0}, "middle_radius must be zero or more"),
        ("palpate", {"path_tolerance": 0.0}, "path_tolerance must be positive"),
        ("palpate", {"force_range": (0.2, 0.1)}, "force_range must be two finite numbers in ascending order"),
        ("palpate", {"force_range": (0.02, 0.1)}, "force_range must begin above force_tolerance, 0.03"),
        ("palpate", {"force_range": (0.1, 9.0)}, "and end at 1.0 at most"),
        ("palpate", {"share_range": (0.0, 0.9)}, "share_range must be above 0 and 1 at most"),
        ("palpate", {"share_range": (0.5, 1.1)}, "share_range must be above 0 and 1 at most"),
        ("palpate", {"length_range": (0.003, 0.02)}, "length_range must begin above twice end_tolerance, 0.002"),
        ("palpate", {"bend_limit": 0.01}, "bend_limit must be a quarter of the shortest path, 0.03, at most"),
    ],
)
def test_configurations_are_checked(name: str, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DEFINITIONS[name].config(**changes)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("press", {"depth_range": (0.006, 0.01)}),
        ("retract", {"shift_range": (0.006, 0.01), "start_offset": (0.01, 0.02)}),
        ("fissure", {"target_grid": (3, 7), "target_size": (0.01, 0.003)}),
        ("clamp", {"slip_range": (0.001, 0.003)}),
        ("palpate", {"force_range": (0.1, 0.2)}),
    ],
)
def test_a_configuration_survives_a_file(name: str, changes: dict[str, Any]) -> None:
    kind = DEFINITIONS[name].config
    config = kind(weights={"hold": 0.7}, **changes)
    assert config != kind()
    assert config.weights.hold == 0.7
    assert kind(**json.loads(json.dumps(asdict(config)))) == config


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("press", {"depth_range": (0.005, 0.04)}, "depth_range must end at 0.02"),
        ("press", {"start_height_range": (0.01, 0.09)}, "start_height_range must end at 0.07"),
        ("press", {"place_radius": 0.06}, "place_radius must be 0.0508 m at most"),
        ("press", {"start_radius": 0.06}, "start_radius must be 0.0508 m at most"),
        ("retract", {"start_offset": (0.06, 0.01)}, "start_offset must keep the blade in the workspace"),
        ("retract", {"start_height_range": (0.01, 0.09)}, "start_height_range must end at 0.05"),
        ("fissure", {"place_limit": 0.04}, "place_limit must be 0.0180"),
        ("fissure", {"start_offset": 0.06}, "start_offset must be 0.0508 m at most"),
        ("fissure", {"start_height_range": (0.01, 0.09)}, "start_height_range must end at 0.0558 m at most"),
        ("clamp", {"start_offset": 0.06}, "start_offset must be 0.0508 m at most"),
        ("clamp", {"start_height_range": (0.01, 0.09)}, "start_height_range must end at 0.0678 m at most"),
        ("palpate", {"length_range": (0.03, 0.09)}, "middle_radius, half of length_range and start_radius must not be"),
        ("palpate", {"start_height_range": (0.01, 0.09)}, "start_height_range must end at 0.07"),
    ],
)
def test_what_is_out_of_reach_is_refused(name: str, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_task(name, **changes)


@pytest.mark.parametrize(
    ("name", "goal", "message"),
    [
        ("press", (0.06, 0.0, 0.01), r"goal must be at a place from \[-0.0508 -0.0508\]"),
        ("press", (0.0, 0.0, 0.02), "goal must have a depth from 0.005 to 0.018 m"),
        ("retract", (0.02, 0.0), "goal must be a displacement of 0.004 to 0.01 m"),
        ("retract", (0.001, 0.0), "goal must be a displacement of 0.004 to 0.01 m"),
        ("retract", (0.0, 0.006), "goal must lead across the fold"),
        ("retract", (-0.006, 0.002), "goal must lead across the fold"),
        ("fissure", (0.05, 0.2, 0.8), "goal must have a place from -0.0180"),
        ("fissure", (0.0, 0.35, 0.8), "goal must have a view from -0.3 to 0.3 rad"),
        ("fissure", (0.0, 0.2, 0.0), "goal must have an exposure above 0"),
        ("fissure", (0.0, 0.2, 1.01), "goal must have an exposure above 0"),
        ("clamp", (0.02, 0.001), r"goal must have a lift from 0\.004 to 0\.012 m"),
        ("clamp", (0.008, 0.02), "goal must have a slip from 0"),
        ("palpate", (1.2, 0.0, 0.0, 0.14), "goal must have a share from 0.0 to 1.0"),
        ("palpate", (0.9, 0.0, 0.0, 0.5), "goal must have a force from 0.1 to 0.18"),
        ("palpate", (0.9, 0.02, 0.02, 0.14), "goal must end the path 0.0240 m from the organ's axis at most, got 0.02"),
    ],
)
def test_goals_are_checked(name: str, goal: tuple[float, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_task(name).check_goal(np.array(goal))
