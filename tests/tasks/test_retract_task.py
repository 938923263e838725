from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from task_helpers import setting_of_task

from spatula_env import scenes
from spatula_env.arrays import FloatArray
from spatula_env.envs.workspace import place_workspace, setting_of
from spatula_env.geometry.rotations import multiply
from spatula_env.tasks import Patch, Path, RetractConfig, RetractTask, Situation, Start
from spatula_env.tasks.base import Evaluation, Memory, weighted_sum

HALF_THICKNESS = 0.0009


@pytest.fixture(scope="module")
def task() -> RetractTask:
    return RetractTask(RetractConfig(), setting_of_task("retract"))


def begin(task: RetractTask, goal: object, place: float = 0.0, height: float = 0.25) -> tuple[FloatArray, Memory]:
    """Goals (W, 2) and the memory of patches at a place and a height."""
    goals = np.atleast_2d(np.asarray(goal, dtype=np.float64))
    count = len(goals)
    memory = task.new_memory(count)
    start = Start(goal=goals, tool_position=np.zeros((count, 3)), drawn=np.tile([place, height], (count, 1)))
    task.begin_memory(memory, np.arange(count), start, [task.setting] * count)
    return goals, memory


BESIDE, ABOVE = (0.0, 0.0, -0.03), (0.0, 0.0, 0.04)
"""Where the blade's lower edge is deep beside the patch, and above the fold."""


def judge(
    task: RetractTask,
    goal: object,
    moved: object = 0.0,
    grip: object = BESIDE,
    push: float = 0.1,
    **changes: object,
) -> Evaluation:
    """The verdict if the organ's nodes have moved, and the blade pushes towards the goal."""
    goals, memory = begin(task, goal)
    changes.setdefault("contact_force", -push * np.sign(goals[:, :1]) * [1.0, 0.0, 0.0])
    nodes = np.broadcast_to(task.setting.rest_nodes + moved, (len(goals), *task.setting.rest_nodes.shape))
    grips = np.broadcast_to(np.asarray(grip, dtype=np.float64), (len(goals), 3))
    situation = Situation.at_rest(task.setting, grips, nodes=np.array(nodes), **changes)
    return task.evaluate(situation, goals, memory)


def test_the_displacement_of_the_patch_is_measured(task: RetractTask) -> None:
    found = judge(task, [[0.006, 0.0], [-0.006, 0.0]], [0.004, -0.001, 0.002])
    assert found.parts["patch_shift"] == pytest.approx(np.tile([0.004, -0.001, 0.002], (2, 1)), abs=1e-12)
    assert found.achieved == pytest.approx(np.tile([0.004, -0.001], (2, 1)), abs=1e-12)
    assert found.error == pytest.approx(np.array([[0.002, 0.001], [-0.01, 0.001]]), abs=1e-8)
    assert found.measures["shift"] == pytest.approx(np.hypot([0.004, 0.004], 0.001))
    assert found.measures["shift_error"] == pytest.approx([np.hypot(0.002, 0.001), np.hypot(0.01, 0.001)], abs=1e-8)


def test_a_fold_that_is_not_pushed_by_its_flank_is_not_retracted(task: RetractTask) -> None:
    goal, moved = [[0.006, 0.0], [-0.006, 0.0]], np.array([[[0.006, 0.0, 0.0]], [[-0.006, 0.0, 0.0]]])
    assert judge(task, goal, moved).within_tolerance.tolist() == [True, True]
    dragging = np.array([[-0.1, 0.0, 0.06], [0.1, 0.0, 0.06]])
    for changes in ({"grip": ABOVE}, {"push": 0.0}, {"push": -0.2}, {"contact_force": dragging}):
        found = judge(task, goal, moved, **changes)
        assert found.measures["pushing"].tolist() == [0.0, 0.0]
        assert (found.achieved == 0.0).all()
        assert not found.within_tolerance.any()
        # What is seen of the patch does not depend on it.
        assert found.measures["shift"] == pytest.approx([0.006, 0.006])


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
def test_an_edge_is_as_low_as_the_blade_is_turned(task: RetractTask, axis: tuple[float, float, float]) -> None:
    """A blade that lies on its side reaches 10 or 1 mm down instead of 20."""
    goal, moved = [[0.006, 0.0]], np.array([[[0.006, 0.0, 0.0]]])
    upright = task.setting.tools[0].orientation
    patch = judge(task, goal, moved).parts["patch_position"][0, 2]
    grip = (0.0, 0.0, patch + 0.02 - 0.004)
    assert judge(task, goal, moved, grip).measures["pushing"].tolist() == [1.0]
    turned = multiply(np.array([*(np.sqrt(0.5) * np.array(axis)), np.sqrt(0.5)]), upright)
    found = judge(task, goal, moved, grip, tool_orientation=turned[None])
    assert found.measures["pushing"].tolist() == [0.0]
    assert not found.within_tolerance.any()


