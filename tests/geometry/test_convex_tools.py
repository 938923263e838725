from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from spatula_env.geometry import Tool, icosphere
from spatula_env.geometry.surface import signed_volume
from spatula_env.geometry.transforms import random_quaternion, rotate

CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
WEDGE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 0.1], [0, 1, 0.1]], dtype=float)
seeds = st.integers(0, 2**32 - 1)


def random_points(seed: int, count: int = 12) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3))


def check_nodes(tool: Tool, points: np.ndarray) -> None:
    """Check the nodes of a tool against the hull of the points it was made of, by SciPy's planes."""
    planes = ConvexHull(points).equations
    extent = np.ptp(points, axis=0).max()
    heights = tool.nodes @ planes[:, :3].T + planes[:, 3]
    np.testing.assert_allclose(heights.max(axis=1), 0.0, atol=2e-6 * extent)  # on the surface
    matching = tool.normals @ planes[:, :3].T > 1.0 - 1e-9
    own = np.where(matching, np.abs(heights), np.inf)
    assert own.min(axis=1).max() < 2e-6 * extent  # on a plane whose normal is the node's

    np.testing.assert_array_equal(tool.opposite[tool.opposite], np.arange(len(tool.nodes)))
    across = tool.nodes[tool.opposite] - tool.nodes
    # One of two opposite nodes casts the ray that the other ends.
    inward = np.einsum("ij,ij->i", across, -tool.normals)
    off_ray = np.linalg.norm(across + inward[:, None] * tool.normals, axis=1)
    assert np.minimum(off_ray, off_ray[tool.opposite]).max() < 1e-9 * extent
    assert (inward > 0.0).all()
    assert (np.bincount(tool.face, minlength=len(tool.face_normals)) > 0).all()
    assert tool.areas.sum() == pytest.approx(ConvexHull(points).area)


@settings(deadline=None, max_examples=50)
@given(seeds, st.integers(4, 20), st.floats(0.1, 5.0))
def test_random_polytopes(seed, count, spacing):
    points = random_points(seed, count)
    tool = Tool.convex(points, spacing)
    check_nodes(tool, points)
    assert signed_volume(tool.vertices, tool.triangles) == pytest.approx(ConvexHull(points).volume)


@settings(deadline=None, max_examples=50)
@given(seeds, st.sampled_from([1.0, 0.125, 0.01]), st.booleans())
def test_turned_plates_are_sampled_face_against_face(seed, thickness, single_precision):
    generator = np.random.default_rng(seed)
    points = rotate(random_quaternion(generator), CUBE * [1.0, 1.0, thickness]) + generator.normal(size=3)
    if single_precision:
        points = points.astype(np.float32).astype(np.float64)
    tool = Tool.convex(points, 0.2)
    check_nodes(tool, points)
    assert len(tool.face_normals) == 6
    assert tool.thickness == pytest.approx(thickness, rel=1e-4)
    # Each pair of parallel faces carries one lattice and its shadow.
    counts = [len(tool.face_nodes(face)) for face in range(6)]
    assert counts[:2] == [25, 25]
    assert counts[2:] == [5 * (1 if thickness < 0.2 else 5)] * 4
    np.testing.assert_allclose(tool.normals[tool.opposite], -tool.normals, atol=1e-4)


def test_convex_cube_has_the_lattice_of_cell_middles():
    tool = Tool.convex(CUBE, 0.25)
    top = tool.nodes[tool.nodes[:, 2] > 0.499]
    assert len(top) == 16
    np.testing.assert_allclose(np.unique(top[:, :2].round(12)), [-0.375, -0.125, 0.125, 0.375])
    np.testing.assert_allclose(tool.areas, 1.0 / 16.0)


def test_points_in_the_middle_of_faces_do_not_matter():
    axes = np.meshgrid(*[np.linspace(-0.5, 0.5, 5)] * 3, indexing="ij")
    tool = Tool.convex(np.stack(axes, axis=-1).reshape(-1, 3), 0.25)
    assert len(tool.face_normals) == 6
    assert len(tool.nodes) == 96
    expected = np.sort(Tool.convex(CUBE, 0.25).nodes, axis=0)
    np.testing.assert_allclose(np.sort(tool.nodes, axis=0), expected, atol=1e-12)


@pytest.mark.parametrize("cut", [1e-8, 1e-7, 3e-7, 5e-7, 7e-7, 9e-7, 1.1e-6, 2e-6])
def test_edge_cut_off_by_next_to_nothing_leaves_the_faces_apart(cut):
    sharp = np.array([corner for corner in CUBE if corner[0] < 0.0 or corner[2] < 0.0])
    blunt = [[0.5 - x, y, 0.5 - z] for y in (-0.5, 0.5) for x, z in ((cut, 0.0), (0.0, cut))]
    tool = Tool.convex(np.concatenate([sharp, blunt]), 0.25)
    normals = [normal for normal in tool.face_normals if np.abs(normal).max() > 0.9]
    assert len(normals) == 6
    np.testing.assert_allclose(np.sort(np.abs(normals), axis=1), [[0.0, 0.0, 1.0]] * 6, atol=1e-5)
    assert len(tool.face_normals) == 6 or cut > 6e-7


def test_wedge():
    tool = Tool.convex(WEDGE, 0.2)
    check_nodes(tool, WEDGE)
    assert len(tool.face_normals) == 5
    # The slanted face is the largest, then the bottom. They are not parallel: each has its own lattice.
    slanted = np.array([0.1, 0.0, 1.0]) / np.hypot(0.1, 1.0)
    np.testing.assert_allclose(tool.face_normals[:2], [slanted, [0.0, 0.0, -1.0]], atol=1e-12)
    assert tool.thickness == pytest.approx(0.1 / np.hypot(0.1, 1.0))
    # Nodes reach into the thin edge.
    assert tool.nodes[tool.face_nodes(0), 0].max() > 0.85
    assert all((tool.nodes[tool.normals[:, 1] == side, 0]).max() > 0.85 for side in (-1.0, 1.0))


