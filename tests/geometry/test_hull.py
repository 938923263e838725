from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from spatula_env.geometry.hull import convex_hull
from spatula_env.geometry.surface import check_surface, signed_volume, triangle_normals
from spatula_env.geometry.transforms import random_quaternion, rotate


def check_hull(points: np.ndarray, tolerance: float = 1e-9) -> np.ndarray:
    """Check a hull against its definition and against SciPy's, and return its triangles."""
    triangles = convex_hull(points)
    extent = np.ptp(points, axis=0).max()
    used, renamed = np.unique(triangles, return_inverse=True)
    check_surface(points[used], renamed.reshape(-1, 3), smallest=0.0, largest=np.inf)
    normals = triangle_normals(points, triangles)
    heights = points @ normals.T - np.einsum("ij,ij->i", normals, points[triangles[:, 0]])
    assert heights.max() <= tolerance * extent
    reference = ConvexHull(points)
    assert signed_volume(points, triangles) == pytest.approx(reference.volume, abs=tolerance * extent**3)
    return triangles


def grid(*counts: int) -> np.ndarray:
    axes = np.meshgrid(*[np.linspace(0.0, 1.0, count) for count in counts], indexing="ij")
    return np.stack(axes, axis=-1).reshape(-1, 3)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(4, 60))
def test_hull_of_random_points(seed, count):
    check_hull(np.random.default_rng(seed).normal(size=(count, 3)))


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(2, 5), st.sampled_from([1.0, 0.125, 0.01]))
def test_hull_of_a_turned_grid_is_the_box(seed, count, thickness):
    # Most points lie in the middle of faces and edges, off them by rounding alone.
    generator = np.random.default_rng(seed)
    points = rotate(random_quaternion(generator), grid(count, count + 1, 3) * [1.0, 2.0, thickness])
    points += generator.normal(scale=10.0, size=3)
    triangles = check_hull(points)
    assert signed_volume(points, triangles) == pytest.approx(2.0 * thickness)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(3, 9))
def test_hull_of_integer_points_with_many_ties(seed, count):
    points = np.random.default_rng(seed).integers(0, 4, size=(4 * count, 3)).astype(float)
    if np.linalg.matrix_rank(points - points[0]) == 3:
        check_hull(points)


def test_hull_of_points_far_from_the_origin():
    # Coordinates are rounded to 1e-8 there, so a thousandth of that would be no tolerance at all.
    points = rotate(random_quaternion(np.random.default_rng(3)), grid(6, 6, 6)) + 1e8
    triangles = convex_hull(points)
    assert signed_volume(points, triangles) == pytest.approx(1.0, rel=1e-6)
    assert len(np.unique(triangles)) < 20


def test_hull_of_many_points_on_a_sphere_uses_them_all():
    points = np.random.default_rng(1).normal(size=(1000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    triangles = check_hull(points)
    assert len(triangles) == 2 * 1000 - 4


def test_hull_of_a_tetrahedron_in_canonical_order():
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    triangles = convex_hull(points)
    assert triangles.tolist() == [[0, 1, 3], [0, 2, 1], [0, 3, 2], [1, 2, 3]]
    assert triangles.dtype == np.int32


def test_hull_does_not_depend_on_the_order_of_the_points():
    generator = np.random.default_rng(2)
    points = generator.normal(size=(40, 3))
    shuffle = generator.permutation(40)
    faces = {frozenset(triangle) for triangle in convex_hull(points).tolist()}
    shuffled = {frozenset(triangle) for triangle in shuffle[convex_hull(points[shuffle])].tolist()}
    assert faces == shuffled


def test_inner_and_repeated_points_are_left_out():
    points = np.concatenate([grid(2, 2, 2), grid(2, 2, 2), [[0.5, 0.5, 0.5], [0.5, 0.5, 1.0]]])
    assert len(np.unique(convex_hull(points))) == 8


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((3, 3)), r"shape \(n, 3\) with n >= 4, got \(3, 3\)"),
        (np.zeros((5, 2)), "shape"),
        (np.zeros((5, 3)), "span a volume"),
        (np.outer(np.arange(5.0), [1.0, 2.0, 3.0]), "span a volume"),
        (grid(3, 3, 1) @ rotate(random_quaternion(np.random.default_rng(0)), np.eye(3)), "span a volume"),
        (np.full((5, 3), np.nan), "finite"),
    ],
)
def test_points_without_a_hull_are_refused(points, message):
    with pytest.raises(ValueError, match=message):
        convex_hull(points)
