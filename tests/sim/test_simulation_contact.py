"""What a thin tool does to a soft organ: no tunnelling, no energy from nothing, and forces that mean something."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from driving import Driver, half_thickness, press, start_above

from spatula_env import scenes
from spatula_env.contact import FlaggedDetector
from spatula_env.contact.path import RESIDUAL_TOLERANCE
from spatula_env.geometry import Tool, icosphere
from spatula_env.geometry.transforms import rotation_matrix
from spatula_env.sim import Simulation

# Scenes made for contact: organs smaller than a tool, surfaces too fine for springs.
pytestmark = pytest.mark.filterwarnings("ignore::spatula_env.sim.SceneWarning")

SPEEDS = [0.5, 5.0, 20.0, 40.0, 60.0, 250.0, 400.0]
"""From slow to so fast that one step would carry the tool right through what it presses [u/s]."""

DEPTH = 1.4
WEIGHT = 100.0
RESIDUAL = 0.03
"""One per cent of the organ's radius [u]."""


@pytest.fixture(scope="module")
def simulation():
    with_flags = Simulation(scenes.seed(), precision="double")
    yield with_flags
    with_flags.close()


@pytest.fixture(scope="module")
def presses(simulation):
    """Runs by speed, made when first asked for: press, hold for a while, and what the surface was like then."""

    @cache
    def run(speed):
        driver = press(simulation, DEPTH, speed, 0.25)
        return driver.record, simulation.tool_position, simulation.nodes

    return run


def depths_inside(simulation, position, nodes):
    """How deep each contact node is inside the organ, both faces: the second step alone, without memory."""
    tool = simulation.scene.tools[0].tool
    contacts = FlaggedDetector(tool, "off").detect(position, (0.0, 0.0, 0.0, 1.0), nodes, simulation.triangles)
    return contacts.depth


# Presses -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", SPEEDS)
def test_a_pressed_tool_is_never_inside(simulation, presses, speed):
    record, position, nodes = presses(speed)
    tool = simulation.scene.tools[0].tool
    flags = np.array(record.flags)
    assert not (flags & flags[:, tool.opposite]).any()
    # The lower face leads, and keeps the contact.
    assert not flags[:, tool.face == 1].any()
    assert flags[-1, tool.face == 0].sum() > 10
    assert max(record.residuals) < RESIDUAL
    # Seen by a detector that knows nothing of what was before: no node is deeper in the organ than the residual.
    assert depths_inside(simulation, position, nodes).max() < RESIDUAL
    # And the organ's top is pressed down, under the tool and not above it.
    under = (np.abs(nodes[:, :2]) < 0.4).all(axis=1) & (nodes[:, 2] > 3.0)
    assert under.any()
    assert (nodes[under, 2] < position[2] - half_thickness(simulation) + RESIDUAL).all()


@pytest.mark.parametrize("speed", SPEEDS)
def test_what_the_organ_gets_the_tool_gives(presses, speed):
    record, _, _ = presses(speed)
    assert np.abs(record.forces[-1]).max() > 1000.0
    assert max(record.given_and_taken) < 1e-9
    assert max(record.torque_errors) < 1e-9


@pytest.mark.parametrize("speed", SPEEDS)
def test_the_organs_momentum_changes_by_the_impulses_alone(presses, speed):
    # Gravity, ground and tool: displacements and springs give no momentum.
    record, _, _ = presses(speed)
    assert max(record.momentum_errors) < 1e-6


@pytest.mark.parametrize("speed", SPEEDS)
def test_a_press_gives_no_more_energy_than_work(presses, speed):
    record, _, _ = presses(speed)
    assert max(record.excess_energies) < 0.01 * record.work


@pytest.mark.parametrize("speed", [5.0, 200.0])
def test_the_force_of_a_held_press_is_steady(simulation, speed):
    driver = press(simulation, DEPTH, speed, 3.0)
    forces = np.array(driver.record.forces[-240:])[:, 2]
    assert forces.mean() > 1000.0
    assert forces.std() <= 0.05 * forces.mean()
    # However fast the tool came, it feels the same in the end.
    assert forces.mean() == pytest.approx(2800.0, rel=0.2)


