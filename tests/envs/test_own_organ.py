"""The option `organ` of environments: tasks on an organ of one's own."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from own_organs import bean, ellipsoid, written

from spatula_env import scenes
from spatula_env.envs.scenery import CALM_PASSAGE, with_short_steps
from spatula_env.geometry import PreparedOrgan
from spatula_env.geometry.overlap import overlaps
from spatula_env.geometry.prepared import UNIT_LENGTH
from spatula_env.geometry.rotations import turn
from spatula_env.learning.experts import PalpateExpert, PressExpert, RetractExpert
from spatula_env.learning.experts.base import Expert
from spatula_env.scenes import Material

EXPERTS: dict[str, type[Expert]] = {"Press": PressExpert, "Palpate": PalpateExpert, "Retract": RetractExpert}


@pytest.fixture(scope="module")
def organ(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(ellipsoid(), tmp_path_factory.mktemp("organ"))


@pytest.fixture(scope="module")
def kidney(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(bean(), tmp_path_factory.mktemp("kidney"))


def made(task: str, organ: str, **options: Any) -> Any:
    return gym.make(f"Spatula/{task}-v0", engine="batch", organ=organ, disable_env_checker=True, **options)


@pytest.mark.parametrize("task", EXPERTS)
def test_environments_conform(task: str, organ: str) -> None:
    with made(task, organ) as env:
        check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("engine", ["batch", "bullet"])
@pytest.mark.parametrize("task", EXPERTS)
def test_engines_of_springs_take_it(task: str, engine: str, organ: str) -> None:
    if engine == "bullet":
        pytest.importorskip("pybullet", reason="PyBullet is not installed")
    with gym.make(f"Spatula/{task}-v0", engine=engine, organ=organ, disable_env_checker=True) as env:
        env.reset(seed=0)
        for _ in range(3):
            _, _, _, _, info = env.step(env.action_space.sample())
        assert not info["diverged"]


@pytest.mark.parametrize(("task", "least"), [("Press", 15), ("Palpate", 10), ("Retract", 14)])
def test_experts_do_the_tasks_on_it(task: str, least: int, kidney: str) -> None:
    envs = gym.make_vec(f"Spatula/{task}-v0", num_envs=16, engine="batch", organ=kidney)
    expert = EXPERTS[task](envs)
    observation, _ = envs.reset(seed=0)
    succeeded = np.zeros(16, dtype=np.bool_)
    for _ in range(150):
        observation, _, _, _, info = envs.step(expert(observation))
        succeeded |= info["is_success"]
        assert info["residual"].max() < 1e-4
    envs.close()
    assert succeeded.sum() >= least


@pytest.mark.parametrize("task", EXPERTS)
@pytest.mark.parametrize("level", ["standard", "hard"])
def test_tools_start_outside_the_organ_and_within_the_workspace(task: str, level: str, kidney: str) -> None:
    envs: Any = gym.make_vec(f"Spatula/{task}-v0", num_envs=64, engine="batch", organ=kidney, level=level)
    envs.reset(seed=5)
    episodes = envs.unwrapped._episodes
    situation = episodes.situation
    for world in range(64):
        setting = episodes._variation.settings[world]
        tool, position = setting.tools[0], situation.tool_positions[world, 0]
        corners = turn(situation.tool_orientations[world, 0], tool.vertices) + position
        assert not overlaps(setting.rest_nodes, setting.triangles, corners, tool.triangles, 1e-4)
        assert (np.abs(position) <= 0.0508 + 1e-9).all()
    envs.close()


@pytest.mark.parametrize("task", EXPERTS)
def test_episodes_are_saved_as_a_whole(task: str, organ: str) -> None:
    with made(task, organ) as env:
        env.reset(seed=2)
        actions = np.random.default_rng(0).uniform(-1.0, 1.0, (8, *env.action_space.shape)).astype(np.float32)
        state = env.unwrapped.save()
        first = [env.step(action)[:2] for action in actions]
        env.unwrapped.restore(state)
        again = [env.step(action)[:2] for action in actions]
        for (one, reward), (other, other_reward) in zip(first, again, strict=True):
            np.testing.assert_array_equal(one, other)
            assert reward == other_reward


@pytest.mark.parametrize("task", EXPERTS)
def test_goals_of_episodes_can_be_asked_for_again(task: str, organ: str) -> None:
    with made(task, organ) as env:
        for seed in range(5):
            env.reset(seed=seed)
            goal = env.unwrapped._episodes.goals[0].copy()
            env.reset(seed=100, options={"goal": goal})
            np.testing.assert_array_equal(env.unwrapped._episodes.goals[0], goal)
            assert env.unwrapped.moment.marks


@pytest.mark.parametrize(
    ("task", "goal", "told"),
    [
        ("Press", (0.048, 0.0, 0.01), "goal must be at a place where the organ is higher"),
        ("Press", (0.043, 0.0, 0.006), "goal must be at a place that can be pressed, got .*, where places are steeper"),
        ("Press", (0.0, 0.0, 0.017), r"goal must have a depth of 0.01\d\d m at most at"),
        ("Palpate", (0.9, 0.04, 0.0, 0.15), "goal must be at most 0.003 m from the end of a path that can be felt"),
        ("Palpate", (0.9, 0.0, 0.0, 0.5), "goal must have a force from"),
        ("Retract", (0.02, 0.0), "goal must be a displacement of 0.004 to 0.01 m"),
    ],
)
def test_goals_out_of_reach_are_refused(task: str, goal: tuple[float, ...], told: str, organ: str) -> None:
    with made(task, organ) as env, pytest.raises(ValueError, match=told):
        env.reset(seed=0, options={"goal": goal})


def test_the_spatula_is_turned_to_the_surface(organ: str) -> None:
    with made("Press", organ) as env:
        slopes = []
        for seed in range(10):
            observation, _ = env.reset(seed=seed)
            slices = env.unwrapped.observation_builder.slices
            normal = observation[slices["place_normal"]]
            orientation = env.unwrapped._episodes.situation.tool_orientations[0, 0]
            np.testing.assert_allclose(turn(orientation, [0.0, 0.0, 1.0]), normal, atol=1e-6)
            slopes.append(np.rad2deg(np.arccos(normal[2])))
        assert max(slopes) > 15.0


def test_depths_are_measured_along_the_normal(organ: str) -> None:
    """An organ that is moved as a whole against the normal is as deep as it was moved."""
    with made("Press", organ) as env:
        env.reset(seed=3)
        episodes = env.unwrapped._episodes
        task, memory, situation = episodes.task, episodes._memory, episodes.situation
        point, normal = memory["point"][0], memory["normal"][0]
        shift = 0.004 * normal
        tool = task.setting.tools[0]
        moved = type(situation)(
            **{
                **vars(situation),
                "nodes": situation.nodes - shift,
                "tool_position": (point - shift - tool.vertices[:, 2].min() * normal)[None],
                "contact_forces": 0.1 * normal[None, None],
            }
        )
        evaluation = task.evaluate(moved, episodes.goals, memory)
        # The surface is curved: half the spatula's width away, it is reached a little aside.
        assert evaluation.measures["depth"][0] == pytest.approx(0.004, rel=0.02)
        assert evaluation.measures["place_error"][0] == pytest.approx(0.0, abs=1e-6)


def test_an_environment_is_made_again_from_its_record(organ: str, tmp_path: Path) -> None:
    file = tmp_path / "an organ.npz"
    shutil.copy(organ, file)
    with gym.make("Spatula/Press-v0", engine="batch", organ=file, disable_env_checker=True) as env:
        recorded = json.loads(json.dumps(env.spec.kwargs))
        assert recorded["organ"] == str(file)
    with gym.make("Spatula/Press-v0", **recorded, disable_env_checker=True) as env:
        assert env.unwrapped.task.setting.organ.name == "ellipsoid"


@pytest.mark.parametrize(
    ("value", "error", "told"),
    [
        ("liver.stl", ValueError, "organ must be a file of `spatula organ prepare`, which ends in .npz, got 'liver"),
        ("nothing.npz", FileNotFoundError, "'nothing.npz' does not exist"),
        (3, ValueError, "organ must be the path of a file of `spatula organ prepare`, or None, got 3"),
    ],
)
def test_what_is_no_organ_is_refused(value: Any, error: type[Exception], told: str) -> None:
    with pytest.raises(error, match=told):
        made("Press", value)


@pytest.mark.parametrize(
    ("task", "told"),
    [
        ("Press", "organ 'small' has 0 places that the tool reaches: of .*; 8 are needed"),
        ("Palpate", "on those are 0 paths"),
        ("Retract", "organ 'small' has 0 places that a blade can push from the side: .*; 8 are needed"),
    ],
)
@pytest.mark.filterwarnings("ignore::spatula_env._warnings.SceneWarning")
def test_organs_that_are_too_small_are_refused_with_the_reasons(task: str, told: str, tmp_path: Path) -> None:
    ball = ellipsoid((0.012, 0.012, 0.006), 0.001)
    small = written(PreparedOrgan(ball.vertices, ball.triangles, "small", held=ball.held), tmp_path)
    with pytest.raises(ValueError, match=told):
        made(task, small)


@pytest.mark.parametrize(("modulus", "times"), [(200.0, 1), (2010.0, 3), (8040.0, 5)])
def test_steps_are_short_enough_for_contact_with_the_material(modulus: float, times: int) -> None:
    """A shear wave goes 1.4 m/s per square root of four times the usual modulus, and edges are about 4 mm."""
    scene = scenes.organ_from_above(ellipsoid(), material=Material(young_modulus=modulus))
    placed = scene.organs[0]
    ends = placed.organ.vertices[placed.organ.triangles] * UNIT_LENGTH
    edge = np.linalg.norm(ends - np.roll(ends, 1, axis=1), axis=2).mean()
    assert placed.material is not None
    speed = np.sqrt(placed.material.shear_modulus / placed.material.density)
    short = with_short_steps(scene)
    assert scene.dt / short.dt == pytest.approx(round(scene.dt / short.dt))
    assert short.dt * speed <= CALM_PASSAGE * edge
    assert round(scene.dt / short.dt) == times
    # Not shorter than it takes.
    assert times == 1 or scene.dt / (times - 1) * speed > CALM_PASSAGE * edge
