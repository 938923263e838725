from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.geometry import box_surface, icosphere
from spatula_env.tasks.surface import farthest_points, surface_heights, surface_samples

GROUND = -7.0


def as_places(*places: tuple[float, float]) -> np.ndarray:
    return np.array(places, dtype=np.float64)


@given(st.floats(-0.99, 0.99), st.floats(-0.49, 0.49))
def test_a_box_is_as_high_everywhere_as_its_top(x: float, y: float) -> None:
    box = box_surface((2.0, 1.0, 3.0), spacing=0.5)
    heights = surface_heights(np.array(box.vertices[None]), np.array(box.triangles), as_places((x, y)), GROUND)
    assert heights == pytest.approx([1.5], abs=1e-12)


def test_the_ground_is_seen_beside_the_organ() -> None:
    box = box_surface((2.0, 1.0, 3.0), spacing=0.5)
    places = as_places((1.2, 0.0), (0.0, 0.0), (0.0, -0.6))
    heights = surface_heights(np.array(box.vertices[None]), np.array(box.triangles), places, GROUND)
    assert heights == pytest.approx([GROUND, 1.5, GROUND], abs=1e-12)


def test_heights_of_a_sphere_follow_its_equation() -> None:
    sphere = icosphere(0.06, subdivisions=4)
    places = as_places((0.0, 0.0), (0.02, 0.01), (-0.03, 0.03))
    heights = surface_heights(np.array(sphere.vertices[None]), np.array(sphere.triangles), places, GROUND)
    expected = np.sqrt(0.06**2 - (places**2).sum(axis=1))
    # Flat triangles lie a little inside the sphere.
    assert heights == pytest.approx(expected, abs=2e-4)
    assert (heights <= expected + 1e-12).all()


def test_every_world_has_its_own_surface() -> None:
    box = box_surface((2.0, 2.0, 2.0), spacing=1.0)
    lifts = np.array([0.0, 0.25, -3.0])
    nodes = box.vertices[None] + lifts[:, None, None] * [0.0, 0.0, 1.0]
    places = np.full((3, 2), 0.3)
    heights = surface_heights(nodes, np.array(box.triangles), places, GROUND)
    assert heights == pytest.approx(1.0 + lifts)


def test_the_uppermost_of_several_layers_is_measured() -> None:
    box = box_surface((2.0, 2.0, 2.0), spacing=1.0)
    nodes = np.concatenate([box.vertices, box.vertices + np.array([0.0, 0.0, 5.0])])
    triangles = np.concatenate([box.triangles, box.triangles + len(box.vertices)]).astype(np.int32)
    assert surface_heights(nodes[None], triangles, as_places((0.1, 0.2)), GROUND) == pytest.approx([6.0])


def test_farthest_points_of_a_line_start_at_the_top_and_halve_the_gaps() -> None:
    line = np.column_stack([np.zeros(9), np.zeros(9), np.arange(9.0)])
    assert farthest_points(line, 4).tolist() == [8, 0, 4, 2]


@given(st.integers(0, 2**32 - 1), st.integers(1, 30))
def test_farthest_points_are_different_and_spread(seed: int, count: int) -> None:
    points = np.random.default_rng(seed).normal(size=(30, 3))
    chosen = farthest_points(points, count)
    assert len(set(chosen.tolist())) == count
    assert chosen[0] == np.argmax(points[:, 2])
    # Each choice lies no farther from those before it than the choice before did.
    gaps = [np.linalg.norm(points[chosen[:k]] - points[chosen[k]], axis=1).min() for k in range(1, count)]
    assert all(a >= b for a, b in pairwise(gaps))


@pytest.mark.parametrize("count", [0, 5])
def test_farthest_points_refuses_impossible_counts(count: int) -> None:
    with pytest.raises(ValueError, match=f"count must be from 1 to 4, the number of points, got {count}"):
        farthest_points(np.zeros((4, 3)), count)


def test_samples_are_spread_by_area_and_always_the_same() -> None:
    sphere = icosphere(1.0, subdivisions=3)
    chosen, weights = surface_samples(sphere.vertices, sphere.triangles, 400)
    assert chosen.shape == (400,)
    assert weights.sum(axis=1) == pytest.approx(np.ones(400))
    assert (weights >= 0.0).all()
    points = np.einsum("pka,pk->pa", sphere.vertices[sphere.triangles[chosen]], weights)
    # Half of them lie on each half of the sphere, whichever way it is cut.
    assert (points > 0.0).mean(axis=0) == pytest.approx(np.full(3, 0.5), abs=0.03)
    again = surface_samples(sphere.vertices, sphere.triangles, 400)
    assert again[0].tolist() == chosen.tolist()
    # A triangle gets as many as its area deserves.
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [9.0, 0.0, 0.0]])
    chosen, _ = surface_samples(vertices, [[0, 1, 2], [1, 3, 2]], 900)
    assert (chosen == 0).sum() == pytest.approx(100, abs=3)
