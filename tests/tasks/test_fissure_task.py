from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from task_helpers import setting_of_task

from spatula_env import scenes
from spatula_env.geometry.rotations import from_rotation_vector, multiply, turn
from spatula_env.tasks.base import weighted_sum
from spatula_env.tasks.fissure import FissureConfig, FissureTask, FissureWeights, sight
from spatula_env.tasks.marks import Path
from spatula_env.tasks.situation import Setting, Situation

SCENE = scenes.fissure()
BLOCK = SCENE.organs[0].organ
LENGTH = SCENE.scale.length
HALF_HEIGHT = 0.02
"""Of the blade [m]."""


@pytest.fixture(scope="module")
def setting() -> Setting:
    return setting_of_task("fissure")


@pytest.fixture(scope="module")
def task(setting: Setting) -> FissureTask:
    return FissureTask(FissureConfig(), setting)


def floor_middle(setting: Setting) -> np.ndarray:
    floor = setting.rest_nodes[BLOCK.floor]
    return 0.5 * (floor[np.argmin(floor[:, 0])] + floor[np.argmax(floor[:, 0])])


def over_floor(setting: Setting, x: float, y: float, z: float) -> np.ndarray:
    """(3,) a point relative to the middle of the floor's lowest line."""
    return floor_middle(setting) + np.array([x, y, z])


def opened(setting: Setting, angle: float) -> np.ndarray:
    """The organ with both walls leaning outwards by an angle, about the floor's lowest line."""
    nodes = setting.rest_nodes.copy()
    height = nodes[:, 2] - floor_middle(setting)[2]
    nodes[:, 1] += np.sign(nodes[:, 1]) * np.maximum(height, 0.0) * np.tan(angle)
    return nodes


def blade_at(setting: Setting, edge: object, tilt: object) -> tuple[np.ndarray, np.ndarray]:
    """Positions (W, 3) and orientations (W, 4) of blades whose edges are at points (W, 3), tilted by angles (W,)."""
    turned = from_rotation_vector(np.atleast_1d(np.asarray(tilt, dtype=np.float64))[:, None] * [1.0, 0.0, 0.0])
    position = np.atleast_2d(edge) + turn(turned, [0.0, 0.0, HALF_HEIGHT])
    return position, multiply(turned, setting.tools[0].orientation)


def far_away(setting: Setting, count: int = 1) -> np.ndarray:
    return np.tile([0.045, 0.0, 0.04], (count, 1))


def judge(task: FissureTask, situation: Situation, goal: object):
    return task.evaluate(situation, np.atleast_2d(np.asarray(goal, dtype=np.float64)), task.new_memory(1))


@pytest.mark.parametrize("view", [-0.3, -0.18, 0.18, 0.25, 0.3])
def test_at_rest_the_wall_hides_the_target(task: FissureTask, setting: Setting, view: float) -> None:
    found = judge(task, Situation.at_rest(setting, far_away(setting)), (0.0, view, 0.8))
    assert found.measures["exposure"].tolist() == [0.0]
    assert not found.within_tolerance[0]


def test_from_straight_above_a_fissure_shows_its_floor(task: FissureTask, setting: Setting) -> None:
    found = judge(task, Situation.at_rest(setting, far_away(setting)), (0.0, 0.0, 0.8))
    assert found.measures["exposure"].tolist() == [1.0]


def test_walls_that_lean_like_the_sight_show_the_target(task: FissureTask, setting: Setting) -> None:
    share = []
    for angle in (0.0, 0.1, 0.13, 0.16, 0.2, 0.25, 0.3):
        nodes = opened(setting, angle)[None]
        found = judge(task, Situation.at_rest(setting, far_away(setting), nodes=nodes), (0.0, 0.25, 0.8))
        share.append(float(found.measures["exposure"][0]))
    assert share[0] == 0.0
    assert share[-1] == 1.0
    assert share == sorted(share)
    assert any(0.0 < part < 1.0 for part in share)


def test_a_blade_in_the_way_hides_the_target(task: FissureTask, setting: Setting) -> None:
    view = -0.25
    above = over_floor(setting, 0.0, 0.0, 0.006)
    aside = np.array([0.0, 0.0035, 0.0])
    upright, orientation = blade_at(setting, above + aside, 0.0)
    along_the_sight, tilted = blade_at(setting, above + aside, view)
    common = {"nodes": opened(setting, 0.4)[None]}
    free = judge(task, Situation.at_rest(setting, far_away(setting), **common), (0.0, view, 0.8))
    crossing = judge(task, Situation.at_rest(setting, upright, orientation, **common), (0.0, view, 0.8))
    parallel = judge(task, Situation.at_rest(setting, along_the_sight, tilted, **common), (0.0, view, 0.8))
    assert free.measures["exposure"][0] == parallel.measures["exposure"][0] == 1.0
    assert crossing.measures["exposure"][0] < 0.3
    assert parallel.within_tolerance[0]
    # Seen past a blade that is nowhere near does not count: the fissure is to be held open with it.
    assert not free.within_tolerance[0]


