from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from task_helpers import setting_of_task

from spatula_env.arrays import FloatArray
from spatula_env.geometry.rotations import from_rotation_vector, turn
from spatula_env.tasks import PalpateConfig, PalpateTask, Path, Ring, Situation, Start
from spatula_env.tasks.base import Evaluation, Memory, weighted_sum
from spatula_env.tasks.pressure_centre import centre_of_pressure

HALF_THICKNESS = 0.00125
FORCE = 0.14


@pytest.fixture(scope="module")
def task() -> PalpateTask:
    return PalpateTask(PalpateConfig(), setting_of_task("palpate"))


class Episode:
    """A path from (length / 2, 0) to (-length / 2, 0), bent to the left of the way back by `bend`."""

    def __init__(self, task: PalpateTask, length: float = 0.04, bend: float = 0.0, share: float = 0.85) -> None:
        self.task = task
        self.goal = np.array([[share, -0.5 * length, 0.0, FORCE]])
        self.memory: Memory = task.new_memory(1)
        start = Start(self.goal, np.zeros((1, 3)), drawn=np.array([[length, 0.0, bend]]))
        task.begin_memory(self.memory, np.array([0]), start, [task.setting])

    @property
    def path(self) -> FloatArray:
        return np.array(self.memory["path"][0])

    def be(self, place: object, force: object = FORCE, **changes: object) -> Evaluation:
        """Judge the spatula at a place (2,), its underside on the sphere's top, with a force upwards or (3,)."""
        vector = np.zeros((1, 3))
        vector[0] = [0.0, 0.0, force] if np.ndim(force) == 0 else force
        grip = [[*np.asarray(place)[:2], -0.025 + HALF_THICKNESS]]
        situation = Situation.at_rest(self.task.setting, grip, contact_force=vector, **changes)
        return self.task.evaluate(situation, self.goal, self.memory)

    def slide(self, begin: float = 0.0, end: float = 1.0, force: float = FORCE, aside: float = 0.0) -> Evaluation:
        """Slide from one part of the path to another."""
        for part in np.linspace(begin, end, 1 + round(60 * abs(end - begin))):
            at = part * (len(self.path) - 1)
            place = [np.interp(at, np.arange(len(self.path)), self.path[:, axis]) for axis in range(2)]
            found = self.be(np.add(place, [0.0, aside]), force)
        return found


@given(st.floats(0.03, 0.04), st.floats(-0.004, 0.004))
def test_paths_lead_over_the_surface_to_the_goal(task: PalpateTask, length: float, bend: float) -> None:
    path = Episode(task, length, bend).path
    assert path[0, :2] == pytest.approx([0.5 * length, 0.0])
    assert path[-1, :2] == pytest.approx([-0.5 * length, 0.0])
    # The way back leads to the right, so that its left is away from the operator.
    middle = path[len(path) // 2]
    assert middle[:2] == pytest.approx([0.0, bend], abs=1e-4)
    pieces = np.hypot(*np.diff(path[:, :2], axis=0).T)
    assert pieces == pytest.approx(np.full(len(pieces), pieces.mean()), rel=0.01)
    # A sphere of 60 mm radius, and within it the polyhedron.
    center = np.array([0.0, 0.0, -0.085])
    distance = np.linalg.norm(path - center, axis=1)
    assert (distance <= 0.06 + 1e-3).all()
    assert (distance >= 0.06 - 3e-3).all()


@pytest.mark.parametrize("bend", [0.0, 0.003])
def test_sliding_along_the_path_with_the_force_feels_all_of_it(task: PalpateTask, bend: float) -> None:
    episode = Episode(task, bend=bend)
    found = episode.slide()
    assert found.measures["share"].tolist() == [1.0]
    assert found.measures["progress"] == pytest.approx([1.0])
    assert found.parts["felt"].tolist() == [[1.0] * 10]
    assert found.measures["end_distance"] == pytest.approx([0.0], abs=1e-8)
    assert found.within_tolerance.tolist() == [True]


@pytest.mark.parametrize(
    ("force", "aside", "expected"),
    [
        (0.14 + 0.029, 0.0, 1.0),
        (0.14 + 0.031, 0.0, 0.0),
        (0.14 - 0.031, 0.0, 0.0),
        (0.0, 0.0, 0.0),
        (0.14, 0.0029, 1.0),
        (0.14, -0.0031, 0.0),
    ],
)
def test_only_a_force_in_the_band_on_the_path_feels(
    task: PalpateTask, force: float, aside: float, expected: float
) -> None:
    found = Episode(task).slide(force=force, aside=aside)
    assert found.measures["share"].tolist() == [expected]
    assert found.measures["progress"] == pytest.approx([expected])


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.008, 0.008), st.floats(-0.008, 0.008))
def test_the_centre_of_pressure_is_where_the_force_acts(
    task: PalpateTask, tilt: float, lean: float, x: float, y: float
) -> None:
    turned = from_rotation_vector(np.array([tilt, lean, 0.0]))
    arm = turn(turned, [x, y, -HALF_THICKNESS])
    force = turn(turned, [0.01, -0.02, FORCE])
    situation = Situation.at_rest(
        task.setting,
        [[0.001, 0.002, 0.003]],
        turned[None],
        contact_force=force[None],
        contact_torque=np.cross(arm, force)[None],
    )
    plate = task.setting.tools[0].vertices
    centre, normal, touching = centre_of_pressure(situation, plate.min(axis=0), plate.max(axis=0), 0.01)
    assert centre[0] - situation.tool_position[0] == pytest.approx(arm, abs=1e-12)
    assert normal == pytest.approx([FORCE])
    assert touching.tolist() == [True]
    off = replace(situation, contact_force=0.01 * situation.contact_force)
    middle, _, touching = centre_of_pressure(off, plate.min(axis=0), plate.max(axis=0), 0.01)
    assert middle[0] - situation.tool_position[0] == pytest.approx(turn(turned, [0.0, 0.0, -HALF_THICKNESS]))
    assert touching.tolist() == [False]


