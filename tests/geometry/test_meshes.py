from __future__ import annotations

import dataclasses
import hashlib

import numpy as np
import pytest

from spatula_env.geometry import Organ, box_surface, icosphere, seed_sphere, torus
from spatula_env.geometry.surface import edges, triangle_normals


def test_seed_sphere_is_the_mesh_of_the_seed():
    organ = seed_sphere()
    assert organ.vertices.shape == (328, 3)
    assert organ.triangles.shape == (652, 3)
    lengths = organ.edge_lengths
    assert len(lengths) == 978
    assert [lengths.min(), lengths.mean(), lengths.max()] == pytest.approx([0.176, 0.669, 1.085], abs=5e-4)
    assert organ.area == pytest.approx(111.9, abs=0.05)
    assert organ.volume == pytest.approx(110.8, abs=0.05)
    np.testing.assert_allclose(np.linalg.norm(organ.vertices, axis=1), 3.0, atol=1e-12)


def test_seed_sphere_keeps_the_order_of_the_points():
    vertices = seed_sphere(1.0, 8).vertices
    np.testing.assert_allclose(vertices[0], [0.0, 0.0, -1.0])
    # Binary digits mirrored at the point: 0, 1/2, 1/4, 3/4, 1/8, 5/8, 3/8, 7/8.
    np.testing.assert_allclose(vertices[:, 2], [-1.0, 0.0, -0.5, 0.5, -0.75, 0.25, -0.25, 0.75])
    np.testing.assert_allclose(np.arctan2(vertices[1, 1], vertices[1, 0]), 3.0 * np.pi / 8.0)


def test_seed_sphere_has_the_same_triangles_on_every_machine():
    # No four of its points are in a plane, by far, so rounding does not decide.
    organ = seed_sphere()
    normals = triangle_normals(organ.vertices, organ.triangles)
    heights = organ.vertices @ normals.T - np.einsum("ij,ij->i", normals, organ.vertices[organ.triangles[:, 0]])
    heights[organ.triangles.T, np.arange(652)] = -np.inf
    assert heights.max() < -1e-4
    digest = hashlib.sha256(organ.triangles.astype("<i4").tobytes()).hexdigest()
    assert digest == "93dbdf29977641d1a2ac5d899ece2aae21de38c4b522d897d54bbcf8dd9032f8"


def test_seed_sphere_triangles_are_in_canonical_order():
    triangles = seed_sphere().triangles
    assert (triangles[:, 0] == triangles.min(axis=1)).all()
    keys = triangles @ np.array([328**2, 328, 1])
    assert (np.diff(keys) > 0).all()


def test_every_seed_sphere_normal_points_outwards():
    organ = seed_sphere()
    middles = organ.vertices[organ.triangles].mean(axis=1)
    assert (np.einsum("ij,ij->i", triangle_normals(organ.vertices, organ.triangles), middles) > 0.0).all()


@pytest.mark.parametrize("subdivisions", range(4))
def test_icosphere(subdivisions):
    organ = icosphere(2.0, subdivisions)
    assert len(organ.triangles) == 20 * 4**subdivisions
    assert len(organ.vertices) == 10 * 4**subdivisions + 2
    np.testing.assert_allclose(np.linalg.norm(organ.vertices, axis=1), 2.0, atol=1e-12)
    assert organ.edge_lengths.max() < 1.4 * organ.edge_lengths.min()


@pytest.mark.parametrize(
    ("size", "spacing", "nodes"),
    [((1.0, 1.0, 1.0), 1.0, 8), ((1.0, 1.0, 1.0), 0.5, 26), ((0.6, 0.4, 0.1), 0.2, 24)],
)
def test_box_surface(size, spacing, nodes):
    organ = box_surface(size, spacing)
    assert len(organ.vertices) == nodes
    assert len(organ.triangles) == 2 * nodes - 4
    assert organ.volume == pytest.approx(np.prod(size))
    assert organ.area == pytest.approx(2.0 * (size[0] * size[1] + size[1] * size[2] + size[2] * size[0]))
    np.testing.assert_allclose(organ.bounds, [-0.5 * np.array(size), 0.5 * np.array(size)], atol=1e-12)
    pairs = edges(organ.triangles)
    along_axes = (np.abs(organ.vertices[pairs[:, 0]] - organ.vertices[pairs[:, 1]]) > 1e-12).sum(axis=1) == 1
    assert organ.edge_lengths[along_axes].max() <= spacing + 1e-12


def test_torus():
    organ = torus(2.0, 0.5, 20, 10)
    assert len(organ.vertices) == 200
    distance = np.hypot(np.hypot(organ.vertices[:, 0], organ.vertices[:, 1]) - 2.0, organ.vertices[:, 2])
    np.testing.assert_allclose(distance, 0.5, atol=1e-12)


def test_organ_cannot_be_written_to_and_does_not_share_memory():
    vertices, triangles = box_surface().vertices.copy(), box_surface().triangles.copy()
    organ = Organ(vertices, triangles)
    vertices[0] = 9.0
    assert organ == Organ(box_surface().vertices, triangles)
    with pytest.raises(ValueError, match="read-only"):
        organ.vertices[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        organ.triangles[0, 0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        organ.name = "other"


def test_organs_are_equal_by_value():
    assert seed_sphere() == seed_sphere()
    assert len({seed_sphere(), seed_sphere(), seed_sphere(2.0)}) == 2
    assert icosphere(1.0, 0) != dataclasses.replace(icosphere(1.0, 0), name="other")
    assert icosphere(1.0, 0) != "icosphere"


def test_organ_is_checked():
    with pytest.raises(ValueError, match="surface 'liver' is open: 3 boundary edges"):
        Organ(seed_sphere().vertices, seed_sphere().triangles[1:], "liver")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: seed_sphere(radius=0.0), "radius must be positive and finite, got 0.0"),
        (lambda: seed_sphere(radius=np.inf), "radius must be positive"),
        (lambda: seed_sphere(node_count=3), "node_count must be an integer of at least 4, got 3"),
        (lambda: seed_sphere(node_count=10.5), "node_count must be an integer"),
        (lambda: icosphere(-1.0), "radius must be positive"),
        (lambda: icosphere(1.0, -1), "subdivisions must be an integer of at least 0"),
        (lambda: icosphere(1.0, True), "subdivisions must be an integer"),
        (lambda: box_surface((1.0, 0.0, 1.0)), "size must be positive"),
        (lambda: box_surface((1.0, 1.0)), "size must have shape"),
        (lambda: box_surface(spacing=np.nan), "spacing must be positive"),
        (lambda: torus(1.0, 1.0), "minor_radius must be less than major_radius"),
        (lambda: torus(major_count=2), "major_count must be an integer of at least 3"),
        (lambda: torus(minor_count=2), "minor_count must be an integer of at least 3"),
    ],
)
def test_impossible_shapes_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
