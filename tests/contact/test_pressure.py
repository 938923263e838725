"""How pushes at single points are spread over the contact nodes of a tool."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from loose import DT, LooseOrgans
from reference_detector import random_rotation, rotation_matrix

from spatula_env.contact.pressure import LEAST_PART, spread_forces
from spatula_env.geometry import Tool, box_surface

seeds = st.integers(0, 2**32 - 1)
PLATE = Tool.box((1.0, 0.8, 0.1), 5, "all")
BOTTOM, TOP = 0, 1
STEP = 0.01


def spread(pushes, *, tool=0, flags=None, reach=0.4, position=(0.0, 0.0, 0.0), turned=None, shape=PLATE):
    """Forces on the nodes from pushes, each a point, an impulse on the organ, an owner and a face."""
    table = np.array([[*point, *impulse, owner, plane] for point, impulse, owner, plane in pushes]).reshape(-1, 8)
    forces = np.full(shape.nodes.shape, np.nan)
    spread_forces(
        table,
        tool,
        np.array(position, dtype=np.float64),
        (np.eye(3) if turned is None else turned).ravel(),
        np.array(shape.nodes),
        np.array(shape.face),
        np.array(shape.areas),
        np.ones(len(shape.nodes), dtype=np.bool_) if flags is None else flags,
        reach,
        STEP,
        forces,
    )
    return forces


def on(face, x=0.0, y=0.0):
    """A point on the plate's bottom or top."""
    return (x, y, 0.05 if face == TOP else -0.05)


def test_in_the_air_there_are_no_forces():
    assert not spread([]).any()
    # Nor from contacts that do not push, nor from another tool's.
    assert not spread([(on(BOTTOM), (0.0, 0.0, 0.0), 0, BOTTOM), (on(BOTTOM), (0.0, 0.0, -1.0), 1, BOTTOM)]).any()


@given(seeds)
def test_whatever_pushes_the_nodes_get_all_of_it(seed):
    generator = np.random.default_rng(seed)
    turned, position = rotation_matrix(random_rotation(generator)), generator.normal(size=3)
    pushes = []
    for _ in range(generator.integers(1, 12)):
        point = turned @ (generator.uniform(-0.6, 0.6, size=3)) + position
        pushes.append((point, generator.normal(size=3), generator.integers(-1, 3), generator.integers(0, 6)))
    flags = generator.uniform(size=len(PLATE.nodes)) < generator.uniform()
    for tool in range(3):
        forces = spread(
            pushes, tool=tool, flags=flags, reach=generator.uniform(0.01, 2.0), position=position, turned=turned
        )
        expected = -sum((impulse for _, impulse, owner, _ in pushes if owner == tool), np.zeros(3)) / STEP
        np.testing.assert_allclose(forces.sum(axis=0), expected, atol=1e-9)


@pytest.mark.parametrize("face", range(6))
def test_only_nodes_of_the_face_that_is_pushed(face):
    # On the rim of that face, where nodes of other faces are as near.
    place = PLATE.nodes[PLATE.face == face].max(axis=0)
    forces = spread([(place, PLATE.face_normals[face], 0, face)], reach=0.6)
    assert forces[PLATE.face == face].any()
    assert not forces[PLATE.face != face].any()
    # They all push against the face.
    assert (forces[PLATE.face == face] @ PLATE.face_normals[face] <= 0.0).all()


def test_nodes_in_contact_come_first():
    flags = (PLATE.face == BOTTOM) & (PLATE.nodes[:, 0] > 0.2)
    forces = spread([(on(BOTTOM, 0.1), (0.0, 0.0, -1.0), 0, BOTTOM)], flags=flags)
    assert forces[flags].any()
    assert not forces[~flags].any()
    # Without any of them on this face, the face's other nodes; those of another face count for nothing.
    flags = PLATE.face == TOP
    forces = spread([(on(BOTTOM, 0.1), (0.0, 0.0, -1.0), 0, BOTTOM)], flags=flags)
    assert forces[PLATE.face == BOTTOM].any()
    assert not forces[PLATE.face != BOTTOM].any()


@pytest.mark.parametrize("nodes_per_edge", [5, 11, 41])
def test_too_few_nodes_in_contact_do_not_get_all_of_it(nodes_per_edge):
    """Pressure does not depend on how densely a face is covered with nodes, if one of them is in contact."""
    shape, reach = Tool.box((1.0, 0.8, 0.1), nodes_per_edge), 0.4
    for x, y in ((0.0, 0.0), (0.47, 0.37)):
        push = [(on(BOTTOM, x, y), (0.0, 0.0, -1.0), 0, BOTTOM)]
        evenly = spread(push, shape=shape, reach=reach)[:, 2] / shape.areas
        only = np.zeros(len(shape.nodes), dtype=np.bool_)
        only[np.argmin(np.linalg.norm(shape.nodes - on(BOTTOM, x, y), axis=1))] = True
        forces = spread(push, shape=shape, reach=reach, flags=only)
        assert forces[only].any()
        assert forces[:, 2].sum() == pytest.approx(1.0 / STEP)
        assert (forces[:, 2] / shape.areas).max() <= (1.0 + 1e-9) / LEAST_PART * evenly.max()


