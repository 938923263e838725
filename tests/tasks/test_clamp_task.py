from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from task_helpers import setting_of_task

from spatula_env import scenes
from spatula_env.geometry.rotations import from_rotation_vector, multiply, turn
from spatula_env.tasks.base import Memory, weighted_sum
from spatula_env.tasks.clamp import GREATEST_SLIP, ClampConfig, ClampTask, ClampWeights
from spatula_env.tasks.marks import Patch, Path
from spatula_env.tasks.situation import Setting, Situation, Start

SCENE = scenes.clamp()
BLOCK = SCENE.organs[0].organ
FLANKS = np.concatenate(BLOCK.flanks)
JAW_LENGTH, JAW_HEIGHT = 0.024, 0.016


@pytest.fixture(scope="module")
def setting() -> Setting:
    return setting_of_task("clamp")


@pytest.fixture(scope="module")
def task(setting: Setting) -> ClampTask:
    return ClampTask(ClampConfig(), setting)


def shares(inner_first: object, inner_second: object) -> np.ndarray:
    """(W, 12) shares of nodes in contact: of the faces that the jaws turn to each other, y up on the first one."""
    first, second = np.atleast_1d(inner_first), np.atleast_1d(inner_second)
    result = np.zeros((len(first), 12))
    result[:, 0], result[:, 7] = first, second
    return result


PRESSED = np.array([[[0.0, -0.15, 0.0], [0.0, 0.15, 0.0]]])
"""What the ridge does to the jaws between which it is held."""

GRIPPED, LOOSE, HALF = shares(0.5, 0.5), shares(0.0, 0.0), shares(0.5, 0.0)


def ridge(setting: Setting) -> np.ndarray:
    return setting.rest_nodes[FLANKS].mean(axis=0)


def raised(setting: Setting, by: object) -> np.ndarray:
    """(W, V, 3) the organ at rest, moved by vectors (W, 3)."""
    return setting.rest_nodes + np.atleast_2d(np.asarray(by, dtype=np.float64))[:, None]


def begun(task: ClampTask, count: int = 1) -> Memory:
    memory = task.new_memory(count)
    start = Start(goal=np.zeros((count, 2)), tool_position=np.zeros((count, 3)))
    task.begin_memory(memory, np.arange(count), start, [task.setting] * count)
    return memory


def judge(task: ClampTask, situation: Situation, memory: Memory | None = None, goal: object = (0.008, 0.0015)):
    count = len(situation.tool_position)
    goals = np.broadcast_to(np.asarray(goal, dtype=np.float64), (count, 2))
    return task.evaluate(situation, goals, begun(task, count) if memory is None else memory)


def held(setting: Setting, grip: object, moved: object, share: np.ndarray = GRIPPED, **changes: object) -> Situation:
    """Jaws at a place, relative to the ridge's middle, on an organ that is moved by a vector [m]."""
    position = ridge(setting) + np.atleast_2d(np.asarray(grip, dtype=np.float64))
    changes.setdefault("contact_forces", np.repeat(PRESSED, len(position), axis=0))
    return Situation.at_rest(setting, position, nodes=raised(setting, moved), contact_share=share, **changes)


def test_the_faces_turned_to_each_other_are_found(setting: Setting) -> None:
    first, second = setting.tools
    assert turn(first.orientation, first.normals[first.face == 0][0]) == pytest.approx([0.0, 1.0, 0.0])
    assert turn(second.orientation, second.normals[second.face == 1][0]) == pytest.approx([0.0, -1.0, 0.0])
    assert first.offset[1] < second.offset[1]


def test_lift_is_how_much_higher_the_crest_is(task: ClampTask, setting: Setting) -> None:
    found = judge(task, held(setting, (0.0, 0.0, 0.0), (0.001, 0.0, 0.0065)))
    assert found.achieved[0, 0] == pytest.approx(0.0065)
    assert found.error[0, 0] == pytest.approx(0.0015, abs=1e-7)
    crooked = setting.rest_nodes.copy()
    crooked[BLOCK.crest[0], 2] += 0.01
    situation = Situation.at_rest(setting, ridge(setting)[None], nodes=crooked[None])
    assert judge(task, situation).measures["lift"][0] == pytest.approx(0.01 / len(BLOCK.crest))


