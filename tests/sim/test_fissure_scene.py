"""A thin spatula enters a fissure on edge, and pushes one wall aside and then the other."""

from __future__ import annotations

import numpy as np
import pytest

from spatula_env import Simulation, scenes

SPEED = 0.5
"""Of the spatula sideways [u/s]."""

SIDEWAYS = 0.4
"""How far the spatula moves sideways: 0.305 u of it with the wall [u]."""

ABOVE_FLOOR = 0.25
"""Of the spatula's lower edge, when it is in the fissure [u]."""


@pytest.fixture(scope="module")
def simulation():
    simulation = Simulation(scenes.fissure())
    yield simulation
    simulation.close()


@pytest.fixture(scope="module")
def block(simulation):
    return simulation.scene.organs[0].organ


@pytest.fixture(scope="module")
def inside(simulation, block):
    """The state after the spatula was lowered into the fissure, and the greatest force on the way."""
    simulation.reset()
    height = block.floor_height + ABOVE_FLOOR + 1.0
    largest, flagged = 0.0, 0
    while simulation.tool_position[2] > height + 1e-9:
        way = simulation.tool_position[2] - height
        report = simulation.step((0.0, 0.0, -min(2.0, way / simulation.dt)))
        largest = max(largest, np.abs(report.force).max())
        flagged += report.contacts.flags.sum()
    return simulation.save(), largest, flagged


def push(simulation, side, distance=SIDEWAYS):
    """Move the spatula sideways and hold it for a while; the reports."""
    steps = round(distance / (SPEED * simulation.dt))
    reports = [simulation.step((0.0, side * SPEED, 0.0)) for _ in range(steps)]
    return reports + [simulation.step() for _ in range(24)]


def near_spatula(simulation, block):
    """The nodes of the walls beside the spatula."""
    rest = simulation.scene.organs[0].vertices
    return [wall[np.abs(rest[wall, 0]) < 0.5] for wall in block.walls]


def test_the_organ_is_at_rest(simulation, block):
    simulation.reset()
    nodes = simulation.nodes
    # It settles into nearly the shape it was made in, and stays there.
    assert np.abs(nodes - block.vertices).max() < 0.03
    for _ in range(round(0.2 / simulation.dt)):
        report = simulation.step()
    assert np.abs(simulation.nodes - nodes).max() < 1e-3
    assert np.abs(simulation.node_velocities).max() < 1e-2
    assert (report.force == 0.0).all()


def test_base_and_floor_are_held(simulation, block, inside):
    simulation.restore(inside[0])
    push(simulation, 1.0)
    for held in (block.base, block.floor):
        np.testing.assert_allclose(simulation.nodes[held], block.vertices[held], atol=1e-6)


def test_the_spatula_enters_without_touching(simulation, inside):
    state, force, flagged = inside
    assert force == 0.0
    assert flagged == 0
    # Well inside: the lower edge is more than a unit below the top.
    assert state.tool_positions[0, 2] - 1.0 < 3.0 - 1.0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_wall_is_pushed_aside(simulation, block, inside, side):
    simulation.restore(inside[0])
    before = simulation.nodes
    reports = push(simulation, side)
    moved = simulation.nodes - before
    pushed, other = near_spatula(simulation, block)[:: -1 if side > 0.0 else 1]
    free = SIDEWAYS - (0.125 - 0.03)
    assert side * moved[pushed, 1].mean() == pytest.approx(free, abs=0.05)
    assert np.abs(moved[other]).mean() < 0.1
    # The fissure is open by that much more.
    assert side * (moved[pushed, 1].mean() - moved[other, 1].mean()) > 0.25

    force = reports[-1].force
    assert side * force[1] < -100.0
    assert abs(force[0]) < 0.05 * abs(force[1])
    assert abs(force[2]) < 0.3 * abs(force[1])
    assert all(side * report.force[1] <= 1e-9 for report in reports)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_pushing_face_is_in_contact_and_the_trailing_one_is_not(simulation, block, inside, side):
    # Rays from the trailing face find the wall behind, and outward rays from the pushing face the far side of the
    # organ: neither must count as a contact, or turn one down.
    simulation.restore(inside[0])
    tool = simulation.scene.tools[0].tool
    # The blade stands on edge: its frame's z axis is along negative y.
    pushing, trailing = tool.normals[:, 2] == -side, tool.normals[:, 2] == side
    rest = block.vertices[block.triangles].mean(axis=1)
    counts = []
    for report in push(simulation, side):
        contacts = report.contacts
        # Where the wall bends around the blade's rim, one or two nodes of its narrow sides may touch too.
        assert not trailing[contacts.flags].any()
        assert (~pushing[contacts.flags]).sum() <= 3
        assert (side * rest[contacts.triangle[contacts.flags], 1] > 0.0).all()
        counts.append((pushing & contacts.flags).sum())
    # Once the wall is reached contact is never lost, and a good part of the face has it in the end.
    first = np.argmax(np.array(counts) > 0)
    assert first * simulation.dt * SPEED == pytest.approx(0.0625, abs=0.03)
    assert min(counts[first:]) > 0
    assert counts[-1] >= 15


