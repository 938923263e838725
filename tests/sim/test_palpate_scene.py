"""A spatula slides over the sphere that is held from below."""

from __future__ import annotations

import numpy as np
import pytest

from spatula_env import Simulation, scenes

SPEED = 0.5
"""Of the spatula sideways [u/s]: 10 mm/s."""


def slide(simulation):
    """Press 3 mm deep, and slide 20 mm to the right; the reports of the slide."""
    simulation.reset()
    top = simulation.nodes[:, 2].max()
    simulation.place_tool((-0.5, 0.0, top + 0.0625))
    for _ in range(36):
        simulation.step((0.0, 0.0, -1.0))
    return [simulation.step((SPEED, 0.0, 0.0)) for _ in range(round(1.0 / SPEED / simulation.dt))]


@pytest.fixture(scope="module")
def simulation():
    return Simulation(scenes.palpate(), engine="batch")


def test_what_is_held_does_not_move(simulation):
    simulation.reset()
    rest = simulation.nodes
    slide(simulation)
    held = np.array(simulation.scene.organs[0].fixed_nodes)
    assert np.abs(simulation.nodes - rest)[held].max() == 0.0
    assert (rest[held, 2] < 2.0).all()
    assert len(held) == (rest[:, 2] < 2.0).sum()


def test_the_organ_stays_where_it_is(simulation):
    simulation.reset()
    rest = simulation.nodes.mean(axis=0)
    reports = slide(simulation)
    assert np.abs(simulation.nodes.mean(axis=0) - rest)[:2].max() < 0.05
    forces = np.array([report.force_newtons for report in reports])
    assert (forces[:, 2] > 0.03).all()
    assert (forces[:, 2] < 0.4).all()


def test_free_it_rolls_away():
    simulation = Simulation(scenes.seed(), engine="batch")
    rest = simulation.nodes.mean(axis=0)
    slide(simulation)
    assert simulation.nodes.mean(axis=0)[0] - rest[0] > 0.1


def test_it_is_the_seeds_sphere_with_tissues_stiffness():
    seed, palpate = scenes.seed(), scenes.palpate()
    assert palpate.organs[0].organ == seed.organs[0].organ
    # Held, the same sphere is stiffer; so a scene unit of force is worth less.
    assert palpate.scale.force < seed.scale.force


@pytest.mark.parametrize("height", [1e-6, 10.0])
def test_something_and_not_everything_is_held(height):
    with pytest.raises(ValueError, match="held_height must be between"):
        scenes.palpate(held_height=height)
