from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.render.camera import Camera
from spatula_env.render.orbit import GREATEST_ELEVATION, Orbit

HOME = Camera.orbit((1.0, 2.0, 3.0), 8.0, -60.0, 30.0, vertical_field_of_view=40.0)


def distance(camera: Camera) -> float:
    return float(np.linalg.norm(np.subtract(camera.position, camera.target)))


def pixel(camera: Camera, point: tuple[float, float, float]) -> np.ndarray:
    return camera.project(np.array(point), 400, 400)[0]


def test_what_is_seen_follows_the_hand() -> None:
    near_eye = (1.0 + 0.5, 2.0 - 0.9, 3.0 + 0.6)
    before = pixel(HOME, near_eye)
    orbit = Orbit(HOME)
    orbit.turn(5.0, 0.0)
    assert pixel(orbit.camera, near_eye)[0] > before[0] + 5.0
    orbit.reset()
    orbit.turn(0.0, 5.0)
    assert pixel(orbit.camera, near_eye)[1] < before[1] - 5.0
    assert distance(orbit.camera) == pytest.approx(8.0)


def test_shifting_by_the_height_of_the_picture_moves_the_middle_to_its_edge() -> None:
    orbit = Orbit(HOME)
    orbit.shift(0.5, 0.0)
    np.testing.assert_allclose(pixel(orbit.camera, HOME.target), (400.0, 200.0), atol=1e-6)
    orbit.reset()
    orbit.shift(0.0, 0.25)
    np.testing.assert_allclose(pixel(orbit.camera, HOME.target), (200.0, 100.0), atol=1e-6)


def test_a_step_takes_a_tenth_of_the_way_up_to_a_limit() -> None:
    orbit = Orbit(HOME)
    orbit.move(1.0)
    assert distance(orbit.camera) == pytest.approx(7.2)
    orbit.move(-1.0)
    assert distance(orbit.camera) == pytest.approx(8.0)
    orbit.move(1000.0)
    assert distance(orbit.camera) == pytest.approx(2.0)
    orbit.move(-1000.0)
    assert distance(orbit.camera) == pytest.approx(32.0)


@given(st.lists(st.tuples(st.floats(-500.0, 500.0), st.floats(-500.0, 500.0)), max_size=5))
def test_the_eye_stays_above_and_finds_back(turns: list[tuple[float, float]]) -> None:
    orbit = Orbit(HOME)
    for right, up in turns:
        orbit.turn(right, up)
        rise = np.degrees(np.arcsin((orbit.camera.position[2] - orbit.camera.target[2]) / distance(orbit.camera)))
        assert -5.001 <= rise <= GREATEST_ELEVATION + 1e-3
    orbit.reset()
    assert orbit.camera == HOME
