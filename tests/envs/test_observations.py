from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from spatula_env import scenes
from spatula_env.envs.control import ALL_SIX, TRANSLATION, ControlLayout, VelocityControl
from spatula_env.envs.observations import NOISE, FrameMemory, ObservationBuilder, first_of, lerobot_keys
from spatula_env.envs.settings import ObservationSettings
from spatula_env.envs.workspace import place_workspace, setting_of
from spatula_env.geometry.rotations import from_rotation_vector, multiply
from spatula_env.tasks import Evaluation, PressConfig, PressTask, Situation, Start

SCENE = scenes.seed()
SETTING = setting_of(SCENE, place_workspace(SCENE, SCENE.organs[0].vertices, 0.025))
MODES = [(mode, goal) for mode in ("state", "dict", "pointcloud") for goal in (False, True)]


def make_builder(
    obs_mode: str = "state", goal_interface: bool = False, layout: ControlLayout = TRANSLATION, **options: Any
) -> tuple[ObservationBuilder, PressTask]:
    task = PressTask(PressConfig(), SETTING)
    control = VelocityControl(layout, SETTING, 0.1)
    settings = ObservationSettings(**options)
    builder = ObservationBuilder(
        SETTING, task, control, obs_mode, settings, goal_interface=goal_interface, hold_progress=not goal_interface
    )
    return builder, task


def make_situation(generator: np.random.Generator, count: int, size: float = 0.01) -> Situation:
    def draw(*shape: int) -> np.ndarray:
        return generator.normal(scale=size, size=(count, *shape))

    return Situation.at_rest(
        SETTING,
        draw(3),
        tool_velocity=draw(3),
        contact_forces=draw(1, 3),
        contact_torque=draw(3),
        peak_pressure=1e5 * np.abs(draw()),
        mean_pressure=1e4 * np.abs(draw()),
        contact_share=np.abs(draw(2)),
        contact_depth=np.abs(draw()),
        nodes=SETTING.rest_nodes + draw(len(SETTING.rest_nodes), 3),
    )


def judge(task: PressTask, situation: Situation, goal: np.ndarray) -> Evaluation:
    memory = task.new_memory(len(goal))
    start = Start(goal, situation.tool_position)
    task.begin_memory(memory, np.arange(len(goal)), start, [SETTING] * len(goal))
    return task.evaluate(situation, goal, memory)


def observe(builder: ObservationBuilder, situation: Situation, goal: np.ndarray, *judged: Any, **named: Any) -> Any:
    frame = builder.build(situation, goal, *judged, np.zeros(len(goal)), **named)
    return frame.get("", frame)


def build(obs_mode: str, goal_interface: bool, count: int = 1, size: float = 0.01) -> tuple[Any, ObservationBuilder]:
    builder, task = make_builder(obs_mode, goal_interface)
    generator = np.random.default_rng(5)
    situation = make_situation(generator, count, size)
    goal = task.sample(generator, count, SETTING).goal
    return observe(builder, situation, goal, judge(task, situation, goal)), builder


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
    assert sum(part.size for part in builder.parts) == vector.shape[1] == 72


def test_parts_hold_what_their_names_say() -> None:
    builder, task = make_builder("dict", layout=ALL_SIX)
    situation = make_situation(np.random.default_rng(1), 2)
    tilted = multiply(from_rotation_vector([[0.3, 0.0, 0.0], [0.0, -0.2, 0.1]]), situation.tool_orientation)
    situation = replace(situation, tool_orientation=tilted, tool_rotation_rate=np.full((2, 3), 0.5))
    goal = task.sample(np.random.default_rng(2), 2, SETTING).goal
    evaluation = judge(task, situation, goal)
    observation = observe(builder, situation, goal, evaluation)
    single = np.float32
    for name in ("tool_position", "tool_velocity", "tool_rotation_rate", "contact_torque", "contact_share"):
        assert observation[name].tolist() == getattr(situation, name).astype(single).tolist()
    assert observation["tool_orientation"] == pytest.approx(np.array([[0.3, 0.0, 0.0], [0.0, -0.2, 0.1]]), abs=1e-6)
    assert observation["contact_force"].tolist() == situation.contact_forces[:, 0].astype(single).tolist()
    assert observation["contact_depth"].tolist() == situation.contact_depth[:, None].astype(single).tolist()
    pressures = np.stack([situation.peak_pressure, situation.mean_pressure], axis=1)
    assert observation["contact_pressure"].tolist() == pressures.astype(single).tolist()
    moved = situation.nodes[:, builder.landmarks] - SETTING.rest_nodes[builder.landmarks]
    assert observation["landmarks"].reshape(2, 16, 3) == pytest.approx(moved, rel=1e-6)
    assert observation["goal"].tolist() == goal.astype(single).tolist()
    assert observation["error"].tolist() == evaluation.error.astype(single).tolist()