def test_a_lifted_organ_that_is_not_gripped_achieves_nothing(task: ClampTask, setting: Setting) -> None:
    for share in (LOOSE, HALF, shares(0.0, 0.5)):
        found = judge(task, held(setting, (0.0, 0.0, 0.0), (0.0, 0.0, 0.008), share))
        assert found.measures["gripped"].tolist() == [0.0]
        assert found.achieved[0, 1] == pytest.approx(GREATEST_SLIP)
        assert not found.within_tolerance[0]
    # Touching with the outer faces is no grip either.
    outside = np.zeros((1, 12))
    outside[0, 1] = outside[0, 6] = 1.0
    assert judge(task, held(setting, (0.0, 0.0, 0.0), (0.0, 0.0, 0.008), outside)).measures["gripped"][0] == 0.0


def test_what_goes_with_the_jaws_does_not_slip(task: ClampTask, setting: Setting) -> None:
    memory = begun(task)
    judge(task, held(setting, (0.001, 0.0, -0.002), (0.0, 0.0, 0.0)), memory)
    for k in range(1, 9):
        way = np.array([0.0004, -0.0002, 0.001]) * k
        found = judge(task, held(setting, way + np.array([0.001, 0.0, -0.002]), way), memory)
        assert found.measures["slip"][0] == pytest.approx(0.0, abs=1e-9)
    assert found.within_tolerance[0]
    assert found.terms["hold"].tolist() == [1.0]


@pytest.mark.parametrize(("slipped", "within"), [(0.0014, True), (0.0016, False)])
def test_what_stays_behind_slips(task: ClampTask, setting: Setting, slipped: float, within: bool) -> None:
    memory = begun(task)
    judge(task, held(setting, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), memory)
    found = judge(task, held(setting, (0.0, 0.0, 0.008 + slipped), (0.0, 0.0, 0.008)), memory)
    assert found.measures["slip"][0] == pytest.approx(slipped)
    assert found.terms["slip"][0] == pytest.approx(slipped)
    assert found.within_tolerance[0] == within


@pytest.mark.parametrize(
    ("forces", "within"),
    [((0.15, 0.15), True), ((0.081, 0.249), True), ((0.079, 0.15), False), ((0.15, 0.251), False), ((0.5, 0.5), False)],
)
def test_a_grip_is_neither_loose_nor_crushing(
    task: ClampTask, setting: Setting, forces: tuple[float, float], within: bool
) -> None:
    pressed = np.array([[[0.0, -forces[0], 0.3], [0.0, forces[1], 0.3]]])
    found = judge(task, held(setting, (0.0, 0.0, 0.008), (0.0, 0.0, 0.008), contact_forces=pressed))
    assert bool(found.within_tolerance[0]) is within
    assert found.measures["grip_force"] == pytest.approx([min(forces)])
    assert found.measures["slip"] == pytest.approx([0.0], abs=1e-12)
    assert found.achieved[0, 1] == pytest.approx(0.0 if within else GREATEST_SLIP, abs=1e-8)


def test_slip_counts_along_the_faces_only(task: ClampTask, setting: Setting) -> None:
    memory = begun(task)
    judge(task, held(setting, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), memory)
    found = judge(task, held(setting, (0.003, 0.005, 0.004), (0.0, 0.0, 0.0)), memory)
    assert found.measures["slip"][0] == pytest.approx(0.005)


def test_jaws_that_turn_with_the_organ_do_not_slip(task: ClampTask, setting: Setting) -> None:
    memory = begun(task)
    judge(task, held(setting, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), memory)
    rotation = from_rotation_vector(np.array([0.1, -0.2, 0.3]))
    middle = ridge(setting)
    nodes = turn(rotation, setting.rest_nodes - middle) + middle
    orientation = multiply(rotation, setting.tools[0].orientation)[None]
    situation = Situation.at_rest(setting, middle[None], orientation, nodes=nodes[None], contact_share=GRIPPED)
    assert judge(task, situation, memory).measures["slip"][0] == pytest.approx(0.0, abs=1e-9)
    upright = Situation.at_rest(setting, middle[None], nodes=nodes[None], contact_share=GRIPPED)
    # What turns about the middle stays there on average; what is off the middle is seen to go.
    off = Situation.at_rest(setting, (middle + np.array([0.008, 0.0, 0.0]))[None], contact_share=GRIPPED)
    memory = begun(task)
    judge(task, off, memory)
    turned = replace(upright, tool_position=(middle + np.array([0.008, 0.0, 0.0]))[None])
    assert judge(task, turned, memory).measures["slip"][0] > 5e-4


