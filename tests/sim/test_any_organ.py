"""Organs of many sizes and shapes, several at once, and between several tools."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from benchmarks.inspection import Inspector
from spatula_env import scenes
from spatula_env.geometry import Tool, box_surface, icosphere, seed_sphere, torus
from spatula_env.geometry.transforms import quaternion_from_axis_angle, rotation_matrix
from spatula_env.sim import Simulation

# Scenes made for contact: organs smaller than a tool, surfaces too fine for springs.
pytestmark = pytest.mark.filterwarnings("ignore::spatula_env.sim.SceneWarning")

PLATE = Tool.box((0.8, 0.8, 0.1), faces="all")
SIDEWAYS = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
"""The plate's thickness along x: its bottom looks along -x, its top along +x."""


def weightless(organs, tools, **others):
    """A scene in which nothing holds or pulls the organs: (shape, place, mass) each; tools: (tool, place, turn)."""
    return scenes.Scene(
        organs=tuple(scenes.PlacedOrgan(organ, position=place, mass=mass) for organ, place, mass in organs),
        tools=tuple(scenes.PlacedTool(tool, position=place, orientation=turn) for tool, place, turn in tools),
        ground=None,
        gravity=0.0,
        **others,
    )


class Watch:
    """Inspects every tool and every organ after each step, independently of the contact model."""

    def __init__(self, simulation):
        self.simulation, self.deepest, self.wrong = simulation, 0.0, 0
        starts = np.cumsum([0, *(len(placed.organ.vertices) for placed in simulation.scene.organs)])
        self.parts = [slice(*pair) for pair in pairwise(starts)]
        self.inspectors = [
            [Inspector(placed.tool, organ.organ.triangles) for organ in simulation.scene.organs]
            for placed in simulation.scene.tools
        ]

    def step(self, *motion):
        simulation = self.simulation
        before = simulation.node_masses @ simulation.node_velocities
        report = simulation.step(*motion)
        nodes = simulation.nodes
        for index, row in enumerate(self.inspectors):
            for part, inspector in zip(self.parts, row, strict=True):
                seen = inspector.inspect(
                    simulation.tool_positions[index], simulation.tool_orientations[index], nodes[part]
                )
                self.deepest, self.wrong = max(self.deepest, seen.residual), self.wrong + seen.wrong_side
        # What the organs get, the tools give; and nothing else changes the organs' momentum.
        impulses, dt = report.nodal_impulses, simulation.dt
        forces = sum(wrench.force for wrench in report.wrenches)
        np.testing.assert_allclose(impulses.sum(axis=0), -forces * dt, atol=1e-9 * (1.0 + np.abs(impulses).sum()))
        weight = [0.0, 0.0, -simulation.scene.gravity * simulation.node_masses.sum()]
        gained = simulation.node_masses @ simulation.node_velocities - before
        np.testing.assert_allclose(
            gained, (report.ground_force + weight - forces) * dt, atol=1e-6 * (1.0 + np.abs(impulses).sum())
        )
        return report


# One organ ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("organ", "speed"),
    [
        (icosphere(3.0, 2), 5.0),
        (icosphere(3.0, 2), 100.0),
        (seed_sphere(3.0, 700), 20.0),
        (icosphere(3.0, 3), 60.0),
        (box_surface((4.0, 4.0, 2.0), 0.5), 20.0),
        (icosphere(3.0, 4), 10.0),
    ],
    ids=lambda value: f"{len(value.triangles)} triangles" if hasattr(value, "triangles") else None,
)
def test_organs_from_coarse_to_fine(organ, speed):
    height = organ.vertices[:, 2].max()
    simulation = Simulation(
        weightless([(organ, (0.0, 0.0, 0.0), 10.0)], [(PLATE, (0.1, 0.05, height + 0.1), (0, 0, 0, 1))]),
        precision="double",
    )
    watch, peak = Watch(simulation), 0.0
    steps = int(np.ceil(0.5 / (speed * simulation.dt)))
    for _ in range(steps):
        report = watch.step((0.0, 0.0, -0.5 / steps / simulation.dt))
        peak = max(peak, report.force[2])
        assert report.residual <= 0.03
    for _ in range(6):
        watch.step()
    assert watch.deepest <= 0.03
    assert watch.wrong == 0
    assert peak > 100.0
    # The organ has its shape yet, but for the dent: no node was thrown.
    assert np.linalg.norm(simulation.nodes - simulation.nodes.mean(axis=0), axis=1).max() < 3.5
    simulation.close()