def test_points_lie_on_the_surfaces_and_move_with_them() -> None:
    builder, task = make_builder("pointcloud")
    goal = np.zeros((1, 3))
    rest = Situation.at_rest(SETTING, np.array([[0.0, 0.01, 0.02]]))
    first = observe(builder, rest, goal, judge(task, rest, goal))
    down, right = np.array([0.0, 0.0, -0.005]), np.array([0.001, 0.0, 0.0])
    moved = replace(rest, nodes=rest.nodes + down, tool_positions=rest.tool_positions + right)
    second = observe(builder, moved, goal, judge(task, rest, goal))
    assert second["organ"] - first["organ"] == pytest.approx(np.tile([0.0, 0.0, -0.005], (1, 256, 1)), abs=1e-7)
    assert second["tool"] - first["tool"] == pytest.approx(np.tile([0.001, 0.0, 0.0], (1, 64, 1)), abs=1e-7)
    middle = SETTING.organ_position
    # On the polyhedron, just within the sphere.
    distance = np.linalg.norm(first["organ"][0] - middle, axis=1)
    assert (distance > 0.055).all()
    assert (distance < 0.06 + 1e-6).all()
    assert abs((first["organ"][0] - middle).mean(axis=0)).max() < 0.004
    blade = first["tool"][0] - [0.0, 0.01, 0.02]
    assert (np.abs(blade) <= np.array([0.01, 0.01, 0.00125]) + 1e-7).all()
    assert np.ptp(blade, axis=0) == pytest.approx([0.02, 0.02, 0.0025], rel=0.15)


def test_noise_has_the_deviations_of_the_units_and_spares_goals() -> None:
    builder, task = make_builder("dict")
    situation = make_situation(np.random.default_rng(1), 400, size=0.004)
    goal = task.sample(np.random.default_rng(2), 400, SETTING).goal
    evaluation = judge(task, situation, goal)
    noise = np.random.default_rng(3).normal(size=(400, 72))
    exact, noisy = (observe(builder, situation, goal, evaluation, noise=error) for error in (None, noise))
    assert (noisy["goal"] == exact["goal"]).all()
    for name, unit in (("tool_position", "m"), ("tool_velocity", "m/s"), ("contact_force", "N")):
        assert (noisy[name] - exact[name]).std() == pytest.approx(NOISE[unit], rel=0.1)
    for name, values in noisy.items():
        assert builder.space[name].contains(values[0]), name


def test_frames_are_late_and_stacked() -> None:
    memory = FrameMemory(delay=1, history=2)
    worlds = np.arange(2)
    memory.push({"x": np.array([[1.0], [10.0]]), "desired_goal": np.array([[0.0], [0.0]])}, worlds, 2, first=True)
    assert memory.show(worlds)["x"].tolist() == [[[1.0], [1.0]], [[10.0], [10.0]]]
    for k in (2.0, 3.0, 4.0):
        memory.push({"x": np.array([[k], [10.0 * k]]), "desired_goal": np.array([[k], [k]])}, worlds, 2, first=False)
    shown = memory.show(worlds)
    assert shown["x"].tolist() == [[[2.0], [3.0]], [[20.0], [30.0]]]
    # Goals are neither late nor stacked.
    assert shown["desired_goal"].tolist() == [[4.0], [4.0]]
    memory.push({"x": np.array([[7.0]]), "desired_goal": np.array([[8.0]])}, np.array([1]), 2, first=True)
    assert memory.show(worlds)["x"].tolist() == [[[2.0], [3.0]], [[7.0], [7.0]]]
    assert memory.show(np.array([1]))["x"].tolist() == [[[7.0], [7.0]]]


