"""Tetrahedra inside organs: what comes with the presets, what is checked, and what Netgen makes of others."""

from __future__ import annotations

import importlib.util
import sys

import numpy as np
import pytest

from spatula_env import scenes
from spatula_env.geometry import Organ, icosphere, seed_sphere, torus
from spatula_env.geometry.tetrahedra import PRESETS, TetrahedralMesh, fill_organ, find_preset, tetrahedralize

needs_netgen = pytest.mark.skipif(importlib.util.find_spec("netgen") is None, reason="needs Netgen (extra tissue)")

CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("name", PRESETS)
def test_a_presets_organ_is_filled_inside_its_own_surface(name: str) -> None:
    organ = getattr(scenes, name)().organs[0].organ
    mesh = fill_organ(organ)
    mesh.check_fills(organ)
    assert np.array_equal(mesh.nodes[: len(organ.vertices)], organ.vertices)
    assert mesh.volumes.sum() == pytest.approx(organ.volume)
    assert mesh.qualities.min() > 0.15
    assert mesh.qualities.max() <= 1.0


def test_a_regular_tetrahedron_is_of_quality_one_and_has_its_altitude() -> None:
    nodes = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
    mesh = TetrahedralMesh(
        nodes, np.array([[0, 2, 1, 3]]) if np.linalg.det(nodes[1:] - nodes[0]) < 0 else [[0, 1, 2, 3]]
    )
    assert mesh.qualities[0] == pytest.approx(1.0)
    assert mesh.altitudes[0] == pytest.approx(np.sqrt(8.0) * np.sqrt(2.0 / 3.0))
    assert mesh.volumes[0] == pytest.approx(8.0 / 3.0)


def test_an_organ_that_differs_is_none_of_the_presets() -> None:
    assert find_preset(seed_sphere()) is not None
    assert find_preset(seed_sphere(2.9)) is None
    assert find_preset(icosphere(3.0, 2)) is None


@pytest.mark.parametrize(
    ("nodes", "tetrahedra", "told"),
    [
        (CORNERS, [[0, 2, 1, 3]], "1 of 1 are inside out or flat"),
        (CORNERS * [1.0, 1.0, 1e-5], [[0, 1, 2, 3]], "1 of 1 are flatter"),
        (CORNERS, [[0, 1, 2, 4]], r"nodes in 0\.\.3, got 0\.\.4"),
        (np.concatenate([CORNERS, CORNERS[:1] + 3.0]), [[0, 1, 2, 3]], "1 of 5 are in none"),
        (CORNERS[:, :2], [[0, 1, 2, 3]], r"shape \(N, 3\)"),
        (CORNERS, [[0.0, 1.0, 2.0, 3.0]], r"integers of shape \(M, 4\)"),
    ],
)
def test_what_is_no_solid_is_refused_with_how_many(nodes: np.ndarray, tetrahedra: list[list[int]], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        TetrahedralMesh(nodes, np.array(tetrahedra))


def test_tetrahedra_that_do_not_fill_an_organ_are_refused_with_how_many() -> None:
    organ = seed_sphere()
    mesh = fill_organ(organ)
    with pytest.raises(ValueError, match="328 are elsewhere"):
        mesh.check_fills(seed_sphere(2.0))
    with pytest.raises(ValueError, match="must be the 642 of organ"):
        mesh.check_fills(icosphere(3.0, 3))
    cut = TetrahedralMesh(mesh.nodes, mesh.tetrahedra[(mesh.tetrahedra >= 328).any(axis=1) | (np.arange(1805) > 0)])
    cut.check_fills(organ)
    inner = np.flatnonzero((mesh.tetrahedra < 328).sum(axis=1) == 3)[0]
    with pytest.raises(ValueError, match="1 are missing and 3 are not among them"):
        TetrahedralMesh(mesh.nodes, np.delete(mesh.tetrahedra, inner, axis=0)).check_fills(organ)


def test_another_organ_without_netgen_is_an_error_that_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "netgen", None)
    with pytest.raises(ImportError, match=r"icosphere.*tissue"):
        fill_organ(icosphere(1.5, 1))


@needs_netgen
@pytest.mark.parametrize("organ", [icosphere(1.0, 2), torus()])
def test_netgen_fills_an_organ_and_keeps_its_surface(organ: Organ) -> None:
    mesh = tetrahedralize(organ)
    assert np.array_equal(mesh.nodes[: len(organ.vertices)], organ.vertices)
    assert mesh.volumes.sum() == pytest.approx(organ.volume)


@needs_netgen
def test_netgen_fills_an_organ_with_a_cavity() -> None:
    ball = icosphere(1.0, 2)
    wall = Organ(
        np.concatenate([ball.vertices, 0.4 * ball.vertices]),
        np.concatenate([ball.triangles, ball.triangles[:, ::-1] + len(ball.vertices)]),
        "wall",
    )
    assert tetrahedralize(wall, grading=0.3).volumes.sum() == pytest.approx(wall.volume)


@needs_netgen
@pytest.mark.parametrize(("name", "value"), [("grading", 0.0), ("max_edge", -1.0)])
def test_what_netgen_is_not_asked(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        tetrahedralize(icosphere(1.0, 1), **{name: value})
