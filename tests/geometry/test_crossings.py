"""Where a surface crosses itself."""

from __future__ import annotations

import numpy as np
import pytest
from intersections import self_intersections

from spatula_env.geometry import (
    Organ,
    box_surface,
    crossings,
    fissured_block,
    icosphere,
    ridged_block,
    seed_sphere,
    torus,
)
from spatula_env.geometry.crossings import self_crossings

BALL = icosphere(1.0, 2)


def pulled(node: int, factor: float = -2.0) -> np.ndarray:
    """Vertices of a coarse sphere, one of which is pulled through the far side."""
    vertices = np.array(icosphere(1.0, 1).vertices)
    vertices[node] *= factor
    return vertices


@pytest.mark.parametrize(
    "organ",
    [BALL, torus(), seed_sphere(), box_surface((1.0, 2.0, 3.0), 0.5), ridged_block(), fissured_block()],
    ids=lambda organ: organ.name,
)
def test_what_surfaces_are_made_of_here_does_not_cross(organ: Organ) -> None:
    assert self_crossings(organ.vertices, organ.triangles).shape == (0, 5)


# By symmetry edges go through others, or through vertices, and not through the insides of triangles.
@pytest.mark.parametrize("node", range(42))
def test_a_vertex_that_is_pulled_through_the_far_side_is_found(node: int) -> None:
    triangles = icosphere(1.0, 1).triangles
    found = self_crossings(pulled(node), triangles)
    assert len(found) > 0
    assert (found == node).any()
    assert len(self_crossings(pulled(node, -0.5), triangles)) == 0


@pytest.mark.parametrize("most", [1, 1000, 500_000])
@pytest.mark.parametrize("noise", [0.02, 0.1, 0.3])
def test_crossings_are_those_that_a_search_of_all_pairs_finds(
    noise: float, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(crossings, "MOST_PAIRS", most)
    total = 0
    for seed in range(5):
        vertices = BALL.vertices + np.random.default_rng(seed).normal(0.0, noise, BALL.vertices.shape)
        found = self_crossings(vertices, BALL.triangles)
        assert len(np.unique(found, axis=0)) == len(found)
        assert len(found) == len(self_intersections(vertices, BALL.triangles))
        total += len(found)
    assert (total > 0) == (noise > 0.05)


@pytest.mark.parametrize(("distance", "crosses"), [(2.5, False), (1.5, True), (0.0, True)])
def test_parts_that_go_through_each_other_cross(distance: float, crosses: bool) -> None:
    other = BALL.vertices * [1.0, 0.5, 1.5] + [distance, 0.01, 0.02]
    vertices = np.concatenate([BALL.vertices, other])
    triangles = np.concatenate([BALL.triangles, BALL.triangles + len(other)])
    assert (len(self_crossings(vertices, triangles)) > 0) == crosses


def test_boxes_that_touch_each_other_are_found() -> None:
    box = box_surface((1.0, 1.0, 1.0), 0.5)
    vertices = np.concatenate([box.vertices, box.vertices + np.array([0.13, 0.07, 1.0])])
    triangles = np.concatenate([box.triangles, box.triangles + len(box.vertices)])
    assert len(self_crossings(vertices, triangles)) > 0
    vertices[len(box.vertices) :, 2] += 1e-6
    assert len(self_crossings(vertices, triangles)) == 0
