"""Two jaws close on a ridge, lift the organ by it, hold it, and let go."""

from __future__ import annotations

import numpy as np
import pytest

from spatula_env import Simulation, scenes

CLOSING, LIFTING = 0.5, 0.5
"""Speeds of the jaws [u/s]."""

LIFT = 0.5
"""How far the jaws go up [u]."""

WIDTH = 0.8
"""Of the ridge [u]."""

SQUEEZE = 0.3
"""How much of the ridge's width the jaws take away."""


@pytest.fixture(scope="module")
def simulation():
    simulation = Simulation(scenes.clamp())
    yield simulation
    simulation.close()


def close_jaws(simulation, squeeze=SQUEEZE):
    """From reset on, close both jaws at the same speed, and hold for a while; the last report."""
    simulation.reset()
    way = scenes.JAW_CLEARANCE + 0.5 * squeeze * WIDTH
    for _ in range(round(way / (CLOSING * simulation.dt))):
        simulation.step([(0.0, CLOSING, 0.0), (0.0, -CLOSING, 0.0)])
    return [simulation.step() for _ in range(24)][-1]


def lift_jaws(simulation):
    return [simulation.step((0.0, 0.0, LIFTING)) for _ in range(round(LIFT / (LIFTING * simulation.dt)))]


def between_jaws(simulation):
    """The nodes of the flanks between the jaws."""
    block, jaw = simulation.scene.organs[0].organ, simulation.scene.tools[0]
    flanks = np.concatenate(block.flanks)
    near = np.abs(block.vertices[flanks, 0]) < 0.5 * jaw.tool.size[0]
    near &= np.abs(block.vertices[flanks, 2] - jaw.position[2]) < 0.5 * jaw.tool.size[1]
    return flanks[near]


@pytest.fixture(scope="module")
def gripped(simulation):
    """The state with the jaws closed, and the last report."""
    report = close_jaws(simulation)
    return simulation.save(), report


@pytest.fixture(scope="module")
def lifted(simulation, gripped):
    """The state after lifting, and how high the nodes between the jaws were before."""
    simulation.restore(gripped[0])
    before = simulation.nodes[between_jaws(simulation), 2]
    lift_jaws(simulation)
    return simulation.save(), before


def test_the_organ_is_at_rest_and_the_jaws_do_not_touch_it(simulation):
    simulation.reset()
    nodes = simulation.nodes
    for _ in range(round(0.2 / simulation.dt)):
        report = simulation.step()
        assert all((wrench.force == 0.0).all() for wrench in report.wrenches)
    assert np.abs(simulation.nodes - nodes).max() < 1e-3
    assert len(report.wrenches) == 2
    assert len(between_jaws(simulation)) >= 10


def test_the_jaws_squeeze_the_ridge_from_both_sides(simulation, gripped):
    state, report = gripped
    first, second = (wrench.force for wrench in report.wrenches)
    # Each is pushed back, and the two are nearly opposite: what is left holds up the organ.
    assert first[1] < -300.0
    np.testing.assert_allclose(first[1], -second[1], rtol=0.05)
    for force in (first, second):
        assert np.hypot(force[0], force[2]) < 0.1 * abs(force[1])
    assert -first[1] * simulation.scene.scale.force == pytest.approx(0.25, rel=0.15)
    # Contact is on the inner faces only. A jaw's frame has its z axis along negative y.
    for contacts, side in zip(report.all_contacts, (-1.0, 1.0), strict=True):
        tool = simulation.scene.tools[0].tool
        flags = contacts[0].flags
        assert flags.sum() >= 10
        assert (tool.normals[flags, 2] == side).all()
    simulation.restore(state)
    width = np.ptp(simulation.nodes[between_jaws(simulation), 1])
    assert width == pytest.approx((1.0 - SQUEEZE) * WIDTH, abs=0.02)


