from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spatula_env.geometry.meshes import box_surface, icosphere, torus
from spatula_env.geometry.surface import (
    canonical_order,
    check_surface,
    connected_components,
    edges,
    signed_volume,
    surface_area,
    triangle_areas,
    triangle_normals,
    vertex_areas,
    winding_numbers,
)

TETRAHEDRON = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def join(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Several surfaces as one array of vertices and one of triangles."""
    start = np.cumsum([0, *[len(vertices) for vertices, _ in parts[:-1]]])
    return (
        np.concatenate([vertices for vertices, _ in parts]),
        np.concatenate([triangles + first for first, (_, triangles) in zip(start, parts, strict=True)]),
    )


def ball(radius: float, centre: float = 0.0, outward: bool = True) -> tuple[np.ndarray, np.ndarray]:
    organ = icosphere(radius, 1)
    return organ.vertices + np.array([centre, 0.0, 0.0]), organ.triangles if outward else organ.triangles[:, ::-1]


def test_valid_surface_comes_back_unchanged_as_copies():
    vertices, triangles = check_surface(TETRAHEDRON.tolist(), FACES.tolist())
    assert vertices.dtype == np.float64
    assert triangles.dtype == np.int32
    np.testing.assert_array_equal(vertices, TETRAHEDRON)
    np.testing.assert_array_equal(triangles, FACES)
    again, _ = check_surface(vertices, triangles)
    again[0] = 5.0
    np.testing.assert_array_equal(vertices, TETRAHEDRON)


@pytest.mark.parametrize("organ", [icosphere(2.0, 2), torus(), box_surface((1.0, 2.0, 0.01), 0.4)])
def test_valid_shapes_pass(organ):
    check_surface(organ.vertices, organ.triangles)


@pytest.mark.parametrize(
    ("vertices", "triangles", "message"),
    [
        (TETRAHEDRON[:, :2], FACES, r"vertices must have shape \(V, 3\), got \(4, 2\)"),
        (TETRAHEDRON.ravel(), FACES, r"vertices must have shape \(V, 3\), got \(12,\)"),
        ([[0.0, 1.0, 2.0], [1.0]], FACES, "vertices must be an array of numbers"),
        (TETRAHEDRON, FACES[:, :2], r"triangles must have shape \(T, 3\), got \(4, 2\)"),
        (TETRAHEDRON, [[0, 1, 2], [0, 1]], "triangles must be an array of integers"),
        (TETRAHEDRON, FACES[:3], "at least 4 triangles, got 3 triangles"),
        (TETRAHEDRON, np.zeros((0, 3), dtype=int), "at least 4 triangles, got 0 triangles"),
        (TETRAHEDRON, FACES.astype(float), "triangles must be integers, got float64"),
        (TETRAHEDRON, np.ones((4, 3), dtype=bool), "triangles must be integers, got bool"),
    ],
)
def test_wrong_arrays_are_refused(vertices, triangles, message):
    with pytest.raises(ValueError, match=f"surface 'organ'.*{message}"):
        check_surface(vertices, triangles)


def test_vertices_that_are_not_finite():
    vertices = TETRAHEDRON.copy()
    vertices[1, 0], vertices[3, 2] = np.nan, np.inf
    with pytest.raises(ValueError, match=r"2 vertices of 4 not finite, first vertex 1: \[nan, 0.0, 0.0\]"):
        check_surface(vertices, FACES)


@pytest.mark.parametrize("index", [4, -1, 2**40])
def test_indices_out_of_range(index):
    triangles = FACES.astype(np.int64)
    triangles[2, 1] = index
    with pytest.raises(ValueError, match=rf"1 triangle of 4 with indices outside 0\.\.3, first triangle 2: .*{index}"):
        check_surface(TETRAHEDRON, triangles)


@pytest.mark.parametrize(("scale", "diagonal"), [(1e-4, "0.000173"), (1e4, "17320")])
def test_size_out_of_limits(scale, diagonal):
    with pytest.raises(ValueError, match=rf"0.001 to 1000 u across.*diagonal of {diagonal}.*scale it"):
        check_surface(TETRAHEDRON * scale, FACES)
    check_surface(TETRAHEDRON * scale, FACES, smallest=1e-5, largest=1e5)


def test_vertices_of_no_triangle():
    with pytest.raises(ValueError, match="2 vertices of no triangle, first vertex 4"):
        check_surface(np.concatenate([TETRAHEDRON, [[2.0, 0.0, 0.0], [3.0, 0.0, 0.0]]]), FACES)


def test_duplicate_vertices():
    vertices = np.concatenate([TETRAHEDRON, [[-0.0, 0.0, 1.0]]])
    triangles = FACES.copy()
    triangles[3] = [0, 4, 2]
    with pytest.raises(ValueError, match="1 duplicate vertex, first vertex 4 at the position of vertex 3"):
        check_surface(vertices, triangles)


def test_triangle_that_repeats_a_vertex():
    with pytest.raises(ValueError, match=r"1 degenerate triangle, first triangle 4: \[1, 1, 2\] repeats a vertex"):
        check_surface(TETRAHEDRON, np.concatenate([FACES, [[1, 1, 2]]]))


@pytest.mark.parametrize("scale", [1e-2, 1.0, 1e2])
def test_triangles_without_area(scale):
    # Vertex 4 is in the middle of edge 0-1, which leaves triangle 0 1 4 flat but the surface closed.
    vertices = np.concatenate([TETRAHEDRON, [[0.5, 0.0, 0.0]]]) * scale
    triangles = np.array([[0, 2, 1], [0, 1, 4], [0, 4, 3], [4, 1, 3], [1, 2, 3], [0, 3, 2]])
    with pytest.raises(ValueError, match=r"1 degenerate triangle, first triangle 1: \[0, 1, 4\] has no area"):
        check_surface(vertices, triangles)


@pytest.mark.parametrize(("removed", "count", "edge"), [([0], 3, r"\d+ and \d+"), ([0, 40], 6, r"\d+ and \d+")])
def test_holes(removed, count, edge):
    organ = icosphere(1.0, 1)
    triangles = np.delete(organ.triangles, removed, axis=0)
    with pytest.raises(ValueError, match=f"'liver.obj' is open: {count} boundary edges, first between vertices {edge}"):
        check_surface(organ.vertices, triangles, "liver.obj")


def test_boundary_edge_is_named():
    pyramid = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.5, 0.5, 1.0]])
    sides = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    with pytest.raises(ValueError, match="is open: 4 boundary edges, first between vertices 0 and 1"):
        check_surface(pyramid, sides)


def test_edges_of_more_than_two_triangles():
    # A second tetrahedron on the other side of edge 0-1.
    vertices = np.concatenate([TETRAHEDRON, [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]])
    other = np.array([[0, 4, 1], [0, 1, 5], [1, 4, 5], [0, 5, 4]])
    with pytest.raises(ValueError, match="not a manifold: 1 edge, first between vertices 0 and 1"):
        check_surface(vertices, np.concatenate([FACES, other]))


def test_triangles_named_twice():
    with pytest.raises(ValueError, match="not a manifold: 3 edges, first between vertices 0 and 1"):
        check_surface(TETRAHEDRON, np.concatenate([FACES, FACES[:1]]))


def test_one_triangle_wound_the_wrong_way():
    triangles = FACES.copy()
    triangles[2] = triangles[2, ::-1]
    with pytest.raises(ValueError, match="wound inconsistently: 3 edges, first between vertices 1 and 2"):
        check_surface(TETRAHEDRON, triangles)


def test_inside_out():
    with pytest.raises(ValueError, match=r"inside-out: signed volume -0.166667 u3; reverse the winding"):
        check_surface(TETRAHEDRON, FACES[:, ::-1])


def test_inside_out_far_from_the_origin():
    with pytest.raises(ValueError, match=r"inside-out: signed volume -0.166667"):
        check_surface(TETRAHEDRON + 500.0, FACES[:, ::-1])


def test_surface_without_volume():
    # Two layers of the same square, one vertex apart so that no vertices coincide.
    vertices = np.array(
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.5, 0.5, 0.0], [0.4, 0.5, 0.0]]
    )
    rim = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    upper = np.column_stack([rim, np.full(4, 4)])
    lower = np.column_stack([rim[:, ::-1], np.full(4, 5)])
    with pytest.raises(ValueError, match="encloses no volume in 1 of 1 component"):
        check_surface(vertices, np.concatenate([upper, lower]))


def test_several_components():
    check_surface(*join(ball(1.0), ball(1.0, 3.0)))
    vertices, triangles = join(ball(1.0), ball(0.5, 3.0, outward=False), ball(0.5, 6.0))
    with pytest.raises(ValueError, match=r"1 of 3 components inside-out, first with triangle 80: .* outwards"):
        check_surface(vertices, triangles)


def test_cavities():
    check_surface(*join(ball(2.0), ball(0.5, 0.7, outward=False)))
    # An island in a cavity is material again.
    check_surface(*join(ball(3.0), ball(2.0, outward=False), ball(1.0)))
    with pytest.raises(ValueError, match=r"1 of 2 components inside-out, .* cavity and must be wound inwards"):
        check_surface(*join(ball(2.0), ball(0.5, 0.7)))


def test_components_that_share_a_vertex_are_judged_one_by_one():
    # The cavity touches the outer surface in a vertex, where the winding number is neither 0 nor 1.
    inner = np.array([[0.5, 0.2, 0.2], [0.2, 0.5, 0.2], [0.2, 0.2, 0.5]])
    vertices = np.concatenate([TETRAHEDRON * 2.0, inner])
    other = np.where(FACES == 0, 0, FACES + 3)
    check_surface(vertices, np.concatenate([FACES, other[:, ::-1]]))
    with pytest.raises(ValueError, match="1 of 2 components inside-out, first with triangle 4"):
        check_surface(vertices, np.concatenate([FACES, other]))

    mirrored = np.array([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    vertices = np.concatenate([TETRAHEDRON * 2.0, mirrored])
    check_surface(vertices, np.concatenate([FACES, other[:, ::-1]]))
    with pytest.raises(ValueError, match="1 of 2 components inside-out, first with triangle 4"):
        check_surface(vertices, np.concatenate([FACES, other]))


def test_measures_of_the_tetrahedron():
    slanted = np.sqrt(3.0) / 2.0
    np.testing.assert_allclose(triangle_areas(TETRAHEDRON, FACES), [0.5, 0.5, slanted, 0.5])
    assert surface_area(TETRAHEDRON, FACES) == pytest.approx(1.5 + slanted)
    assert signed_volume(TETRAHEDRON, FACES) == pytest.approx(1.0 / 6.0)
    assert signed_volume(TETRAHEDRON, FACES[:, ::-1]) == pytest.approx(-1.0 / 6.0)
    expected = [[0.0, 0.0, -1.0], [0.0, -1.0, 0.0], np.ones(3) / np.sqrt(3.0), [-1.0, 0.0, 0.0]]
    np.testing.assert_allclose(triangle_normals(TETRAHEDRON, FACES), expected, atol=1e-12)
    np.testing.assert_allclose(vertex_areas(TETRAHEDRON, FACES), [1.5, *[1.0 + slanted] * 3])
    assert edges(FACES).tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]


def test_volume_keeps_its_digits_far_from_the_origin():
    assert signed_volume(TETRAHEDRON + 1e7, FACES) == pytest.approx(1.0 / 6.0, rel=1e-12)


def test_normal_of_a_triangle_without_area_is_zero():
    assert triangle_normals(TETRAHEDRON, np.array([[0, 1, 1]])).tolist() == [[0.0, 0.0, 0.0]]


def test_measures_of_curved_shapes_converge():
    ring = torus(2.0, 0.5, 192, 96)
    assert ring.volume == pytest.approx(2.0 * np.pi**2 * 2.0 * 0.25, rel=2e-3)
    assert ring.area == pytest.approx(4.0 * np.pi**2 * 2.0 * 0.5, rel=2e-3)
    sphere = icosphere(3.0, 4)
    assert sphere.volume == pytest.approx(36.0 * np.pi, rel=5e-3)
    assert sphere.area == pytest.approx(36.0 * np.pi, rel=5e-3)


@pytest.mark.parametrize(("organ", "euler"), [(icosphere(1.0, 2), 2), (box_surface(), 2), (torus(), 0)])
def test_edges_by_the_euler_characteristic(organ, euler):
    assert len(organ.vertices) - len(edges(organ.triangles)) + len(organ.triangles) == euler


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_canonical_order_undoes_any_shuffle_but_not_a_flip(seed):
    generator = np.random.default_rng(seed)
    triangles = canonical_order(icosphere(1.0, 1).triangles)
    shuffled = generator.permutation(triangles)
    shift = generator.integers(0, 3, size=(len(shuffled), 1))
    shuffled = np.take_along_axis(shuffled, (np.arange(3) + shift) % 3, axis=1)
    np.testing.assert_array_equal(canonical_order(shuffled), triangles)
    assert not np.array_equal(canonical_order(shuffled[:, ::-1]), triangles)


def test_components_are_labelled_in_order_of_appearance():
    _, triangles = join(ball(1.0), ball(1.0, 3.0), ball(1.0, 6.0))
    order = np.random.default_rng(0).permutation(len(triangles))
    owner = order // 80
    label = connected_components(triangles[order])
    first = [np.argmax(label == k) for k in range(3)]
    assert first == sorted(first)
    for k in range(3):
        assert (owner[label == k] == owner[first[k]]).all()
    assert connected_components(FACES).tolist() == [0, 0, 0, 0]


def test_components_of_a_long_strip():
    count = 3000
    index = np.random.default_rng(1).permutation(count + 2)
    strip = index[np.arange(count)[:, None] + np.arange(3)]
    assert connected_components(strip).max() == 0


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_winding_number_tells_inside_from_outside(seed):
    organ = torus(2.0, 0.5, 24, 12)
    points = np.random.default_rng(seed).uniform(-3.0, 3.0, size=(40, 3))
    distance = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 2.0, points[:, 2])
    # Where the hole is, chords of its circle lie outside of the tube that the facets stand for.
    clear = (distance < 0.45) | (distance > 0.52)
    numbers = winding_numbers(points[clear], organ.vertices, organ.triangles)
    np.testing.assert_allclose(numbers, distance[clear] < 0.5, atol=1e-9)
    flipped = winding_numbers(points[clear], organ.vertices, organ.triangles[:, ::-1])
    np.testing.assert_allclose(flipped, -numbers, atol=1e-9)
