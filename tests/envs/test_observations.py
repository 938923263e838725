from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from spatula_env.envs.observations import ObservationBuilder, first_of
from spatula_env.geometry import icosphere
from spatula_env.tasks import PressConfig, PressTask, Setting, Situation

SPHERE = icosphere(0.06, subdivisions=2)
MODES = [(mode, goal) for mode in ("state", "dict") for goal in (False, True)]


def make_setting() -> Setting:
    return Setting(
        rest_nodes=SPHERE.vertices - [0.0, 0.0, 0.085],
        triangles=SPHERE.triangles,
        ground_height=-0.145,
        tool_low=np.array([-0.01, -0.01, -0.00125]),
        tool_high=np.array([0.01, 0.01, 0.00125]),
        workspace_low=np.full(3, -0.0508),
        workspace_high=np.full(3, 0.0508),
    )


def make_builder(obs_mode: str = "state", goal_interface: bool = False) -> tuple[ObservationBuilder, PressTask]:
    setting = make_setting()
    task = PressTask(PressConfig(), setting)
    return ObservationBuilder(setting, task, 2, 0.1, obs_mode, goal_interface=goal_interface), task


def make_situation(generator: np.random.Generator, count: int, size: float = 0.01) -> Situation:
    def draw(*shape: int) -> np.ndarray:
        return generator.normal(scale=size, size=(count, *shape))

    return Situation(
        tool_position=draw(3),
        tool_velocity=draw(3),
        contact_force=draw(3),
        peak_force=np.abs(draw()),
        contact_share=np.abs(draw(2)),
        contact_depth=np.abs(draw()),
        nodes=make_setting().rest_nodes + draw(len(SPHERE.vertices), 3),
        action=np.zeros((count, 3)),
    )


def build(obs_mode: str, goal_interface: bool, count: int = 1, size: float = 0.01) -> tuple[Any, ObservationBuilder]:
    builder, task = make_builder(obs_mode, goal_interface)
    generator = np.random.default_rng(5)
    situation = make_situation(generator, count, size)
    goal = task.sample(generator, count).goal
    return builder.build(situation, goal, task.evaluate(situation, goal)), builder


@pytest.mark.parametrize(("obs_mode", "goal_interface"), MODES)
@pytest.mark.parametrize("size", [0.01, 1e6])
def test_observations_lie_in_their_space_whatever_happens(obs_mode: str, goal_interface: bool, size: float) -> None:
    observation, builder = build(obs_mode, goal_interface, size=size)
    assert builder.space.contains(first_of(observation))


@pytest.mark.parametrize(("obs_mode", "goal_interface"), MODES)
def test_all_bounds_are_finite(obs_mode: str, goal_interface: bool) -> None:
    space = make_builder(obs_mode, goal_interface)[0].space
    boxes = space.spaces.values() if isinstance(space, spaces.Dict) else [space]
    for box in boxes:
        assert isinstance(box, spaces.Box)
        assert box.dtype == np.float32
        assert np.isfinite(box.low).all()
        assert np.isfinite(box.high).all()
        assert (box.low < box.high).all()


def test_both_modes_say_the_same() -> None:
    vector, builder = build("state", False)
    named, _ = build("dict", False)
    assert set(named) == set(builder.slices)
    for name, part in builder.slices.items():
        assert vector[:, part].tolist() == named[name].tolist(), name
    assert sum(part.size for part in builder.parts) == vector.shape[1] == 66


def test_parts_hold_what_their_names_say() -> None:
    builder, task = make_builder("dict")
    situation = make_situation(np.random.default_rng(1), 2)
    goal = task.sample(np.random.default_rng(2), 2).goal
    evaluation = task.evaluate(situation, goal)
    observation: Any = builder.build(situation, goal, evaluation)
    single = np.float32
    for name in ("tool_position", "tool_velocity", "contact_force", "contact_share"):
        assert observation[name].tolist() == getattr(situation, name).astype(single).tolist()
    assert observation["contact_depth"].tolist() == situation.contact_depth[:, None].astype(single).tolist()
    moved = situation.nodes[:, builder.landmarks] - make_setting().rest_nodes[builder.landmarks]
    assert observation["landmarks"].reshape(2, 16, 3) == pytest.approx(moved, rel=1e-6)
    assert observation["goal"].tolist() == goal.astype(single).tolist()
    assert observation["error"].tolist() == evaluation.error.astype(single).tolist()


@pytest.mark.parametrize("obs_mode", ["state", "dict"])
def test_what_depends_on_the_goal_is_only_in_the_goals(obs_mode: str) -> None:
    builder, task = make_builder(obs_mode, True)
    situation = make_situation(np.random.default_rng(1), 1)
    seen = []
    for goal in np.array([[[0.0, 0.0, 0.006]], [[0.01, 0.0, 0.015]]]):
        observation: Any = builder.build(situation, goal, task.evaluate(situation, goal))
        assert observation.pop("desired_goal").tolist() == goal.astype(np.float32).tolist()
        seen.append({name: values.tolist() for name, values in observation.items()})
    assert seen[0] == seen[1]
    assert "achieved_goal" in seen[0]
    if obs_mode == "state":
        assert set(seen[0]) == {"observation", "achieved_goal"}


@pytest.mark.parametrize(("obs_mode", "goal_interface"), MODES)
def test_many_worlds_are_seen_as_gymnasium_batches_them(obs_mode: str, goal_interface: bool) -> None:
    from gymnasium.vector.utils import batch_space

    observation, builder = build(obs_mode, goal_interface, count=3)
    assert batch_space(builder.space, 3).contains(observation)


def test_landmarks_are_spread_over_the_upper_half_and_always_the_same() -> None:
    builder, again = make_builder()[0], make_builder()[0]
    assert builder.landmarks.tolist() == again.landmarks.tolist()
    points = SPHERE.vertices[builder.landmarks]
    assert len(set(builder.landmarks.tolist())) == 16
    assert (points[:, 2] >= -1e-12).all()
    distances = np.linalg.norm(points[:, None] - points[None], axis=-1) + np.eye(16)
    upper = SPHERE.vertices[SPHERE.vertices[:, 2] >= -1e-12]
    to_nearest = np.linalg.norm(upper[:, None] - points[None], axis=-1).min(axis=1)
    # No node of the upper half is farther from the landmarks than they are from each other.
    assert to_nearest.max() <= distances.min()


@pytest.mark.parametrize("obs_mode", ["rgb", "rgbd", "pointcloud", ""])
def test_other_modes_are_refused(obs_mode: str) -> None:
    with pytest.raises(ValueError, match=r"obs_mode must be one of \['state', 'dict'\], got"):
        make_builder(obs_mode)