def test_what_the_organ_gets_the_jaws_give(simulation, gripped):
    simulation.restore(gripped[0])
    for report in lift_jaws(simulation):
        given = report.nodal_impulses.sum(axis=0)
        taken = sum(wrench.force for wrench in report.wrenches) * simulation.dt
        size = np.abs(report.nodal_impulses).sum()
        np.testing.assert_allclose(given, -taken, atol=1e-9 * size)


def test_the_jaws_lift_the_organ(simulation, lifted):
    state, before = lifted
    simulation.restore(state)
    raised = simulation.nodes[between_jaws(simulation), 2] - before
    assert raised.min() >= 0.4
    assert raised.max() < LIFT + 0.05
    # All of it is off the ground.
    assert simulation.nodes[:, 2].min() > 0.3


def test_the_jaws_hold_the_organ(simulation, lifted):
    simulation.restore(lifted[0])
    [simulation.step() for _ in range(120)]
    nodes, forces = simulation.nodes, []
    for _ in range(120):
        report = simulation.step()
        assert (report.ground_force == 0.0).all()
        forces.append(sum(wrench.force for wrench in report.wrenches))
    weight = simulation.node_masses.sum() * simulation.scene.gravity
    assert weight == pytest.approx(100.0)
    np.testing.assert_allclose(np.mean(forces, axis=0), [0.0, 0.0, -weight], atol=0.05 * weight)
    assert np.isfinite(simulation.nodes).all()
    assert np.abs(simulation.nodes - nodes).max() < 0.03


def test_open_jaws_let_go(simulation, lifted):
    simulation.restore(lifted[0])
    for _ in range(96):
        report = simulation.step([(0.0, -1.0, 0.0), (0.0, 1.0, 0.0)])
    for _ in range(96):
        report = simulation.step()
    assert all((wrench.force == 0.0).all() for wrench in report.wrenches)
    assert simulation.nodes[:, 2].min() == pytest.approx(0.0, abs=1e-3)
    np.testing.assert_allclose(simulation.nodes[:, 2], simulation.scene.organs[0].vertices[:, 2], atol=0.1)


def test_a_light_grip_slips():
    # The fingers of a smooth clamp slide off, so that a lift says something about friction.
    simulation = Simulation(scenes.clamp(friction=0.0))
    close_jaws(simulation)
    before = simulation.nodes[between_jaws(simulation), 2]
    lift_jaws(simulation)
    raised = simulation.nodes[between_jaws(simulation), 2] - before
    simulation.close()
    assert np.abs(raised).max() < 0.1


def test_an_organ_held_at_its_base_is_pulled_and_slips():
    simulation = Simulation(scenes.clamp(fixed_base=True))
    block = simulation.scene.organs[0].organ
    close_jaws(simulation)
    largest = max(-sum(wrench.force[2] for wrench in report.wrenches) for report in lift_jaws(simulation))
    held = simulation.nodes[block.base]
    simulation.close()
    # Far more than its weight.
    assert largest > 300.0
    np.testing.assert_allclose(held, block.vertices[block.base], atol=1e-6)


def test_tilted_jaws_reach_under_the_ridge():
    scene = scenes.clamp(jaw_tilt=0.2)
    for placed, side in zip(scene.tools, (-1.0, 1.0), strict=True):
        x, _, _, w = placed.orientation
        angle = 2.0 * np.arctan2(x, w)
        corners = placed.tool.vertices
        y = np.cos(angle) * corners[:, 1] - np.sin(angle) * corners[:, 2] + placed.position[1]
        z = np.sin(angle) * corners[:, 1] + np.cos(angle) * corners[:, 2] + placed.position[2]
        nearest = np.abs(y).min()
        assert nearest == pytest.approx(0.5 * WIDTH + scenes.JAW_CLEARANCE)
        # The corners next to the ridge are lower ones.
        assert z[np.abs(y) < nearest + 1e-9].max() < placed.position[2]
        assert (side * y > 0.0).all()
        assert z.min() >= scene.organs[0].organ.foot_height - 1e-9
