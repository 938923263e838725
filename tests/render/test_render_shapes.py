from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.render import Mesh, arrow_mesh, box_mesh, ring_mesh, sphere_mesh, tube_mesh


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", np.cross(a, b), c).sum() / 6.0)


def is_closed(mesh: Mesh) -> bool:
    """Every edge, named by the places of its ends, is walked once in each direction."""
    places = [tuple(place) for place in np.round(mesh.vertices, 9)]
    edges = Counter(
        (places[triangle[k]], places[triangle[(k + 1) % 3]]) for triangle in mesh.triangles for k in range(3)
    )
    return all(edges[edge] == edges[edge[::-1]] for edge in edges)


@pytest.mark.parametrize("subdivisions", [0, 1, 2, 3])
def test_sphere(subdivisions):
    mesh = sphere_mesh((1.0, -2.0, 3.0), 1.5, subdivisions=subdivisions)
    assert len(mesh.triangles) == 20 * 4**subdivisions
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices - (1.0, -2.0, 3.0), axis=1), 1.5)
    assert is_closed(mesh)
    exact = 4 / 3 * np.pi * 1.5**3
    assert exact * (1 - 0.6 / 4**subdivisions) < volume(mesh) < exact


def test_many_spheres_and_their_colors():
    centers = np.array([(0.0, 0.0, 0.0), (5.0, 0.0, 0.0)])
    mesh = sphere_mesh(centers, 0.5, colors=[(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)], subdivisions=1)
    assert volume(mesh) == pytest.approx(2 * volume(sphere_mesh((0, 0, 0), 0.5, subdivisions=1)))
    right = mesh.vertices[:, 0] > 2.5
    np.testing.assert_array_equal(mesh.vertex_colors[right], np.tile((0.0, 0.0, 1.0), (right.sum(), 1)))


def test_box_volume_and_pose():
    half_turn = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
    mesh = box_mesh((2.0, 1.0, 0.5), (5.0, 6.0, 7.0), half_turn)
    assert len(mesh.triangles) == 12
    assert is_closed(mesh)
    assert volume(mesh) == pytest.approx(1.0)
    # A quarter turn about z: x and y change places.
    np.testing.assert_allclose(mesh.vertices.min(axis=0), (4.5, 5.0, 6.75))
    np.testing.assert_allclose(mesh.vertices.max(axis=0), (5.5, 7.0, 7.25))


def test_bevel_takes_the_edges_away():
    size, bevel = np.array([2.0, 1.0, 0.5]), 0.1
    mesh = box_mesh(size, bevel=bevel)
    assert len(mesh.triangles) == 44
    assert is_closed(mesh)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), size)
    # Prisms of bevel^2 / 2 along the edges, between the corners; at each corner the cube of side `bevel`
    # loses all but a tetrahedron.
    edges = 4 * (size - 2 * bevel).sum() * bevel**2 / 2
    corners = 8 * (bevel**3 - bevel**3 / 6)
    assert volume(mesh) == pytest.approx(size.prod() - edges - corners)


@pytest.mark.parametrize("vector", [(0.0, 0.0, 2.0), (1.0, -2.0, 0.5), (0.0, 0.0, -0.1)])
def test_arrow_reaches_from_start_to_tip(vector):
    start = np.array([1.0, 2.0, 3.0])
    mesh = arrow_mesh(start, vector, width=0.1)
    assert is_closed(mesh)
    assert volume(mesh) > 0
    length = np.linalg.norm(vector)
    along = (mesh.vertices - start) @ vector / length
    assert along.min() == pytest.approx(0.0, abs=1e-12)
    assert along.max() == pytest.approx(length)
    tip = mesh.vertices[np.argmax(along)]
    np.testing.assert_allclose(tip, start + vector)


