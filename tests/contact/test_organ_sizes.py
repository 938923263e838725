"""Organs from a few triangles to more than an engine can load in minutes."""

from __future__ import annotations

import numpy as np
import pytest
from loose import DT, LooseOrgans

from benchmarks.inspection import Inspector
from spatula_env.geometry import Tool, icosphere

PLATE = Tool.box((0.8, 0.8, 0.1), faces="all")


@pytest.mark.parametrize("subdivisions", [1, 3, 5])
@pytest.mark.parametrize("speed", [10.0, 300.0])
def test_the_contact_of_organs_from_80_to_20480_triangles(subdivisions, speed):
    # Nodes that are left alone stay where they are.
    organ = icosphere(3.0, subdivisions)
    top = organ.vertices[:, 2].max()
    masses = np.full(len(organ.vertices), 10.0 / len(organ.vertices))
    loose = LooseOrgans([organ], [(PLATE, (0.1, 0.05, top + 0.06), (0.0, 0.0, 0.0, 1.0))], masses)
    inspector, taken = Inspector(PLATE, organ.triangles), 0.0
    for step in range(1, 4):
        loose.velocities[:] = 0.0
        loose.step((0.0, 0.0, -speed))
        assert loose.positions[0, 2] == pytest.approx(top + 0.06 - step * speed * DT)
        seen = inspector.inspect(loose.positions[0], loose.orientations[0], loose.nodes)
        assert seen.residual <= 0.03
        assert not seen.wrong_side
        taken += loose.wrenches[0, 2]
    lowest = loose.positions[0, 2] - 0.05
    if lowest > -3.0:
        under = (np.abs(loose.nodes[:, :2] - [0.1, 0.05]) < 0.35).all(axis=1) & (organ.vertices[:, 2] > 0.0)
        assert (loose.nodes[under, 2] <= lowest + 2e-3).all()
    assert taken > 0.0
    assert not np.array_equal(loose.nodes, organ.vertices)
