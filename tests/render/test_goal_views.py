"""The goal is in view from where a page looks first, over many episodes."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import spatula_env
from spatula_env.render.viewpoints import fit_camera, viewpoint_of
from spatula_env.tasks.exposure import visible_points
from spatula_env.tasks.marks import Patch, Ring

pytest.importorskip("viser", reason="the extra web is not installed")
first_view = pytest.importorskip("spatula_env.teleop.web.scene_display").first_view
_fog = pytest.importorskip("spatula_env.teleop.web.viewers")._fog

gym.register_envs(spatula_env)

EPISODES = 20
WIDTH, HEIGHT = 640, 480


def outline(mark):
    if isinstance(mark, Ring):
        angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
        return mark.point + mark.radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(24)])
    return np.asarray(mark.points)


def seen_share(nodes, triangles, patch, direction):
    """How much of a patch's surface is seen along a direction, and not from behind."""
    faces = triangles[np.isin(triangles, patch.nodes).all(axis=1)]
    corners = nodes[faces]
    out = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(out, axis=1)
    points = corners.mean(axis=1) + 0.02 * out / area[:, None]
    nothing = np.zeros((1, 1, 4, 3))
    seen = visible_points(nodes[None], triangles, nothing, np.ascontiguousarray(points[None]), direction[None])[0]
    return float((seen * area).sum() / area.sum())


@pytest.mark.parametrize("name", spatula_env.TASKS)
def test_the_goal_is_in_the_first_view(name):
    env = gym.make(f"Spatula/{name}-v0", engine="batch")
    shares = []
    for seed in range(EPISODES):
        env.reset(seed=seed)
        points, viewpoint = first_view(env.unwrapped)
        camera = fit_camera(points, viewpoint, WIDTH / HEIGHT)
        moment = env.unwrapped.moment
        assert moment.marks
        nodes, triangles = np.ascontiguousarray(moment.nodes), np.array(env.unwrapped._episodes.worlds.triangles)
        # What is to be seen is not faded.
        near, far = _fog(camera, points)
        distances = np.linalg.norm(nodes - camera.position, axis=1)
        assert near > distances.max() and far > 2.0 * near
        away = np.array(camera.position) - camera.target
        direction = away / np.linalg.norm(away)
        for mark in moment.marks:
            if isinstance(mark, Patch):
                shares.append(seen_share(nodes, triangles, mark, direction))
                places = nodes[mark.nodes]
            else:
                places = outline(mark)
            pixels, depth = camera.project(places, WIDTH, HEIGHT)
            assert (depth > 0.0).all() and (pixels >= 0.0).all() and (pixels <= (WIDTH, HEIGHT)).all()
        tools, _ = camera.project(np.atleast_2d(moment.tool_positions), WIDTH, HEIGHT)
        assert (tools >= 0.0).all() and (tools <= (WIDTH, HEIGHT)).all()
        if name == "Retract":
            # On the side of the patch: from straight along the fold it is a thin line.
            general = viewpoint_of(env.unwrapped._episodes.scene).azimuth
            assert np.sign(viewpoint.azimuth - general) == -np.sign(env.unwrapped.goal[0])
    env.close()
    assert all(share > 0.5 for share in shares)