@pytest.fixture(scope="module")
def ring():
    """A ring with its axis upwards, and a stick in its hole."""
    stick = Tool.box((0.4, 0.4, 1.6), node_spacing=0.2, faces="all")
    scene = weightless([(torus(2.0, 0.6, 32, 16), (0.0, 0.0, 0.0), 10.0)], [(stick, (0.0, 0.0, 0.0), (0, 0, 0, 1))])
    simulation = Simulation(scene, precision="double")
    yield simulation
    simulation.close()


@pytest.mark.parametrize("direction", [0.0, 0.7, 2.5])
@pytest.mark.parametrize("speed", [4.0, 40.0])
def test_a_stick_in_a_ring_meets_its_inner_side(ring, direction, speed):
    ring.reset()
    watch = Watch(ring)
    for _ in range(3):
        assert not watch.step().contacts.flags.any()
    # The hole is 2.8 u wide.
    way = np.array([np.cos(direction), np.sin(direction), 0.0])
    steps = int(np.ceil(1.5 / (speed * ring.dt)))
    peak = 0.0
    for _ in range(steps):
        report = watch.step(1.5 / steps / ring.dt * way)
        peak = max(peak, -float(report.force @ way))
    assert watch.deepest <= 0.03
    assert watch.wrong == 0
    assert peak > 50.0
    # The ring is pushed along, and is still around the stick.
    assert ring.node_masses @ ring.nodes @ way > 0.0
    far = (ring.nodes - ring.tool_position) @ way
    assert far.max() > 0.3
    assert far.min() < -0.3


@pytest.mark.parametrize("speed", [5.0, 80.0])
def test_a_plate_pressed_onto_a_ring_from_above(ring, speed):
    scene = weightless(
        [(torus(2.0, 0.6, 32, 16), (0.0, 0.0, 0.0), 10.0)],
        [(Tool.box((5.6, 0.6, 0.1), node_spacing=0.3), (0.0, 0.0, 0.75), (0, 0, 0, 1))],
    )
    simulation = Simulation(scene, precision="double")
    watch = Watch(simulation)
    steps = int(np.ceil(0.4 / (speed * simulation.dt)))
    for _ in range(steps):
        report = watch.step((0.0, 0.0, -0.4 / steps / simulation.dt))
    for _ in range(4):
        report = watch.step()
    # On both sides of the hole, and not above it.
    touched = simulation.scene.tools[0].tool.nodes[report.contacts.flags]
    assert (touched[:, 0] > 1.0).any()
    assert (touched[:, 0] < -1.0).any()
    assert (np.abs(touched[:, 0]) > 1.0).all()
    assert watch.deepest <= 0.03
    assert watch.wrong == 0
    simulation.close()


# Several organs ----------------------------------------------------------------------------------------------------

BALL = icosphere(1.0, 2)
PAIR = [(BALL, (-1.2, 0.0, 0.0), 4.0), (BALL, (1.2, 0.1, 0.0), 4.0)]
COUNT = len(BALL.vertices)


def test_an_organ_that_is_not_touched_moves_as_if_no_tool_were_there():
    both = Simulation(weightless(PAIR, [(PLATE, (0.0, 0.0, 0.0), SIDEWAYS)]), precision="double")
    alone = Simulation(weightless(PAIR[:1], [(PLATE, (0.0, 0.0, 0.0), SIDEWAYS)]), precision="double")
    far = Simulation(weightless(PAIR, [(PLATE, (0.0, 30.0, 0.0), SIDEWAYS)]), precision="double")
    touched = 0
    for _ in range(20):
        report, expected = both.step((-8.0, 0.0, 0.0)), alone.step((-8.0, 0.0, 0.0))
        far.step()
        first, second = report.all_contacts[0]
        touched += first.flags.sum()
        assert not second.flags.any()
        assert not report.nodal_impulses[COUNT:].any()
        # To the last bit, the one as if it were alone, the other as if it were.
        np.testing.assert_array_equal(both.nodes[:COUNT], alone.nodes)
        np.testing.assert_array_equal(both.nodes[COUNT:], far.nodes[COUNT:])
        np.testing.assert_array_equal(report.force, expected.force)
    assert touched > 100
    for simulation in (both, alone, far):
        simulation.close()


