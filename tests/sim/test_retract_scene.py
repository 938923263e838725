"""An upright blade pushes a fold aside, draws it along, and lets it go."""

from __future__ import annotations

import numpy as np
import pytest

from spatula_env import Simulation, scenes
from spatula_env.geometry.transforms import rotate

SPEED = 1.0
"""Of the blade [u/s]."""

PUSH = 0.3
"""How far the blade goes after it has touched the fold, about [u]."""


@pytest.fixture(scope="module")
def simulation():
    return Simulation(scenes.retract(), engine="batch")


@pytest.fixture(scope="module")
def block(simulation):
    return simulation.scene.organs[0].organ


def push(simulation, block, side, way=PUSH, aside=0.0):
    """Touch the fold from the left (1) or the right (-1), push it aside, draw it along; the reports of the push."""
    simulation.reset()
    flank = simulation.nodes[block.flanks[1 if side > 0.0 else 0]]
    outermost = np.abs(flank[:, 0]).max()
    height = block.foot_height + 0.2 + 0.5 * simulation.scene.tools[0].tool.size[1]
    simulation.place_tool((-side * (outermost + 0.05), 0.0, height), scenes.UPRIGHT)
    reports = [simulation.step((side * SPEED, 0.0, 0.0)) for _ in range(round((way + 0.05) / SPEED / simulation.dt))]
    if aside:
        for _ in range(round(abs(aside) / SPEED / simulation.dt)):
            reports.append(simulation.step((0.0, np.sign(aside) * SPEED, 0.0)))
    return reports


def test_the_blade_looks_to_the_left_and_to_the_right(simulation):
    turned = rotate(np.array(scenes.UPRIGHT), np.eye(3))
    assert turned == pytest.approx(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]))
    corners = rotate(np.array(scenes.UPRIGHT), simulation.scene.tools[0].tool.vertices)
    assert np.ptp(corners, axis=0) == pytest.approx([0.09, 1.0, 2.0])


def test_the_fold_runs_away_from_the_operator(simulation, block):
    nodes = simulation.nodes
    right, left = (nodes[flank] for flank in block.flanks)
    assert (right[:, 0] > 0.0).all()
    assert (left[:, 0] < 0.0).all()
    assert np.ptp(right[:, 1]) > 2.0 * np.ptp(nodes[block.crest, 0])


def test_the_blade_begins_above_the_organ(simulation):
    simulation.reset()
    lowest = simulation.tool_position[2] - 1.0
    assert lowest == pytest.approx(simulation.nodes[:, 2].max() + scenes.BLADE_CLEARANCE, abs=0.02)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_push_moves_the_fold_aside_and_not_the_base(simulation, block, side):
    simulation.reset()
    rest = simulation.nodes
    reports = push(simulation, block, side)
    moved = simulation.nodes - rest
    assert np.abs(moved[block.base]).max() == 0.0
    crest = moved[block.crest, 0].mean() * side
    assert 0.3 * PUSH < crest < 1.5 * PUSH
    force = reports[-1].force_newtons
    assert -0.3 < side * force[0] < -0.05
    assert abs(force[1]) < 0.1 * abs(force[0])
    assert max(report.residual for report in reports) < 0.03


def test_friction_draws_the_fold_along(simulation, block):
    flank = block.flanks[1]
    push(simulation, block, 1.0)
    before = simulation.nodes[flank, 1].mean()
    forces = [push(simulation, block, 1.0, aside=aside)[-1].force for aside in (0.08, -0.08)]
    assert forces[0][1] < 0.0 < forces[1][1]
    for force in forces:
        assert abs(force[1]) <= 0.4 * abs(force[0]) * 1.001
    push(simulation, block, 1.0, aside=0.08)
    assert simulation.nodes[flank, 1].mean() > before + 0.005


def test_the_fold_comes_back_when_it_is_let_go(simulation, block):
    simulation.reset()
    rest = simulation.nodes
    push(simulation, block, 1.0)
    for _ in range(120):
        simulation.step((-SPEED, 0.0, 0.0))
    for _ in range(240):
        simulation.step()
    assert np.abs(simulation.nodes - rest).max() < 0.03


@pytest.mark.bullet
def test_bullet_feels_the_same(simulation, block):
    expected = push(simulation, block, 1.0)
    with_bullet = Simulation(scenes.retract(), engine="bullet")
    try:
        found = push(with_bullet, block, 1.0)
    finally:
        with_bullet.close()
    greatest = max(np.linalg.norm(report.force) for report in expected)
    differences = [np.linalg.norm(a.force - b.force) for a, b in zip(found, expected, strict=True)]
    assert max(differences) < 0.02 * greatest
