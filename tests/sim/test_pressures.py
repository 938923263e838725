"""Contact pressures in a report: what they add up to, where they are, and in which units."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from driving import Driver, press, start_above

from spatula_env import scenes
from spatula_env.geometry import Tool, box_surface
from spatula_env.geometry.transforms import quaternion_from_axis_angle, rotation_matrix
from spatula_env.sim import Simulation


@pytest.fixture(scope="module")
def simulation():
    made = Simulation(scenes.seed(faces="all"))
    yield made
    made.close()


@pytest.fixture(scope="module")
def pressed(simulation):
    """Reports of a press, a drag and a turn, with the tool's orientation at each."""
    driver = press(simulation, 1.0, 5.0, 0.1)
    motions = [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((3.0, -1.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (2.0, 1.0, 4.0)),
    ]
    found = []
    for linear, angular in motions:
        for _ in range(20):
            found.append((driver.step(linear, angular), rotation_matrix(simulation.tool_orientation)))
    return found


def test_forces_on_the_nodes_add_up_to_the_tools_force(pressed):
    for report, _ in pressed:
        wrench = report.wrenches[0]
        assert np.linalg.norm(wrench.force) > 100.0
        np.testing.assert_allclose(
            wrench.node_forces.sum(axis=0), wrench.force, atol=1e-9 * np.linalg.norm(wrench.force)
        )
        np.testing.assert_array_equal(wrench.force, report.force)
        np.testing.assert_array_equal(wrench.torque, report.torque)


def test_a_nodes_pressure_is_the_force_against_its_face_over_its_area(simulation, pressed):
    tool = simulation.scene.tools[0].tool
    for report, turned in pressed:
        wrench = report.wrenches[0]
        against = -(wrench.node_forces * (tool.normals @ turned.T)).sum(axis=1)
        np.testing.assert_allclose(wrench.pressures * tool.areas, np.maximum(against, 0.0), atol=1e-9)


def test_the_peak_is_on_a_node_in_contact(simulation, pressed):
    tool = simulation.scene.tools[0].tool
    for report, _ in pressed:
        pressures = report.wrenches[0].pressures
        face = tool.face == tool.face[np.argmax(pressures)]
        # A face may be pressed between its nodes: then its nearest nodes stand for it.
        assert report.contacts.flags[np.argmax(pressures)] or not report.contacts.flags[face].any()
        assert report.peak_pressure_pascals == pytest.approx(pressures.max() * simulation.scene.scale.pressure)
        np.testing.assert_allclose(report.pressures_pascals, pressures * simulation.scene.scale.pressure)
    # A press that is held has its peak on the lower face, by nodes in contact.
    assert all(report.contacts.flags[np.argmax(report.wrenches[0].pressures)] for report, _ in pressed[:20])


def test_pascals_are_newtons_over_square_metres(simulation, pressed):
    report, _ = pressed[0]
    # All of it on one node would be this pressure; it is on many.
    square_metre = simulation.scene.scale.length**2
    tool = simulation.scene.tools[0].tool
    total = (report.pressures_pascals * tool.areas * square_metre)[tool.face == 0].sum()
    assert total == pytest.approx(report.force_newtons[2], rel=0.01)
    assert report.peak_pressure_pascals > total / square_metre


@pytest.mark.parametrize("scale", [scenes.Scale(0.02, 1.0), scenes.Scale(0.01, 3.0)])
def test_the_scale_decides_the_pascals(scale):
    simulation = Simulation(dataclasses.replace(scenes.seed(), scale=scale))
    report = press(simulation, 0.5, 5.0, 0.05).step()
    expected = report.wrenches[0].pressures.max() * scale.mass / scale.length
    assert report.peak_pressure_pascals == pytest.approx(expected)
    assert expected > 0.0
    simulation.close()


def test_in_the_air_there_is_no_pressure(simulation):
    start_above(simulation)
    report = simulation.step()
    assert not report.wrenches[0].pressures.any()
    assert not report.wrenches[0].node_forces.any()
    assert report.peak_pressure_pascals == 0.0


def test_pressures_all_at_once_are_those_of_the_report(simulation):
    tool = simulation.scene.tools[0].tool
    driver, touched = press(simulation, 0.8, 5.0, 0.05), 0
    for motion in ((0.0, 0.0, 0.0), (2.0, 1.0, 0.0), (0.0, 0.0, 8.0)):
        for _ in range(30):
            report = driver.step(motion)
            found, on_nodes = simulation.pressures(), report.wrenches[0].pressures
            np.testing.assert_allclose(found.nodes[0], on_nodes, rtol=1e-9, atol=1e-9)
            assert found.peak == pytest.approx(on_nodes.max(), rel=1e-9, abs=1e-9)
            forces, areas = (np.bincount(tool.face, values) for values in (on_nodes * tool.areas, tool.areas))
            np.testing.assert_allclose(found.faces, forces / areas, rtol=1e-9, atol=1e-9)
            touched += found.peak > 0.0
    # The last motion took the tool off the organ.
    assert 60 <= touched < 90 and found.peak == 0.0


def test_pressures_are_those_of_a_step(simulation):
    simulation.reset()
    with pytest.raises(RuntimeError, match="before the first step"):
        simulation.pressures()
    simulation.step()
    assert simulation.pressures().peak == 0.0
    simulation.restore(simulation.save())
    with pytest.raises(RuntimeError, match="before the first step"):
        simulation.pressures()


@pytest.mark.bullet
def test_bullets_own_contact_tells_no_pressures():
    simulation = Simulation(scenes.seed(), contact="bullet")
    start_above(simulation)
    for _ in range(120):
        report = simulation.step((0.0, 0.0, -1.0))
    wrench = report.wrenches[0]
    assert np.isfinite(wrench.force).all()
    assert np.isnan(wrench.node_forces).all()
    assert np.isnan(wrench.pressures).all()
    assert np.isnan(report.peak_pressure_pascals)
    assert simulation.pressures().peak == 0.0 and not simulation.pressures().nodes[0].any()
    simulation.close()


def block_and_plate(orientation):
    """A flat block, its bottom held, and a plate wholly above its top; weightless, and turned as asked."""
    block = box_surface((2.4, 2.4, 1.0), 0.2)
    turned = rotation_matrix(orientation)
    return scenes.Scene(
        organs=(
            scenes.PlacedOrgan(
                block,
                mass=10.0,
                orientation=tuple(orientation),
                fixed_nodes=tuple(np.flatnonzero(block.vertices[:, 2] < 0.0)),
            ),
        ),
        tools=(
            scenes.PlacedTool(Tool.box((1.0, 0.8, 0.1), 5), tuple(turned @ [0.0, 0.0, 0.551]), tuple(orientation), 0.0),
        ),
        ground=None,
        gravity=0.0,
    )


@pytest.mark.parametrize("angle", [0.0, 2.0])
def test_a_flat_press_has_the_mean_pressure_of_force_over_area(angle):
    orientation = quaternion_from_axis_angle((1.0, 2.0, 0.5), angle)
    scene = block_and_plate(orientation)
    simulation, tool = Simulation(scene), scene.tools[0].tool
    down = rotation_matrix(orientation) @ [0.0, 0.0, -1.0]
    for _ in range(48):
        report = simulation.step(0.3 * down)
    for _ in range(48):
        report = simulation.step()
    lower = tool.face == 0
    # The lower face, to its corners, and nothing of the upper one. In between the hollow surface bulges away.
    corners = lower & (np.abs(tool.nodes[:, :2]) > [0.49, 0.39]).all(axis=1)
    assert report.contacts.flags[corners].all()
    assert not report.contacts.flags[~lower].any()
    pressures = report.wrenches[0].pressures
    assert not pressures[~lower].any()
    force = -down @ report.force
    assert force > 10.0
    assert np.average(pressures[lower], weights=tool.areas[lower]) == pytest.approx(force / 0.8, rel=1e-6)
    # What presses the rim is the surface that it is bent around; in the middle it is less.
    assert force / 0.8 < pressures.max() < 20.0 * force / 0.8
    assert report.peak_pressure_pascals == pytest.approx(pressures.max() * scene.scale.pressure)
    simulation.close()


def test_deeper_is_more_pressure(simulation):
    top = start_above(simulation)
    driver, peaks = Driver(simulation), []
    for depth in (0.1, 0.4, 1.0):
        driver.to_height(top - depth + 0.0625, 2.0)
        driver.hold(0.1)
        peaks.append(np.mean([driver.step().peak_pressure_pascals for _ in range(12)]))
    assert all(second > first for first, second in pairwise(peaks))
    # In the order of a hundred pascals to some kilopascals: what soft tissue bears.
    assert 10.0 < peaks[0]
    assert peaks[-1] < 1e5
