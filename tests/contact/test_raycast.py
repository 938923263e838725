"""One ray against every triangle: Möller and Trumbore's test, where the answer is known beforehand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_detector import Surface

from spatula_env.contact.raycast import cast_ray
from spatula_env.geometry import box_surface, icosphere, seed_sphere, torus

CORNERS = np.array([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [0.0, 2.0, 1.0]])
ONE = np.array([[0, 1, 2]], dtype=np.int32)
ORGANS = [seed_sphere(), icosphere(2.0, 2), torus(1.5, 0.5, 24, 12), box_surface((2.0, 1.5, 1.0), 0.3)]


def cast(origin, direction, vertices=CORNERS, triangles=ONE):
    return cast_ray(
        np.array(origin, dtype=np.float64),
        np.array(direction, dtype=np.float64),
        np.array(vertices, dtype=np.float64),
        np.array(triangles, dtype=np.int32),
    )


@pytest.mark.parametrize("length", [1.0, 0.25, 10.0])
def test_a_hit_in_the_middle(length):
    triangle, t, v, w, facing = cast((0.5, 0.75, 0.0), (0.0, 0.0, length))
    assert triangle == 0
    # Distances are in lengths of the direction; the normal of the triangle is +z.
    assert t == pytest.approx(1.0 / length, abs=1e-12)
    assert (v, w) == pytest.approx((0.25, 0.375), abs=1e-12)
    assert facing == 1.0


def test_the_side_of_a_hit():
    assert cast((0.5, 0.75, 2.0), (0.0, 0.0, -1.0))[4] == -1.0
    assert cast((0.5, 0.75, 2.0), (0.0, 0.0, -1.0), triangles=[[0, 2, 1]])[4] == 1.0


@pytest.mark.parametrize(
    ("origin", "direction"),
    [
        ((0.5, 0.75, 0.0), (0.0, 0.0, -1.0)),  # behind
        ((-0.1, 0.5, 0.0), (0.0, 0.0, 1.0)),  # outside the first edge
        ((0.5, -0.1, 0.0), (0.0, 0.0, 1.0)),  # outside the second
        ((1.1, 1.1, 0.0), (0.0, 0.0, 1.0)),  # outside the third
        ((-1.0, 0.5, 1.0), (1.0, 0.0, 0.0)),  # in the triangle's plane
        ((-1.0, 0.5, 0.5), (1.0, 0.0, 0.0)),  # parallel to it
    ],
)
def test_misses(origin, direction):
    triangle, t, _, _, facing = cast(origin, direction)
    assert triangle == -1
    assert t == np.inf
    assert facing == 0.0


def test_no_triangles():
    assert cast((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), triangles=np.zeros((0, 3)))[0] == -1


def test_an_oblique_hit():
    target = np.array([0.3, 0.4, 1.0])
    origin = np.array([5.0, -3.0, -2.0])
    triangle, t, v, w, _ = cast(origin, target - origin)
    assert triangle == 0
    assert t == pytest.approx(1.0, abs=1e-12)
    assert (v, w) == pytest.approx((0.15, 0.2), abs=1e-12)


def test_the_nearest_of_several():
    heights = [3.0, 1.0, 2.0, -1.0]
    vertices = np.concatenate([CORNERS + np.array([0.0, 0.0, height - 1.0]) for height in heights])
    triangles = np.arange(12).reshape(-1, 3)
    assert cast((0.5, 0.5, 0.0), (0.0, 0.0, 1.0), vertices, triangles)[0] == 1
    assert cast((0.5, 0.5, 1.5), (0.0, 0.0, 1.0), vertices, triangles)[0] == 2
    assert cast((0.5, 0.5, 0.0), (0.0, 0.0, -1.0), vertices, triangles)[0] == 3


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 2**32 - 1), st.integers(0, len(ORGANS) - 1))
def test_against_the_plain_form(seed, which):
    generator = np.random.default_rng(seed)
    organ = ORGANS[which]
    surface = Surface(organ.vertices, organ.triangles)
    for _ in range(10):
        origin, direction = 1.5 * generator.normal(size=3), generator.normal(size=3)
        triangle, t, v, w, facing = cast(origin, direction, organ.vertices, organ.triangles)
        expected, distance, weights = surface.cast(origin, direction)
        assert triangle == expected
        if expected >= 0:
            assert t == pytest.approx(distance, abs=1e-9)
            assert (v, w) == pytest.approx(tuple(weights[1:]), abs=1e-9)
            assert facing == np.sign(surface.normals[expected] @ direction)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0, 1, 3]))
def test_rays_through_edges_and_vertices_are_not_lost(seed, which):
    # From inside a convex body every ray leaves it, also one aimed exactly at a vertex or at a point of an edge.
    generator = np.random.default_rng(seed)
    organ = ORGANS[which]
    origin = generator.uniform(-0.3, 0.3, 3)
    chosen = organ.triangles[generator.integers(0, len(organ.triangles), 20)]
    fraction = generator.choice([0.0, 0.5, 0.25, generator.random()], 20)[:, None]
    targets = (1.0 - fraction) * organ.vertices[chosen[:, 0]] + fraction * organ.vertices[chosen[:, 1]]
    for target in targets:
        triangle, t, v, w, facing = cast(origin, target - origin, organ.vertices, organ.triangles)
        assert triangle >= 0
        assert t == pytest.approx(1.0, abs=1e-9)
        assert facing == 1.0
        corners = organ.vertices[organ.triangles[triangle]]
        np.testing.assert_allclose(np.array([1.0 - v - w, v, w]) @ corners, target, rtol=0.0, atol=1e-9)
