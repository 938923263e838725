"""The benchmark of tissue: its references are right, and comparisons that cannot be made are reported."""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
import pytest

from benchmarks import elements, solids, tissue
from spatula_env.geometry.meshes import icosphere
from spatula_env.scenes import Material
from spatula_env.sim.tissue.hyperelastic import Hyperelastic

F = np.array([[1.1, 0.05, 0.0], [-0.04, 0.95, 0.1], [0.02, 0.0, 0.97]])


def test_a_block_is_filled_by_tetrahedra_of_positive_volume() -> None:
    solid = solids.block(np.array([1.0, 2.0, 3.0]), (2, 3, 4))
    assert len(solid.nodes) == 3 * 4 * 5
    assert len(solid.tetrahedra) == 6 * 2 * 3 * 4
    assert solid.volumes.min() > 0.0
    assert solid.volumes.sum() == pytest.approx(6.0)
    assert solid.nodes.min(axis=0).tolist() == [0.0, 0.0, 0.0]
    assert solid.nodes.max(axis=0).tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("frequency", [1, 2, 3, 8])
def test_a_geodesic_sphere_is_closed_and_even(frequency: int) -> None:
    organ = solids.geodesic_sphere(3.0, frequency)
    assert (len(organ.vertices), len(organ.triangles)) == (10 * frequency**2 + 2, 20 * frequency**2)
    np.testing.assert_allclose(np.linalg.norm(organ.vertices, axis=1), 3.0)
    lengths = organ.edge_lengths
    assert len(lengths) == 30 * frequency**2
    assert lengths.max() < 1.5 * lengths.min()
    if frequency & (frequency - 1) == 0:
        same = icosphere(3.0, frequency.bit_length() - 1)
        assert organ.volume == pytest.approx(same.volume)


def test_a_graded_sphere_is_finer_at_its_poles() -> None:
    organ = solids.graded_sphere(3.0, 4, 0.3)
    np.testing.assert_allclose(np.linalg.norm(organ.vertices, axis=1), 3.0)
    near_poles = np.abs(organ.vertices[:, 2]) > 2.7
    even = np.abs(solids.graded_sphere(3.0, 4).vertices[:, 2]) > 2.7
    assert near_poles.sum() > 2 * even.sum()


@pytest.mark.parametrize("material", tissue.MATERIALS.values())
def test_slopes_of_the_documented_energy_are_the_laws_stress(material: Material) -> None:
    stress = Hyperelastic.of(material).stress(F)
    for i in range(3):
        for j in range(3):
            change = np.zeros((3, 3))
            change[i, j] = 1e-5
            rise = solids.documented_energy(material, F + change) - solids.documented_energy(material, F - change)
            assert rise / 2e-5 == pytest.approx(stress[i, j], abs=1e-4 * np.abs(stress).max())


def test_small_strains_have_the_moduli() -> None:
    material = Material(young_modulus=3000.0, poisson_ratio=0.3)
    assert solids.uniaxial_stress(material, 1.001) / 0.001 == pytest.approx(3000.0, rel=2e-3)
    assert solids.shear_stress(material, 0.001) / 0.001 == pytest.approx(material.shear_modulus, rel=1e-5)


def test_equilibrium_is_where_nothing_pulls() -> None:
    solid, law = solids.block(np.ones(3), (3, 3, 3)), Hyperelastic.of(Material())
    x, y, z = solid.nodes.T
    free = np.column_stack([x > 0.0, y > 0.0, (z > 0.0) & (z < 1.0)])
    nodes, forces = solids.equilibrium(solid, law, solid.nodes * [1.0, 1.0, 0.9], free)
    assert np.abs(forces[free]).max() < 1e-5 * np.abs(forces).max()
    # A compressed block with free sides has homogeneous strain.
    wide = float(nodes[:, 0].max())
    assert 1.03 < wide < 1.06
    np.testing.assert_allclose(nodes, solid.nodes * [wide, wide, 0.9], atol=1e-4)


def test_a_solid_that_cannot_come_to_rest_is_told() -> None:
    solid = solids.block(np.ones(3), (2, 2, 2))
    free = np.repeat(((solid.nodes[:, 2] > 0.0) & (solid.nodes[:, 2] < 1.0))[:, None], 3, axis=1)
    with pytest.raises(RuntimeError, match="a solid has not come to rest"):
        solids.equilibrium(solid, Hyperelastic.of(Material()), solid.nodes * [1.0, 1.0, 0.8], free, iterations=2)


@pytest.mark.parametrize("name", ["kernels", "patch", "shear", "momentum"])
def test_a_check_passes_and_tells_its_limit(name: str) -> None:
    check = tissue.checks()[name]()
    assert 0.0 < check.value <= check.threshold < 1.0
    assert check.passed


def test_what_cannot_be_compared_is_told(monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.setitem(sys.modules, "felupe", None)
    assert elements.felupe_version() is None
    monkeypatch.setattr(sys, "argv", ["tissue", "--json", "--checks", "hertz", "patch"])
    tissue.main()
    told = capsys.readouterr()
    assert "hertz is left out: comparing with another code needs felupe: pip install felupe" in told.err
    result = json.loads(told.out)
    assert result["passed"] is False
    assert set(result["left_out"]) == {"hertz"}
    assert result["checks"]["patch"]["passed"] is True


def test_felupe_presses_a_sphere_as_hertz_says() -> None:
    pytest.importorskip("felupe")
    forces = elements.press_sphere(1.0 / 2.9, 0.45 / (1.45 * 0.1), [0.01, 0.02], cells=12)
    expected = 4.0 / 3.0 / (1.0 - 0.45**2) * np.array([0.01, 0.02]) ** 1.5
    np.testing.assert_allclose(forces, expected, rtol=0.08)
