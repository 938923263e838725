"""The residual depth after a step, against the independent inspection."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loose import LooseOrgans

from benchmarks.inspection import Inspector, WorldInspector
from benchmarks.probes import EDGE_SPACING
from spatula_env import Simulation, scenes
from spatula_env.contact import step
from spatula_env.contact.depth import PRECISION
from spatula_env.contact.edge_depth import EDGES_COUNT_FROM
from spatula_env.geometry import Tool, box_surface, icosphere
from spatula_env.geometry.transforms import random_quaternion

SPHERE = icosphere(1.0, 2)
VERTICES = np.array(SPHERE.vertices)
TOOLS = {
    "plate": Tool.box((1.0, 0.7, 0.125)),
    "block": Tool.box((0.8, 0.8, 0.8), faces="all"),
    "wedge": Tool.convex([(x, y, z) for x in (-0.6, 0.6) for y, z in ((0.0, -0.4), (-0.4, 0.3), (0.4, 0.3))], 0.2),
}
WORLDS = {name: LooseOrgans([SPHERE], [(tool, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))]) for name, tool in TOOLS.items()}
INSPECTORS = {name: Inspector(tool, SPHERE.triangles) for name, tool in TOOLS.items()}


def measured(name, position, orientation, vertices):
    structure = WORLDS[name].world.structure
    return step.measure_depth(structure, np.array([position]), np.array([orientation]), vertices)


@given(st.sampled_from(list(TOOLS)), st.integers(0, 2**32))
@settings(max_examples=150)
def test_it_is_what_the_inspection_sees(name, number):
    generator = np.random.default_rng(number)
    orientation = random_quaternion(generator)
    direction = generator.normal(size=3)
    position = generator.uniform(0.0, 1.7) * direction / np.linalg.norm(direction)
    inspector = INSPECTORS[name]
    inspector.reset()
    seen = inspector.inspect(position, orientation, VERTICES)
    # The inspection samples edges, so that it may slightly underestimate the greatest depth.
    exact = max(seen.surface_depth, seen.corner_depth)
    depth = measured(name, position, orientation, VERTICES)
    assert depth >= max(exact, seen.edge_depth) - 2.0 * PRECISION
    assert depth <= max(exact, seen.edge_depth) + 0.5 * EDGE_SPACING + 2.0 * PRECISION


def test_a_tool_that_is_swallowed_is_deep():
    assert measured("plate", (0.1, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), 4.0 * VERTICES) == pytest.approx(3.6, abs=0.1)
    assert measured("plate", (5.1, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), 4.0 * VERTICES) == 0.0


def test_a_ridge_between_all_corners_and_nodes_is_seen():
    organ = box_surface((4.0, 0.02, 2.0))
    world = LooseOrgans([organ], [(TOOLS["plate"], (0.0, 0.05, 0.97), (0.0, 0.0, 0.0, 1.0))])
    depth = step.measure_depth(world.world.structure, world.positions, world.orientations, world.nodes)
    assert depth == pytest.approx(0.0625, abs=2.0 * PRECISION)


def test_an_edge_in_a_flat_surface_is_deeper_than_the_surface_is_in_the_tool():
    organ = box_surface((6.0, 6.0, 2.0), 0.7)
    turned = (np.sin(np.pi / 8.0), 0.0, 0.0, np.cos(np.pi / 8.0))
    world = LooseOrgans([organ], [(TOOLS["block"], (0.0, 0.0, 1.0 + 0.4 * np.sqrt(2.0) - 0.006), turned)])
    depth = step.measure_depth(world.world.structure, world.positions, world.orientations, world.nodes)
    assert depth == pytest.approx(0.006, abs=2.0 * PRECISION)


@pytest.mark.parametrize(("engine", "contact"), [("batch", "flags"), ("bullet", "flags"), ("bullet", "bullet")])
def test_reports_tell_the_depth_that_is_left(engine, contact):
    simulation = Simulation(scenes.seed(), engine=engine, contact=contact)
    inspector, depths = WorldInspector(simulation.scene), []
    try:
        for index in range(150):
            report = simulation.step((0.0, 1.0, -6.0 if index < 100 else 0.0), (0.0, 0.0, 2.0))
            seen = inspector.inspect(simulation.tool_positions, simulation.tool_orientations, simulation.nodes)
            tool = seen.tools[0]
            depths.append((report.residual, tool.surface_depth, tool.corner_depth, tool.edge_depth))
    finally:
        simulation.close()
    reported, surface, corner, edge = np.array(depths).T
    exact = np.maximum(surface, corner)
    assert exact.max() > (0.02 if contact == "bullet" else 1e-5)
    assert (reported >= np.maximum(exact, np.where(exact > EDGES_COUNT_FROM, edge, 0.0)) - 2.0 * PRECISION).all()
    # The seed's spatula has faces at right angles, and the surface that they cut into is nearly flat.
    shallow = exact < 0.02
    assert (reported[shallow] <= np.sqrt(2.0) * exact[shallow] + 2.0 * PRECISION).all()
