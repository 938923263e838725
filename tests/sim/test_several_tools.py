"""Several tools on one organ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spatula_env import Simulation, scenes
from spatula_env.contact.pressure import LEAST_PART
from spatula_env.geometry.transforms import quaternion_from_axis_angle, rotate

CLEARANCE = 0.1
SPEED = 3.0


def around(count, polar):
    """The scene of the seed, held from below, with spatulas whose faces are tangent to the sphere, and their normals.

    They come in at an angle `polar` from the top [deg], a quarter of a turn from each other.
    """
    scene, middle = scenes.seed(), np.array([0.0, 0.0, 3.0])
    vertices = scene.organs[0].vertices
    held = tuple(np.flatnonzero(vertices[:, 2] < vertices[:, 2].min() + 0.6).tolist())
    tools, normals = [], []
    for azimuth in 0.5 * np.pi * np.arange(count):
        turn = quaternion_from_axis_angle((-np.sin(azimuth), np.cos(azimuth), 0.0), np.deg2rad(polar))
        normals.append(rotate(turn, np.array([0.0, 0.0, 1.0])))
        place = middle + (3.0 + CLEARANCE) * normals[-1]
        tools.append(replace(scene.tools[0], position=tuple(place.tolist()), orientation=tuple(turn.tolist())))
    organ = replace(scene.organs[0], fixed_nodes=held)
    return replace(scene, organs=(organ,), tools=tuple(tools)), np.array(normals)


def pressed(count, polar, depth, hold):
    """The simulation after all tools have gone in and been held, and the reports of the holding."""
    scene, normals = around(count, polar)
    simulation = Simulation(scene, engine="batch")
    for _ in range(round((depth + CLEARANCE) / SPEED / scene.dt)):
        simulation.step(-SPEED * normals)
    return simulation, [simulation.step(0.0 * normals) for _ in range(hold)]


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_a_held_press_is_looked_at_once_a_step_however_many_tools_there_are(count):
    """A step that is divided costs several times as much, for each of the tools."""
    simulation, reports = pressed(count, 40.0, 0.8, 120)
    assert all(np.linalg.norm(report.loads[:, :3], axis=1).min() > 0.0 for report in reports)
    assert np.mean([report.queries for report in reports[20:]]) <= 1.1
    assert max(report.residual for report in reports) <= 0.01
    simulation.close()


def test_tools_that_face_each_other_carry_loads_that_their_sum_does_not_show():
    """Momentum balances with every force, force is pressure over area, and no node has more than the mesh resolves."""
    simulation, reports = pressed(4, 90.0, 0.8, 60)
    scene, report = simulation.scene, reports[-1]
    forces = report.loads[:, :3]
    magnitudes = np.linalg.norm(forces, axis=1)
    assert np.linalg.norm(forces.sum(axis=0)) < 0.2 * magnitudes.sum()
    np.testing.assert_allclose(report.force, forces[0])
    # What the tools take, the nodes are given.
    np.testing.assert_allclose(forces.sum(axis=0), -report.nodal_impulses.sum(axis=0) / scene.dt, atol=1e-9 * 4e3)
    for placed, wrench, force in zip(scene.tools, report.wrenches, forces, strict=True):
        np.testing.assert_allclose(wrench.node_forces.sum(axis=0), force, atol=1e-9 * magnitudes.max())
        normal = rotate(np.array(placed.orientation), np.array([0.0, 0.0, 1.0]))
        carried = float((wrench.pressures * placed.tool.areas).sum())
        assert carried == pytest.approx(abs(float(force @ normal)), rel=0.15)
        # On a corner's quarter of the area over which pushes are spread, and no smaller one.
        least_area = 0.25 * LEAST_PART * np.pi * report.reach**2 / 3.0
        assert wrench.pressures.max() <= carried / least_area
    simulation.close()