def test_a_plate_that_presses_with_its_rim_feels_there(task: PalpateTask) -> None:
    episode = Episode(task)
    end = episode.path[-1]
    # The middle is at the end, and the force acts 8 mm beside it.
    torque = np.cross([[0.0, 0.008, -HALF_THICKNESS]], [[0.0, 0.0, FORCE]])
    beside = episode.be(end, contact_torque=torque)
    assert beside.measures["path_distance"] == pytest.approx([0.008])
    assert beside.measures["share"].tolist() == [0.0]
    assert beside.achieved[0, 1:3] - end[:2] == pytest.approx([0.0, 0.008], abs=1e-7)
    assert episode.be(end).measures["share"][0] > 0.0


def test_the_path_goes_with_the_organ(task: PalpateTask) -> None:
    episode = Episode(task)
    moved = np.array([0.002, -0.001, 0.003])
    nodes = (task.setting.rest_nodes + moved)[None]
    found = episode.be(episode.path[-1] + moved, nodes=nodes)
    assert found.measures["end_distance"] == pytest.approx([0.0], abs=1e-7)
    assert found.measures["path_distance"] == pytest.approx([0.0], abs=1e-9)
    assert found.measures["share"][0] > 0.0
    assert episode.be(episode.path[-1], nodes=nodes).measures["end_distance"] == pytest.approx([np.hypot(2, 1) * 1e-3])


def test_the_way_back_feels_as_well(task: PalpateTask) -> None:
    assert Episode(task).slide(1.0, 0.0).measures["share"].tolist() == [1.0]


def test_what_was_left_out_is_told_and_can_be_felt_later(task: PalpateTask) -> None:
    episode = Episode(task)
    episode.slide(0.0, 0.3)
    episode.slide(0.3, 0.6, force=0.0)
    found = episode.slide(0.6, 1.0)
    assert found.measures["share"] == pytest.approx([0.7], abs=0.051)
    felt = found.parts["felt"][0]
    assert (felt[:3] == 1.0).all()
    assert (felt[4:6] == 0.0).all()
    assert (felt[6:] == 1.0).all()
    assert not found.within_tolerance[0]
    episode.slide(0.6, 0.3)
    assert episode.slide(0.6, 1.0).within_tolerance[0]


def test_a_stroke_feels_what_lies_between_two_steps_but_a_leap_does_not(task: PalpateTask) -> None:
    stroke = Episode(task)
    stroke.be(stroke.path[10])
    assert stroke.be(stroke.path[20]).measures["share"] == pytest.approx([10 / 40], abs=0.03)
    leap = Episode(task)
    leap.be(leap.path[10])
    leap.be(leap.path[15], force=0.0)
    assert leap.be(leap.path[20]).measures["share"] == pytest.approx([2 / 40], abs=0.051)


def test_nothing_is_felt_before_the_organ_is_touched(task: PalpateTask) -> None:
    episode = Episode(task)
    found = episode.be(episode.path[5], force=0.0)
    assert found.measures["progress"].tolist() == [0.0]
    assert found.parts["felt"].tolist() == [[0.0] * 10]


def test_the_normal_force_is_perpendicular_to_the_faces(task: PalpateTask) -> None:
    episode = Episode(task)
    assert episode.be([0.0, 0.0], [0.3, 0.2, 0.1]).parts["normal_force"] == pytest.approx(np.array([[0.1]]))
    # Turned by 90 degrees about x, the spatula's upper face looks towards the operator.
    tilted = np.array([[np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]])
    found = episode.be([0.0, 0.0], [0.3, 0.2, 0.1], tool_orientation=tilted)
    assert found.parts["normal_force"] == pytest.approx(np.array([[-0.2]]))