def test_only_the_patch_counts(task: RetractTask) -> None:
    _, memory = begin(task, [0.006, 0.0])
    others = memory["weights"][0] == 0.0
    moved = judge(task, [0.006, 0.0], others[:, None] * np.array([0.01, 0.02, 0.03]))
    assert moved.parts["patch_shift"] == pytest.approx(np.zeros((1, 3)), abs=1e-12)
    assert others.mean() > 0.9


@pytest.mark.parametrize("side", [-1.0, 1.0])
@given(st.floats(-0.008, 0.008), st.floats(0.05, 0.45))
def test_the_patch_is_on_the_flank_that_is_pushed(task: RetractTask, side: float, place: float, height: float) -> None:
    _, memory = begin(task, [side * 0.006, 0.0], place, height)
    weights, rest = memory["weights"][0], memory["rest"][0]
    nodes = task.setting.rest_nodes[weights > 0.0]
    assert weights.sum() == pytest.approx(1.0)
    assert (weights >= 0.0).all()
    # Who pushes to the right touches the left flank.
    assert (side * nodes[:, 0] < 0.0).all()
    assert abs(rest[1] - place) < 0.004
    assert (np.hypot(nodes[:, 1] - place, nodes[:, 2] - rest[2]) < 0.0135).all()


def test_higher_patches_are_higher(task: RetractTask) -> None:
    heights = [begin(task, [0.006, 0.0], 0.0, height)[1]["rest"][0, 2] for height in (0.05, 0.25, 0.45)]
    assert heights[0] < heights[1] < heights[2]


def test_patches_move_smoothly_with_their_place(task: RetractTask) -> None:
    middles = [begin(task, [0.006, 0.0], place, 0.25)[1]["rest"][0] for place in np.linspace(-0.008, 0.008, 161)]
    assert np.linalg.norm(np.diff(middles, axis=0), axis=1).max() < 0.001


def test_within_tolerance_is_a_disc_around_the_goal(task: RetractTask) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    for radius, expected in ((0.00099, True), (0.00101, False)):
        for direction in np.column_stack([np.cos(angle), np.sin(angle)]):
            found = judge(task, [0.006, 0.0005], [*([0.006, 0.0005] + radius * direction), 0.005])
            assert bool(found.within_tolerance[0]) is expected
            assert found.terms["hold"].tolist() == [float(expected)]


def test_an_organ_at_rest_is_not_retracted(task: RetractTask) -> None:
    generator = np.random.default_rng(0)
    goal = task.sample(generator, 100, task.setting).goal
    assert not judge(task, goal).within_tolerance.any()


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_reach_is_greatest_where_the_blade_touches_the_patch(task: RetractTask, side: float) -> None:
    goal = [side * 0.006, 0.0]
    _, memory = begin(task, goal)
    place = memory["rest"][0] - [side * HALF_THICKNESS, 0.0, 0.008 - 0.02]
    assert judge(task, goal, grip=place).terms["reach"] == pytest.approx([1.0])
    for offset in np.vstack([np.eye(3), -np.eye(3)]) * 0.003:
        near = judge(task, goal, grip=place + offset).terms["reach"]
        far = judge(task, goal, grip=place + 2.0 * offset).terms["reach"]
        assert 1.0 > near[0] > far[0]


@given(st.floats(0.0, 0.9), st.floats(0.01, 0.1))
def test_moving_the_patch_towards_the_goal_pays(task: RetractTask, part: float, step: float) -> None:
    goal = np.array([0.006, 0.0004])
    less, more = (judge(task, goal, [*(share * goal), 0.0]) for share in (part, part + step))
    assert weighted_sum(more.terms, task.weights)[0] > weighted_sum(less.terms, task.weights)[0]


def test_force_and_action_are_reported_raw_and_cost_something(task: RetractTask) -> None:
    idle = judge(task, [0.006, 0.0], push=0.0).terms
    busy = judge(task, [0.006, 0.0], contact_force=np.array([[0.3, 0.0, 0.4]]), action=np.full((1, 3), 0.5)).terms
    assert busy["force"] == pytest.approx([0.5])
    assert busy["action"] == pytest.approx([0.75])
    difference = weighted_sum(busy, task.weights) - weighted_sum(idle, task.weights)
    assert difference == pytest.approx([-0.02 * 0.5 - 0.01 * 0.75])


