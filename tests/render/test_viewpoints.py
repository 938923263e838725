from __future__ import annotations

import numpy as np
import pytest

from spatula_env import scenes
from spatula_env.render.shapes import quaternion_matrix
from spatula_env.render.viewpoints import Viewpoint, default_camera, fit_camera

SCENES = {"seed": scenes.seed, "fissure": scenes.fissure, "clamp": scenes.clamp, "retract": scenes.retract}


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
def test_a_camera_is_as_close_as_it_can_be(aspect: float) -> None:
    points = np.random.default_rng(0).normal(size=(50, 3)) * (1.0, 2.0, 0.5) + (3.0, 0.0, 1.0)
    camera = fit_camera(points, Viewpoint(azimuth=-40.0, elevation=30.0, room=0.0), aspect)
    height = 200
    width = round(aspect * height)
    pixels, depth = camera.project(points, width, height)
    assert (depth > 0.0).all()
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    assert (low > -1e-6).all() and (high < np.array([width, height]) + 1e-6).all()
    # Along one axis of the picture, both sides are touched.
    assert (np.abs(low) + np.abs(np.array([width, height]) - high)).min() < 1e-6
    direction = np.array(camera.position) - camera.target
    direction /= np.linalg.norm(direction)
    wanted = np.radians((-40.0, 30.0))
    expected = (np.cos(wanted[1]) * np.cos(wanted[0]), np.cos(wanted[1]) * np.sin(wanted[0]), np.sin(wanted[1]))
    np.testing.assert_allclose(direction, expected, atol=1e-9)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("aspect", [0.75, 1.6])
def test_all_tools_are_in_the_picture(name: str, aspect: float) -> None:
    scene = SCENES[name]()
    camera = default_camera(scene, aspect)
    for placed in scene.tools:
        corners = placed.tool.vertices @ quaternion_matrix(placed.orientation).T + placed.position
        # Of a long blade, the lower end.
        corners = corners[corners[:, 2] < corners[:, 2].min() + 1.0]
        pixels, _ = camera.project(corners, round(300 * aspect), 300)
        assert (pixels >= 0.0).all() and (pixels <= (300 * aspect, 300)).all()


def test_one_looks_down_into_a_fissure_and_sideways_at_jaws() -> None:
    into, along = default_camera(scenes.fissure()), default_camera(scenes.clamp())
    down = np.array(into.position) - into.target
    assert down[2] > np.hypot(down[0], down[1])
    # Along the fissure rather than across it.
    assert abs(down[0]) > abs(down[1])
    scene = scenes.clamp()
    pixels, _ = along.project([placed.position for placed in scene.tools], 300, 300)
    # The jaws are side by side.
    assert pixels[1, 0] - pixels[0, 0] > 60.0
    assert abs(pixels[1, 1] - pixels[0, 1]) < 60.0


def test_a_fold_is_seen_from_its_end_on_the_operators_side() -> None:
    camera = default_camera(scenes.retract())
    away = np.array(camera.position) - camera.target
    assert away[1] < -3.0 * abs(away[0])
