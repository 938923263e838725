"""A tool that slides, ploughs and turns stays out of the organ, as seen from outside after every physics step.

`benchmarks.inspection` shares nothing with the contact model: it knows depths of the whole surface, not of what made
contact.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import slides
from benchmarks.inspection import ALLOWED, restore_recording, watch_motion
from spatula_env import Simulation, scenes

CORNER_SLIDES = Path(__file__).with_name("corner_slides.npz")
"""Random motion in palpation at 25 mm/s. In the 61st step a corner of the plate slides over an edge of the mesh:
it passes the plane of the triangle that it comes to while it is still over the one that it leaves."""


@pytest.mark.parametrize("engine", ["batch", "bullet"])
def test_a_corner_that_slides_over_an_edge_of_the_mesh_stays_out(engine):
    simulation = Simulation(scenes.palpate(), engine=engine)
    try:
        seen = watch_motion(simulation, *restore_recording(simulation, CORNER_SLIDES))
    finally:
        simulation.close()
    assert seen.steps == seen.touching == 144
    # It was 0.11 u deep, nearly the plate's thickness, and the report said 0.001 u.
    assert seen.depth <= 0.002
    assert seen.depth <= seen.reported + 1e-6


@pytest.mark.parametrize("number", [0, 1, 2, 3, 4, 5, 6])
def test_slides_and_turns_stay_out(number):
    # In the fifth, with a friction of 1.8, sweeps went in circles: 0.017 u deep after ten passes.
    slide = slides.draw(slides.SEED, number)
    outcome = slides.run(slide)
    assert outcome.seen.touching > 50
    assert outcome.seen.depth <= ALLOWED
    assert not outcome.failed
