"""Many worlds at once: each equals the same world alone, in `Simulation` and in Bullet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spatula_env import Simulation, scenes
from spatula_env.geometry import Tool
from spatula_env.sim.batch import BatchSimulation

SCENE = scenes.seed(tool_size=(1.0, 1.0, 0.125))
WEIGHT = 100.0
COUNT = 19
"""Worlds: more than a block of sixteen, and no whole number of blocks of eight."""


@pytest.fixture(scope="module")
def batch():
    return BatchSimulation(SCENE, COUNT)


@pytest.fixture(scope="module")
def top(batch):
    batch.reset()
    return batch.nodes[0, :, 2].max()


def velocities(seed, count=COUNT):
    """Downwards, each with its own speed and direction."""
    generator = np.random.default_rng(seed)
    return generator.uniform([-2.0, -2.0, -8.0], [2.0, 2.0, -4.0], size=(count, 1, 3))


def press(batch, top, seed=0, calls=4, steps=6):
    """Drive every tool its own way into its organ, and record."""
    batch.reset()
    batch.place_tools(np.tile([0.1, 0.0, top + 0.15], (batch.count, 1, 1)))
    linear, angular = velocities(seed, batch.count), 0.2 * velocities(seed + 1, batch.count)
    loads = [batch.advance(linear, angular, steps) for _ in range(calls)]
    return loads, batch.nodes


def equal_loads(first, second, rows=slice(None), other=slice(None)):
    for name in ("forces", "torques", "peak_forces", "penetrations", "residuals", "ground_forces", "diverged"):
        np.testing.assert_array_equal(getattr(first, name)[rows], getattr(second, name)[other], err_msg=name)
    np.testing.assert_array_equal(first.flags[0][rows], second.flags[0][other])


# Worlds and single simulations -------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_world_is_what_a_simulation_is(dtype, top):
    batch = BatchSimulation(SCENE, 3, dtype=dtype)
    recorded, nodes = press(batch, top)
    precision = "single" if dtype == np.float32 else "double"
    simulation = Simulation(SCENE, engine="batch", precision=precision)
    linear, angular = velocities(0, 3), 0.2 * velocities(1, 3)
    tolerance = 1e-12
    for world in range(3):
        simulation.reset()
        simulation.place_tool((0.1, 0.0, top + 0.15))
        for loads in recorded:
            reports = [simulation.step(linear[world], angular[world]) for _ in range(6)]
            forces = np.array([report.force for report in reports])
            np.testing.assert_allclose(
                loads.forces[world, 0], forces.mean(axis=0), atol=1e3 * tolerance, rtol=tolerance
            )
            torque = np.mean([report.torque for report in reports], axis=0)
            np.testing.assert_allclose(loads.torques[world, 0], torque, atol=1e3 * tolerance, rtol=tolerance)
            assert loads.peak_forces[world, 0] == pytest.approx(np.linalg.norm(forces, axis=1).max(), rel=tolerance)
            np.testing.assert_array_equal(loads.flags[0][world], reports[-1].contacts.flags)
            assert loads.penetrations[world] == pytest.approx(reports[-1].penetration, abs=tolerance)
            assert loads.residuals[world] == pytest.approx(max(r.residual for r in reports), abs=tolerance)
            ground = np.mean([report.ground_force for report in reports], axis=0)
            np.testing.assert_allclose(loads.ground_forces[world], ground, atol=1e3 * tolerance)
        assert reports[-1].contacts.flags.any()
        np.testing.assert_allclose(nodes[world], simulation.nodes, atol=tolerance)
        np.testing.assert_allclose(batch.tool_positions[world], simulation.tool_positions, atol=1e-12)
        np.testing.assert_allclose(batch.tool_orientations[world], simulation.tool_orientations, atol=1e-12)
        assert batch.times[world] == pytest.approx(simulation.time)


@pytest.mark.bullet
def test_double_precision_follows_bullet(top):
    batch, bullet = BatchSimulation(SCENE, 2, dtype=np.float64), Simulation(SCENE, engine="bullet")
    batch.place_tools(np.tile([0.1, 0.0, top + 0.05], (2, 1, 1)))
    bullet.place_tool((0.1, 0.0, top + 0.05))
    for k in range(40):
        velocity = np.array([0.0, 0.0, -5.0 if k < 30 else 0.0])
        loads = batch.advance(np.tile(velocity, (2, 1, 1)))
        report = bullet.step(velocity)
    assert loads.forces[1, 0, 2] > 5.0
    np.testing.assert_allclose(loads.forces[:, 0], np.tile(report.force, (2, 1)), atol=0.02 * report.force[2])
    np.testing.assert_allclose(batch.nodes[1], bullet.nodes, atol=0.02)
    bullet.close()


@pytest.mark.parametrize("others", [1, 8, 16, 35])
def test_what_happens_in_a_world_does_not_depend_on_others(batch, top, others):
    loads, nodes = press(batch, top)
    few = BatchSimulation(SCENE, others)
    few.place_tools(np.tile([0.1, 0.0, top + 0.15], (others, 1, 1)))
    shared = min(others, COUNT)
    linear, angular = np.zeros((2, others, 1, 3))
    # In reverse, so that each is in another lane of another block.
    where = np.arange(others)[::-1][:shared]
    linear[where], angular[where] = velocities(0)[:shared], 0.2 * velocities(1)[:shared]
    for expected in loads:
        equal_loads(few.advance(linear, angular, 6), expected, where, slice(shared))
    np.testing.assert_array_equal(few.nodes[where], nodes[:shared])


def test_threads_change_nothing(top):
    serial, parallel = BatchSimulation(SCENE, 20, parallel=False), BatchSimulation(SCENE, 20, parallel=True)
    expected, nodes = press(serial, top)
    found, same = press(parallel, top)
    for first, second in zip(expected, found, strict=True):
        equal_loads(first, second)
    np.testing.assert_array_equal(nodes, same)


def test_many_steps_in_one_call_are_those_steps(batch, top):
    together, nodes = press(batch, top, calls=2, steps=6)
    one_by_one, same = press(batch, top, calls=12, steps=1)
    np.testing.assert_array_equal(nodes, same)
    for k, loads in enumerate(together):
        part = one_by_one[6 * k : 6 * k + 6]
        np.testing.assert_allclose(loads.forces, np.mean([one.forces for one in part], axis=0), atol=1e-9)
        np.testing.assert_allclose(loads.peak_forces, np.max([one.peak_forces for one in part], axis=0), rtol=1e-12)
        np.testing.assert_array_equal(loads.residuals, np.max([one.residuals for one in part], axis=0))
        np.testing.assert_array_equal(loads.penetrations, part[-1].penetrations)
        np.testing.assert_allclose(loads.ground_forces, np.mean([one.ground_forces for one in part], axis=0), atol=1e-9)


@pytest.mark.parametrize("scene", [scenes.fissure(), scenes.clamp()], ids=["fissure", "clamp"])
def test_other_scenes_are_stepped_too(scene):
    batch = BatchSimulation(scene, 2)
    single = Simulation(scene, engine="batch")
    count = len(scene.tools)
    generator = np.random.default_rng(0)
    for _ in range(5):
        linear, angular = generator.normal(size=(2, count, 3)) * 3.0
        loads = batch.advance(np.stack([linear, -linear]), np.stack([angular, angular]), 4)
        reports = [single.step(linear, angular) for _ in range(4)]
    assert not loads.diverged.any()
    np.testing.assert_allclose(batch.nodes[0], single.nodes, atol=1e-12)
    expected = np.mean([report.loads for report in reports], axis=0)
    np.testing.assert_allclose(loads.forces[0], expected[:, :3], atol=1e-9)
    assert [flags.shape for flags in loads.flags] == [(2, len(placed.tool.nodes)) for placed in scene.tools]


# States --------------------------------------------------------------------------------------------------------------


def test_at_rest_the_ground_carries_the_weight(batch):
    batch.reset()
    nodes = batch.nodes
    loads = batch.advance(np.zeros((COUNT, 1, 3)), steps=24)
    np.testing.assert_allclose(loads.ground_forces, np.tile([0.0, 0.0, WEIGHT], (COUNT, 1)), atol=0.1)
    assert not loads.forces.any()
    assert not loads.flags[0].any()
    assert np.abs(batch.nodes - nodes).max() < 1e-3
    np.testing.assert_allclose(batch.node_masses.sum(axis=1), 10.0)
    assert np.abs(batch.node_velocities).max() < 0.05


@pytest.mark.parametrize("which", ["indices", "mask"])
def test_some_worlds_are_reset(batch, top, which):
    press(batch, top)
    before, times = batch.nodes, batch.times
    chosen = np.array([17, 2, 5])
    mask = np.isin(np.arange(COUNT), chosen)
    batch.reset(chosen if which == "indices" else mask)
    fresh = BatchSimulation(SCENE, 2)
    np.testing.assert_array_equal(batch.nodes[mask], np.repeat(fresh.nodes[:1], 3, axis=0))
    np.testing.assert_array_equal(batch.nodes[~mask], before[~mask])
    np.testing.assert_array_equal(batch.tool_positions[mask, 0], [SCENE.tools[0].position] * 3)
    assert not batch.times[mask].any()
    np.testing.assert_array_equal(batch.times[~mask], times[~mask])
    # They go on as if nothing had been before.
    batch.place_tools(np.tile([0.1, 0.0, top + 0.05], (3, 1, 1)), worlds=chosen)
    fresh.place_tools(np.tile([0.1, 0.0, top + 0.05], (2, 1, 1)))
    down = np.array([[0.0, 0.0, -6.0]])
    loads = batch.advance(np.tile(down, (COUNT, 1, 1)), steps=20)
    expected = fresh.advance(np.tile(down, (2, 1, 1)), steps=20)
    assert expected.flags[0].any()
    equal_loads(loads, expected, mask, np.zeros(3, dtype=int))


def test_saved_worlds_go_on_to_the_last_bit(batch, top):
    press(batch, top)
    state = batch.save([4, 11])
    linear = velocities(5)
    expected = [batch.advance(linear, steps=5) for _ in range(4)]
    nodes = batch.nodes
    other = BatchSimulation(SCENE, 6)
    other.restore(state, [5, 0])
    part = np.zeros((6, 1, 3))
    part[[5, 0]] = linear[[4, 11]]
    for loads in expected:
        equal_loads(other.advance(part, steps=5), loads, [5, 0], [4, 11])
    np.testing.assert_array_equal(other.nodes[[5, 0]], nodes[[4, 11]])
    assert other.times[5] == pytest.approx(batch.times[4])
    # What was saved is not changed by going on.
    other.restore(state, [1, 2])
    np.testing.assert_array_equal(other.nodes[[1, 2]], state.nodes)


def test_what_is_read_is_a_copy(batch):
    batch.reset()
    for name in (
        "nodes",
        "node_velocities",
        "tool_positions",
        "tool_orientations",
        "times",
        "triangles",
        "node_masses",
    ):
        getattr(batch, name)[:] = 7
        assert not np.all(getattr(batch, name) == 7), name
    first = batch.advance(np.zeros((COUNT, 1, 3)))
    second = batch.advance(np.zeros((COUNT, 1, 3)))
    for name in ("forces", "ground_forces", "diverged"):
        assert not np.shares_memory(getattr(first, name), getattr(second, name))


# Parameters ----------------------------------------------------------------------------------------------------------


def resting_force(batch):
    return batch.advance(np.zeros((batch.count, 1, 3)), steps=4).ground_forces[:, 2]


def test_worlds_differ_in_mass_and_gravity():
    batch = BatchSimulation(SCENE, 4)
    batch.set_parameters(mass_scale=2.0, worlds=[1])
    batch.set_parameters(mass_scale=[0.5, 3.0], gravity=[10.0, 5.0], worlds=[2, 3])
    batch.settle([3])
    np.testing.assert_allclose(resting_force(batch), [WEIGHT, 2.0 * WEIGHT, 0.5 * WEIGHT, 1.5 * WEIGHT], atol=0.5)
    # It is from there that episodes begin.
    batch.reset()
    assert resting_force(batch)[3] == pytest.approx(1.5 * WEIGHT, abs=0.5)
    np.testing.assert_allclose(batch.node_masses.sum(axis=1), [10.0, 20.0, 5.0, 30.0])


def test_a_heavier_organ_pushes_back_harder(top):
    batch = BatchSimulation(SCENE, 2)
    batch.set_parameters(mass_scale=[1.0, 2.0])
    linear = np.tile(velocities(3, 1), (2, 1, 1))
    batch.reset()
    batch.place_tools(np.tile([0.1, 0.0, top + 0.15], (2, 1, 1)))
    loads = batch.advance(linear, steps=30)
    np.testing.assert_allclose(loads.forces[1], 2.0 * loads.forces[0], rtol=1e-3)


def test_a_softer_organ_pushes_back_less(top):
    batch = BatchSimulation(SCENE, 2)
    batch.set_parameters(stiffness=[1.0, 0.3])
    batch.place_tools(np.tile([0.0, 0.0, top + 0.1], (2, 1, 1)))
    loads = batch.advance(np.tile([0.0, 0.0, -3.0], (2, 1, 1)), steps=60)
    assert 0.0 < loads.forces[1, 0, 2] < 0.8 * loads.forces[0, 0, 2]


def test_friction_is_each_worlds_own(top):
    batch = BatchSimulation(SCENE, 3)
    batch.set_parameters(friction=[0.0, 0.1, 0.5])
    batch.place_tools(np.tile([0.0, 0.0, top + 0.1], (3, 1, 1)))
    batch.advance(np.tile([0.0, 0.0, -3.0], (3, 1, 1)), steps=40)
    loads = batch.advance(np.tile([3.0, 0.0, 0.0], (3, 1, 1)), steps=10)
    drag = -loads.forces[:, 0, 0] / loads.forces[:, 0, 2]
    assert drag[0] + 0.05 < drag[1] < drag[2] - 0.05


def test_tools_are_each_worlds_own(top):
    batch = BatchSimulation(SCENE, 3)
    thick = Tool.box(size=(1.0, 1.0, 0.5), nodes_per_edge=6, faces="largest")
    batch.set_tools([thick], worlds=[1])
    batch.place_tools(np.tile([0.0, 0.0, top + 0.2], (3, 1, 1)))
    loads = batch.advance(np.tile([0.0, 0.0, -1.0], (3, 1, 1)), steps=12)
    assert loads.flags[0].any(axis=1).tolist() == [False, True, False]
    assert loads.forces[1, 0, 2] > 0.0


# Bad input and broken worlds -------------------------------------------------------------------------------------


def test_a_world_that_diverges_leaves_the_others_alone(top):
    batch, sound = BatchSimulation(SCENE, 5), BatchSimulation(SCENE, 5)
    state = batch.save([3])
    broken = type(state)(**{**vars(state), "node_velocities": np.full_like(state.node_velocities, 1e38)})
    batch.restore(broken, [3])
    linear = velocities(0, 5)
    for one in (batch, sound):
        one.place_tools(np.tile([0.1, 0.0, top + 0.15], (5, 1, 1)))
    others = [0, 1, 2, 4]
    for _ in range(3):
        loads, expected = batch.advance(linear, steps=8), sound.advance(linear, steps=8)
        assert loads.diverged.tolist() == [False, False, False, True, False]
        equal_loads(loads, expected, others, others)
        for values in (loads.forces, loads.torques, loads.peak_forces, loads.flags[0], loads.ground_forces):
            assert not values[3].any()
    batch.reset([3])
    loads = batch.advance(np.zeros((5, 1, 3)), steps=4)
    assert not loads.diverged.any()
    assert loads.ground_forces[3, 2] == pytest.approx(WEIGHT, abs=0.5)


ZEROS = np.zeros((COUNT, 1, 3))
NAN_IN_TWO = ZEROS.copy()
NAN_IN_TWO[2, 0, 1] = np.nan


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda b: b.advance(np.zeros((COUNT, 3))), r"linear_velocities must have shape \(19, 1, 3\), got \(19, 3\)"),
        (lambda b: b.advance(NAN_IN_TWO), "linear_velocities must be finite, in world 2"),
        (lambda b: b.advance(np.zeros((COUNT, 1, 3)), NAN_IN_TWO), "angular_velocities must be finite, in world 2"),
        (lambda b: b.advance("fast"), "linear_velocities must be numbers"),
        (
            lambda b: b.advance(np.full((COUNT, 1, 3), -2e4)),
            "linear_velocities must be at most 10000 u/s along each axis",
        ),
        (lambda b: b.advance(ZEROS, np.full((COUNT, 1, 3), 1e9)), "angular_velocities must be at most 10000 rad/s"),
        (lambda b: b.advance(np.zeros((COUNT, 1, 3)), steps=0), "steps must be an integer, 1 or more, got 0"),
        (lambda b: b.place_tools(np.zeros((2, 1, 3)), worlds=[1]), r"positions must have shape \(1, 1, 3\)"),
        (
            lambda b: b.place_tools(np.zeros((2, 1, 3)), [[[0, 0, 0, 1.0]], [[0, 0, 0, 2.0]]], [4, 7]),
            "orientations of world 7 must be a unit quaternion",
        ),
        (lambda b: b.reset([COUNT]), r"worlds must be indices in 0..18"),
        (lambda b: b.reset(["a"]), r"worlds must be indices in 0..18"),
        (lambda b: b.set_parameters(friction=[0.1, -0.2], worlds=[3, 8]), "friction must be zero or more, in world 8"),
        (lambda b: b.set_parameters(mass_scale=0.0), "mass_scale must be more than zero, in world 0"),
        (lambda b: b.set_parameters(gravity=[1.0, np.inf], worlds=[3, 8]), "gravity must be finite, in world 8"),
        (lambda b: b.set_tools([], worlds=[3, 8]), "tools must be 1 or 2, one for each world; got 0"),
        (
            lambda b: b.set_tools([Tool.box(nodes_per_edge=3)]),
            "tools must have 72 contact nodes, as the scene's; got 18",
        ),
        (lambda b: b.restore(b.save([1, 2]), [1]), r"state.nodes must have shape \(1, 328, 3\), got \(2, 328, 3\)"),
    ],
)
def test_bad_input_is_named_and_changes_nothing(batch, call, message):
    before = batch.nodes, batch.tool_positions, batch.tool_orientations, batch.times
    with pytest.raises(ValueError, match=message):
        call(batch)
    for kept, now in zip(
        before, (batch.nodes, batch.tool_positions, batch.tool_orientations, batch.times), strict=True
    ):
        np.testing.assert_array_equal(kept, now)


def test_tools_that_are_exchanged_leave_parameters_as_they_are():
    shown = []
    for exchanges_first in (False, True):
        worlds = BatchSimulation(SCENE, 2)
        small = [replace(placed, tool=placed.tool.scaled(0.8)) for placed in SCENE.tools]
        if exchanges_first:
            worlds.exchange_tools(small)
        worlds.set_parameters(gravity=[4.0, 12.0], mass_scale=[0.5, 2.0])
        if not exchanges_first:
            worlds.exchange_tools(small)
        worlds.place_tools(np.tile([0.0, 0.0, 6.2], (2, 1, 1)))
        loads = worlds.advance(np.tile([0.3, 0.0, -5.0], (2, 1, 1)), steps=60)
        ledgers = [memory.ledger for memory in worlds.save().memories]
        shown.append((worlds.nodes, loads.forces, ledgers))
    for one, other in zip(*shown, strict=True):
        np.testing.assert_array_equal(one, other)
    assert shown[0][1][0, 0, 2] > 0.0
    assert shown[0][1][0, 0, 2] != shown[0][1][1, 0, 2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"worlds": 0}, "worlds must be an integer of at least 1, got 0"),
        ({"worlds": 2, "contact": "bullet"}, "contact must be 'flags' or 'second_step' with engine 'batch'"),
        ({"worlds": 2, "first_step": "never"}, "first_step must be one of"),
        ({"worlds": 2, "dtype": np.int32}, "dtype must be float32 or float64, got int32"),
    ],
)
def test_bad_settings_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        BatchSimulation(SCENE, **arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"engine": "batch", "contact": "bullet"}, "contact must be 'flags' or 'second_step' with engine 'batch'"),
        ({"engine": "batch", "precision": "half"}, "precision must be one of"),
        ({"engine": "newton"}, "engine must be one of"),
    ],
)
def test_a_simulation_says_what_engines_offer(arguments, message):
    with pytest.raises(ValueError, match=message):
        Simulation(SCENE, **arguments)