def test_forces_on_the_contact_nodes_add_up(simulation):
    report = press(simulation, 0.8, 5.0, 0.1).step()
    tool, wrench = simulation.scene.tools[0].tool, report.wrenches[0]
    assert wrench.node_forces.shape == tool.nodes.shape
    np.testing.assert_allclose(wrench.node_forces.sum(axis=0), report.force, rtol=1e-9)
    # Each pushes on its face, not pulls; and only the lower face is touched.
    assert ((wrench.node_forces * tool.normals).sum(axis=1) <= 1e-9).all()
    assert not wrench.node_forces[tool.face == 1].any()


def test_deeper_means_harder(simulation):
    means = [np.mean(press(simulation, depth, 5.0, 0.5).record.forces[-60:], axis=0)[2] for depth in (0.3, 0.6, 1.2)]
    assert 0.0 < means[0] < means[1] < means[2]


@pytest.mark.parametrize("dt", [1.0 / 60.0, 1.0 / 480.0])
@pytest.mark.parametrize("speed", [5.0, 200.0])
def test_presses_at_other_time_steps(dt, speed):
    simulation = Simulation(scenes.seed(dt=dt), precision="double")
    driver = press(simulation, DEPTH, speed, 0.25)
    record, tool = driver.record, simulation.scene.tools[0].tool
    flags = np.array(record.flags)
    assert not (flags & flags[:, tool.opposite]).any()
    assert not flags[:, tool.face == 1].any()
    assert flags[-1].sum() > 10
    assert max(record.residuals) < RESIDUAL
    assert depths_inside(simulation, simulation.tool_position, simulation.nodes).max() < RESIDUAL
    assert max(record.given_and_taken) < 1e-9
    assert max(record.momentum_errors) < 1e-6
    simulation.close()


@pytest.mark.parametrize("tool_size", [(1.0, 1.0, 0.02), (0.3, 0.3, 0.125), (2.0, 0.5, 0.3)])
def test_presses_with_other_tools(tool_size):
    simulation = Simulation(scenes.seed(tool_size=tool_size), precision="double")
    driver = press(simulation, 0.8, 60.0, 0.1)
    tool = simulation.scene.tools[0].tool
    flags = np.array(driver.record.flags)
    assert flags[-1].any()
    assert not flags[:, tool.face == 1].any()
    assert max(driver.record.residuals) < RESIDUAL
    assert max(driver.record.excess_energies) < 0.01 * driver.record.work
    assert depths_inside(simulation, simulation.tool_position, simulation.nodes).max() < RESIDUAL
    simulation.close()


@pytest.mark.parametrize("speed", [5.0, 60.0])
def test_presses_with_nodes_on_all_faces(speed):
    simulation = Simulation(scenes.seed(faces="all"), precision="double")
    driver = press(simulation, 0.8, speed, 0.25)
    record, tool = driver.record, simulation.scene.tools[0].tool
    flags = np.array(record.flags)
    assert flags[-1, tool.face == 0].sum() > 10
    assert not flags[:, tool.face == 1].any()
    assert not (flags & flags[:, tool.opposite]).any()
    assert record.forces[-1][2] > 1000.0
    assert max(record.residuals) < RESIDUAL
    assert max(record.excess_energies) < 0.01 * record.work
    assert max(record.given_and_taken) < 1e-9
    assert max(record.torque_errors) < 1e-9
    simulation.close()


@pytest.mark.parametrize("speed", [2.0, 10.0])
def test_a_polyhedron_presses_with_all_its_faces(speed):
    # A wedge, its edge down: no face is perpendicular to the motion.
    wedge = Tool.convex([(x, y, z) for x in (-0.6, 0.6) for y, z in ((0.0, -0.4), (-0.4, 0.3), (0.4, 0.3))], 0.15)
    base = scenes.seed()
    scene = dataclasses.replace(base, tools=(scenes.PlacedTool(wedge, position=(0.0, 0.0, 7.0)),))
    simulation = Simulation(scene, precision="double")
    driver = Driver(simulation)
    driver.to_height(5.6, speed)
    driver.hold(0.25)
    record = driver.record
    assert max(record.excess_energies) < 0.01 * record.work
    assert np.mean(record.forces[-30:], axis=0)[2] > 100.0
    assert record.flags[-1].any()
    flags = np.array(record.flags)
    assert not (flags & flags[:, wedge.opposite]).any()
    assert max(record.given_and_taken) < 1e-9
    assert max(record.torque_errors) < 1e-9
    assert max(record.momentum_errors) < 1e-6
    simulation.close()


