"""Whether a tool reaches into an organ."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.geometry import Tool, icosphere
from spatula_env.geometry.overlap import overlaps

SPHERE = icosphere(1.0, 2)
BOX = Tool.box((0.5, 0.4, 0.1), 2)


def reaches(height: float, aside: float = 0.0, tolerance: float = 0.0, scale: float = 1.0) -> bool:
    corners = np.array(BOX.vertices) * scale + (aside, 0.0, height)
    return overlaps(np.array(SPHERE.vertices), np.array(SPHERE.triangles), corners, np.array(BOX.triangles), tolerance)


def test_a_body_outside_through_and_inside_a_surface() -> None:
    assert [reaches(height) for height in (1.06, 1.04, 0.9, 0.0, -0.9, -1.04, -1.06)] == [
        False, True, True, True, True, True, False,
    ]  # fmt: skip


def test_a_body_that_encloses_the_surface_overlaps_it() -> None:
    assert reaches(0.0, scale=100.0)


def test_an_edge_between_all_corners_is_enough() -> None:
    # All corners and nodes of the surface are outside of each other: only faces cross.
    corners = np.array(BOX.vertices) * (8.0, 0.1, 0.1) + (0.0, 0.31, 0.0)
    assert overlaps(np.array(SPHERE.vertices), np.array(SPHERE.triangles), corners, np.array(BOX.triangles))


def test_what_only_touches_within_the_tolerance_does_not_overlap() -> None:
    assert reaches(1.0499)
    assert not reaches(1.0499, tolerance=0.001)


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
def test_points_of_the_body_that_are_deep_inside_mean_that_it_overlaps(height: float, aside: float) -> None:
    corners = np.array(BOX.vertices) + np.array([aside, 0.0, height])
    distances = np.linalg.norm(corners, axis=1)
    if distances.min() < 0.9:
        assert reaches(height, aside)
    if np.linalg.norm([max(abs(aside) - 0.25, 0.0), max(abs(height) - 0.05, 0.0)]) > 1.0:
        assert not reaches(height, aside)
