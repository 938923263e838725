"""The option `organ` of Fissure and Clamp: organs of one's own that name a fissure or a ridge."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from own_organs import ellipsoid, fold, mound, written

from spatula_env.geometry.overlap import overlaps
from spatula_env.geometry.rotations import turn
from spatula_env.learning.experts import ClampExpert, FissureExpert
from spatula_env.learning.experts.base import Expert

EXPERTS: dict[str, type[Expert]] = {"Fissure": FissureExpert, "Clamp": ClampExpert}


@pytest.fixture(scope="module")
def organs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("organs")
    return {"Fissure": written(mound(), folder), "Clamp": written(fold(), folder)}


def made(task: str, organs: dict[str, str], **options: Any) -> Any:
    return gym.make(f"Spatula/{task}-v0", engine="batch", organ=organs[task], disable_env_checker=True, **options)


@pytest.mark.parametrize("task", EXPERTS)
def test_environments_conform(task: str, organs: dict[str, str]) -> None:
    with made(task, organs) as env:
        check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("task", EXPERTS)
def test_experts_do_the_tasks_on_it(task: str, organs: dict[str, str]) -> None:
    envs = gym.make_vec(f"Spatula/{task}-v0", num_envs=8, engine="batch", organ=organs[task])
    expert = EXPERTS[task](envs)
    observation, _ = envs.reset(seed=0)
    succeeded = np.zeros(8, dtype=np.bool_)
    for _ in range(80):
        observation, _, _, _, info = envs.step(expert(observation))
        succeeded |= info["is_success"]
        assert info["residual"].max() < 1e-4
        if succeeded.all():
            break
    envs.close()
    assert succeeded.sum() >= 7


@pytest.mark.parametrize("task", EXPERTS)
def test_tools_start_outside_the_organ(task: str, organs: dict[str, str]) -> None:
    envs: Any = gym.make_vec(
        f"Spatula/{task}-v0", num_envs=32, engine="batch", organ=organs[task], randomization="default"
    )
    envs.reset(seed=5)
    episodes = envs.unwrapped._episodes
    situation = episodes.situation
    for world in range(32):
        setting = episodes._variation.settings[world]
        for number, tool in enumerate(setting.tools):
            corners = turn(situation.tool_orientations[world, number], tool.vertices)
            corners = corners + situation.tool_positions[world, number]
            assert not overlaps(setting.rest_nodes, setting.triangles, corners, tool.triangles, 1e-4)
    envs.close()


def test_tools_are_stopped_near_the_floor(organs: dict[str, str]) -> None:
    """Wherever the floor is: the preset's stop would be 30 mm above the ground, the mound's floor is at 25 mm."""
    with made("Fissure", organs, max_force=None) as env:
        env.reset(seed=0, options={"tool_position": (0.0, 0.0, 0.0)})
        task = env.unwrapped._episodes.task
        for _ in range(40):
            env.step(np.array([0.0, 0.0, -1.0, 0.0], dtype=np.float32))
        situation = env.unwrapped._episodes.situation
        edge = float(situation.lowest_corner(task.setting.tools[0])[0]) - task.setting.ground_height
    assert edge == pytest.approx(task.stop_height, abs=1e-3)
    assert 0.02 < task.stop_height < 0.03


@pytest.mark.parametrize("task", EXPERTS)
def test_goals_of_episodes_can_be_asked_for_again(task: str, organs: dict[str, str]) -> None:
    with made(task, organs) as env:
        for seed in range(3):
            env.reset(seed=seed)
            goal = env.unwrapped._episodes.goals[0].copy()
            env.reset(seed=100, options={"goal": goal})
            np.testing.assert_array_equal(env.unwrapped._episodes.goals[0], goal)
            assert env.unwrapped.moment.marks


def test_goals_where_the_blade_does_not_get_down_are_refused(organs: dict[str, str]) -> None:
    with (
        made("Fissure", organs) as env,
        pytest.raises(ValueError, match=r"goal must have a place from -0\.0100 to 0\.0100"),
    ):
        env.reset(options={"goal": (0.011, 0.2, 0.8)})


@pytest.mark.parametrize(("task", "line"), [("Fissure", "fissure"), ("Clamp", "ridge")])
def test_organs_that_name_no_line_are_refused(task: str, line: str, tmp_path: Any) -> None:
    plain = written(ellipsoid(), tmp_path)
    told = f"organ must say where its {line} is, and 'ellipsoid' does not: it names no lines; prepare it with"
    with pytest.raises(ValueError, match=told):
        made(task, {task: plain})