# Release -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.5, 2.0, 5.0, 10.0, 20.0, 40.0, 100.0])
def test_no_energy_is_gained_on_release(simulation, speed):
    # Kinetic energy and energy of height cannot exceed the work that the tool has done; the springs' energy, which
    # cannot be asked for, only makes the left side smaller than it is.
    driver = press(simulation, DEPTH, 5.0, 0.25)
    pressed = driver.record.work
    assert pressed > 1000.0
    driver.to_height(simulation.tool_position[2] + 2.5, speed)
    driver.hold(0.25)
    assert max(driver.record.excess_energies) < 0.01 * pressed
    assert np.isfinite(simulation.nodes).all()
    if speed <= 10.0:
        # The tool is free, and the organ round again. (A tool that is gone at once lets the organ jump.)
        assert not driver.step().contacts.flags.any()
        assert simulation.nodes[:, 2].max() < 7.0


@pytest.mark.parametrize("speed", [5.0, 60.0])
def test_going_up_and_down_again_and_again(simulation, speed):
    top = start_above(simulation)
    driver = Driver(simulation)
    tool = simulation.scene.tools[0].tool
    for _ in range(4):
        driver.to_height(top - 1.0, speed)
        driver.to_height(top + 0.2, speed)
    flags = np.array(driver.record.flags)
    assert not (flags & flags[:, tool.opposite]).any()
    assert max(driver.record.given_and_taken) < 1e-9
    assert max(driver.record.residuals) < RESIDUAL
    assert max(driver.record.excess_energies) < 0.01 * max(driver.record.work, 1000.0)


# Jumps -------------------------------------------------------------------------------------------------------------


def small_organ_scene():
    """A ball smaller than the plate that is to fly through it, weightless."""
    return scenes.Scene(
        organs=(scenes.PlacedOrgan(icosphere(0.3, 2), position=(0.01, 0.02, 0.0), mass=1.0),),
        tools=(scenes.PlacedTool(Tool.box(), position=(0.0, 0.0, 0.8)),),
        ground=None,
        gravity=0.0,
    )


@pytest.mark.parametrize("jump", [0.9, 1.6, 4.0])
def test_a_jump_clean_through_an_organ_is_seen(jump):
    # One step from well above the ball into its lower half, or to well beneath it, where a query sees nothing.
    scene = small_organ_scene()
    simulation = Simulation(scene, precision="double")
    tool = scene.tools[0].tool
    report = simulation.step((0.0, 0.0, -jump / simulation.dt))
    assert simulation.tool_position[2] == pytest.approx(0.8 - jump)
    # All of the ball is before the plate's lower face: none of it has been passed.
    # Its walls lie on each other there, and are kept apart in the same solve.
    assert simulation.nodes[:, 2].max() <= 0.8 - jump - 0.0625 + RESIDUAL_TOLERANCE
    assert not report.contacts.flags[tool.face == 1].any()
    assert report.force[2] > 0.0
    assert report.residual < 0.003
    if jump > 1.2:
        at_end = FlaggedDetector(tool).detect(
            (0.0, 0.0, 0.8 - jump),
            (0.0, 0.0, 0.0, 1.0),
            icosphere(0.3, 2).vertices,
            icosphere(0.3, 2).triangles,
            (0.0, 0.0, -1.0),
        )
        assert not at_end.flags.any()
    else:
        assert report.contacts.flags[tool.face == 0].any()
    simulation.close()


@pytest.mark.parametrize("speed", [5.0, 20.0, 384.0])
def test_a_ball_smaller_than_the_plate_is_taken_along(speed):
    simulation = Simulation(small_organ_scene(), precision="double")
    driver = Driver(simulation)
    driver.to_height(-0.8, speed)
    # The tool stops; the ball comes out of its dent on the side to which it was pushed.
    driver.hold(1.0)
    assert (simulation.node_masses @ simulation.nodes)[2] < simulation.tool_position[2]
    assert simulation.nodes[:, 2].max() < simulation.tool_position[2] - 0.0625 + 0.003
    simulation.close()


