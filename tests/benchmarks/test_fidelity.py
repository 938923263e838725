"""The tools that measure fidelity: is the ledger right, and does it show imbalances?"""

from __future__ import annotations

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import fidelity, pictures
from benchmarks.fidelity import Check, Curve
from benchmarks.ledger import Ledger
from spatula_env import Simulation, scenes
from spatula_env.geometry.transforms import random_quaternion, rotate

GRAVITY, DT = 10.0, 0.01


class ScriptedSimulation:
    """Stands in for a simulation: two nodes of 2 kg with given motion, and a tool with a given force."""

    dt = DT
    scene = SimpleNamespace(gravity=GRAVITY)
    node_masses = np.array([2.0, 2.0])
    tool_position = np.zeros(3)

    def __init__(self):
        self.nodes = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
        self.node_velocities = np.zeros((2, 3))
        self.next_report = None

    def script(self, velocities, impulses, force, torque=(0.0, 0.0, 0.0), ground=(0.0, 0.0, 0.0), rise=0.0):
        self.after = np.array(velocities, dtype=float), rise
        self.next_report = SimpleNamespace(
            nodal_impulses=np.array(impulses, dtype=float),
            force=np.array(force, dtype=float),
            torque=np.array(torque, dtype=float),
            ground_force=np.array(ground, dtype=float),
        )

    def step(self, linear, angular):
        self.node_velocities, rise = self.after
        self.nodes = self.nodes + np.array([0.0, 0.0, rise])
        return self.next_report


STILL = np.zeros((2, 3))


def test_free_fall_balances():
    # Half a step of falling loses as much height as it gains speed.
    simulation = ScriptedSimulation()
    ledger = Ledger(simulation)
    speed = -GRAVITY * DT
    simulation.script([[0.0, 0.0, speed]] * 2, STILL, (0.0, 0.0, 0.0), rise=0.5 * speed * DT)
    ledger.step()
    assert ledger.momentum_error < 1e-12
    assert ledger.exchange_error == 0.0
    assert ledger.excess == pytest.approx(0.0, abs=1e-12)
    assert ledger.work == 0.0


def test_work_is_what_the_tool_pays_and_kinetic_energy_may_be_that_much():
    # A tool at 3 u/s gives each node an impulse of 2 kg u/s upwards; the ground carries the weight.
    simulation = ScriptedSimulation()
    ledger = Ledger(simulation)
    ground = (0.0, 0.0, 4.0 * GRAVITY)
    impulses = np.array([[0.0, 0.0, 2.0]] * 2)
    simulation.script([[0.0, 0.0, 1.0]] * 2, impulses, (0.0, 0.0, -4.0 / DT), ground=ground)
    ledger.step((0.0, 0.0, 3.0))
    assert ledger.work == pytest.approx(12.0)
    assert ledger.exchange_error < 1e-12
    assert ledger.momentum_error < 1e-12
    assert ledger.excess == 0.0
    # Pulled back, the tool gets work out of it, and the greatest remains known.
    simulation.script([[0.0, 0.0, 2.0]] * 2, impulses, (0.0, 0.0, -4.0 / DT), ground=ground)
    ledger.step((0.0, 0.0, -1.0))
    assert (ledger.work, ledger.greatest_work) == (pytest.approx(8.0), pytest.approx(12.0))
    # Kinetic energy 4 * 5**2 / 2 = 50 with work of 8 only.
    simulation.script([[0.0, 0.0, 5.0]] * 2, 3.0 * impulses, (0.0, 0.0, -12.0 / DT), ground=ground)
    ledger.step()
    assert ledger.excess == pytest.approx(42.0)
    # Height counts as well, and a later calm does not make it good.
    simulation.script(STILL, STILL, (0.0, 0.0, 0.0), rise=2.0)
    ledger.step()
    assert ledger.excess == pytest.approx(4.0 * GRAVITY * 2.0 - 8.0)
    simulation.script(STILL, STILL, (0.0, 0.0, 0.0), rise=-2.0)
    ledger.step()
    assert ledger.excess == pytest.approx(72.0)


def test_a_turning_tool_works_too():
    simulation = ScriptedSimulation()
    ledger = Ledger(simulation)
    simulation.script(STILL, STILL, (0.0, 0.0, 0.0), torque=(0.0, -7.0, 0.0))
    ledger.step(angular=(0.0, 2.0, 0.0))
    assert ledger.work == pytest.approx(14.0 * DT)


def test_forces_and_moments_that_nobody_got_show():
    size = 4.0 * GRAVITY * DT
    simulation = ScriptedSimulation()
    ledger = Ledger(simulation)
    simulation.script(STILL, STILL, (1.0, 0.0, 0.0))
    ledger.step()
    assert ledger.exchange_error == pytest.approx(DT / size)
    ledger = Ledger(simulation)
    # A couple: the forces cancel, the moments do not.
    simulation.script(STILL, [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]], (0.0, 0.0, 0.0))
    ledger.step()
    assert ledger.exchange_error == pytest.approx(2.0 / (2.0 + 2.0 + size))
    ledger = Ledger(simulation)
    simulation.script([[1.0, 0.0, 0.0]] * 2, STILL, (0.0, 0.0, 0.0), ground=(0.0, 0.0, 4.0 * GRAVITY))
    ledger.step()
    assert ledger.momentum_error == pytest.approx(4.0 / size)