def test_frustum_samples_the_smaller_of_two_parallel_faces_through_the_larger():
    base = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=float)
    top = base * [0.6, 0.6, 0.0] + [0.0, 0.0, 0.5]
    points = np.concatenate([base, top])
    tool = Tool.convex(points, 0.4)
    check_nodes(tool, points)
    upper = np.flatnonzero(tool.normals[:, 2] > 0.999)
    assert len(upper) == 9  # of the 25 rays of the base, those within the top
    assert (tool.normals[tool.opposite[upper], 2] < -0.999).all()
    # The other 16 end on the slanted sides, whose own rays all end on the base.
    below = np.flatnonzero(tool.normals[:, 2] < -0.999)
    cells = tool.nodes[below, :2] / 0.4
    assert (np.abs(cells - np.round(cells)) < 1e-9).all(axis=1).sum() == 25
    assert (tool.normals[tool.opposite[below], 2] > 0.0).all()


def test_small_face_that_every_ray_misses_still_gets_a_node():
    base = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=float)
    top = base * [0.01, 0.01, 0.0] + [0.0, 0.0, 0.5]
    points = np.concatenate([base, top])
    tool = Tool.convex(points, 1.0)
    check_nodes(tool, points)
    upper = np.flatnonzero(tool.normals[:, 2] > 0.999)
    np.testing.assert_allclose(tool.nodes[upper], [[0.0, 0.0, 0.5]], atol=1e-12)
    np.testing.assert_allclose(tool.nodes[tool.opposite[upper]], [[0.0, 0.0, 0.0]], atol=1e-12)


@settings(deadline=None, max_examples=25)
@given(seeds, st.floats(0.1, 1.0))
def test_no_place_on_a_face_is_far_from_a_node(seed, spacing):
    points = random_points(seed, 8)
    tool = Tool.convex(points, spacing)
    generator = np.random.default_rng(seed)
    for triangle in tool.triangles:
        corners = tool.vertices[triangle]
        places = generator.dirichlet(np.ones(3), size=20) @ corners
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normal /= np.linalg.norm(normal)
        # Also the nodes where rays of other faces end, and those of an opposite parallel face, count.
        own = tool.nodes[tool.normals @ normal > 1.0 - 1e-9]
        apart = np.linalg.norm(places[:, None] - own, axis=2).min(axis=1)
        # Half a strip across, half a part along, and at a tip the rest of the strip.
        assert apart.max() <= 1.5 * spacing


def test_round_tool():
    points = icosphere(0.5, 2).vertices
    tool = Tool.convex(points, 0.1)
    check_nodes(tool, points)
    assert tool.thickness == pytest.approx(1.0, rel=0.05)
    assert tool.bounding_radius == pytest.approx(0.5)


@settings(deadline=None, max_examples=25)
@given(seeds)
def test_convex_contains(seed):
    points = random_points(seed)
    tool = Tool.convex(points, 1.0)
    places = np.random.default_rng(seed).uniform(-2.0, 2.0, size=(200, 3))
    planes = ConvexHull(points).equations
    heights = (places @ planes[:, :3].T + planes[:, 3]).max(axis=1)
    clear = np.abs(heights) > 1e-5
    np.testing.assert_array_equal(tool.contains(places)[clear], heights[clear] < 0.0)


def test_faces_from_the_largest_to_the_smallest():
    tool = Tool.convex(CUBE * [1.0, 2.0, 3.0], 0.5)
    areas = [tool.areas[tool.face_nodes(face)].sum() for face in range(6)]
    np.testing.assert_allclose(areas, [6.0, 6.0, 3.0, 3.0, 2.0, 2.0])
    assert (np.diff(tool.face) >= 0).all()


@settings(deadline=None, max_examples=60)
@given(seeds, st.sampled_from([1e-12, 1e-10, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4]))
def test_rough_coordinates_do_not_break_a_tool(seed, noise):
    axes = np.meshgrid(*[np.linspace(0.0, 1.0, 4)] * 3, indexing="ij")
    points = np.stack(axes, axis=-1).reshape(-1, 3) * [1.0, 1.0, 0.05]
    points += np.random.default_rng(seed).normal(scale=noise, size=points.shape)
    tool = Tool.convex(points, 0.2)
    assert signed_volume(tool.vertices, tool.triangles) == pytest.approx(0.05, rel=200.0 * noise + 1e-4)
    np.testing.assert_array_equal(tool.opposite[tool.opposite], np.arange(len(tool.nodes)))
    if noise <= 1e-8:
        assert len(tool.face_normals) == 6


@pytest.mark.parametrize(
    ("points", "spacing", "message"),
    [
        (CUBE, 0.0, "node_spacing must be positive and finite, got 0.0"),
        (CUBE, np.inf, "node_spacing must be positive"),
        (CUBE, 1e-5, r"at most 100000 nodes, this lattice has about 6e\+10"),
        (CUBE[:3], 0.2, r"vertices of tool 'convex': .* n >= 4, got \(3, 3\)"),
        (CUBE[:4], 0.2, "vertices of tool 'convex': points must span a volume"),
        (CUBE * np.nan, 0.2, "finite"),
    ],
)
def test_impossible_tools_are_refused(points, spacing, message):
    with pytest.raises(ValueError, match=message):
        Tool.convex(points, spacing)
