from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.geometry import Tool, icosphere, torus
from spatula_env.geometry.rotations import from_rotation_vector
from spatula_env.geometry.rotations import turn as turn_vectors
from spatula_env.tasks import (
    Evaluation,
    Path,
    PressConfig,
    PressTask,
    Ring,
    Setting,
    Situation,
    Start,
    ToolShape,
)
from spatula_env.tasks.base import weighted_sum

RADIUS = 0.06
SPHERE = icosphere(RADIUS, subdivisions=3)
HALF_THICKNESS = 0.00125


def make_spatula() -> ToolShape:
    tool = Tool.box(size=(0.02, 0.02, 2.0 * HALF_THICKNESS))
    return ToolShape(
        vertices=tool.vertices,
        orientation=np.array([0.0, 0.0, 0.0, 1.0]),
        offset=np.zeros(3),
        nodes=tool.nodes,
        normals=tool.normals,
        face=tool.face,
        triangles=tool.triangles,
    )


def make_setting() -> Setting:
    """A sphere whose top is 25 mm below the workspace's middle."""
    return Setting(
        rest_nodes=SPHERE.vertices - [0.0, 0.0, RADIUS + 0.025],
        triangles=SPHERE.triangles,
        ground_height=-2.0 * RADIUS - 0.025,
        tools=(make_spatula(),),
        workspace_low=np.full(3, -0.0508),
        workspace_high=np.full(3, 0.0508),
    )


def make_situation(position: object, sunk: object = 0.0, force: float = 0.1, action: float = 0.0) -> Situation:
    """The spatula at positions (W, 3), the whole organ lower than at rest by `sunk` (W,)."""
    tool = np.atleast_2d(np.asarray(position, dtype=np.float64))
    count = len(tool)
    down = np.broadcast_to(np.asarray(sunk, dtype=np.float64), (count,))
    nodes = make_setting().rest_nodes - down[:, None, None] * [0.0, 0.0, 1.0]
    return Situation.at_rest(
        make_setting(),
        tool,
        nodes=nodes,
        contact_force=np.tile([0.0, 0.0, force], (count, 1)),
        contact_forces=np.tile([0.0, 0.0, force], (count, 1, 1)),
        peak_force=np.full(count, force),
        action=np.full((count, 3), action),
    )


def judge(task: PressTask, situation: Situation, goal: np.ndarray) -> Evaluation:
    """What a task makes of a situation, in episodes with these goals."""
    count = len(goal)
    memory = task.new_memory(count)
    start = Start(goal=goal, tool_position=situation.tool_position)
    task.begin_memory(memory, np.arange(count), start, [make_setting()] * count)
    return task.evaluate(situation, goal, memory)


@pytest.fixture(scope="module")
def task() -> PressTask:
    return PressTask(PressConfig(), make_setting())


def test_depth_is_how_far_the_surface_went_down(task: PressTask) -> None:
    positions = [[0.0, 0.0, 0.0], [0.012, -0.004, -0.03], [0.0, 0.01, 0.04]]
    found = judge(task, make_situation(positions, [0.0, 0.007, 0.011]), np.zeros((3, 3)))
    assert found.achieved[:, :2] == pytest.approx(np.array(positions)[:, :2], abs=1e-8)
    assert found.measures["depth"] == pytest.approx([0.0, 0.007, 0.011], abs=1e-8)


def test_a_sunken_spatula_achieves_nothing_if_the_organ_has_not_moved(task: PressTask) -> None:
    goal = np.array([[0.0, 0.0, 0.01]])
    inside = judge(task, make_situation([0.0, 0.0, -0.025 - 0.01 + HALF_THICKNESS]), goal)
    assert inside.measures["depth"] == pytest.approx([0.0], abs=1e-12)
    assert not inside.within_tolerance[0]


@pytest.mark.parametrize("degrees", [61.0, 80.0, 90.0, 180.0])
def test_an_edge_that_is_pushed_in_does_not_press(task: PressTask, degrees: float) -> None:
    goal = np.array([[0.0, 0.0, 0.01]])
    half = 0.5 * np.radians(degrees)
    for axis in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]):
        tilted = replace(
            make_situation([0.0, 0.0, 0.0], 0.01, 0.5),
            tool_orientation=np.array([[*(np.sin(half) * np.array(axis)), np.cos(half)]]),
        )
        assert judge(task, tilted, goal).measures["depth"].tolist() == [0.0]
    slightly = replace(
        make_situation([0.0, 0.0, 0.0], 0.01, 0.5),
        tool_orientation=np.array([[np.sin(0.2), 0.0, 0.0, np.cos(0.2)]]),
    )
    assert judge(task, slightly, goal).measures["depth"] == pytest.approx([0.01])