def test_what_is_seen_counts_while_the_blade_is_down_at_the_floor(task: FissureTask, setting: Setting) -> None:
    view = -0.25
    for height, counts in ((0.006, True), (0.0099, True), (0.0101, False), (0.016, False)):
        # The target is 2 mm above the floor. Higher up the blade is farther aside, along the sight.
        aside = np.array([0.0, 0.0035 + np.tan(-view) * (height - 0.006), 0.0])
        position, orientation = blade_at(setting, over_floor(setting, 0.0, 0.0, height) + aside, view)
        situation = Situation.at_rest(setting, position, orientation, nodes=opened(setting, 0.4)[None])
        found = judge(task, situation, (0.0, view, 0.8))
        assert found.measures["exposure"][0] > 0.0
        assert found.achieved[0, 2] == (found.measures["exposure"][0] if counts else 0.0)


def test_the_blade_hides_no_more_than_its_width(task: FissureTask, setting: Setting) -> None:
    above = over_floor(setting, 0.0, 0.0, 0.006)
    position, orientation = blade_at(setting, above + np.array([0.012, 0.001, 0.0]), 0.0)
    situation = Situation.at_rest(setting, position, orientation)
    # The target reaches from -6 to 6 mm, the blade from 2 to 22 mm: two of five columns. Across, the target reaches
    # from -1 to 1 mm, the blade from -0.25 to 2.25 mm.
    hidden = 1.0 - judge(task, situation, (0.0, 0.0, 0.8)).measures["exposure"][0]
    assert hidden == pytest.approx(2.0 / 5.0 * 13.0 / 21.0)


def test_achieved_are_place_tilt_and_exposure_of_the_blade(task: FissureTask, setting: Setting) -> None:
    edge = over_floor(setting, 0.007, 0.001, 0.01)
    position, orientation = blade_at(setting, edge, 0.12)
    found = judge(task, Situation.at_rest(setting, position, orientation), (0.002, 0.2, 0.85))
    assert found.achieved[0] == pytest.approx([0.007, 0.12, 0.0], abs=1e-9)
    assert found.error[0] == pytest.approx([-0.005, 0.08, 0.85], abs=1e-7)
    assert found.parts["target_offset"][0] == pytest.approx([-0.005, -0.001, -0.008], abs=1e-9)
    assert found.measures["target_distance"][0] == pytest.approx(np.sqrt(5.0**2 + 3.0**2 + 5.0**2) * 1e-3)


def test_the_goal_is_met_by_more_than_what_is_asked_for(task: FissureTask) -> None:
    achieved = np.array([[0.0, 0.2, 0.79], [0.0, 0.2, 0.8], [0.0, 0.2, 1.0], [0.009, 0.2, 1.0], [0.0, 0.31, 1.0]])
    desired = np.array([0.0, 0.2, 0.8])
    assert task.fulfils(achieved, desired).tolist() == [False, True, True, False, False]
    assert task.compute_reward(achieved, np.tile(desired, (5, 1))).tolist() == [-1.0, 0.0, 0.0, -1.0, -1.0]
    assert task.compute_reward(achieved[1], desired).shape == ()


def test_coming_closer_tilting_and_seeing_pay(task: FissureTask, setting: Setting) -> None:
    rewards = []
    for edge, tilt, lean in (
        (over_floor(setting, 0.01, 0.008, 0.04), 0.0, 0.0),
        (over_floor(setting, 0.0, 0.0, 0.036), 0.0, 0.0),
        (over_floor(setting, 0.0, 0.0, 0.006), 0.0, 0.0),
        (over_floor(setting, 0.0, -0.0035, 0.006), 0.12, 0.0),
        (over_floor(setting, 0.0, -0.0035, 0.006), 0.25, 0.4),
    ):
        position, orientation = blade_at(setting, edge, tilt)
        situation = Situation.at_rest(setting, position, orientation, nodes=opened(setting, lean)[None])
        rewards.append(float(weighted_sum(judge(task, situation, (0.0, 0.25, 0.85)).terms, task.weights)[0]))
    assert rewards == sorted(rewards)
    assert rewards[-1] > rewards[-2] + 0.5


def test_force_and_action_are_reported_raw(task: FissureTask, setting: Setting) -> None:
    situation = Situation.at_rest(
        setting,
        far_away(setting),
        contact_force=np.array([[0.0, 3.0, 4.0]]),
        action=np.full((1, 4), 0.5),
    )
    terms = judge(task, situation, (0.0, 0.2, 0.8)).terms
    assert terms["force"] == pytest.approx([5.0])
    assert terms["action"] == pytest.approx([1.0])
    assert set(terms) == set(task.weights) == set(asdict(FissureWeights()))


