"""The option `material` of environments."""

from __future__ import annotations

import json
from typing import Any

import gymnasium as gym
import pytest

from spatula_env import scenes
from spatula_env.envs import EnvSettings
from spatula_env.scenes import Material


@pytest.mark.parametrize(
    "material", [Material(young_modulus=4000.0), {"young_modulus": 4000.0}, json.loads('{"young_modulus": 4000.0}')]
)
def test_a_material_comes_as_such_or_as_a_mapping(material: object) -> None:
    assert EnvSettings(material=material).material == Material(young_modulus=4000.0)


def test_a_region_of_the_brain_is_a_material() -> None:
    assert EnvSettings(material="cortex").material == Material.brain("cortex")


@pytest.mark.parametrize(
    ("material", "told"),
    [
        ("liver", r"region must be one of \['cortex'"),
        ({"modulus": 1.0}, r"material must have fields among \['young_modulus'.*got \['modulus'\]"),
        ({"poisson_ratio": 0.5}, "poisson_ratio must be from 0 to 0.49, got 0.5"),
        (3.0, "material must be a Material, a mapping of fields among .*, got 3.0"),
    ],
)
def test_what_is_no_material_is_refused(material: object, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        EnvSettings(material=material)


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
def test_springs_have_no_material(make: object) -> None:
    with pytest.raises(ValueError, match=r"material must be None but with the engines .*, got it with engine 'ba"):
        make("Spatula/Press-v0", engine="batch", material="cortex")


def test_organs_are_of_the_material_that_is_asked_for() -> None:
    wanted = Material(young_modulus=4000.0, relaxation=((0.3, 2.0),))
    with gym.make("Spatula/Palpate-v0", engine="tissue", material=wanted, disable_env_checker=True) as env:
        made: Any = env.unwrapped
        assert made.simulation.scene.organs[0].material == wanted
        # What is recorded can be written to a file, and makes the same again.
        recorded = json.loads(json.dumps(env.spec.kwargs))
        assert EnvSettings(**recorded).material == wanted


def test_a_scene_of_a_material_is_the_preset_that_was_given_it() -> None:
    material = Material(density=1100.0)
    ours, preset = scenes.with_material(scenes.seed(), material), scenes.seed(material=material)
    for one, other in zip(ours.organs, preset.organs, strict=True):
        assert (one.organ, one.position, one.mass, one.material) == (other.organ, other.position, other.mass, material)
        assert one.orientation == pytest.approx(other.orientation, abs=1e-15)
    assert ours.scale.length == preset.scale.length
    assert ours.scale.mass == pytest.approx(preset.scale.mass, rel=1e-12)