@pytest.mark.parametrize("angular", [(1.0, 0.0, 0.0), (0.3, -0.5, 2.0)])
def test_the_surface_in_contact_does_not_move_into_the_tool(simulation, angular):
    # Neither under a tool that sinks nor under one that turns: the velocities of surface and tool are compared.
    linear = (0.1, 0.2, -0.5)
    driver = press(simulation, 0.8, 5.0, 0.25)
    tool, triangles = simulation.scene.tools[0].tool, simulation.triangles
    for _ in range(30):
        report = driver.step(linear, angular)
        contacts, turned = report.contacts, rotation_matrix(simulation.tool_orientation)
        flagged = contacts.flags
        assert flagged.sum() > 8
        weights, corners = contacts.barycentric[flagged], triangles[contacts.triangle[flagged]]
        arms, outwards = tool.nodes[flagged] @ turned.T, tool.normals[flagged] @ turned.T
        velocities = np.einsum("nc,ncx->nx", weights, simulation.node_velocities[corners])
        points = np.einsum("nc,ncx->nx", weights, simulation.nodes[corners])
        approach = ((velocities - linear - np.cross(angular, arms)) * outwards).sum(axis=1)
        # Where a gap is left, it may be closed within a step.
        gap = ((points - simulation.tool_position - arms) * outwards).sum(axis=1)
        approach += np.maximum(gap, 0.0) / simulation.dt
        # Friction keeps the sweeps from converging to the last digit.
        assert approach.min() > -0.05


def test_a_jump_through_the_seeds_sphere_is_seen(simulation):
    # From the left of the sphere to its right, ten units in one step, the plate upright.
    simulation.reset()
    tool = simulation.scene.tools[0].tool
    upright = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
    simulation.place_tool((-5.0, 0.0, 3.0), upright)
    report = simulation.step((10.0 / simulation.dt, 0.0, 0.0))
    np.testing.assert_allclose(simulation.tool_position, [5.0, 0.0, 3.0], atol=1e-9)
    # Turned so, the face that is the top in the tool's frame looks along +x, and leads.
    assert report.contacts.flags[tool.face == 1].any()
    assert not report.contacts.flags[tool.face == 0].any()
    assert simulation.nodes[:, 0].max() > 5.0
    assert np.isfinite(simulation.nodes).all()


def test_a_spinning_tool_is_followed_too(simulation):
    # Half a turn a step about an axis in its plane: both faces sweep the organ's top.
    top = start_above(simulation)
    simulation.place_tool((0.0, 0.0, top + 0.1))
    driver = Driver(simulation)
    tool = simulation.scene.tools[0].tool
    for _ in range(10):
        driver.step(angular=(np.pi / simulation.dt, 0.0, 0.0))
    flags = np.array(driver.record.flags)
    assert not (flags & flags[:, tool.opposite]).any()
    assert np.isfinite(simulation.nodes).all()
    assert max(driver.record.given_and_taken) < 1e-9


# The organ's weight ------------------------------------------------------------------------------------------------


def carrying(size, nodes_per_edge, friction):
    """A simulation whose tool has lifted the organ off the ground from beneath, gently, and the driver."""
    tool = Tool.box(size, nodes_per_edge)
    base = scenes.seed()
    scene = dataclasses.replace(base, tools=(scenes.PlacedTool(tool, position=(0.0, 0.0, -2.0), friction=friction),))
    simulation = Simulation(scene, precision="double")
    centre = simulation.node_masses @ simulation.nodes / simulation.node_masses.sum()
    # The tool goes through the ground, which is the organ's alone.
    simulation.place_tool((centre[0], centre[1], -0.5 * size[2] - 0.01))
    driver = Driver(simulation)
    steps, lift = 480, 0.3
    for k in range(steps):
        speed = lift / (steps * simulation.dt) * (1.0 - np.cos(2.0 * np.pi * (k + 0.5) / steps))
        driver.step((0.0, 0.0, speed))
    return simulation, driver


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize(("size", "nodes_per_edge"), [((8.0, 8.0, 0.5), 17), ((1.0, 1.0, 0.125), 6)])
def test_a_tool_that_carries_the_organ_feels_its_weight(size, nodes_per_edge, friction):
    simulation, driver = carrying(size, nodes_per_edge, friction)
    tool, masses = simulation.scene.tools[0].tool, simulation.node_masses
    before = masses @ simulation.node_velocities
    forces, ground = [], []
    for _ in range(240):
        report = driver.step()
        forces.append(report.force)
        ground.append(report.ground_force)
        assert not report.contacts.flags[tool.face == 0].any()
    assert not np.any(ground)
    mean = np.mean(forces, axis=0)
    assert mean[2] == pytest.approx(-WEIGHT, rel=0.01)
    assert np.abs(mean[:2]).max() < 0.01 * WEIGHT
    # What is missing from the weight is the organ's own acceleration, to the last digits.
    gained = masses @ simulation.node_velocities - before
    np.testing.assert_allclose(mean + gained, [0.0, 0.0, -WEIGHT], atol=1e-4)
    assert max(driver.record.momentum_errors) < 1e-6
    assert max(driver.record.residuals) < RESIDUAL
    # The organ stands on the tool, clear of the ground.
    assert simulation.nodes[:, 2].min() > 0.05
    simulation.close()


