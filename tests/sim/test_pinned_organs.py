"""Tools that are driven into organs which cannot give way: the hand stops, and goes on where it can."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.inspection import Inspector
from spatula_env import Simulation
from spatula_env.geometry import Tool, box_surface
from spatula_env.geometry.transforms import rotation_matrix
from spatula_env.scenes import PlacedOrgan, PlacedTool, Scene
from spatula_env.sim.worlds import Worlds

SLAB = box_surface((4.0, 4.0, 1.0), 0.5)
SPATULA = Tool.box((1.0, 1.0, 0.125), 6)

DEEPEST = 0.01
"""What the inspector may see anywhere [u]."""


def held_nodes(which):
    """Indices of the slab's nodes that are held."""
    heights = SLAB.vertices[:, 2]
    chosen = {
        "all": np.ones(len(heights), bool),
        "top": heights > 0.4,
        "most": np.random.default_rng(1).random(len(heights)) < 0.85,
    }
    return tuple(np.flatnonzero(chosen[which]).tolist())


def scene_of(which):
    """A spatula above a slab that is held."""
    return Scene(
        organs=(PlacedOrgan(SLAB, (0.0, 0.0, 0.5), mass=4.0, fixed_nodes=held_nodes(which)),),
        tools=(PlacedTool(SPATULA, (0.1, 0.2, 1.5)),),
        ground=None,
        gravity=0.0,
    )


class Watched:
    """Steps a simulation and looks from outside at every step."""

    def __init__(self, simulation):
        self.simulation, self.inspector = simulation, Inspector(SPATULA, simulation.triangles)
        self.deepest = self.told = 0.0

    def go(self, steps, linear=(0.0, 0.0, 0.0), angular=(0.0, 0.0, 0.0)):
        simulation = self.simulation
        for _ in range(steps):
            report = simulation.step(linear, angular)
            seen = self.inspector.inspect(simulation.tool_position, simulation.tool_orientation, simulation.nodes)
            self.deepest, self.told = max(self.deepest, seen.residual), max(self.told, report.residual)

    def lowest(self):
        """Height of the spatula's lowest corner [u]."""
        rotation = rotation_matrix(self.simulation.tool_orientation)
        return float((self.simulation.tool_position + SPATULA.vertices @ rotation.T)[:, 2].min())


@pytest.mark.parametrize("engine", ["batch", "bullet"])
@pytest.mark.parametrize("which", ["all", "top", "most"])
def test_a_tool_does_not_get_into_an_organ_that_is_held(which, engine):
    simulation = Simulation(scene_of(which), engine=engine)
    watched = Watched(simulation)
    watched.go(200, (0.5, 0.3, -4.0))
    assert watched.deepest < DEEPEST and watched.told < DEEPEST
    # It came as near as a step lets it, and no farther.
    assert 1.0 - DEEPEST < watched.lowest() < 1.0 + 4.0 * simulation.dt
    stopped_at, way = simulation.tool_position[2], 4.0 * simulation.dt
    watched.go(60, (0.0, 0.0, 4.0))
    # It starts slowly, from 1/256 of its pace at least, which takes eight steps, and ends as many behind.
    assert 52 * way < simulation.tool_position[2] - stopped_at <= 60 * way + 1e-9
    stopped_at = simulation.tool_position[2]
    watched.go(1, (0.0, 0.0, 4.0))
    assert simulation.tool_position[2] - stopped_at == pytest.approx(way, abs=1e-9)
    # Nor does a rim that is turned into it.
    watched.go(200, (0.0, 0.0, -4.0), (0.0, 2.0, 0.0))
    assert watched.deepest < DEEPEST and watched.told < DEEPEST
    simulation.close()


def test_a_tool_that_was_put_into_an_organ_gets_out():
    simulation = Simulation(scene_of("top"), engine="batch")
    simulation.place_tool((0.1, 0.2, 0.9))
    watched = Watched(simulation)
    watched.go(60, (0.0, 0.0, 2.0))
    assert watched.lowest() == pytest.approx(0.9 - 0.0625 + 60 * 2.0 * simulation.dt, abs=1e-9)
    simulation.close()


def test_a_hand_that_was_stopped_goes_on_slowly_and_is_saved_so():
    simulation = Simulation(scene_of("all"), engine="batch")
    way = 4.0 * simulation.dt

    def moved(up, angular=(0.0, 0.0, 0.0)):
        before = simulation.tool_position[2]
        report = simulation.step((0.0, 0.0, 4.0 * up), angular)
        moved = (simulation.tool_position[2] - before) / way
        assert report.stopped == (abs(moved - up) > 1e-9)
        return moved

    while moved(-1.0) != 0.0:
        pass
    saved = simulation.save()
    ways = [moved(1.0) for _ in range(5)]
    np.testing.assert_allclose(ways, [0.25, 0.5, 1.0, 1.0, 1.0], atol=1e-9)
    simulation.restore(saved)
    assert moved(1.0) == pytest.approx(0.25, abs=1e-9)
    # Each stop in a row leaves less of it.
    simulation.restore(saved)
    stops = sum(moved(-1.0) == 0.0 for _ in range(100))
    assert stops > 10
    assert 0.0 < moved(1.0) <= 0.25
    simulation.reset()
    assert moved(1.0) == pytest.approx(1.0, abs=1e-9)
    simulation.close()


def test_what_stops_a_hand_counts_as_restraint():
    worlds = Worlds(scene_of("all"), 2, engine="batch")
    linear = np.zeros((2, 1, 3))
    linear[0, 0, 2] = -4.0
    for _ in range(10):
        loads = worlds.advance(linear, steps=12)
    np.testing.assert_array_equal(loads.restrained, [1.0, 0.0])
    worlds.close()