def test_one_wall_and_then_the_other(simulation, block, inside):
    simulation.restore(inside[0])
    before = simulation.nodes
    walls = near_spatula(simulation, block)
    first = push(simulation, 1.0)[-1]
    assert first.force[1] < -100.0
    # Back to the middle: no contact left, and the wall has come back.
    middle = push(simulation, -1.0)[-1]
    assert abs(middle.force[1]) < 0.01 * abs(first.force[1])
    assert np.abs(simulation.nodes - before)[walls[1]].max() < 0.05
    second = push(simulation, -1.0)[-1]
    assert second.force[1] == pytest.approx(-first.force[1], rel=0.25)
    assert (simulation.nodes - before)[walls[0], 1].mean() < -0.25
    tool = simulation.scene.tools[0].tool
    normals = tool.normals[second.contacts.flags]
    assert (normals[:, 2] >= 0.0).all()
    assert normals[:, 2].mean() > 0.9


def test_what_the_organ_gets_the_spatula_gives(simulation, inside):
    simulation.restore(inside[0])
    for report in push(simulation, 1.0):
        given = report.nodal_impulses.sum(axis=0)
        np.testing.assert_allclose(given, -report.force * simulation.dt, atol=1e-9 + 1e-9 * np.abs(given).max())


def test_forces_are_those_of_soft_tissue(simulation, inside):
    # Moved aside by 6 mm, by a blade 20 mm wide.
    simulation.restore(inside[0])
    newtons = np.abs(push(simulation, 1.0)[-1].force_newtons).max()
    assert newtons == pytest.approx(0.28, rel=0.15)


def test_a_floor_that_is_not_held_follows_the_wall(block):
    simulation = Simulation(scenes.fissure(fixed_floor=False))
    height = block.floor_height + ABOVE_FLOOR + 1.0
    simulation.place_tool((0.0, 0.0, height), scenes.ON_EDGE)
    before = simulation.nodes
    force = push(simulation, 1.0)[-1].force
    moved = simulation.nodes - before
    simulation.close()
    assert force[1] < -50.0
    assert moved[block.floor, 1].mean() > 0.2


def test_the_spatula_on_the_held_floor(simulation, block):
    # The floor's triangles have nodes that are held and nodes that are not: a contact close to a held one must not move
    # the others by its depth over their small weights.
    simulation.reset()
    simulation.place_tool((0.0, 0.0, block.floor_height + 0.15 + 1.0), scenes.ON_EDGE)
    before = simulation.nodes
    for _ in range(60):
        report = simulation.step((0.0, 0.0, -1.0))
        assert np.abs(simulation.nodes - before).max() < 1.0
        assert np.isfinite(report.force).all()
        # The floor gives way as little as its held nodes let it; a throw would be hundreds of newtons.
        assert np.abs(report.force_newtons).max() < 13.5