@pytest.mark.parametrize(("obs_mode", "goal_interface"), MODES)
def test_stacked_observations_have_an_axis_more(obs_mode: str, goal_interface: bool) -> None:
    single, stacked = (make_builder(obs_mode, goal_interface, history=n)[0].space for n in (1, 3))
    if isinstance(single, spaces.Dict):
        assert isinstance(stacked, spaces.Dict)
        for name in single:
            assert single[name].shape is not None
            extra = () if name.endswith("_goal") else (3,)
            assert stacked[name].shape == (*extra, *single[name].shape)
    else:
        assert stacked.shape == (3, 72)


def test_entries_can_be_renamed_for_lerobot() -> None:
    assert lerobot_keys(make_builder("state")[0].space) == {"observation": "observation.state"}
    assert lerobot_keys(make_builder("rgbd", True)[0].space) == {
        "image": "observation.images.front",
        "depth": "observation.images.front_depth",
        "state": "observation.state",
        "desired_goal": "observation.goal",
        "achieved_goal": "observation.achieved_goal",
    }
    names = lerobot_keys(make_builder("dict")[0].space)
    assert names["landmarks"] == "observation.landmarks"
    assert len(set(names.values())) == len(names)


def test_pictures_are_taken_over() -> None:
    builder, task = make_builder("rgbd", image_size=(8, 12))
    situation, goal = make_situation(np.random.default_rng(1), 2), np.zeros((2, 3))
    pictures = {"image": np.full((2, 8, 12, 3), 7, np.uint8), "depth": np.full((2, 8, 12, 1), 3.0)}
    observation = observe(builder, situation, goal, judge(task, situation, goal), pictures=pictures)
    assert builder.space.contains(first_of(observation))
    assert (observation["image"] == 7).all()
    # What is farther than the bound is at the bound.
    assert (observation["depth"] == 1.0).all()
    with pytest.raises(ValueError, match="pictures are needed with obs_mode='rgbd'"):
        builder.build(situation, goal, judge(task, situation, goal), np.zeros(2))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"noise": -1.0}, "observation.noise must be zero or more"),
        ({"delay": -1}, "observation.delay must be 0 to 0.5 s, got -1"),
        ({"delay": 2}, "observation.delay must be 0 to 0.5 s, got 2"),
        ({"history": 0}, "observation.history must be an integer of at least 1"),
        ({"image_size": 84}, r"observation.image_size must be two integers \(height, width\), got 84"),
        ({"image_size": (4, 84)}, "observation.image_size must be an integer of at least 8 and at most 8192, got 4"),
        ({"organ_points": 0}, "observation.organ_points must be an integer of at least 1"),
    ],
)
def test_settings_are_checked(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ObservationSettings(**options)


@pytest.mark.parametrize("obs_mode", ["state", "dict"])
def test_what_depends_on_the_goal_is_only_in_the_goals(obs_mode: str) -> None:
    builder, task = make_builder(obs_mode, True)
    situation = make_situation(np.random.default_rng(1), 1)
    seen = []
    for goal in np.array([[[0.0, 0.0, 0.006]], [[0.01, 0.0, 0.015]]]):
        observation = observe(builder, situation, goal, judge(task, situation, goal))
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
    heights = SETTING.rest_nodes[:, 2]
    level = 0.5 * (heights.min() + heights.max())
    points = SETTING.rest_nodes[builder.landmarks]
    assert len(set(builder.landmarks.tolist())) == 16
    assert (points[:, 2] >= level).all()
    distances = np.linalg.norm(points[:, None] - points[None], axis=-1) + np.eye(16)
    upper = SETTING.rest_nodes[heights >= level]
    to_nearest = np.linalg.norm(upper[:, None] - points[None], axis=-1).min(axis=1)
    # No node of the upper half is farther from the landmarks than they are from each other.
    assert to_nearest.max() <= distances.min()