def test_the_path_ahead_begins_where_the_spatula_has_got_to(task: PalpateTask) -> None:
    episode = Episode(task)
    start = episode.be([0.0, 0.0], 0.0).parts["path_ahead"].reshape(5, 3)
    underside = np.array([0.0, 0.0, -0.025])
    assert start + underside == pytest.approx(episode.path[[0, 5, 10, 15, 20]], abs=1e-12)
    episode.slide(0.0, 0.5)
    half = episode.be([0.0, 0.0]).parts["path_ahead"].reshape(5, 3)
    assert half + underside == pytest.approx(episode.path[[20, 25, 30, 35, 40]], abs=1e-9)
    episode.slide(0.5, 1.0)
    end = episode.be([0.0, 0.0], 0.0).parts["path_ahead"].reshape(5, 3)
    assert end + underside == pytest.approx(np.tile(episode.path[-1], (5, 1)), abs=1e-9)


@pytest.mark.parametrize(
    ("achieved", "expected"),
    [
        ((0.85, 0.0, 0.0, 0.14), True),
        ((1.0, 0.0019, 0.0, 0.14 + 0.0299), True),
        ((0.84, 0.0, 0.0, 0.14), False),
        ((1.0, 0.0015, 0.0015, 0.14), False),
        ((1.0, 0.0, 0.0, 0.14 - 0.0301), False),
    ],
)
def test_the_goal_needs_share_place_and_force(task: PalpateTask, achieved: tuple[float, ...], expected: bool) -> None:
    desired = np.array([0.85, 0.0, 0.0, 0.14])
    assert bool(task.fulfils(np.array(achieved), desired)) is expected
    assert task.compute_reward(np.array(achieved), desired) == (0.0 if expected else -1.0)


def test_feeling_more_pays(task: PalpateTask) -> None:
    episode = Episode(task)
    rewards = [weighted_sum(episode.slide(part, part + 0.1).terms, task.weights)[0] for part in np.arange(8) / 10]
    assert (np.diff(rewards) > 0.0).all()


@given(st.floats(0.0, 0.02), st.floats(1e-4, 0.01))
def test_coming_closer_pays(task: PalpateTask, distance: float, step: float) -> None:
    episode = Episode(task)
    near, far = (episode.be(episode.path[0, :2] + [d, 0.0], 0.0) for d in (distance, distance + step))
    assert near.terms["reach"][0] > far.terms["reach"][0]
    assert weighted_sum(near.terms, task.weights)[0] > weighted_sum(far.terms, task.weights)[0]


def test_the_right_force_pays_on_the_path(task: PalpateTask) -> None:
    episode = Episode(task)
    terms = [episode.be(episode.path[0], force).terms["force"][0] for force in (0.0, 0.08, 0.14, 0.2)]
    assert terms[0] < terms[1] < terms[2] > terms[3]
    assert terms[2] == pytest.approx(1.0)
    assert episode.be(episode.path[0] + 0.006).terms["force"][0] < 0.1


def test_many_worlds_are_judged_as_each_alone(task: PalpateTask) -> None:
    generator = np.random.default_rng(3)
    start = task.sample(generator, 6, task.setting)
    together, alone = task.new_memory(6), [task.new_memory(1) for _ in range(6)]
    task.begin_memory(together, np.arange(6), start, [task.setting] * 6)
    for w, memory in enumerate(alone):
        for name in memory:
            memory[name][:] = together[name][w : w + 1]
    for step in range(8):
        grip = np.array([*zip(*(together["path"][w, 4 * step] for w in range(6)), strict=True)]).T
        force = generator.uniform(0.05, 0.25, (6, 1)) * [0.0, 0.0, 1.0]
        many = task.evaluate(Situation.at_rest(task.setting, grip, contact_force=force), start.goal, together)
        for w in range(6):
            row = slice(w, w + 1)
            situation = Situation.at_rest(task.setting, grip[row], contact_force=force[row])
            one = task.evaluate(situation, start.goal[row], alone[w])
            assert one.achieved.tolist() == many.achieved[row].tolist()
            for kind in ("terms", "measures", "parts"):
                for name, values in getattr(one, kind).items():
                    assert values.tolist() == getattr(many, kind)[name][row].tolist(), name
    assert 0.0 < together["felt"].mean() < 1.0