def test_only_what_was_between_the_jaws_counts(task: ClampTask, setting: Setting) -> None:
    memory = begun(task)
    judge(task, held(setting, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), memory)
    rest = setting.rest_nodes
    away = np.abs(rest[FLANKS] - ridge(setting))
    between = (away[:, 0] <= 0.5 * JAW_LENGTH) & (away[:, 2] <= 0.5 * JAW_HEIGHT)
    assert 0.2 < between.mean() < 0.9
    assert memory["between"][0].tolist() == between.tolist()
    nodes = rest.copy()
    nodes[FLANKS[~between]] += [0.01, 0.0, -0.01]
    outside = Situation.at_rest(setting, ridge(setting)[None], nodes=nodes[None], contact_share=GRIPPED)
    assert judge(task, outside, memory).measures["slip"][0] == pytest.approx(0.0, abs=1e-12)
    larger = begun(task)
    situation = held(setting, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), tool_scale=np.array([1.5]))
    judge(task, situation, larger)
    assert larger["between"].sum() > between.sum()


def test_a_new_grip_begins_where_it_is_but_not_by_losing_touch_with_one_jaw(task: ClampTask, setting: Setting) -> None:
    memory = begun(task)
    nowhere, up = (0.0, 0.0, 0.0), (0.0, 0.0, 0.004)
    judge(task, held(setting, nowhere, nowhere), memory)
    assert judge(task, held(setting, up, nowhere), memory).measures["slip"][0] == pytest.approx(0.004)
    for share in (HALF, shares(0.0, 0.5)):
        assert judge(task, held(setting, up, nowhere, share), memory).achieved[0, 1] == pytest.approx(GREATEST_SLIP)
        assert judge(task, held(setting, up, nowhere), memory).measures["slip"][0] == pytest.approx(0.004)
    judge(task, held(setting, up, nowhere, LOOSE), memory)
    assert judge(task, held(setting, up, nowhere), memory).measures["slip"][0] == pytest.approx(0.0, abs=1e-12)


def test_a_new_episode_forgets_the_grip_in_its_world_only(task: ClampTask, setting: Setting) -> None:
    memory = begun(task, 3)
    still = held(setting, np.zeros((3, 3)), np.zeros((3, 3)), np.repeat(GRIPPED, 3, axis=0))
    judge(task, still, memory)
    start = Start(goal=np.zeros((1, 2)), tool_position=np.zeros((1, 3)))
    task.begin_memory(memory, np.array([1]), start, [setting])
    assert memory["gripped"].tolist() == [True, False, True]
    moved = held(setting, np.tile([0.0, 0.0, 0.002], (3, 1)), np.zeros((3, 3)), np.repeat(GRIPPED, 3, axis=0))
    assert judge(task, moved, memory).measures["slip"] == pytest.approx([0.002, 0.0, 0.002])


def test_the_way_to_the_ridge_is_seen(task: ClampTask, setting: Setting) -> None:
    found = judge(task, held(setting, (0.003, -0.002, 0.02), (0.001, 0.0, 0.0), LOOSE))
    assert found.parts["ridge_offset"][0] == pytest.approx([-0.002, 0.002, -0.02])


def test_coming_closer_gripping_and_lifting_pay(task: ClampTask, setting: Setting) -> None:
    rewards = []
    for grip, moved, share in (
        ((0.0, 0.0, 0.03), (0.0, 0.0, 0.0), LOOSE),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), LOOSE),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), GRIPPED),
        ((0.0, 0.0, 0.004), (0.0, 0.0, 0.004), GRIPPED),
        ((0.0, 0.0, 0.008), (0.0, 0.0, 0.008), GRIPPED),
    ):
        rewards.append(float(weighted_sum(judge(task, held(setting, grip, moved, share)).terms, task.weights)[0]))
    assert rewards == sorted(rewards)
    assert rewards[-1] > rewards[-2] + 0.5


def test_force_and_action_are_reported_raw(task: ClampTask, setting: Setting) -> None:
    forces = np.array([[[0.0, -3.0, -4.0], [0.0, 2.0, 0.0]]])
    situation = held(setting, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), contact_forces=forces, action=np.full((1, 4), 0.5))
    terms = judge(task, situation).terms
    assert terms["force"] == pytest.approx([7.0])
    assert terms["action"] == pytest.approx([1.0])
    assert set(terms) == set(task.weights) == set(asdict(ClampWeights()))