@pytest.mark.parametrize("place", [(0.05, 0.05), (-0.0508, 0.04), (0.0, 0.0599)])
def test_a_goal_beside_the_organ_is_refused(task: PressTask, place: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match=r"^goal must be at a place"):
        task.check_goal(np.array([*place, 0.01]))
    task.check_goal(np.array([0.03, -0.03, 0.01]))


@given(st.floats(0.0, 0.019), st.floats(-0.05, 0.03))
def test_without_a_touch_nothing_is_achieved(task: PressTask, force: float, sunk: float) -> None:
    found = judge(task, make_situation([0.0, 0.0, 0.0], sunk, force), np.array([[0.0, 0.0, 0.01]]))
    assert found.measures["depth"].tolist() == [0.0]
    pressed_from_below = make_situation([0.0, 0.0, 0.0], sunk, -1.0)
    assert judge(task, pressed_from_below, np.array([[0.0, 0.0, 0.01]])).measures["depth"].tolist() == [0.0]


@given(st.floats(-0.04, 0.04), st.floats(-0.04, 0.04), st.floats(-1.0, 1.0))
def test_an_organ_that_has_rolled_aside_is_not_pressed(task: PressTask, x: float, y: float, turn: float) -> None:
    rolled = from_rotation_vector(np.array([y, -x, turn]) / RADIUS * [1.0, 1.0, RADIUS])
    situation = make_situation([0.0, 0.0, 0.0])
    middle = np.array([0.0, 0.0, -RADIUS - 0.025])
    nodes = turn_vectors(rolled, situation.nodes - middle) + middle + [x, y, 0.0]
    found = judge(task, replace(situation, nodes=nodes), np.array([[0.0, 0.0, 0.01]]))
    # A mesh of a sphere is not round: it is as high as its corners and edges are.
    assert found.measures["depth"] == pytest.approx([0.0], abs=4e-4)


def test_within_tolerance_needs_both_the_place_and_the_depth(task: PressTask) -> None:
    goal = np.tile([0.005, 0.0, 0.01], (5, 1))
    positions = np.array(
        [[0.005, 0.0, 0.0], [0.0065, 0.001, 0.0], [0.0075, 0.0, 0.0], [0.005, 0.0, 0.0], [0.005, 0.0, 0.0]]
    )
    found = judge(task, make_situation(positions, [0.01, 0.0109, 0.01, 0.0112, 0.0088]), goal)
    assert found.within_tolerance.tolist() == [True, True, False, False, False]
    assert found.terms["hold"].tolist() == [1.0, 1.0, 0.0, 0.0, 0.0]


def test_error_is_goal_minus_achieved(task: PressTask) -> None:
    goal = np.array([[0.01, -0.005, 0.012]])
    found = judge(task, make_situation([0.002, 0.001, 0.0], 0.004), goal)
    assert found.error == pytest.approx(np.array([[0.008, -0.006, 0.008]]), abs=1e-8)
    assert found.measures["place_error"] == pytest.approx([0.01], abs=1e-8)
    assert found.measures["depth_error"] == pytest.approx([0.008], abs=1e-8)


def test_reward_terms_are_largest_where_the_goal_is_met(task: PressTask) -> None:
    goal = np.array([[0.0, 0.0, 0.01]])
    met = judge(task, make_situation([0.0, 0.0, -0.025 - 0.01 + HALF_THICKNESS], 0.01), goal).terms
    assert met["reach"] == pytest.approx([1.0], abs=1e-6)
    assert met["depth"] == pytest.approx([1.0], abs=1e-6)
    assert met["hold"].tolist() == [1.0]


@given(st.floats(0.0, 0.02), st.floats(1e-4, 0.02))
def test_coming_closer_pays(task: PressTask, height: float, step: float) -> None:
    goal = np.tile([0.0, 0.0, 0.01], (2, 1))
    # Both above the organ: only "reach" can tell them apart.
    found = judge(task, make_situation([[0.0, 0.0, height - 0.02], [0.0, 0.0, height - 0.02 + step]]), goal)
    reward = weighted_sum(found.terms, task.weights)
    assert reward[0] > reward[1]


