from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from spatula_env.render import Camera

numbers = st.floats(-5.0, 5.0)
vectors = st.tuples(numbers, numbers, numbers)


@st.composite
def cameras(draw) -> Camera:
    return Camera.orbit(
        draw(vectors),
        draw(st.floats(0.5, 20.0)),
        draw(st.floats(-360.0, 360.0)),
        draw(st.floats(-89.0, 89.0)),
        vertical_field_of_view=draw(st.floats(5.0, 120.0)),
    )


def test_pinhole_formula_by_hand():
    camera = Camera((0, 0, 0), (0, 1, 0), vertical_field_of_view=90.0)
    pixels, depth = camera.project([(0.0, 2.0, 0.0), (1.0, 2.0, 0.0), (0.0, 2.0, 1.0), (2.0, 4.0, -4.0)], 80, 60)
    # The focal length of 90 degrees is half the height: 30 pixels.
    np.testing.assert_allclose(pixels, [(40, 30), (55, 30), (40, 15), (55, 60)], atol=1e-12)
    np.testing.assert_allclose(depth, [2, 2, 2, 4])


@given(cameras(), vectors)
def test_projection_agrees_with_the_matrices(camera, point):
    width, height = 64, 48
    view = camera.view_matrix() @ np.array([*point, 1.0])
    assume(view[2] < -0.1)
    clip = camera.projection_matrix(width / height) @ view
    expected = (0.5 * (1 + clip[0] / clip[3]) * width, 0.5 * (1 - clip[1] / clip[3]) * height)
    pixels, depth = camera.project(point, width, height)
    np.testing.assert_allclose(pixels, expected, atol=1e-8)
    assert depth == pytest.approx(-view[2])


@given(cameras(), st.integers(0, 5), st.integers(0, 3), st.floats(0.2, 50.0))
def test_unproject_takes_back_project(camera, column, row, distance):
    depth = np.full((4, 6), 1.0)
    depth[row, column] = distance
    point = camera.unproject(depth)[row, column]
    pixels, back = camera.project(point, 6, 4)
    np.testing.assert_allclose(pixels, (column + 0.5, row + 0.5), atol=1e-7)
    assert back == pytest.approx(distance)


@given(cameras())
def test_axes_are_a_right_handed_frame_with_up_in_the_picture(camera):
    right, up, forward = camera.axes()
    np.testing.assert_allclose(camera.axes() @ camera.axes().T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.cross(right, up), -forward, atol=1e-12)
    assert up[2] > 0.0
    assert right[2] == pytest.approx(0.0, abs=1e-12)


def test_near_and_far_planes_map_to_the_ends_of_clip_space():
    camera = Camera((0, 0, 0), (0, 1, 0), near=0.5, far=8.0)
    for depth, expected in ((0.5, -1.0), (8.0, 1.0)):
        clip = camera.projection_matrix(1.5) @ camera.view_matrix() @ np.array([0.3, depth, 0.2, 1.0])
        assert clip[2] / clip[3] == pytest.approx(expected)


def test_orbit_angles():
    np.testing.assert_allclose(Camera.orbit((1, 2, 3), 2, 0, 0).position, (3, 2, 3), atol=1e-12)
    np.testing.assert_allclose(Camera.orbit((1, 2, 3), 2, 90, 0).position, (1, 4, 3), atol=1e-12)
    np.testing.assert_allclose(Camera.orbit((0, 0, 0), 2, 0, 30).position, (np.sqrt(3), 0, 1), atol=1e-12)


def test_points_behind_the_eye_have_no_pixel():
    pixels, depth = Camera((0, 0, 0), (0, 1, 0)).project([(0, -1, 0), (0, 0, 1)], 8, 8)
    assert np.isnan(pixels).all()
    np.testing.assert_array_equal(depth, [-1, 0])


def test_equal_cameras_are_equal_keys():
    first = Camera(np.array([0.0, 0.0, 1.0]), [1, 0, 0])
    second = Camera((0, 0, 1), (1.0, 0.0, 0.0))
    assert first == second
    assert hash(first) == hash(second)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("position", {"position": (0, 0)}),
        ("position", {"position": (0, 0, np.nan)}),
        ("target", {"target": (0, 0, 0)}),
        ("up", {"up": (0, 2, 0)}),
        ("up", {"up": (0, 0, 0)}),
        ("vertical_field_of_view", {"vertical_field_of_view": 180.0}),
        ("near", {"near": 0.0}),
        ("near", {"near": 2.0, "far": 2.0}),
        ("far", {"far": np.inf}),
    ],
)
def test_bad_cameras(name, options):
    with pytest.raises(ValueError, match=name):
        Camera(**{"position": (0, 0, 0), "target": (0, 1, 0), **options})


def test_bad_arguments():
    camera = Camera((0, 0, 0), (0, 1, 0))
    with pytest.raises(ValueError, match="distance"):
        Camera.orbit((0, 0, 0), 0.0, 0, 0)
    with pytest.raises(ValueError, match="elevation"):
        Camera.orbit((0, 0, 0), 1.0, 0, 90.0)
    with pytest.raises(ValueError, match="points"):
        camera.project([(0, 1)], 8, 8)
    with pytest.raises(ValueError, match="width"):
        camera.intrinsics(0, 8)
    with pytest.raises(ValueError, match="aspect"):
        camera.projection_matrix(0.0)
    with pytest.raises(ValueError, match="depth"):
        camera.unproject(np.ones(4))
