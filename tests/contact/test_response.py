"""The solves of the contact response: cases that can be computed by hand, and what any solution must satisfy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from reference_detector import random_rotation, rotation_matrix

from spatula_env.contact.energy import (
    ENERGY_TOLERANCE,
    GREATEST_WORK,
    LEDGER_LENGTH,
    REST_HEIGHT,
    WORK,
    keep_ledger,
    limit_energy,
    passive_share,
    scale_impulses,
    sum_heights,
    sum_motion,
)
from spatula_env.contact.response import (
    measure_gaps,
    solve_positions,
    solve_velocities,
    start_pushed,
    sum_impulses,
)
from spatula_env.contact.structures import (
    DISPLACEMENT,
    FEATURE_LENGTH,
    FOURTH,
    FRICTION,
    GAP,
    GROUND,
    IMPULSE,
    INERTIA,
    NO_VERTEX,
    NORMAL,
    ORGANS,
    ORIGIN,
    OWNER,
    POINT,
    ROW_LENGTH,
    VELOCITY,
    WEIGHTS,
)

DT = 0.01
UP = (0.0, 0.0, 1.0)
MANY, EXACT = 20000, 1e-13
"""Sweeps and tolerance of a solve that is to be exact."""

seeds = st.integers(0, 2**32 - 1)


class Constraints:
    """Constraints on some vertices, and the solves that they go through."""

    def __init__(self, masses, vertices):
        self.masses = np.array(masses, dtype=np.float64)
        with np.errstate(divide="ignore"):
            self.inverse_mass = 1.0 / self.masses
        self.vertices = np.array(vertices, dtype=np.float64)
        self.start = self.vertices.copy()
        self.rows, self.features = np.zeros((0, ROW_LENGTH)), np.zeros((0, FEATURE_LENGTH), dtype=np.int32)

    def add(self, corners, weights, normal, point, *, friction=0.0, origin=None, velocity=(0.0, 0.0, 0.0), owner=0):
        row = np.zeros(ROW_LENGTH)
        row[WEIGHTS : WEIGHTS + 3], row[NORMAL : NORMAL + 3], row[POINT : POINT + 3] = weights, normal, point
        row[VELOCITY : VELOCITY + 3], row[FRICTION] = velocity, friction
        row[ORIGIN : ORIGIN + 3] = np.asarray(weights) @ self.vertices[list(corners)] if origin is None else origin
        self.rows = np.vstack([self.rows, row])
        self.features = np.vstack([self.features, [*corners, NO_VERTEX, owner, 0]]).astype(np.int32)

    @property
    def mean_inverse_mass(self):
        free = self.inverse_mass[self.inverse_mass > 0.0]
        return float(free.mean()) if len(free) else 0.0

    def measure(self):
        return measure_gaps(
            len(self.rows), self.rows, self.features, self.inverse_mass, self.mean_inverse_mass, self.vertices
        )

    def move(self, sweeps=MANY, tolerance=EXACT, warm=None, frictional=MANY):
        """Solve for positions; returns the displacements of the vertices."""
        self.measure()
        if warm is not None:
            self.rows[:, DISPLACEMENT : DISPLACEMENT + 3] = warm
            start_pushed(len(self.rows), self.rows, self.features, self.inverse_mass, DISPLACEMENT, self.vertices)
        self.sweeps = solve_positions(
            np.arange(len(self.rows)), self.rows, self.features, self.inverse_mass, self.vertices, sweeps, tolerance,
            frictional,
        )  # fmt: skip
        self.measure()
        return self.vertices - self.start

    def push(self, velocities, sweeps=MANY, tolerance=EXACT, warm=None):
        """Solve for velocities; returns them."""
        after = np.array(velocities, dtype=np.float64)
        self.measure()
        if warm is not None:
            self.rows[:, IMPULSE : IMPULSE + 3] = warm
            start_pushed(len(self.rows), self.rows, self.features, self.inverse_mass, IMPULSE, after)
        self.sweeps = solve_velocities(
            np.arange(len(self.rows)), self.rows, self.features, self.inverse_mass, after, DT, sweeps, tolerance
        )
        return after

    def multipliers(self, column):
        """The parts along the normals, and those across (C, 3)."""
        vectors, normals = self.rows[:, column : column + 3], self.rows[:, NORMAL : NORMAL + 3]
        along = (vectors * normals).sum(axis=1)
        return along, vectors - along[:, None] * normals


def single(mass=2.0, height=-0.1, friction=0.0, origin=None, velocity=(0.0, 0.0, 0.0)):
    """One vertex at a height over a plane."""
    constraints = Constraints([mass], [(0.3, 0.4, height)])
    constraints.add(
        (0, 0, 0), (1.0, 0.0, 0.0), UP, (0.3, 0.4, 0.0), friction=friction, origin=origin, velocity=velocity
    )
    return constraints


# One constraint ----------------------------------------------------------------------------------------------------


def test_a_vertex_is_put_onto_the_plane():
    constraints = single()
    assert constraints.measure() == pytest.approx(0.1)
    np.testing.assert_allclose(constraints.move(), [[0.0, 0.0, 0.1]], atol=1e-12)
    along, across = constraints.multipliers(DISPLACEMENT)
    assert along == pytest.approx(0.2)
    assert not across.any()


@pytest.mark.parametrize("height", [0.0, 1e-6, 0.5])
def test_a_vertex_before_the_plane_is_left_alone(height):
    constraints = single(height=height)
    assert constraints.measure() == 0.0
    assert not constraints.move().any()
    # And so is its velocity, as long as it does not come through within the step.
    assert not constraints.push([(0.0, 0.0, 1.0)])[0, :2].any()
    assert constraints.push([(0.0, 0.0, -0.99 * height / DT)])[0, 2] == pytest.approx(-0.99 * height / DT)


@pytest.mark.parametrize("mass", [0.1, 1.0, 7.0])
def test_a_vertex_that_flies_into_the_plane_takes_its_velocity(mass):
    constraints = single(mass, height=0.0, velocity=(0.0, 0.0, 3.0))
    after = constraints.push([(1.0, 2.0, -5.0)])
    np.testing.assert_allclose(after, [(1.0, 2.0, 3.0)], atol=1e-12)
    assert constraints.multipliers(IMPULSE)[0] == pytest.approx(8.0 * mass)


def test_a_gap_may_be_closed_within_the_step_and_no_further():
    constraints = single(height=0.02)
    np.testing.assert_allclose(constraints.push([(0.0, 0.0, -5.0)]), [(0.0, 0.0, -2.0)], atol=1e-12)
    # A vertex that is inside is not thrown out: only its approach is taken.
    constraints = single(height=-0.02)
    np.testing.assert_allclose(constraints.push([(0.0, 0.0, -5.0)]), [(0.0, 0.0, 0.0)], atol=1e-12)
    np.testing.assert_allclose(single(height=-0.02).push([(0.0, 0.0, 0.7)]), [(0.0, 0.0, 0.7)], atol=1e-12)


@given(seeds)
def test_a_point_of_a_triangle_moves_the_corners_by_weight_and_lightness(seed):
    generator = np.random.default_rng(seed)
    masses, weights = generator.uniform(0.1, 3.0, size=3), generator.dirichlet(np.ones(3))
    vertices, normal = generator.normal(size=(3, 3)), rotation_matrix(random_rotation(generator))[0]
    depth = generator.uniform(0.01, 1.0)
    constraints = Constraints(masses, vertices)
    constraints.add((0, 1, 2), weights, normal, weights @ vertices + depth * normal)
    moved = constraints.move()
    # The least motion, weighted with the masses, that lifts the point by the depth.
    shares = weights / masses
    np.testing.assert_allclose(moved, depth * np.outer(shares / (weights @ shares), normal), atol=1e-9)
    # An impulse does the same to velocities.
    np.testing.assert_allclose(
        constraints.push(-2.0 * normal + np.zeros((3, 3))),
        -2.0 * normal + 2.0 * np.outer(shares / (weights @ shares), normal),
        atol=1e-9,
    )


@pytest.mark.parametrize("fixed", [(0,), (0, 1), (0, 1, 2)])
def test_fixed_corners_stay(fixed):
    masses = np.array([1.0, 2.0, 3.0])
    masses[list(fixed)] = np.inf
    constraints = Constraints(masses, [(0.0, 0.0, -0.1), (1.0, 0.0, -0.1), (0.0, 1.0, -0.1)])
    constraints.add((0, 1, 2), (0.2, 0.3, 0.5), UP, (0.3, 0.5, 0.0))
    moved = constraints.move()
    assert not moved[list(fixed)].any()
    if len(fixed) < 3:
        assert constraints.rows[0, GAP] == pytest.approx(0.0, abs=1e-9)
        assert (moved[~np.isinf(masses), 2] > 0.0).all()
    else:
        # Nothing can be done: it is no violation either.
        assert constraints.measure() == 0.0
        assert constraints.rows[0, INERTIA] == 0.0


def test_beside_a_fixed_vertex_nothing_is_thrown_in_one_go():
    # Nearly on the fixed corner: to lift this point by 0.1, the free corner would have to rise by ten.
    constraints = Constraints([np.inf, 1.0], [(0.0, 0.0, -0.1), (1.0, 0.0, -0.1)])
    constraints.add((0, 1, 1), (0.99, 0.01, 0.0), UP, (0.01, 0.0, 0.0))
    assert 0.0 < constraints.move(sweeps=1)[1, 2] < 0.01


# Friction ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("slip", [0.01, 0.0499, 0.0501, 0.3])
def test_friction_of_a_displacement(slip):
    # Pushed up by 0.1 with a coefficient of 0.5: a slip up to 0.05 is taken back, and no more of a longer one.
    constraints = single(friction=0.5, origin=(0.3 - slip, 0.4, -0.1))
    moved = constraints.move()
    np.testing.assert_allclose(moved, [[-min(slip, 0.05), 0.0, 0.1]], atol=1e-12)
    along, across = constraints.multipliers(DISPLACEMENT)
    assert np.linalg.norm(across) <= 0.5 * along[0] + 1e-12


@pytest.mark.parametrize("speed", [0.5, 0.99, 1.01, 8.0])
@pytest.mark.parametrize("direction", [0.0, 1.0, 2.5])
def test_friction_of_an_impulse(speed, direction):
    # It comes down at 2 u/s with a coefficient of 0.5: a slip of up to 1 u/s is stopped.
    way = np.array([np.cos(direction), np.sin(direction), 0.0])
    constraints = single(height=0.0, friction=0.5, velocity=(0.3, 0.1, 0.0))
    plane = np.array([0.3, 0.1, 0.0])
    after = constraints.push([plane + speed * way - 2.0 * np.array(UP)])
    np.testing.assert_allclose(after, [plane + max(speed - 1.0, 0.0) * way], atol=1e-12)


def test_without_pressure_there_is_no_friction():
    np.testing.assert_allclose(single(height=0.0, friction=5.0).push([(1.0, 0.0, 0.1)]), [(1.0, 0.0, 0.1)], atol=1e-12)
    assert not single(height=0.01, friction=5.0, origin=(9.0, 9.0, 0.01)).move().any()


@pytest.mark.parametrize("friction", [0.0, 0.3, 2.0])
@pytest.mark.parametrize("slope", [0.1, 0.5, 1.0])
def test_a_weight_on_a_slope_slides_if_friction_is_less_than_the_slope(friction, slope):
    # Step after step of gravity alone, the impulse starting from that of the last step.
    normal = np.array([-np.sin(np.arctan(slope)), 0.0, np.cos(np.arctan(slope))])
    velocities, warm = np.zeros((1, 3)), np.zeros((1, 3))
    for _ in range(20):
        constraints = Constraints([2.0], [(0.0, 0.0, 0.0)])
        constraints.add((0, 0, 0), (1.0, 0.0, 0.0), normal, (0.0, 0.0, 0.0), friction=friction)
        velocities = constraints.push(velocities - 10.0 * DT * np.array(UP), warm=warm)
        # The start's impulse changed the velocities already: it has to be that of this step in the end.
        warm = constraints.rows[:, IMPULSE : IMPULSE + 3].copy()
    downhill = -np.cross(np.cross(normal, UP), normal)
    downhill /= np.linalg.norm(downhill)
    steepness = np.sin(np.arctan(slope)) - friction * np.cos(np.arctan(slope))
    expected = 20 * DT * 10.0 * max(steepness, 0.0)
    np.testing.assert_allclose(velocities[0], expected * downhill, atol=1e-9)


# Several constraints -----------------------------------------------------------------------------------------------


def test_a_wedge_of_two_planes_holds_a_vertex_in_its_corner():
    constraints = Constraints([1.0], [(-0.2, 0.0, -0.1)])
    constraints.add((0, 0, 0), (1.0, 0.0, 0.0), UP, (0.0, 0.0, 0.0))
    constraints.add((0, 0, 0), (1.0, 0.0, 0.0), (np.sqrt(0.5), 0.0, np.sqrt(0.5)), (0.0, 0.0, 0.0))
    np.testing.assert_allclose(constraints.move(), [[0.15, 0.0, 0.15]], atol=1e-9)
    # Where the slanted plane has put it, it is above the other one already.
    assert constraints.multipliers(DISPLACEMENT)[0][0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_between_two_planes_that_leave_no_room_nothing_runs_away(friction):
    constraints = Constraints([1.0], [(0.0, 0.0, 0.0)])
    constraints.add((0, 0, 0), (1.0, 0.0, 0.0), UP, (0.0, 0.0, 0.2), friction=friction)
    constraints.add((0, 0, 0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 0.0, -0.3), friction=friction)
    moved = constraints.move(sweeps=50)
    assert np.isfinite(moved).all()
    assert -0.3 - 1e-9 <= moved[0, 2] <= 0.2 + 1e-9
    assert constraints.sweeps == 50
    after = constraints.push([(0.0, 0.0, 0.0)], sweeps=50)
    assert np.isfinite(after).all()
    np.testing.assert_allclose(after, 0.0, atol=1e-9)


def random_constraints(generator, vertices, count, friction=0.0):
    """Constraints on random triangles of random vertices that some place of the vertices satisfies."""
    masses = generator.uniform(0.3, 3.0, size=vertices)
    constraints = Constraints(masses, generator.normal(size=(vertices, 3)))
    target = constraints.vertices + 0.3 * generator.normal(size=(vertices, 3))
    for _ in range(count):
        corners = generator.choice(vertices, 3, replace=False)
        weights = generator.dirichlet(np.ones(3))
        normal = rotation_matrix(random_rotation(generator))[0]
        room = generator.uniform(0.0, 0.1)
        point = weights @ target[corners] - room * normal
        constraints.add(corners, weights, normal, point, friction=friction)
    return constraints, target


@settings(max_examples=40)
@given(seeds, st.integers(1, 8))
def test_the_shortest_way_out_of_all_constraints(seed, count):
    constraints, target = random_constraints(np.random.default_rng(seed), 6, count)
    moved = constraints.move()
    assume(constraints.sweeps < MANY)
    gaps, (along, across) = constraints.rows[:, GAP], constraints.multipliers(DISPLACEMENT)
    # Karush, Kuhn and Tucker's conditions of the least motion weighted with the masses; with them it is the only one.
    assert gaps.min() > -1e-6
    assert along.min() >= 0.0
    assert (along * gaps).max() < 1e-6
    np.testing.assert_allclose(across, 0.0, atol=1e-12)
    pushes = np.zeros_like(moved)
    for row, corners in zip(constraints.rows, constraints.features, strict=True):
        pushes[corners[:3]] += np.outer(row[WEIGHTS : WEIGHTS + 3], row[DISPLACEMENT : DISPLACEMENT + 3])
    np.testing.assert_allclose(moved * constraints.masses[:, None], pushes, atol=1e-9)
    # A place that satisfies all of them is known: no nearer.
    way = target - constraints.start
    assert constraints.masses @ (moved**2).sum(axis=1) <= constraints.masses @ (way**2).sum(axis=1) + 1e-6


@settings(max_examples=40)
@given(seeds, st.integers(1, 8), st.sampled_from([DISPLACEMENT, IMPULSE]))
def test_a_warm_start_leads_to_the_same_end(seed, count, column):
    generator = np.random.default_rng(seed)
    cold, _ = random_constraints(generator, 6, count)
    warm, _ = random_constraints(np.random.default_rng(seed), 6, count)
    # Any multipliers, those of contacts that no longer push and those that pull among them.
    start = generator.normal(size=(count, 3))
    if column == DISPLACEMENT:
        results = cold.move(), warm.move(warm=start)
    else:
        velocities = generator.normal(size=(6, 3))
        results = cold.push(velocities), warm.push(velocities, warm=start)
    assume(max(cold.sweeps, warm.sweeps) < MANY)
    np.testing.assert_allclose(results[1], results[0], atol=1e-6)
    along, across = warm.multipliers(column)
    assert along.min() >= 0.0
    np.testing.assert_allclose(across, 0.0, atol=1e-12)


@settings(max_examples=40)
@given(seeds, st.integers(1, 8))
def test_starting_from_the_end_there_is_nothing_left_to_do(seed, count):
    cold, _ = random_constraints(np.random.default_rng(seed), 6, count, friction=0.3)
    cold.move()
    assume(cold.sweeps < MANY)
    again, _ = random_constraints(np.random.default_rng(seed), 6, count, friction=0.3)
    again.move(warm=cold.rows[:, DISPLACEMENT : DISPLACEMENT + 3], tolerance=1e-9)
    assert again.sweeps == 1
    np.testing.assert_allclose(again.vertices, cold.vertices, atol=1e-8)


@settings(max_examples=40)
@given(seeds, st.integers(1, 10), st.floats(0.0, 2.0), st.integers(1, 60))
def test_momentum_changes_by_the_impulses_however_early_the_sweeps_end(seed, count, friction, sweeps):
    generator = np.random.default_rng(seed)
    constraints, _ = random_constraints(generator, 6, count, friction)
    constraints.rows[:, VELOCITY : VELOCITY + 3] = generator.normal(size=(count, 3))
    before = 3.0 * generator.normal(size=(6, 3))
    start = generator.normal(size=(count, 3))
    after = constraints.push(before, sweeps=sweeps, warm=start)
    impulses = constraints.rows[:, IMPULSE : IMPULSE + 3]
    np.testing.assert_allclose(constraints.masses @ (after - before), impulses.sum(axis=0), atol=1e-9)
    # All of them push, and are within the friction cone.
    along, across = constraints.multipliers(IMPULSE)
    assert along.min() >= -1e-12
    assert (np.linalg.norm(across, axis=1) <= friction * along + 1e-9).all()


@settings(max_examples=40)
@given(seeds, st.integers(1, 6))
def test_planes_at_rest_take_energy_and_give_none(seed, count):
    generator = np.random.default_rng(seed)
    constraints, _ = random_constraints(generator, 6, count, generator.uniform(0.0, 1.0))
    # On their planes: velocities may not lead through any of them.
    for row, corners in zip(constraints.rows, constraints.features, strict=True):
        row[POINT : POINT + 3] = row[WEIGHTS : WEIGHTS + 3] @ constraints.vertices[corners[:3]]
    before = generator.normal(size=(6, 3))
    after = constraints.push(before)
    assume(constraints.sweeps < MANY)
    masses = constraints.masses
    assert masses @ (after**2).sum(axis=1) <= masses @ (before**2).sum(axis=1) + 1e-6
    for row, corners in zip(constraints.rows, constraints.features, strict=True):
        assert row[WEIGHTS : WEIGHTS + 3] @ after[corners[:3]] @ row[NORMAL : NORMAL + 3] > -1e-6


# Sums --------------------------------------------------------------------------------------------------------------


def test_impulses_are_summed_up_by_tool_and_by_node():
    generator = np.random.default_rng(0)
    constraints, _ = random_constraints(generator, 6, 9)
    owners = np.array([0, 1, GROUND] * 3)
    constraints.features[:, OWNER] = owners
    constraints.rows[:, IMPULSE : IMPULSE + 3] = generator.normal(size=(9, 3))
    impulses, weights = constraints.rows[:, IMPULSE : IMPULSE + 3].copy(), constraints.rows[:, WEIGHTS : WEIGHTS + 3]
    places = np.einsum("cw,cwx->cx", weights, constraints.vertices[constraints.features[:, :3]])
    positions, nodal, wrenches = generator.normal(size=(2, 3)), np.ones((6, 3)), np.ones((3, 6))
    sum_impulses(9, constraints.rows, constraints.features, 2, positions, constraints.vertices, nodal, wrenches)
    for tool in range(2):
        mine = owners == tool
        np.testing.assert_allclose(wrenches[tool, :3], -impulses[mine].sum(axis=0), atol=1e-12)
        moments = np.cross(places[mine] - positions[tool], -impulses[mine]).sum(axis=0)
        np.testing.assert_allclose(wrenches[tool, 3:], moments, atol=1e-12)
    np.testing.assert_allclose(wrenches[2, :3], -impulses[owners == GROUND].sum(axis=0), atol=1e-12)
    # The nodes' impulses are from tools only, and equal to what these gave.
    np.testing.assert_allclose(nodal.sum(axis=0), -wrenches[:2, :3].sum(axis=0), atol=1e-12)
    np.testing.assert_allclose(
        np.cross(constraints.vertices, nodal).sum(axis=0),
        np.cross(places, impulses)[owners >= 0].sum(axis=0),
        atol=1e-12,
    )


# Energy ------------------------------------------------------------------------------------------------------------

FIRST, END = 4, 10


class Energies:
    """An organ of six moving nodes, in the middle of others."""

    def __init__(self, seed, fixed=()):
        generator = np.random.default_rng(seed)
        self.masses = generator.uniform(0.3, 3.0, size=12)
        self.masses[list(fixed)] = np.inf
        self.inverse_mass = 1.0 / self.masses
        self.vertices, self.velocities = generator.normal(size=(12, 3)), generator.normal(size=(12, 3))
        self.free = np.isfinite(self.masses) & (np.arange(12) >= FIRST) & (np.arange(12) < END)
        self.velocities[~np.isfinite(self.masses)] = 0.0
        self.rest_height = float(self.masses[self.free] @ generator.normal(size=12)[self.free])
        self.gravity = 3.0
        self.before = self.velocities.copy()

    def energy(self):
        masses = self.masses[self.free]
        kinetic = 0.5 * masses @ (self.velocities[self.free] ** 2).sum(axis=1)
        return kinetic + self.gravity * (masses @ self.vertices[self.free, 2] - self.rest_height)

    def momentum(self, velocities):
        return self.masses[self.free] @ velocities[self.free]

    def of_mean(self):
        """Energy that remains when the free nodes move as one."""
        masses = self.masses[self.free]
        height = masses @ self.vertices[self.free, 2] - self.rest_height
        return 0.5 * (self.momentum(self.before) ** 2).sum() / masses.sum() + self.gravity * height

    def limit(self, allowed, greatest_work=0.0, mean_edge=0.0):
        ledger = np.array([allowed, greatest_work, self.rest_height, 1.0])
        return limit_energy(
            FIRST, END, self.inverse_mass, self.sums(), self.velocities, self.gravity, mean_edge, ledger
        )

    def sums(self):
        return sum_motion(FIRST, END, self.inverse_mass, self.vertices, self.velocities, self.rest_height)

    def assert_others_untouched(self):
        others = np.r_[0:FIRST, END:12]
        np.testing.assert_array_equal(self.velocities[others], self.before[others])


@given(seeds, st.sampled_from([(), (1, 7), (4, 5, 6)]), st.floats(0.01, 0.99))
def test_energy_above_the_bound_is_taken_and_momentum_is_not(seed, fixed, part):
    organ = Energies(seed, fixed)
    least, all_of_it = organ.of_mean(), organ.energy()
    allowed = least + part * (all_of_it - least)
    taken = organ.limit(allowed)
    assert organ.energy() == pytest.approx(allowed, abs=1e-9)
    assert taken == pytest.approx(all_of_it - allowed, abs=1e-9)
    np.testing.assert_allclose(organ.momentum(organ.velocities), organ.momentum(organ.before), atol=1e-9)
    organ.assert_others_untouched()


@given(seeds, st.floats(1e-9, 10.0))
def test_energy_below_the_bound_is_left_alone(seed, room):
    organ = Energies(seed)
    assert organ.limit(organ.energy() + room) == 0.0
    np.testing.assert_array_equal(organ.velocities, organ.before)


@given(seeds, st.floats(0.001, 100.0))
def test_more_than_relative_motion_cannot_be_taken(seed, missing):
    # Then the organ moves as one; its own momentum is not touched.
    organ = Energies(seed)
    least, all_of_it = organ.of_mean(), organ.energy()
    assert organ.limit(least - missing) == pytest.approx(all_of_it - least)
    np.testing.assert_allclose(organ.momentum(organ.velocities), organ.momentum(organ.before), atol=1e-9)
    np.testing.assert_allclose(np.ptp(organ.velocities[FIRST:END], axis=0), 0.0, atol=1e-7)
    organ.assert_others_untouched()


@given(seeds)
def test_a_part_of_the_work_is_allowed_for_rounding(seed):
    organ = Energies(seed)
    allowed = organ.energy() - 0.1
    assert organ.limit(allowed, greatest_work=0.1001 / ENERGY_TOLERANCE) == 0.0
    mass = organ.masses[organ.free].sum()
    assert organ.limit(allowed, mean_edge=np.sqrt(0.2002 / ENERGY_TOLERANCE / mass)) == 0.0
    assert organ.limit(allowed) > 0.0


@given(seeds, st.floats(0.05, 0.95))
def test_impulses_give_an_organ_no_more_energy_than_they_do_work(seed, part):
    # The share of the impulses is chosen so that the organ's mean motion gains no more energy than the work.
    organ = Energies(seed, fixed=(1, 7))
    generator = np.random.default_rng(seed + 1)
    impulses = generator.normal(size=(12, 3))
    impulses[organ.inverse_mass == 0.0] = 0.0
    free = organ.free
    given_momentum, mass = impulses[free].sum(axis=0), organ.masses[free].sum()
    work = generator.uniform(-1.0, 0.2)

    def excess(share):
        """Kinetic energy of the mean motion plus potential energy less the work, with a share of the impulses."""
        mean = (organ.momentum(organ.velocities) - (1.0 - share) * given_momentum) / mass
        height = organ.masses[free] @ organ.vertices[free, 2] - organ.rest_height
        return 0.5 * mass * mean @ mean + organ.gravity * height - share * work

    # The bound is between the energy without impulses and that with all of them, if these add any.
    without, with_all = excess(0.0), excess(1.0)
    allowed = without + part * (with_all - without)
    ledger = np.array([allowed + work, -1e9, organ.rest_height, 1.0])
    share = passive_share(FIRST, END, organ.inverse_mass, organ.sums(), impulses, work, organ.gravity, 0.0, ledger)
    if with_all <= without:
        assert share == 1.0
    else:
        assert 0.0 < share < 1.0
        assert excess(share) == pytest.approx(allowed, abs=1e-9)
        # It is the largest share within the bound.
        assert excess(min(share + 1e-3, 1.0)) > allowed


def test_a_share_of_impulses_is_left_to_one_organ_and_to_all_of_the_ground():
    rows, features = np.ones((4, ROW_LENGTH)), np.zeros((4, FEATURE_LENGTH), dtype=np.int32)
    features[:, 0], features[:, OWNER] = (FIRST, FIRST, END, FIRST), (0, GROUND, 0, 1)
    scale_impulses(4, rows, features, FIRST, END, 0.25)
    np.testing.assert_array_equal(rows[:, IMPULSE : IMPULSE + 3].T, np.tile([0.25, 1.0, 1.0, 0.25], (3, 1)))
    np.testing.assert_array_equal(rows[:, :IMPULSE], 1.0)


def test_fixed_nodes_stay_at_rest_when_energy_is_taken():
    organ = Energies(1, fixed=(1, 7))
    assert organ.limit(0.5 * (organ.of_mean() + organ.energy())) > 0.0
    assert not organ.velocities[[1, 7]].any()


def test_the_sum_of_heights_counts_an_organs_free_nodes():
    organ = Energies(2, fixed=(3, 8))
    expected = organ.masses[organ.free] @ organ.vertices[organ.free, 2]
    assert sum_heights(FIRST, END, organ.inverse_mass, organ.vertices) == pytest.approx(expected)


def pair_of_points(generator, friction=0.0):
    """A vertex held above a triangle, which has come through it, all of different masses."""
    constraints = Constraints(generator.uniform(0.5, 3.0, 4), [(0, 0, 0), (1, 0, 0.1), (0, 1, -0.1), (0.3, 0.3, -0.2)])
    weights = -generator.dirichlet(np.ones(3))
    constraints.add((0, 1, 2), weights, UP, (0.0, 0.0, 0.05), friction=friction, owner=ORGANS)
    constraints.features[0, FOURTH] = 3
    constraints.rows[0, ORIGIN : ORIGIN + 3] = (
        weights @ constraints.vertices[:3] + constraints.vertices[3] + (0.1, 0, 0)
    )
    return constraints


@given(seeds, st.sampled_from([0.0, 0.5]))
def test_points_of_organs_are_kept_apart_and_momentum_is_kept(seed, friction):
    generator = np.random.default_rng(seed)
    constraints = pair_of_points(generator, friction)
    masses = 1.0 / constraints.inverse_mass
    weights = np.append(constraints.rows[0, WEIGHTS : WEIGHTS + 3], 1.0)
    moved = constraints.move()
    np.testing.assert_allclose(masses @ moved, 0.0, atol=1e-12)
    # A push beyond what is missing twice is not allowed in one solve, and none is needed here.
    assert weights @ constraints.vertices[:, 2] == pytest.approx(0.05, abs=1e-9)
    before = generator.normal(size=(4, 3))
    after = constraints.push(before)
    np.testing.assert_allclose(masses @ after, masses @ before, atol=1e-9)
    assert weights @ after[:, 2] >= -1e-6


def test_what_contradicts_itself_is_pushed_no_farther_than_twice_what_is_missing():
    """Two triangles that hold a vertex on opposite sides: sweeps would go on for ever."""
    constraints = Constraints(np.ones(4), [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.3, 0.3, -0.2)])
    for normal in (UP, (0.0, 0.0, -1.0)):
        weights = (-0.4, -0.3, -0.3)
        constraints.add((0, 1, 2), weights, normal, np.multiply(0.05, normal), owner=ORGANS)
    constraints.features[:, FOURTH] = 3
    moved = constraints.move(sweeps=200)
    assert np.abs(moved).max() < 2 * 0.25 + 0.05


def test_impulses_between_organs_are_no_tools_load():
    constraints = pair_of_points(np.random.default_rng(0))
    constraints.rows[:, IMPULSE : IMPULSE + 3] = 1.0
    nodal, wrenches = np.ones((4, 3)), np.ones((2, 6))
    sum_impulses(1, constraints.rows, constraints.features, 1, np.zeros((1, 3)), constraints.vertices, nodal, wrenches)
    assert not nodal.any() and not wrenches.any()


@given(seeds)
def test_work_between_organs_is_what_their_energies_of_motion_change_by(seed):
    generator = np.random.default_rng(seed)
    masses, before = generator.uniform(0.5, 2.0, 8), generator.normal(size=(8, 3))
    rows, features = np.zeros((3, ROW_LENGTH)), np.zeros((3, FEATURE_LENGTH), dtype=np.int32)
    after = before.copy()
    for c in range(3):
        corners = np.array([*generator.permutation(4)[:3], 4 + generator.integers(4)])
        rows[c, WEIGHTS : WEIGHTS + 3] = -generator.dirichlet(np.ones(3))
        rows[c, IMPULSE : IMPULSE + 3] = generator.normal(size=3)
        features[c, :3], features[c, FOURTH], features[c, OWNER] = corners[:3], corners[3], ORGANS
        weights = np.append(rows[c, WEIGHTS : WEIGHTS + 3], 1.0)
        np.add.at(after, corners, weights[:, None] * rows[c, IMPULSE : IMPULSE + 3] / masses[corners, None])
    ledger = np.zeros((2, LEDGER_LENGTH))
    none = np.zeros((0, 3))
    keep_ledger(3, rows, features, np.array([0, 4]), 1.0 / masses, before, none, none, none, before, after, ledger)
    energies = 0.5 * masses * ((after**2).sum(axis=1) - (before**2).sum(axis=1))
    np.testing.assert_allclose(ledger[:, WORK], [energies[:4].sum(), energies[4:].sum()], atol=1e-12)


@given(seeds)
def test_work_is_counted_for_the_organ_that_it_is_done_on(seed):
    generator = np.random.default_rng(seed)
    count, tools, first = 9, 2, np.array([0, 4, 10])
    rows, features = np.zeros((count, ROW_LENGTH)), np.zeros((count, FEATURE_LENGTH), dtype=np.int32)
    organs = generator.integers(0, 3, size=count)
    features[:, 0], features[:, OWNER] = first[organs] + 1, generator.integers(-1, tools, size=count)
    impulses, points = generator.normal(size=(2, count, 3))
    rows[:, IMPULSE : IMPULSE + 3], rows[:, POINT : POINT + 3] = impulses, points
    positions, linear, angular = generator.normal(size=(3, tools, 3))
    nodes, inverse_mass, still = generator.normal(size=(12, 3)), np.ones(12), np.zeros((12, 3))
    ledger = np.zeros((3, LEDGER_LENGTH))
    keep_ledger(count, rows, features, first, inverse_mass, nodes, positions, linear, angular, still, still, ledger)
    expected = np.zeros(3)
    for impulse, point, organ, owner in zip(impulses, points, organs, features[:, OWNER], strict=True):
        if owner >= 0:
            expected[organ] += impulse @ (linear[owner] + np.cross(angular[owner], point - positions[owner]))
    np.testing.assert_allclose(ledger[:, WORK], expected, atol=1e-12)
    np.testing.assert_allclose(ledger[:, GREATEST_WORK], np.maximum(expected, 0.0), atol=1e-12)
    heights = [nodes[:4, 2].sum(), nodes[4:10, 2].sum(), nodes[10:, 2].sum()]
    np.testing.assert_allclose(ledger[:, REST_HEIGHT], heights, atol=1e-12)
    # Heights are those of the first step; work goes on.
    keep_ledger(
        count, rows, features, first, inverse_mass, nodes + 1.0, positions, -linear, -angular, still, still, ledger
    )
    np.testing.assert_allclose(ledger[:, WORK], 0.0, atol=1e-12)
    np.testing.assert_allclose(ledger[:, GREATEST_WORK], np.maximum(expected, 0.0), atol=1e-12)
    np.testing.assert_allclose(ledger[:, REST_HEIGHT], heights, atol=1e-12)


@pytest.mark.parametrize("frictional", [0, 1, MANY])
def test_friction_is_left_as_it_is_after_so_many_sweeps(frictional):
    # A vertex 0.1 below the plane that has slipped by 0.02: the normal part is solved for all the same.
    constraints = single(friction=0.5, origin=(0.28, 0.4, -0.1))
    moved = constraints.move(frictional=frictional)
    np.testing.assert_allclose(moved, [(-0.02 if frictional else 0.0, 0.0, 0.1)], atol=1e-9)
    # What friction there is already stays: 0.06 kg u move 2 kg by 0.03 u.
    constraints = single(friction=0.5, origin=(0.28, 0.4, -0.1))
    moved = constraints.move(frictional=0, warm=np.array([0.06, 0.0, 0.2]))
    np.testing.assert_allclose(moved, [(0.03, 0.0, 0.1)], atol=1e-9)