def test_force_and_action_are_reported_raw_and_cost_something(task: PressTask) -> None:
    goal = np.array([[0.0, 0.0, 0.01]])
    idle = judge(task, make_situation([0.0, 0.0, 0.0], force=0.0), goal).terms
    busy = judge(task, make_situation([0.0, 0.0, 0.0], force=3.0, action=0.5), goal).terms
    assert busy["force"] == pytest.approx([3.0])
    assert busy["action"] == pytest.approx([0.75])
    difference = weighted_sum(busy, task.weights) - weighted_sum(idle, task.weights)
    assert difference == pytest.approx([-0.002 * 3.0 - 0.01 * 0.75])


def test_many_worlds_are_judged_as_each_alone(task: PressTask) -> None:
    generator = np.random.default_rng(3)
    positions = generator.uniform(-0.05, 0.05, (7, 3))
    sunk, goal = generator.uniform(0.0, 0.02, 7), task.sample(generator, 7, make_setting()).goal
    together = judge(task, make_situation(positions, sunk, force=1.0), goal)
    for w in range(7):
        alone = judge(task, make_situation(positions[w], sunk[w], force=1.0), goal[w : w + 1])
        assert alone.achieved.tolist() == together.achieved[w : w + 1].tolist()
        for name, values in alone.terms.items():
            assert values.tolist() == together.terms[name][w : w + 1].tolist(), name


def test_what_is_achieved_stays_within_its_bounds(task: PressTask) -> None:
    # Off the organ's edge, and with the organ gone from under the spatula.
    found = judge(task, make_situation([[0.0508, 0.0508, 0.0], [0.0, 0.0, 0.0]], [0.0, 1.0]), np.zeros((2, 3)))
    assert (found.achieved >= task.goal_low).all()
    assert (found.achieved <= task.goal_high).all()
    assert found.achieved[1, 2] == task.goal_high[2]


@given(st.integers(0, 2**32 - 1))
def test_samples_are_in_their_ranges(task: PressTask, seed: int) -> None:
    start = task.sample(np.random.default_rng(seed), 5, make_setting())
    assert start.goal.shape == start.tool_position.shape == (5, 3)
    assert (np.hypot(*start.goal[:, :2].T) <= 0.015).all()
    assert (start.goal[:, 2] >= 0.005).all()
    assert (start.goal[:, 2] <= 0.018).all()
    assert (np.hypot(*start.tool_position[:, :2].T) <= 0.02).all()
    underside_above_top = start.tool_position[:, 2] - HALF_THICKNESS + 0.025
    assert (underside_above_top >= 0.01 - 1e-9).all()
    assert (underside_above_top <= 0.03 + 1e-9).all()
    for goal in start.goal:
        task.check_goal(goal)


def test_sampling_fills_the_disc_evenly(task: PressTask) -> None:
    goal = task.sample(np.random.default_rng(0), 20_000, make_setting()).goal
    # A disc of half the radius holds a quarter of the area.
    assert np.mean(np.hypot(goal[:, 0], goal[:, 1]) < 0.0075) == pytest.approx(0.25, abs=0.015)
    assert np.mean(goal, axis=0) == pytest.approx([0.0, 0.0, 0.0115], abs=2e-4)


goals = st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(-0.03, 0.06))


@given(goals, st.tuples(st.floats(-0.004, 0.004), st.floats(-0.004, 0.004), st.floats(-0.002, 0.002)))
def test_sparse_reward_is_zero_within_tolerance(
    task: PressTask, desired: tuple[float, ...], offset: tuple[float, ...]
) -> None:
    reward = task.compute_reward(np.add(desired, offset), np.array(desired))
    place, depth = np.hypot(offset[0], offset[1]), abs(offset[2])
    if place < 0.002 - 1e-6 and depth < 0.001 - 1e-6:
        assert reward == 0.0
    elif place > 0.002 + 1e-6 or depth > 0.001 + 1e-6:
        assert reward == -1.0


@given(st.integers(0, 2**32 - 1))
def test_sparse_reward_agrees_with_the_evaluation_to_the_last_bit(task: PressTask, seed: int) -> None:
    generator = np.random.default_rng(seed)
    goal = task.sample(generator, 8, make_setting()).goal
    # On the very edge of what is tolerated.
    angle = generator.uniform(0.0, 2.0 * np.pi, 8)
    position = goal + 0.002 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(8)])
    found = judge(task, make_situation(position, goal[:, 2] + generator.choice([-0.001, 0.0, 0.001], 8)), goal)
    stored = task.compute_reward(found.achieved.astype(np.float32), goal.astype(np.float32))
    assert (stored == 0.0).tolist() == found.within_tolerance.tolist()