def test_many_worlds_are_judged_as_each_alone(task: ClampTask, setting: Setting) -> None:
    generator = np.random.default_rng(4)
    share = shares([0.5, 0.0, 0.3, 0.2], [0.2, 0.5, 0.1, 0.7])
    grips, moves = generator.uniform(-0.004, 0.004, (2, 4, 3)), generator.uniform(-0.01, 0.01, (2, 4, 3))
    memory, found = begun(task, 4), []
    for k in range(2):
        found.append(judge(task, held(setting, grips[k], moves[k], share), memory))
    for w in range(4):
        alone = begun(task)
        for k in range(2):
            one = judge(task, held(setting, grips[k, w], moves[k, w], share[w : w + 1]), alone)
        assert one.achieved == pytest.approx(found[1].achieved[w : w + 1], abs=1e-12)
        for name, values in one.terms.items():
            assert values == pytest.approx(found[1].terms[name][w : w + 1], abs=1e-12), name


def test_the_goal_bounds_the_slip_and_tolerates_an_error_of_the_lift(task: ClampTask) -> None:
    desired = np.array([0.008, 0.0015])
    achieved = np.array([[0.008, 0.0], [0.0089, 0.0015], [0.0071, 0.0014], [0.0092, 0.0], [0.008, 0.0016]])
    assert task.fulfils(achieved, desired).tolist() == [True, True, True, False, False]
    assert task.compute_reward(achieved, np.tile(desired, (5, 1))).tolist() == [0.0, 0.0, 0.0, -1.0, -1.0]


@given(st.integers(0, 2**32 - 1))
def test_sparse_reward_agrees_with_the_evaluation_to_the_last_bit(task: ClampTask, setting: Setting, seed: int) -> None:
    generator = np.random.default_rng(seed)
    goal = task.sample(generator, 4, setting).goal
    memory = begun(task, 4)
    share = np.repeat(GRIPPED, 4, axis=0)
    judge(task, held(setting, np.zeros((4, 3)), np.zeros((4, 3)), share), memory)
    lift = goal[:, 0] + generator.choice([-0.001, 0.0, 0.001], 4)
    slip = goal[:, 1] * generator.choice([0.5, 1.0, 1.5], 4)
    up = np.array([[0.0, 0.0, 1.0]])
    found = judge(task, held(setting, (lift + slip)[:, None] * up, lift[:, None] * up, share), memory, goal)
    stored = task.compute_reward(found.achieved.astype(np.float32), goal.astype(np.float32))
    assert (stored == 0.0).tolist() == found.within_tolerance.tolist()


@given(st.integers(0, 2**32 - 1))
def test_samples_are_in_their_ranges(task: ClampTask, setting: Setting, seed: int) -> None:
    start = task.sample(np.random.default_rng(seed), 4, setting)
    assert start.control is not None
    lift, slip = start.goal.T
    assert ((lift >= 0.004) & (lift <= 0.012) & (slip >= 0.001) & (slip <= 0.002)).all()
    assert ((start.control >= 0.02) & (start.control <= 0.03)).all()
    assert (np.abs(start.tool_position[:, :2] - ridge(setting)[:2]) <= 0.008).all()
    gap = start.tool_position[:, 2] - 0.5 * JAW_HEIGHT - setting.rest_nodes[BLOCK.crest, 2].max()
    assert ((gap >= 0.002 - 1e-12) & (gap <= 0.012 + 1e-12)).all()
    for goal in start.goal:
        task.check_goal(goal)


def test_marks_show_the_crest_and_its_height(task: ClampTask, setting: Setting) -> None:
    patch, line = task.marks(np.array([0.01, 0.001]))
    assert isinstance(patch, Patch)
    assert isinstance(line, Path)
    assert patch.nodes.tolist() == BLOCK.crest.tolist()
    assert line.points[:, 2] == pytest.approx(setting.rest_nodes[BLOCK.crest, 2].max() + 0.01)
    assert line.points[1, 0] - line.points[0, 0] > 0.02


def test_other_scenes_are_refused(setting: Setting) -> None:
    with pytest.raises(ValueError, match="organ must be a RidgedBlock"):
        ClampTask(ClampConfig(), replace(setting, organ=None))
    with pytest.raises(ValueError, match=r"setting\.tools must be two jaws, got 1"):
        ClampTask(ClampConfig(), replace(setting, tools=setting.tools[:1]))