def test_a_short_arrow_is_all_head_and_no_arrow_is_empty():
    thick = np.linalg.norm(arrow_mesh((0, 0, 0), (0, 0, 5), width=0.1).vertices[:, :2], axis=1).max()
    thin = np.linalg.norm(arrow_mesh((0, 0, 0), (0, 0, 0.1), width=0.1).vertices[:, :2], axis=1).max()
    assert thick == pytest.approx(0.12)
    assert 0.0 < thin < 0.5 * thick
    assert len(arrow_mesh((0, 0, 0), (0, 0, 0)).triangles) == 0


def test_ring_volume():
    mesh = ring_mesh((1, 2, 3), 2.0, (1, 1, 0), width=0.4, sides=200)
    assert is_closed(mesh)
    # A tube of ten sides has a little less than the volume of a round one, 2 pi^2 R r^2.
    ten_sides = 5 * np.sin(2 * np.pi / 10) / np.pi
    assert volume(mesh) == pytest.approx(2 * np.pi**2 * 2.0 * 0.2**2 * ten_sides, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("radius", lambda: sphere_mesh((0, 0, 0), 0.0)),
        ("subdivisions", lambda: sphere_mesh((0, 0, 0), 1.0, subdivisions=5)),
        ("centers", lambda: sphere_mesh((0, 0), 1.0)),
        ("colors", lambda: sphere_mesh((0, 0, 0), 1.0, colors=[(0, 0, 0), (0, 0, 0)])),
        ("size", lambda: box_mesh((1, 0, 1))),
        ("bevel", lambda: box_mesh((1, 1, 0.1), bevel=0.06)),
        ("orientation", lambda: box_mesh((1, 1, 1), orientation=(0, 0, 0, 2))),
        ("width", lambda: arrow_mesh((0, 0, 0), (0, 0, 1), width=0.0)),
        ("sides", lambda: arrow_mesh((0, 0, 0), (0, 0, 1), sides=2)),
        ("vector", lambda: arrow_mesh((0, 0, 0), (0, 0, np.nan))),
        ("direction", lambda: ring_mesh((0, 0, 0), 1.0, (0, 0, 0))),
        ("width", lambda: ring_mesh((0, 0, 0), 1.0, width=2.0)),
        ("radius", lambda: ring_mesh((0, 0, 0), -1.0)),
    ],
)
def test_bad_shapes(name, make):
    with pytest.raises(ValueError, match=name):
        make()


# To the micrometre: nearer points are taken for one.
PLACE = st.integers(-2_000_000, 2_000_000).map(lambda micrometres: 1e-6 * micrometres)


@given(st.lists(st.tuples(PLACE, PLACE, PLACE), min_size=2, max_size=6, unique=True))
def test_a_tube_keeps_its_distance_from_the_line(points):
    line = np.array(points)
    mesh = tube_mesh(line, width=0.2, sides=6)
    rings = mesh.vertices.reshape(-1, 6, 3)
    kept = line[np.concatenate([[True], np.linalg.norm(np.diff(line, axis=0), axis=1) > 1e-9])]
    if len(kept) < 2:
        assert len(mesh.triangles) == 0
        return
    np.testing.assert_allclose(rings.mean(axis=1), kept, atol=1e-9)
    assert np.linalg.norm(rings - kept[:, None], axis=-1).max() < 0.1 + 1e-9
    assert len(mesh.triangles) == 2 * 6 * (len(kept) - 1)


def test_a_straight_tube_is_a_cylinder_seen_from_outside():
    mesh = tube_mesh([(0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 3.0)], width=0.4, sides=12)
    np.testing.assert_allclose(np.hypot(*mesh.vertices[:, :2].T), 0.2, atol=1e-6)
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    middle = (a + b + c) / 3.0 * (1.0, 1.0, 0.0)
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), middle) > 0.0).all()


def test_a_tube_needs_points_of_three_numbers():
    with pytest.raises(ValueError, match="points must have the shape"):
        tube_mesh([(0.0, 1.0)])
    with pytest.raises(ValueError, match="width"):
        tube_mesh([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], width=0.0)