def test_a_new_episode_forgets_the_last_one(task: PalpateTask) -> None:
    memory = task.new_memory(2)
    start = task.sample(np.random.default_rng(0), 2, task.setting)
    task.begin_memory(memory, np.arange(2), start, [task.setting] * 2)
    for name in ("felt", "was_feeling"):
        memory[name][:] = True
    memory["progress"][:], memory["last"][:] = 7.0, 7.0
    again = Start(start.goal[1:], start.tool_position[1:], drawn=start.drawn[1:])
    task.begin_memory(memory, np.array([1]), again, [task.setting])
    assert memory["felt"].all(axis=1).tolist() == [True, False]
    assert memory["was_feeling"].tolist() == [True, False]
    assert memory["progress"].tolist() == [7.0, 0.0]


@given(st.integers(0, 2**32 - 1))
def test_samples_are_in_their_ranges(task: PalpateTask, seed: int) -> None:
    start = task.sample(np.random.default_rng(seed), 5, task.setting)
    assert start.drawn is not None
    share, end, force = start.goal[:, 0], start.goal[:, 1:3], start.goal[:, 3]
    way, bend = start.drawn[:, :2], start.drawn[:, 2]
    length = np.hypot(*way.T)
    for values, (low, high) in ((share, (0.8, 0.9)), (force, (0.1, 0.18)), (length, (0.03, 0.04))):
        assert (values >= low - 1e-12).all()
        assert (values <= high + 1e-12).all()
    assert (np.abs(bend) <= 0.004).all()
    assert (np.hypot(*(end + 0.5 * way).T) <= 0.004 + 1e-9).all()
    assert (np.hypot(*(start.tool_position[:, :2] - end - way).T) <= 0.01 + 1e-9).all()
    underside_above_top = start.tool_position[:, 2] - HALF_THICKNESS + 0.025
    assert (underside_above_top >= 0.005 - 1e-9).all()
    assert (underside_above_top <= 0.015 + 1e-9).all()
    for goal in start.goal:
        task.check_goal(goal)


@given(st.floats(0.005, 0.024), st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi))
def test_paths_to_a_chosen_end_stay_on_top(task: PalpateTask, distance: float, angle: float, drawn: float) -> None:
    end = distance * np.array([np.cos(angle), np.sin(angle)])
    way = 0.04 * np.array([np.cos(drawn), np.sin(drawn)])
    memory = task.new_memory(1)
    start = Start(np.array([[0.85, *end, FORCE]]), np.zeros((1, 3)), drawn=np.array([[*way, 0.0]]))
    task.begin_memory(memory, np.array([0]), start, [task.setting])
    path = memory["path"][0]
    assert path[-1, :2] == pytest.approx(end)
    assert np.hypot(*(path[0, :2] - end)) == pytest.approx(0.04)
    assert np.hypot(*path[0, :2]) <= 0.036


def test_paths_lead_in_all_directions(task: PalpateTask) -> None:
    drawn = task.sample(np.random.default_rng(0), 4000, task.setting).drawn
    assert drawn is not None
    count, _ = np.histogram(np.arctan2(drawn[:, 1], drawn[:, 0]), bins=8, range=(-np.pi, np.pi))
    assert (np.abs(count - 500) < 100).all()


@given(st.integers(0, 2**32 - 1))
def test_sparse_reward_agrees_with_the_evaluation_to_the_last_bit(task: PalpateTask, seed: int) -> None:
    generator = np.random.default_rng(seed)
    episode = Episode(task, share=float(generator.choice([0.0, 0.025, 0.5])))
    angle = generator.uniform(0.0, 2.0 * np.pi)
    # On the very edge of what is tolerated.
    place = episode.goal[0, 1:3] + 0.002 * np.array([np.cos(angle), np.sin(angle)])
    found = episode.be(place, FORCE + generator.choice([-0.03, 0.0, 0.03]))
    stored = task.compute_reward(found.achieved.astype(np.float32), episode.goal.astype(np.float32))
    assert (stored == 0.0).tolist() == found.within_tolerance.tolist()


def test_what_is_achieved_stays_within_its_bounds(task: PalpateTask) -> None:
    found = Episode(task).be([0.0508, 0.0508], 100.0)
    assert (found.achieved >= task.goal_low).all()
    assert (found.achieved <= task.goal_high).all()


def test_marks_show_the_path_and_its_end(task: PalpateTask) -> None:
    episode = Episode(task)
    path, ring = task.marks(episode.goal[0], None, episode.memory)
    assert isinstance(path, Path)
    assert isinstance(ring, Ring)
    assert path.points[:, :2] == pytest.approx(episode.path[:, :2])
    assert (path.points[:, 2] > episode.path[:, 2]).all()
    assert ring.point == pytest.approx(path.points[-1])
    (alone,) = task.marks(episode.goal[0])
    assert isinstance(alone, Ring)
    assert alone.point == pytest.approx(ring.point)