def test_the_mean_force_is_that_of_the_last_steps():
    simulation = ScriptedSimulation()
    ledger = Ledger(simulation)
    for force in (100.0, 1.0, 3.0):
        simulation.script(STILL, STILL, (0.0, 0.0, force))
        ledger.step()
    np.testing.assert_allclose(ledger.mean_force(2.0 * DT), [0.0, 0.0, 2.0])
    np.testing.assert_allclose(ledger.mean_force(0.0), [0.0, 0.0, 3.0])


@pytest.mark.parametrize(("value", "passed"), [(0.01, True), (0.011, False), (math.nan, False), (math.inf, False)])
def test_a_check_passes_up_to_its_threshold(value, passed):
    check = Check(value, 0.01, details={"a": 1})
    assert check.passed == passed
    assert json.loads(json.dumps(check.as_dict(), allow_nan=False))["passed"] == passed


def curve(*forces):
    depths = np.linspace(0.1, 0.1 * len(forces), len(forces))
    return Curve(depths, np.array(forces, dtype=float), np.zeros(len(forces)))


def test_curves_are_compared_where_they_are_meant_to():
    # The first depth is not compared.
    assert curve(100.0, 200.0, 300.0).difference(curve(50.0, 202.0, 291.0)) == pytest.approx((0.03, 0.3))
    assert curve(100.0, 200.0, 300.0).difference(curve(100.0, 200.0, 300.0))[0] == 0.0


def test_a_falling_force_shows():
    assert curve(100.0, 200.0, 300.0).fall == 0.0
    assert curve(100.0, 400.0, 300.0, 350.0).fall == pytest.approx(0.25)
    assert curve(-10.0, 100.0).fall == pytest.approx(0.1)


def test_curves_are_sorted_into_checks():
    curves = {
        fidelity.REFERENCE: curve(100.0, 200.0),
        fidelity.HALF_STEP: curve(100.0, 204.0),
        "twice the time step": curve(100.0, 150.0),
        "3 nodes along an edge": curve(100.0, 140.0),
        fidelity.HALF_SPACING: curve(100.0, 180.0),
    }
    checks = fidelity.compare_curves(curves)
    assert checks["time_step"].details["twice the time step"]["difference"] == pytest.approx(0.25)
    assert checks["time_step"].value == pytest.approx(0.02)
    assert checks["time_step"].passed
    assert checks["node_spacing"].value == pytest.approx(0.1)
    assert not checks["node_spacing"].passed


@pytest.mark.parametrize("dt", [1.0 / 480.0, 1.0 / 120.0])
def test_a_scene_with_another_time_step_is_as_stiff_and_as_heavy(dt):
    base, scene = scenes.seed(), fidelity.scaled_scene(dt, 11)
    assert scene.dt == dt
    assert scene.organs[0].mass / dt**2 == pytest.approx(base.organs[0].mass / base.dt**2)
    assert scene.organs[0].mass * scene.gravity == pytest.approx(base.organs[0].mass * base.gravity)
    assert len(scene.tools[0].tool.nodes) == 2 * 11**2


def test_a_moved_scene_is_congruent():
    generator = np.random.default_rng(1)
    position, orientation = generator.uniform(-5.0, 5.0, 3), random_quaternion(generator)
    base = fidelity.free_scene(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    moved = fidelity.free_scene(position, orientation)
    for scene in (base, moved):
        assert (scene.ground, scene.gravity) == (None, 0.0)
    np.testing.assert_allclose(
        moved.organs[0].vertices, rotate(orientation, base.organs[0].vertices) + position, atol=1e-12
    )
    before, after = base.tools[0], moved.tools[0]
    corners = rotate(np.array(before.orientation), before.tool.vertices) + before.position
    np.testing.assert_allclose(
        rotate(np.array(after.orientation), after.tool.vertices) + after.position,
        rotate(orientation, corners) + position,
        atol=1e-12,
    )
    # The nodes that are held are those under the others, seen from the tool.
    heights = base.organs[0].vertices[:, 2]
    assert heights[list(base.organs[0].fixed_nodes)].max() <= np.sort(heights)[len(base.organs[0].fixed_nodes) - 1]
    assert moved.organs[0].fixed_nodes == base.organs[0].fixed_nodes


def test_a_release_presses_and_lets_go():
    simulation = Simulation(scenes.seed())
    # A sag of some hundredths of a unit, and 100 kg u/s2 of weight.
    assert 0.0 < fidelity.settled_energy(simulation) < 10.0
    ledger = fidelity.release(simulation, 0.5, 2.0, "same")
    assert ledger.greatest_work > 100.0
    assert np.max(ledger.forces) > 100.0
    assert not np.any(ledger.forces[-1])
    assert simulation.tool_position[2] > simulation.nodes[:, 2].max() + 1.0
    simulation.close()


def test_a_force_curve_has_a_force_at_each_depth():
    measured = fidelity.force_curve(scenes.seed(), (0.1, 0.2))
    np.testing.assert_allclose(measured.depths, [0.1, 0.2])
    assert 0.0 < measured.forces[0] < measured.forces[1]
    assert (measured.ripple < 0.2 * measured.forces).all()


def test_curves_are_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    curves = {name: curve(100.0, 200.0, 250.0) for name in (fidelity.REFERENCE, "half the time step")}
    path = tmp_path / "curves.png"
    pictures.draw_curves(curves, curve(90.0, 210.0, 260.0), path)
    assert path.read_bytes().startswith(b"\x89PNG")