def test_many_worlds_are_judged_as_each_alone(task: RetractTask) -> None:
    generator = np.random.default_rng(3)
    start = task.sample(generator, 6, task.setting)
    memory = task.new_memory(6)
    task.begin_memory(memory, np.arange(6), start, [task.setting] * 6)
    nodes = task.setting.rest_nodes + generator.normal(0.0, 0.003, (6, *task.setting.rest_nodes.shape))
    together = task.evaluate(Situation.at_rest(task.setting, start.tool_position, nodes=nodes), start.goal, memory)
    for w in range(6):
        row = slice(w, w + 1)
        situation = Situation.at_rest(task.setting, start.tool_position[row], nodes=nodes[row])
        alone = task.evaluate(situation, start.goal[row], {name: values[row] for name, values in memory.items()})
        assert alone.achieved.tolist() == together.achieved[row].tolist()
        for kind in ("terms", "measures", "parts"):
            for name, values in getattr(alone, kind).items():
                assert values.tolist() == getattr(together, kind)[name][row].tolist(), name


def test_episodes_begin_in_their_own_rows(task: RetractTask) -> None:
    memory = task.new_memory(3)
    start = Start(np.array([[0.006, 0.0]]), np.zeros((1, 3)), drawn=np.array([[0.0, 0.25]]))
    task.begin_memory(memory, np.array([1]), start, [task.setting])
    assert (memory["weights"].sum(axis=1) > 0.0).tolist() == [False, True, False]


def test_the_goal_turns_with_the_organ(task: RetractTask) -> None:
    angle = 0.4
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    turned = replace(task.setting, rest_nodes=task.setting.rest_nodes @ turn.T)
    straight = task.sample(np.random.default_rng(5), 4, task.setting)
    askew = task.sample(np.random.default_rng(5), 4, turned)
    assert askew.goal == pytest.approx(straight.goal @ turn[:2, :2].T)
    memories = []
    for start, setting in ((straight, task.setting), (askew, turned)):
        memories.append(task.new_memory(4))
        task.begin_memory(memories[-1], np.arange(4), start, [setting] * 4)
    assert memories[1]["weights"] == pytest.approx(memories[0]["weights"])


def test_what_is_achieved_stays_within_its_bounds(task: RetractTask) -> None:
    found = judge(task, [[0.006, 0.0], [-0.006, 0.0]], [1.0, -1.0, 0.0])
    assert (found.achieved >= task.goal_low).all()
    assert (found.achieved <= task.goal_high).all()


@given(st.integers(0, 2**32 - 1))
def test_samples_are_in_their_ranges(task: RetractTask, seed: int) -> None:
    start = task.sample(np.random.default_rng(seed), 5, task.setting)
    assert start.goal.shape == start.drawn.shape == (5, 2)
    size = np.hypot(*start.goal.T)
    assert (size >= 0.004 - 1e-12).all()
    assert (size <= 0.01 + 1e-12).all()
    assert (np.abs(start.goal[:, 1]) <= size * np.sin(0.12) + 1e-12).all()
    assert (np.abs(start.tool_position[:, :2]) <= [0.02 + 1e-6, 0.01 + 1e-6]).all()
    # The lower edge is 20 mm below the blade's middle and the organ's top 20 mm below the workspace's.
    edge_above_top = start.tool_position[:, 2] - 0.02 + 0.02
    assert (edge_above_top >= 0.006 - 1e-9).all()
    assert (edge_above_top <= 0.02 + 1e-9).all()
    for goal in start.goal:
        task.check_goal(goal)


def test_both_flanks_are_asked_for(task: RetractTask) -> None:
    goal = task.sample(np.random.default_rng(0), 2000, task.setting).goal
    assert np.mean(goal[:, 0] > 0.0) == pytest.approx(0.5, abs=0.04)


@given(st.integers(0, 2**32 - 1))
def test_sparse_reward_agrees_with_the_evaluation_to_the_last_bit(task: RetractTask, seed: int) -> None:
    generator = np.random.default_rng(seed)
    goal = task.sample(generator, 8, task.setting).goal
    angle = generator.uniform(0.0, 2.0 * np.pi, 8)
    # On the very edge of what is tolerated.
    moved = np.column_stack([goal + 0.001 * np.column_stack([np.cos(angle), np.sin(angle)]), np.zeros(8)])
    found = judge(task, goal, moved[:, None])
    stored = task.compute_reward(found.achieved.astype(np.float32), goal.astype(np.float32))
    assert (stored == 0.0).tolist() == found.within_tolerance.tolist()


def test_marks_show_the_patch_and_its_way(task: RetractTask) -> None:
    goals, memory = begin(task, [0.006, 0.0005])
    patch, path, _ = task.marks(goals[0], None, memory)
    assert isinstance(patch, Patch)
    assert patch.nodes.tolist() == np.flatnonzero(memory["weights"][0]).tolist()
    assert isinstance(path, Path)
    assert path.points[1] - path.points[0] == pytest.approx([0.006, 0.0005, 0.0])
    assert task.marks(goals[0]) == ()


def test_other_organs_are_refused() -> None:
    scene = scenes.seed()
    setting = setting_of(scene, place_workspace(scene, scene.organs[0].vertices, 0.02))
    with pytest.raises(ValueError, match="organ must be a RidgedBlock"):
        RetractTask(RetractConfig(), setting)