def test_many_worlds_are_judged_as_each_alone(task: FissureTask, setting: Setting) -> None:
    generator = np.random.default_rng(2)
    start = task.sample(generator, 5, setting)
    nodes = np.stack([opened(setting, angle) for angle in generator.uniform(0.0, 0.4, 5)])
    edges = floor_middle(setting) + generator.uniform(-0.005, 0.005, (5, 3)) + [0.0, 0.0, 0.008]
    position, orientation = blade_at(setting, edges, generator.uniform(-0.3, 0.3, 5))
    together = judge(task, Situation.at_rest(setting, position, orientation, nodes=nodes), start.goal)
    for w in range(5):
        row = slice(w, w + 1)
        situation = Situation.at_rest(setting, position[row], orientation[row], nodes=nodes[row])
        alone = judge(task, situation, start.goal[row])
        assert alone.achieved.tolist() == together.achieved[row].tolist()
        for name, values in alone.terms.items():
            assert values == pytest.approx(together.terms[name][row], rel=1e-12), name


def test_the_target_goes_with_the_organ_and_the_blade_grows(task: FissureTask, setting: Setting) -> None:
    shift = np.array([0.003, -0.002, 0.001])
    edge = over_floor(setting, 0.0, 0.0, 0.01)
    position, orientation = blade_at(setting, edge, 0.0)
    moved = Situation.at_rest(setting, position, orientation, nodes=setting.rest_nodes[None] + shift)
    offset = judge(task, moved, (0.0, 0.2, 0.8)).parts["target_offset"][0]
    assert offset == pytest.approx(shift - [0.0, 0.0, 0.008], abs=1e-9)
    larger = Situation.at_rest(setting, position, orientation, tool_scale=np.array([1.1]))
    offset = judge(task, larger, (0.0, 0.2, 0.8)).parts["target_offset"][0]
    assert offset == pytest.approx([0.0, 0.0, -0.008 + 0.1 * HALF_HEIGHT], abs=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_samples_are_in_their_ranges(task: FissureTask, setting: Setting, seed: int) -> None:
    start = task.sample(np.random.default_rng(seed), 4, setting)
    assert start.tool_orientation is not None
    place, view, exposure = start.goal.T
    assert (np.abs(place) <= 0.01).all()
    assert ((np.abs(view) >= 0.18) & (np.abs(view) <= 0.3)).all()
    assert ((exposure >= 0.8) & (exposure <= 0.9)).all()
    blade = setting.tools[0]
    corners = start.tool_position[:, None] + turn(start.tool_orientation[:, None], blade.vertices)
    gap = corners[:, :, 2].min(axis=1) - setting.rest_nodes[:, 2].max()
    assert ((gap >= 0.004 - 1e-12) & (gap <= 0.015 + 1e-12)).all()
    assert (np.abs(start.tool_position[:, :2] - floor_middle(setting)[:2]) <= 0.01).all()
    for goal in start.goal:
        task.check_goal(goal)


def test_the_sight_leans_to_both_sides(task: FissureTask, setting: Setting) -> None:
    views = task.sample(np.random.default_rng(0), 400, setting).goal[:, 1]
    assert np.mean(views > 0.0) == pytest.approx(0.5, abs=0.08)
    # A positive angle leans towards the operator, at negative y.
    assert sight(np.array([0.2]))[0] == pytest.approx([0.0, -np.sin(0.2), np.cos(0.2)])


@given(st.integers(0, 2**32 - 1))
def test_sparse_reward_agrees_with_the_evaluation_to_the_last_bit(
    task: FissureTask, setting: Setting, seed: int
) -> None:
    generator = np.random.default_rng(seed)
    goal = task.sample(generator, 4, setting).goal
    goal[:, 2] = generator.integers(1, 22, 4) / 21.0
    edges = over_floor(setting, 0.0, 0.0, 0.006) + goal[:, :1] * [1.0, 0.0, 0.0]
    edges[:, 0] += generator.choice([-0.008, 0.0, 0.008], 4)
    tilt = goal[:, 1] + generator.choice([-0.1, 0.0, 0.1], 4)
    position, orientation = blade_at(setting, edges, tilt)
    nodes = np.stack([opened(setting, angle) for angle in generator.uniform(0.2, 0.5, 4)])
    found = judge(task, Situation.at_rest(setting, position, orientation, nodes=nodes), goal)
    stored = task.compute_reward(found.achieved.astype(np.float32), goal.astype(np.float32))
    assert (stored == 0.0).tolist() == found.within_tolerance.tolist()


def test_marks_show_the_target_and_the_sight(task: FissureTask, setting: Setting) -> None:
    outline, line = task.marks(np.array([0.004, -0.2, 0.8]))
    assert isinstance(outline, Path)
    assert isinstance(line, Path)
    middle = over_floor(setting, 0.004, 0.0, 0.002)
    assert np.ptp(outline.points, axis=0) == pytest.approx([0.012, 0.002, 0.0])
    assert line.points[0] == pytest.approx(middle)
    way = line.points[1] - line.points[0]
    assert way / np.linalg.norm(way) == pytest.approx([0.0, np.sin(0.2), np.cos(0.2)])


def test_other_scenes_are_refused(setting: Setting) -> None:
    with pytest.raises(ValueError, match="organ must be a FissuredBlock"):
        FissureTask(FissureConfig(), replace(setting, organ=None))
    with pytest.raises(ValueError, match=r"setting\.tools must be one blade, got 2 tools"):
        FissureTask(FissureConfig(), replace(setting, tools=setting.tools * 2))