def test_a_tool_between_two_organs_touches_both():
    # Wedged in: it turns about y until its rims meet the one and the other, which flee.
    simulation = Simulation(weightless(PAIR, [(PLATE, (0.0, 0.0, 0.0), SIDEWAYS)]), precision="double")
    watch, together = Watch(simulation), 0
    for _ in range(20):
        report = watch.step((0.0, 0.0, 0.0), (0.0, 20.0, 0.0))
        first, second = report.all_contacts[0]
        given = report.nodal_impulses[:COUNT].sum(axis=0), report.nodal_impulses[COUNT:].sum(axis=0)
        if first.flags.any() and second.flags.any():
            together += 1
            # No node is in contact with both.
            assert not (first.flags & second.flags).any()
        # The one is pushed to the left, the other to the right.
        assert given[0][0] <= 1e-9
        assert given[1][0] >= -1e-9
    assert together > 2
    assert watch.deepest <= 0.03
    # They have gone apart.
    assert (simulation.node_velocities[:COUNT] * simulation.node_masses[:COUNT, None]).sum(axis=0)[0] < 0.0
    assert (simulation.node_velocities[COUNT:] * simulation.node_masses[COUNT:, None]).sum(axis=0)[0] > 0.0
    simulation.close()


@pytest.mark.parametrize("speed", [4.0, 60.0])
def test_organs_of_different_fineness_are_pressed_at_once(speed):
    organs = [(icosphere(1.0, 1), (-1.1, 0.0, 0.0), 3.0), (icosphere(1.0, 3), (1.1, 0.0, 0.0), 3.0)]
    plate = Tool.box((4.0, 1.0, 0.1), node_spacing=0.25)
    simulation = Simulation(weightless(organs, [(plate, (0.0, 0.0, 1.1), (0, 0, 0, 1))]), precision="double")
    watch, parts = Watch(simulation), None
    steps = int(np.ceil(0.4 / (speed * simulation.dt)))
    for _ in range(steps):
        report = watch.step((0.0, 0.0, -0.4 / steps / simulation.dt))
        if all(contacts.flags.any() for contacts in report.all_contacts[0]):
            parts = [report.nodal_impulses[part].sum(axis=0)[2] for part in watch.parts]
    assert parts is not None
    assert max(parts) < 0.0
    assert watch.deepest <= 0.03
    assert watch.wrong == 0
    simulation.close()


def test_a_blow_to_one_organ_does_not_calm_another():
    # The second tool plucks the second organ, which rings; then the first tool hits the first organ very fast.
    tools = [(PLATE, (-1.2, 0.0, 1.2), (0, 0, 0, 1)), (PLATE, (5.0, 0.1, 1.2), (0, 0, 0, 1))]
    organs = [PAIR[0], (BALL, (5.0, 0.1, 0.0), 4.0)]
    runs = []
    for blow in (0.0, -300.0):
        simulation = Simulation(weightless(organs, tools), precision="double")
        for _ in range(30):
            simulation.step([[0.0, 0.0, 0.0], [0.0, 0.0, -6.0]])
        for k in range(10):
            simulation.step([[0.0, 0.0, blow if k == 0 else 0.0], [0.0, 0.0, 40.0]])
        runs.append(simulation.nodes[COUNT:])
        simulation.close()
    # But for rounding: a step that is divided adds up its parts.
    np.testing.assert_allclose(runs[0], runs[1], rtol=0.0, atol=1e-12)


