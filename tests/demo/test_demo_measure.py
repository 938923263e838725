from __future__ import annotations

import numpy as np

from spatula_env.demo.measure import footprint, is_inside, surface_heights
from spatula_env.geometry import seed_sphere


def test_the_footprint_is_covered_evenly_and_without_its_rim() -> None:
    points = footprint(np.array([-1.0, 2.0]), np.array([1.0, 3.0]), count=4)
    assert points.shape == (16, 2)
    np.testing.assert_allclose(points.mean(axis=0), [0.0, 2.5])
    np.testing.assert_allclose(np.unique(points[:, 0]), [-0.75, -0.25, 0.25, 0.75])
    np.testing.assert_allclose(np.unique(points[:, 1]), [2.125, 2.375, 2.625, 2.875])


def test_heights_of_a_slope_and_beside_it() -> None:
    # z = x over the square 0..1, as two triangles.
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0], [0.0, 1.0, 0.0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    points = np.array([[0.25, 0.5], [0.5, 0.5], [0.9, 0.1], [1.5, 0.5]])
    heights = surface_heights(points, vertices, triangles)
    np.testing.assert_allclose(heights[:3], [0.25, 0.5, 0.9], atol=1e-12)
    assert np.isnan(heights[3])


def test_the_topmost_surface_counts() -> None:
    organ = seed_sphere()
    heights = surface_heights(np.array([[0.1, 0.2], [2.9, 2.9]]), organ.vertices, organ.triangles)
    assert 2.8 < heights[0] < 3.0
    assert np.isnan(heights[1])


def test_inside_and_outside_of_a_sphere() -> None:
    organ = seed_sphere()
    assert is_inside(np.array([0.1, 0.2, 0.0]), organ.vertices, organ.triangles)
    assert is_inside(np.array([0.1, 0.2, 2.7]), organ.vertices, organ.triangles)
    for outside in ([0.1, 0.2, 3.1], [0.1, 0.2, -3.1], [4.0, 0.0, 0.0]):
        assert not is_inside(np.array(outside), organ.vertices, organ.triangles)
