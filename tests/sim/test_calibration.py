"""Organs are as stiff as tissue, for every mass and time step: indentations measured again."""

from __future__ import annotations

import dataclasses
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from spatula_env import scenes

SCRIPTS = Path(__file__).parents[2] / "scripts"
DEPTHS = np.array([2.0, 4.0, 6.0])


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def script():
    return load("calibrate_stiffness")


@pytest.fixture(scope="module")
def pressed(script):
    """How the seed's sphere is pressed, in one orientation, and what came out."""
    indentation = next(made for made in script.indentations() if made.name == "seed")
    indentation = dataclasses.replace(indentation, variants=indentation.variants[:1])
    return indentation, script.calibrate(indentation, DEPTHS)


@pytest.mark.parametrize("name", ["seed", "clamp", "retract"])
def test_the_organ_has_the_modulus_of_tissue(script, pressed, name):
    if name == "seed":
        found = pressed[1]
    else:
        indentation = next(made for made in script.indentations() if made.name == name)
        low, high = indentation.window
        found = script.calibrate(indentation, np.linspace(low, high, 3))
    assert found.modulus == pytest.approx(scenes.TISSUE_MODULUS, rel=0.1)
    assert 1400.0 < found.modulus < 9000.0


@pytest.mark.parametrize("engine", ["batch", "bullet"])
def test_the_calibration_measures_what_an_organ_gives(script, pressed, engine):
    # One press with either engine: a force of a good part of a newton, in proportion to the modulus.
    indentation, found = pressed
    scene = indentation.variants[0]
    newtons = script.force_curves(scene, indentation, DEPTHS[1:2], engine) * scene.scale.force
    np.testing.assert_allclose(newtons[0], found.forces[0, 1:2], rtol=0.01)
    assert 0.1 < newtons[0, 0] < 0.4


def test_any_mass_gives_the_same_newtons(script, pressed):
    indentation, found = pressed
    scene = scenes.seed(mass=2.5)
    newtons = script.force_curves(scene, indentation, DEPTHS) * scene.scale.force
    np.testing.assert_allclose(newtons, found.forces, rtol=0.01)


@pytest.mark.parametrize("dt", [1.0 / 120.0, 1.0 / 480.0])
def test_any_time_step_gives_the_same_newtons(script, pressed, dt):
    indentation, found = pressed
    # The weight that the organ rests with is to be the same as well: then the static problem is.
    scene = scenes.seed(dt=dt)
    scene = dataclasses.replace(scene, gravity=scene.gravity / (240.0 * dt) ** 2)
    newtons = script.force_curves(scene, indentation, DEPTHS) * scene.scale.force
    np.testing.assert_allclose(newtons, found.forces, rtol=0.05)


def test_a_density_like_that_of_tissue_is_six_times_as_stiff(script, pressed):
    indentation, found = pressed
    scene = scenes.seed(scale="density")
    newtons = script.force_curves(scene, indentation, DEPTHS) * scene.scale.force
    assert newtons[0, -1] / found.forces[0, -1] == pytest.approx(6.1, rel=0.05)


def test_the_elastic_solid_agrees_with_the_formula_of_a_punch():
    pytest.importorskip("scipy")
    solid = load("elastic_solid")
    coarse, fine = solid.half_space(0.25, extent=10.0), solid.half_space(0.125, extent=10.0)
    formula = 1.012 * 2.0 / np.sqrt(np.pi) / (1.0 - solid.POISSON**2)
    # Ten units of depth, and not an infinity, make it a few per cent stiffer.
    assert 1.0 < (2.0 * fine - coarse) / formula < 1.1


def test_the_elastic_solid_under_a_uniform_strain():
    # A box pushed over all of its face, and free at the sides, is a bar: force = modulus x area / length.
    pytest.importorskip("scipy")
    solid = load("elastic_solid")
    x, y, z = np.linspace(0.0, 1.0, 4), np.array([0.0, 0.2, 0.5]), np.linspace(0.0, 2.0, 5)

    def push(nodes):
        held = solid._planes(nodes, (0, 0.0), (1, 0.0), (2, 0.0))
        pushed = np.zeros_like(held)
        pushed[nodes[:, 2] > 2.0 - 1e-9, 2] = True
        return solid.Push(held | pushed, pushed, 4)

    found = solid.resistance((x, y, z), lambda x, y, z: x < np.inf, push)
    assert found == pytest.approx(4.0 * (1.0 * 0.5) / 2.0, rel=1e-5)
