"""Scenes whose scale comes from an indentation of their own organ, whatever its mesh."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from spatula_env import Simulation, scenes
from spatula_env.geometry import Tool, box_surface, icosphere, torus
from spatula_env.sim import calibrated
from spatula_env.sim.calibration import lower_face


def ball(subdivisions, held=2.0, **options):
    """A sphere of 60 mm radius, held from below, under the spatula of the seed."""
    scene = scenes.seed()
    organ = scenes.PlacedOrgan(icosphere(3.0, subdivisions), position=(0.0, 0.0, 3.0), **options)
    fixed = tuple(np.flatnonzero(organ.vertices[:, 2] < held).tolist())
    return dataclasses.replace(scene, organs=(dataclasses.replace(organ, fixed_nodes=fixed),))


def newtons(scene, depth=8e-3):
    """What the spatula feels when it has pressed so deep [m] and waited."""
    simulation = Simulation(scene, engine="batch")
    top = float(simulation.nodes[:, 2].max())
    simulation.place_tool((0.0, 0.0, top + 0.0625 + 0.01))
    way, speed = depth / scene.scale.length + 0.01, 0.5
    for _ in range(round(way / (speed * scene.dt))):
        simulation.step((0.0, 0.0, -speed))
    forces = [simulation.step().force_newtons[2] for _ in range(240)]
    return float(np.mean(forces[120:]))


@pytest.fixture(scope="module")
def balls():
    return {subdivisions: ball(subdivisions) for subdivisions in (2, 3)}


def test_spheres_of_any_mesh_are_as_stiff_as_asked(balls):
    found = {number: newtons(calibrated(scene, 2000.0)) for number, scene in balls.items()}
    as_they_were = {number: newtons(scene) for number, scene in balls.items()}
    # With the seed's scale the finer one is far softer.
    assert as_they_were[2] > 5.0 * as_they_were[3]
    assert found[3] == pytest.approx(found[2], rel=0.25)
    # Force = modulus x 2a / (1 - nu^2) x depth, for a plate of 20 mm.
    expected = 2000.0 * 1.012 * 2.0 * 0.02 / np.sqrt(np.pi) / 0.75 * 8e-3
    for force in found.values():
        assert force == pytest.approx(expected, rel=0.25)


def test_force_is_in_proportion_to_the_modulus_that_is_asked_for(balls):
    soft, hard = calibrated(balls[2], 1000.0), calibrated(balls[2], 3000.0)
    assert hard.scale.mass == pytest.approx(3.0 * soft.scale.mass)
    assert dataclasses.replace(hard, scale=balls[2].scale) == balls[2]
    assert hard.scale.length == balls[2].scale.length


def test_mass_and_time_step_do_not_matter(balls):
    heavy = ball(2, mass=30.0)
    assert calibrated(heavy).scale.mass == pytest.approx(calibrated(balls[2]).scale.mass / 3.0, rel=0.05)


def test_the_preset_is_found_again():
    # One place of six; their moduli lie between 1.6 and 3.0 kPa.
    found = calibrated(scenes.palpate())
    assert 0.6 < found.scale.mass / scenes.palpate().scale.mass < 1.4


def test_the_face_that_looks_down_counts():
    tool = Tool.box((1.0, 2.0, 0.5))
    flat = scenes.PlacedTool(tool, position=(0.0, 0.0, 7.0))
    assert lower_face(flat) == pytest.approx(2.0)
    on_edge = dataclasses.replace(flat, orientation=(np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)))
    assert lower_face(on_edge) == pytest.approx(0.5)


def test_a_place_without_an_organ_is_named():
    scene = dataclasses.replace(scenes.seed(), organs=(scenes.PlacedOrgan(torus(), position=(0.0, 0.0, 0.5)),))
    with pytest.raises(ValueError, match=r"there is no organ under the tool at \[0.0, 0.0\] in scene 'seed'"):
        calibrated(scene)


@pytest.mark.parametrize("place", [(1.0,), (0.0, np.nan), 3.0])
def test_bad_places_are_refused(place):
    with pytest.raises(ValueError, match="place must be two finite numbers"):
        calibrated(scenes.seed(), place=place)


@pytest.mark.parametrize("modulus", [0.0, -1.0, np.inf])
def test_bad_moduli_are_refused(modulus):
    with pytest.raises(ValueError, match="young_modulus must be positive"):
        calibrated(scenes.seed(), modulus)


@pytest.mark.filterwarnings("ignore::spatula_env.sim.SceneWarning")
def test_a_thin_organ_is_pressed_by_half_of_its_thickness_and_a_thinner_one_refused():
    scene = scenes.seed()
    for thickness, borne in ((0.4, True), (0.06, False)):
        slab = box_surface((5.0, 4.0, thickness), 0.5)
        organ = scenes.PlacedOrgan(slab, position=(0.0, 0.0, 0.5 * thickness))
        fixed = tuple(np.flatnonzero(organ.vertices[:, 2] < 0.01).tolist())
        thin = dataclasses.replace(scene, organs=(dataclasses.replace(organ, fixed_nodes=fixed),))
        if borne:
            assert calibrated(thin).scale.mass > 0.0
        else:
            with pytest.raises(ValueError, match="at least 2 mm thick under the tool"):
                calibrated(thin)
