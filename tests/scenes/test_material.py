"""Materials: what they are at small strain, the published tests of brain, and what is refused."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env import scenes
from spatula_env.scenes import Material
from spatula_env.scenes.material import BRAIN
from spatula_env.sim.tissue.hyperelastic import Hyperelastic

DATA = Path(__file__).parents[2] / "scripts" / "data" / "brain_budday2017.csv"

GREATEST_ERRORS = {"cortex": 0.025, "corona_radiata": 0.0286, "basal_ganglia": 0.0156, "corpus_callosum": 0.0184}
"""Root mean square errors [kPa]; those of one-term Ogden models of incompressible tissue, fitted to the same points,
are 0.025, 0.022, 0.012 and 0.013."""

MATERIALS = [Material(), Material(poisson_ratio=0.3), *(Material.brain(region) for region in BRAIN)]


@pytest.mark.parametrize("material", MATERIALS)
def test_small_strains_are_those_of_youngs_modulus_and_poissons_ratio(material: Material) -> None:
    law, strain = Hyperelastic.of(material), 1e-5
    modulus = float(law.uniaxial(1.0 + strain) - law.uniaxial(1.0 - strain)) / (2.0 * strain)
    assert modulus == pytest.approx(material.young_modulus, rel=1e-4)
    assert float(law.simple_shear(strain)) / strain == pytest.approx(material.shear_modulus, rel=1e-4)
    squeezed = law.stress(np.eye(3) * (1.0 + strain))[0, 0] / (3.0 * strain)
    bulk = material.lame_parameter + 2.0 / 3.0 * material.shear_modulus
    assert squeezed == pytest.approx(bulk, rel=1e-3)


@given(entries=st.lists(st.floats(-0.3, 0.3), min_size=9, max_size=9), index=st.integers(0, len(MATERIALS) - 1))
def test_stress_is_the_slope_of_energy(entries: list[float], index: int) -> None:
    law, f = Hyperelastic.of(MATERIALS[index], unit=1e3), np.eye(3) + np.reshape(entries, (3, 3))
    if np.linalg.det(f) < 0.2:
        return
    directions, step = np.eye(9).reshape(9, 3, 3), 1e-6
    slopes = (law.energy(f + step * directions) - law.energy(f - step * directions)) / (2.0 * step)
    np.testing.assert_allclose(slopes.reshape(3, 3), law.stress(f), atol=1e-4 * (1.0 + np.abs(law.stress(f)).max()))


@given(angle=st.floats(-3.0, 3.0), entries=st.lists(st.floats(-0.2, 0.2), min_size=9, max_size=9))
def test_a_turn_costs_no_energy(angle: float, entries: list[float]) -> None:
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    f = np.eye(3) + np.reshape(entries, (3, 3))
    for material in MATERIALS:
        law = Hyperelastic.of(material, unit=1e3)
        assert float(law.energy(turn @ f)) == pytest.approx(float(law.energy(f)), abs=1e-9)


@pytest.mark.parametrize("region", BRAIN)
def test_brain_is_as_published(region: Any) -> None:
    law = Hyperelastic.of(Material.brain(region, poisson_ratio=0.49), unit=1e3)
    with DATA.open(newline="") as file:
        rows = np.array(
            [
                [float(v) for k, v in row.items() if k != "region"]
                for row in csv.DictReader(file)
                if row["region"] == region
            ]
        )
    errors = np.concatenate([law.uniaxial(rows[:, 0]) - rows[:, 1], law.simple_shear(rows[:, 2]) - rows[:, 3]])
    assert len(rows) == 33
    assert np.sqrt((errors**2).mean()) <= GREATEST_ERRORS[region]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"young_modulus": 0.0}, "young_modulus must be positive"),
        ({"poisson_ratio": 0.5}, r"poisson_ratio must be from 0 to 0.49, got 0.5"),
        ({"poisson_ratio": -0.1}, "poisson_ratio"),
        ({"density": -1.0}, "density"),
        ({"model": "jelly"}, "model must be one of"),
        ({"viscosity": -1.0}, "viscosity"),
        ({"relaxation": ((0.5, 1.0), (0.5, 2.0))}, "less than 1 in all"),
        ({"relaxation": ((0.5, 0.0),)}, "a time of relaxation"),
        ({"relaxation": ((0.5, 1.0, 2.0),)}, "pairs of a share and a time"),
        ({"rivlin": (-1.0, 1.0)}, "left alone"),
        ({"model": "rivlin", "rivlin": (-1.0, 0.0)}, "from 0 to 0.5"),
        ({"model": "rivlin", "rivlin": (-1.0, -1.0)}, "the second of rivlin"),
    ],
)
def test_what_is_no_material_is_refused(options: dict[str, Any], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        Material(**options)


def test_brain_knows_its_regions() -> None:
    with pytest.raises(ValueError, match="region must be one of"):
        Material.brain("liver")  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["seed", "palpate", "retract", "fissure", "clamp"])
def test_presets_take_a_material_and_have_its_density(name: str) -> None:
    material = Material(density=900.0)
    scene = getattr(scenes, name)(material=material)
    placed = scene.organs[0]
    assert placed.material == material
    mass = placed.mass * scene.scale.mass
    assert mass / (placed.organ.volume * scene.scale.length**3) == pytest.approx(900.0)
    assert getattr(scenes, name)().organs[0].material is None