def test_ground_and_tool_share_the_load(simulation):
    # Pressed from above, the ground carries the organ's weight and what the tool adds.
    driver = press(simulation, 0.8, 5.0, 1.0)
    ground, tool = [], []
    before = driver.masses @ simulation.node_velocities
    for _ in range(240):
        report = driver.step()
        ground.append(report.ground_force)
        tool.append(report.force)
    gained = driver.masses @ simulation.node_velocities - before
    balance = np.mean(ground, axis=0) - np.mean(tool, axis=0) - [0.0, 0.0, WEIGHT]
    np.testing.assert_allclose(balance, gained, atol=1e-4)


# The other contact models ------------------------------------------------------------------------------------------


def test_second_step_alone_lets_both_faces_push():
    simulation = Simulation(scenes.seed(), contact="second_step", precision="double")
    driver = press(simulation, DEPTH, 20.0, 0.5)
    tool = simulation.scene.tools[0].tool
    flags = np.array(driver.record.flags)
    assert (flags & flags[:, tool.opposite]).any(axis=1).sum() > 30
    # The press has failed: nothing of the force is left, or it is shaken to pieces.
    forces = np.array(driver.record.forces[-60:])[:, 2]
    assert forces.mean() < 500.0 or forces.std() > 0.5 * forces.mean()
    simulation.close()


@pytest.mark.bullet
def test_bullets_own_contact_ends_inside():
    simulation = Simulation(scenes.seed(), contact="bullet")
    top = start_above(simulation)
    target = top - DEPTH + half_thickness(simulation)
    while simulation.tool_position[2] > target + 1e-9:
        way = simulation.tool_position[2] - target
        report = simulation.step((0.0, 0.0, -min(20.0, way / simulation.dt)))
    for _ in range(240):
        report = simulation.step()
    # The detector watches, and sees the tool deep in the organ.
    assert report.penetration > 0.5
    assert report.residual > 0.5
    assert depths_inside(simulation, simulation.tool_position, simulation.nodes).max() > 0.5
    assert simulation.nodes[:, 2].max() > simulation.tool_position[2] + 0.5
    # Bullet tells no nodal impulses.
    assert np.isnan(report.nodal_impulses).all()
    assert np.isfinite(report.force).all()
    simulation.close()


@pytest.mark.bullet
def test_bullets_own_contact_feels_a_slow_touch():
    # So that the test above does not pass because there is no contact at all.
    simulation = Simulation(scenes.seed(), contact="bullet")
    start_above(simulation)
    peak = 0.0
    for _ in range(480):
        peak = max(peak, simulation.step((0.0, 0.0, -0.25)).force[2])
    assert peak > 10.0
    simulation.close()


def test_first_step_can_be_chosen():
    simulation = Simulation(scenes.seed(), first_step="any_hit", precision="double")
    driver = press(simulation, 1.0, 60.0, 0.1)
    tool = simulation.scene.tools[0].tool
    flags = np.array(driver.record.flags)
    assert not (flags & flags[:, tool.opposite]).any()
    assert flags[-1, tool.face == 0].any()
    assert max(driver.record.residuals) < RESIDUAL
    simulation.close()