def test_marks_are_the_place_at_rest_and_the_pressed_point(task: PressTask) -> None:
    surface, pressed, line = task.marks(np.array([0.01, 0.0, 0.012]))
    assert isinstance(surface, Ring)
    assert isinstance(pressed, Ring)
    assert isinstance(line, Path)
    assert surface.point == pytest.approx([0.01, 0.0, np.sqrt(RADIUS**2 - 0.01**2) - RADIUS - 0.025], abs=5e-4)
    assert pressed.point - surface.point == pytest.approx([0.0, 0.0, -0.012])
    assert line.points.tolist() == [surface.point.tolist(), pressed.point.tolist()]
    # They reach around the spatula.
    assert surface.radius > 0.01 * np.sqrt(2.0)


def test_an_organ_elsewhere_is_pressed_where_it_is(task: PressTask) -> None:
    shifted = replace(
        make_setting(),
        rest_nodes=make_setting().rest_nodes + np.array([0.004, -0.003, 0.005]),
        organ_position=np.array([0.004, -0.003, -RADIUS - 0.02]),
    )
    here = task.sample(np.random.default_rng(4), 3, make_setting())
    there = task.sample(np.random.default_rng(4), 3, shifted)
    assert there.goal - here.goal == pytest.approx(np.tile([0.004, -0.003, 0.0], (3, 1)))
    assert there.tool_position - here.tool_position == pytest.approx(np.tile([0.004, -0.003, 0.005], (3, 1)))
    memory = task.new_memory(3)
    task.begin_memory(memory, np.arange(3), there, [shifted] * 3)
    at_rest = Situation.at_rest(shifted, there.goal)
    assert task.evaluate(at_rest, there.goal, memory).measures["depth"] == pytest.approx(np.zeros(3), abs=1e-12)


def test_a_larger_spatula_reaches_farther_down(task: PressTask) -> None:
    goal, memory = np.array([[0.0, 0.0, 0.01]] * 2), task.new_memory(2)
    situation = replace(make_situation(np.zeros((2, 3)) - [0.0, 0.0, 0.02]), tool_scale=np.array([1.0, 2.0]))
    task.begin_memory(memory, np.arange(2), Start(goal, situation.tool_position), [make_setting()] * 2)
    reach = task.evaluate(situation, goal, memory).terms["reach"]
    assert reach[1] > reach[0]


# Organs with a hole ------------------------------------------------------------------------------------------------

RING = torus(0.03, 0.012, 48, 24)


def ring_setting() -> Setting:
    """A ring that lies on the ground, its top 25 mm below the workspace's middle."""
    return replace(
        make_setting(),
        rest_nodes=RING.vertices - [0.0, 0.0, 0.012 + 0.025],
        triangles=RING.triangles,
        ground_height=-0.024 - 0.025,
    )


def test_a_hole_at_the_axis_is_told() -> None:
    with pytest.raises(ValueError, match=r"no surface at center \(0.0, 0.0\) m from its axis.*another one, task="):
        PressTask(PressConfig(depth_range=(0.002, 0.005)), ring_setting())
    with pytest.raises(ValueError, match=r"no surface within place_radius \(0.015 m\) of center \(0.03, 0.0\)"):
        PressTask(PressConfig(center=(0.03, 0.0), depth_range=(0.002, 0.005)), ring_setting())


@given(st.integers(0, 2**32 - 1))
def test_goals_and_starts_lie_around_the_center(seed: int) -> None:
    config = PressConfig(center=[0.0, 0.03], place_radius=0.008, start_radius=0.01, depth_range=[0.002, 0.005])
    setting = ring_setting()
    start = PressTask(config, setting).sample(np.random.default_rng(seed), 50, setting)
    assert (np.hypot(*(start.goal[:, :2] - [0.0, 0.03]).T) <= 0.008).all()
    assert (np.hypot(*(start.tool_position[:, :2] - [0.0, 0.03]).T) <= 0.01).all()
    heights = setting.surface_heights(setting.rest_nodes[None], start.goal[:, :2])
    assert (heights > setting.ground_height + 0.01).all()


@pytest.mark.parametrize("center", [(0.01,), (0.0, np.inf), "axis", None])
def test_a_center_is_two_finite_numbers(center: object) -> None:
    with pytest.raises(ValueError, match="center must be"):
        PressConfig(center=center)


def test_a_center_too_near_the_rim_of_the_workspace_is_refused() -> None:
    with pytest.raises(ValueError, match=r"place_radius must be 0.0108 m at most"):
        PressTask(PressConfig(center=(0.04, 0.0)), make_setting())
