"""Filled contours of pressure, and what a drag of the mouse means."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from spatula_env.geometry import seed_sphere
from spatula_env.render.display_surface import vertex_normals
from spatula_env.render.palette import PRESSURE_LIMITS
from spatula_env.teleop.web.pressure_contours import LEVELS, pressure_contours, pressure_field, split_at_levels
from spatula_env.teleop.web.scene_display import on_drag_plane

ORGAN = seed_sphere()
POINTS, TRIANGLES = np.array(ORGAN.vertices), np.array(ORGAN.triangles)


def areas(points, triangles):
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def test_the_limits_are_levels():
    assert set(PRESSURE_LIMITS) <= set(LEVELS)
    assert list(LEVELS) == sorted(LEVELS)


@given(arrays(np.float64, len(POINTS), elements=st.floats(-1.0, 11.0)))
def test_cutting_loses_nothing(values):
    levels = (0.0, 2.5, 5.0, 9.0)
    points, triangles, band = split_at_levels(POINTS, TRIANGLES, values, levels)
    assert np.array_equal(points[: len(POINTS)], POINTS)
    assert areas(points, triangles).sum() == pytest.approx(areas(POINTS, TRIANGLES).sum())
    # Still closed and wound alike: every edge once in each direction, and the volume is the same.
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    there = {tuple(edge) for edge in edges.tolist()}
    assert len(there) == len(edges) and all((b, a) in there for a, b in there)
    assert _volume(points, triangles) == pytest.approx(_volume(POINTS, TRIANGLES))
    assert band.min() >= 0 and band.max() <= len(levels)


def _volume(points, triangles):
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0


def test_bands_of_a_linear_field_are_slices():
    # Height on a flat square: bands are strips of known area.
    grid = np.linspace(0.0, 1.0, 8)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(64)])
    corner = (np.arange(7)[:, None] * 8 + np.arange(7)).ravel()
    triangles = np.concatenate(
        [np.column_stack([corner, corner + 8, corner + 9]), np.column_stack([corner, corner + 9, corner + 1])]
    )
    levels = (0.21, 0.5, 0.83)
    fine, cut, band = split_at_levels(points, triangles, points[:, 0] + 0.0, levels)
    size = np.bincount(band, areas(fine, cut), minlength=4)
    assert size == pytest.approx([0.21, 0.29, 0.33, 0.17])


def test_pressure_is_felt_around_the_tool_and_on_the_wall_that_is_pressed():
    normals = vertex_normals(POINTS, TRIANGLES)
    top = POINTS[:, 2].argmax()
    places, down = POINTS[[top]], np.array([[0.0, 0.0, -1.0]])
    field = pressure_field(POINTS, normals, places, down, np.array([5000.0]))
    assert field[top] == pytest.approx(5000.0)
    assert not field[POINTS[:, 2] < 2.0].any()
    # A face that looks the other way does not press this wall.
    assert not pressure_field(POINTS, normals, places, -down, np.array([5000.0])).any()
    assert not pressure_field(POINTS, normals, places, down, np.array([1.0])).any()
    assert not pressure_field(POINTS, normals, places + 10.0, down, np.array([5000.0])).any()


def test_bands_tell_the_pressure():
    normals = vertex_normals(POINTS, TRIANGLES)
    field = np.where(POINTS[:, 2] > 2.0, 4500.0, 0.0)
    pieces = pressure_contours(POINTS, normals, TRIANGLES, field, 0.0)
    assert len(pieces) == len(LEVELS)
    strongest = LEVELS.index(4000.0)
    assert all(piece is not None for piece in pieces[: strongest + 1])
    assert not any(pieces[strongest + 1 :])
    points, triangles = pieces[strongest]
    whole = TRIANGLES[(POINTS[TRIANGLES][..., 2] > 2.0).all(axis=1)]
    assert areas(points, triangles).sum() >= areas(POINTS, whole).sum()
    assert not any(pressure_contours(POINTS, normals, TRIANGLES, np.zeros(len(POINTS)), 0.0))


def test_what_colours_the_organ_lies_over_it():
    normals = vertex_normals(POINTS, TRIANGLES)
    (points, _), *_ = pressure_contours(POINTS, normals, TRIANGLES, np.full(len(POINTS), 300.0), 0.5)
    assert np.linalg.norm(points, axis=1).min() > np.linalg.norm(POINTS, axis=1).max() + 0.4


# Multiples of a micrometre: products of far smaller values would underflow.
POINT = arrays(np.float64, 3, elements=st.integers(-5_000_000, 5_000_000).map(lambda micrometres: 1e-6 * micrometres))


@given(POINT, POINT, POINT, st.booleans())
def test_a_drag_stays_in_its_plane_and_under_the_mouse(eye, point, grabbed, level):
    place = on_drag_plane(eye, point, grabbed, level=level)
    if place is None:
        return
    ray = point - eye
    assert np.linalg.norm(np.cross(place - eye, ray)) <= 1e-6 * (1.0 + np.linalg.norm(place)) * np.linalg.norm(ray)
    assert (place - eye) @ ray > 0.0
    if level:
        assert place[2] == pytest.approx(grabbed[2], abs=1e-9)
    else:
        assert (place - grabbed)[:2] @ (grabbed - eye)[:2] == pytest.approx(0.0, abs=1e-6)


def test_a_drag_down_goes_straight_down():
    eye, grabbed = np.array([0.0, -10.0, 6.0]), np.array([0.0, 0.0, 2.0])
    place = on_drag_plane(eye, np.array([0.0, -1.0, 1.0]), grabbed, level=False)
    assert place[:2] == pytest.approx([0.0, 0.0]) and place[2] < 2.0
    away = on_drag_plane(eye, np.array([0.0, 1.0, 2.2]), grabbed, level=True)
    assert away[1] > 0.0 and away[2] == pytest.approx(2.0)


def test_a_drag_to_the_horizon_goes_nowhere():
    eye, grabbed = np.array([0.0, -10.0, 6.0]), np.zeros(3)
    assert on_drag_plane(eye, np.array([0.0, 0.0, 6.0]), grabbed, level=True) is None
    assert on_drag_plane(eye, np.array([0.0, 0.0, 9.0]), grabbed, level=True) is None
    assert on_drag_plane(eye, eye, grabbed, level=False) is None