# Several tools -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [3.0, 30.0, 150.0])
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_two_tools_squeeze_an_organ(speed, friction):
    scene = weightless(
        [(icosphere(1.5, 2), (0.0, 0.0, 0.0), 5.0)],
        [(PLATE, (-1.6, 0.0, 0.0), SIDEWAYS), (PLATE, (1.6, 0.0, 0.0), SIDEWAYS)],
    )
    scene = scenes.Scene(
        organs=scene.organs,
        tools=tuple(scenes.PlacedTool(p.tool, p.position, p.orientation, friction) for p in scene.tools),
        ground=None,
        gravity=0.0,
    )
    simulation = Simulation(scene, precision="double")
    watch, faces = Watch(simulation), [set(), set()]
    steps = int(np.ceil(0.5 / (speed * simulation.dt)))
    closing = 0.5 / steps / simulation.dt
    work = 0.0
    for k in range(steps + 24):
        velocities = np.array([[closing, 0.0, 0.0], [-closing, 0.0, 0.0]]) * (k < steps)
        report = watch.step(velocities)
        work -= sum(report.wrenches[t].force @ velocities[t] for t in range(2)) * simulation.dt
        for tool in range(2):
            flags = report.all_contacts[tool][0].flags
            faces[tool] |= set(PLATE.face[flags].tolist())
            assert not (flags & flags[PLATE.opposite]).any()
            # Each tool's wrench is the sum of what it feels at its nodes.
            wrench = report.wrenches[tool]
            np.testing.assert_allclose(
                wrench.node_forces.sum(axis=0), wrench.force, atol=1e-9 * (1.0 + np.abs(wrench.force).max())
            )
    # The left one with its top, which looks along +x; the right one with its bottom.
    assert 1 in faces[0] and 0 not in faces[0]
    assert 0 in faces[1] and 1 not in faces[1]
    assert watch.deepest <= 0.03
    assert watch.wrong == 0
    # Both are pushed out, about as much; the organ is squeezed.
    assert report.wrenches[0].force[0] < -50.0
    assert report.wrenches[1].force[0] > 50.0
    assert np.ptp(simulation.nodes[:, 0]) > 1.0
    kinetic = 0.5 * simulation.node_masses @ (simulation.node_velocities**2).sum(axis=1)
    assert kinetic < work
    simulation.close()


def test_the_moments_of_two_tools_balance_with_the_organs():
    scene = weightless(
        [(icosphere(1.5, 2), (0.0, 0.0, 0.0), 5.0)],
        [(PLATE, (-1.6, 0.3, 0.0), SIDEWAYS), (PLATE, (1.6, -0.3, 0.1), SIDEWAYS)],
    )
    simulation = Simulation(scene, precision="double")
    for _ in range(20):
        report = simulation.step([[6.0, 0.0, 0.5], [-6.0, 0.0, 0.0]])
        moments = sum(
            wrench.torque + np.cross(position, wrench.force)
            for wrench, position in zip(report.wrenches, simulation.tool_positions, strict=True)
        )
        organs = np.cross(simulation.nodes, report.nodal_impulses).sum(axis=0) / simulation.dt
        np.testing.assert_allclose(
            moments, -organs, atol=1e-9 * (1.0 + np.abs(report.nodal_impulses).sum() / simulation.dt)
        )
    assert report.wrenches[0].force.any()
    assert report.wrenches[1].force.any()
    simulation.close()


@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_an_organ_between_a_tool_and_the_ground(tilt):
    block = box_surface((2.0, 2.0, 1.0), 0.25)
    orientation = quaternion_from_axis_angle((1.0, 1.0, 0.0), tilt)
    lowest = (PLATE.vertices @ rotation_matrix(orientation).T)[:, 2].min()
    simulation = Simulation(
        scenes.Scene(
            organs=(scenes.PlacedOrgan(block, position=(0.0, 0.0, 0.5), mass=5.0),),
            tools=(scenes.PlacedTool(PLATE, position=(0.0, 0.0, 3.0), orientation=tuple(orientation)),),
        ),
        precision="double",
    )
    top = simulation.nodes[:, 2].max()
    simulation.place_tool((0.0, 0.0, top - lowest + 0.02), orientation)
    watch = Watch(simulation)
    for _ in range(40):
        watch.step((0.0, 0.0, -3.0))
    ground, tool = [], []
    for _ in range(120):
        report = watch.step()
        ground.append(report.ground_force[2])
        tool.append(report.wrenches[0].force[2])
    assert watch.deepest <= 0.03
    assert watch.wrong == 0
    assert simulation.nodes[:, 2].min() > -0.01
    # The ground carries the weight and what the tool presses with.
    assert np.mean(tool) > 100.0
    assert np.mean(ground) == pytest.approx(np.mean(tool) + 50.0, rel=0.05)
    simulation.close()