def test_a_push_stays_where_it_is_though_nodes_elsewhere_are_in_contact():
    flags = (PLATE.face == BOTTOM) & (PLATE.nodes[:, 0] < -0.4)
    forces = spread([(on(BOTTOM, 0.4, 0.1), (0.0, 0.0, -1.0), 0, BOTTOM)], flags=flags)
    away = np.linalg.norm(PLATE.nodes - on(BOTTOM, 0.4, 0.1), axis=1)
    assert forces.any()
    assert not forces[away >= 0.4].any()


def test_a_face_without_nodes_hands_on_to_the_nearest_ones():
    # A side face of a tool with nodes on its largest faces only.
    shape = Tool.box((1.0, 0.8, 0.1), 5)
    forces = spread([((0.5, 0.0, 0.04), (-1.0, 0.0, 0.0), 0, 3)], shape=shape, reach=0.3)
    pushed = np.abs(forces).max(axis=1) > 0.0
    assert pushed.any()
    assert (shape.nodes[pushed, 0] > 0.15).all()
    assert {BOTTOM, TOP} == set(shape.face[pushed].tolist())


def test_nothing_in_reach_the_nearest_node_gets_all():
    forces = spread([(on(BOTTOM, 0.1, 0.02), (0.0, 0.0, -3.0), 0, BOTTOM)], reach=0.01)
    nearest = np.argmin(np.linalg.norm(PLATE.nodes - on(BOTTOM, 0.1, 0.02), axis=1))
    np.testing.assert_allclose(forces[nearest], [0.0, 0.0, 300.0])
    assert np.count_nonzero(forces) == 1


def test_the_nearer_the_more_and_nothing_beyond_reach():
    forces = spread([(on(BOTTOM), (0.0, 0.0, -1.0), 0, BOTTOM)], reach=0.45)
    away = np.linalg.norm(PLATE.nodes - on(BOTTOM), axis=1)
    bottom = PLATE.face == BOTTOM
    assert not forces[bottom & (away >= 0.45)].any()
    # By a node's share of the face, so as pressures, they fall off with the distance.
    pressures = forces[bottom, 2] / PLATE.areas[bottom]
    order = np.argsort(away[bottom].round(9), kind="stable")
    assert (np.diff(pressures[order]) <= 1e-9 * pressures.max()).all()
    assert pressures[order][0] > 2.0 * pressures[order][5]
    # Those at the same distance are pressed alike.
    np.testing.assert_allclose(forces[bottom, 2].reshape(5, 5), forces[bottom, 2].reshape(5, 5)[::-1, ::-1])


def test_turning_and_moving_everything_turns_the_forces():
    generator = np.random.default_rng(3)
    turned, position = rotation_matrix(random_rotation(generator)), generator.normal(size=3)
    pushes = [
        (on(BOTTOM, *generator.uniform(-0.4, 0.4, size=2)), generator.normal(size=3), 0, BOTTOM) for _ in range(5)
    ]
    moved = [(turned @ point + position, turned @ impulse, owner, face) for point, impulse, owner, face in pushes]
    expected = spread(pushes) @ turned.T
    np.testing.assert_allclose(spread(moved, position=position, turned=turned), expected, atol=1e-9)


def test_pushes_add_up():
    first, second = (((on(BOTTOM, x, 0.1), (0.1, 0.0, -1.0), 0, BOTTOM)) for x in (-0.2, 0.3))
    np.testing.assert_allclose(spread([first, second]), spread([first]) + spread([second]), atol=1e-12)


def test_a_plate_on_a_flat_surface_is_pressed_evenly():
    # A surface of loose nodes, finer than the plate's lattice, all of equal mass: it meets the plate everywhere alike.
    organ = box_surface((3.0, 3.0, 0.5), 0.1)
    loose = LooseOrgans([organ], [(PLATE, (0.013, 0.021, 0.25 + 0.05 + 0.001), (0.0, 0.0, 0.0, 1.0))])
    loose.step((0.0, 0.0, -0.01 / DT))
    flags = loose.detectors[0][0].flags
    np.testing.assert_array_equal(flags, PLATE.face == BOTTOM)
    forces = np.empty(PLATE.nodes.shape)
    spread_forces(
        loose.contact_table(), 0, loose.positions[0], np.eye(3).ravel(), np.array(PLATE.nodes),
        np.array(PLATE.face), np.array(PLATE.areas), flags, 0.25, DT, forces,
    )  # fmt: skip
    np.testing.assert_allclose(forces.sum(axis=0), loose.wrenches[0, :3], rtol=1e-9)
    assert not forces[PLATE.face != BOTTOM].any()
    pressures = forces[flags, 2] / PLATE.areas[flags]
    mean = loose.wrenches[0, 2] / 0.8
    assert np.average(pressures, weights=PLATE.areas[flags]) == pytest.approx(mean)
    inner = (np.abs(PLATE.nodes[flags, :2]) < [0.49, 0.39]).all(axis=1)
    np.testing.assert_allclose(pressures[inner], mean, rtol=0.5)
