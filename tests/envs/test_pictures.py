from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from films import opened_film
from gymnasium.wrappers import RecordVideo
from gymnasium.wrappers.vector import RecordVideo as RecordVideos

import spatula_env
from spatula_env.envs import PressEnv
from spatula_env.envs.pictures import EpisodePictures, in_scene
from spatula_env.envs.press import PressVectorEnv
from spatula_env.tasks.marks import Patch, Points, Ring
from spatula_env.tasks.marks import Path as Line

gym.register_envs(spatula_env)

SIZE = {"width": 64, "height": 56}
GOAL = {"goal": (0.006, -0.004, 0.008), "tool_position": (0.006, -0.004, -0.016)}
DOWN = np.array([0.0, 0.0, -0.6], dtype=np.float32)


def pressed(env: PressEnv, steps: int = 9) -> None:
    env.reset(seed=0, options=GOAL)
    for _ in range(steps):
        env.step(DOWN)


@pytest.mark.parametrize("engine", ["bullet", "batch"])
def test_pressure_is_a_colour_on_the_organ(engine: str) -> None:
    with PressEnv(engine=engine, render_mode="rgb_array", width=128, height=128) as env:
        pressed(env)
        picture = env.render()
        (pressures,) = env._episodes._node_pressures
        assert pressures.max() > 1000.0
        pressures[:] = 0.0
        bare = env.render()
        assert picture is not None and bare is not None
        change = picture.astype(int) - bare
        assert ((change[..., 2] < -40) & (change[..., 0] > -60)).sum() > 20
        env.reset(seed=0, options=GOAL)
        assert env._episodes.pressures[0].max() == 0.0


def test_what_a_camera_sees_depends_on_what_is_there_only() -> None:
    with PressEnv() as env:
        pictures = EpisodePictures(env._episodes, 64, 56)
        pressed(env)
        first, first_depth = pictures.rgbd()
        # Another goal is nothing that a camera could see.
        env._episodes.goals[0, :2] += 0.01
        second, second_depth = pictures.rgbd()
        assert (first == second).all()
        assert (first_depth == second_depth).all()
        env.step(DOWN)
        assert (pictures.rgbd()[0] != first).any()


def test_depth_is_the_distance_in_metres() -> None:
    with PressEnv() as env:
        env.reset(seed=0, options=GOAL)
        pictures = EpisodePictures(env._episodes, 64, 56)
        images, depths = pictures.rgbd()
        assert images.shape == (1, 56, 64, 3) and images.dtype == np.uint8
        assert depths.shape == (1, 56, 64) and depths.dtype == np.float32
        camera = pictures._sensor.camera
        assert 0.0 < depths.min() and depths.max() <= np.float32(camera.far) * np.float32(env.workspace.length)
        points = camera.unproject(depths[0] / env.workspace.length)
        # What is seen of the organ lies on the organ, within the sagging of its triangles.
        red, green, _ = np.moveaxis(images[0].astype(int), -1, 0)
        organ = red > green + 40
        nodes = env.simulation.nodes
        middle = 0.5 * (nodes.min(axis=0) + nodes.max(axis=0))
        away = np.linalg.norm(points[organ] - middle, axis=1)
        assert organ.sum() > 300
        assert np.percentile(away, 5) > 2.8 and np.percentile(away, 95) < 3.05


def test_some_worlds_of_many() -> None:
    with_all = PressVectorEnv(3)
    try:
        with_all.reset(seed=1)
        with_all.step(np.tile(DOWN, (3, 1)))
        pictures = EpisodePictures(with_all._episodes, 48, 40)
        images, depths = pictures.rgbd()
        assert images.shape == (3, 40, 48, 3)
        assert (images[0] != images[1]).any()
        some, some_depths = pictures.rgbd([2, 0])
        assert (some == images[[2, 0]]).all()
        assert (some_depths == depths[[2, 0]]).all()
    finally:
        with_all.close()


def test_a_world_of_many_looks_like_a_single_one() -> None:
    with PressEnv(engine="batch", render_mode="rgb_array", **SIZE) as env:
        many = PressVectorEnv(2, render_mode="rgb_array", **SIZE)
        try:
            many.reset(seed=5)
            env.reset(seed=6)
            for _ in range(3):
                many.step(np.tile(DOWN, (2, 1)))
                env.step(DOWN)
            pictures, picture = many.render(), env.render()
            assert pictures is not None and picture is not None
            difference = np.abs(pictures[1].astype(int) - picture)
            assert (difference.max(axis=-1) > 8).mean() < 0.01
        finally:
            many.close()


def test_an_organ_that_differs_in_size_and_place_looks_so() -> None:
    images = []
    for size, shift in ((1.0, 0.0), (0.8, 0.0), (1.0, 0.015)):
        with PressEnv(randomization={"organ_size": size, "organ_x": shift}) as env:
            env.reset(seed=0, options=GOAL)
            images.append(EpisodePictures(env._episodes, 64, 56).rgbd()[0][0].astype(int))
    red = [(image[..., 0] > image[..., 1] + 40) for image in images]
    assert red[1].sum() < 0.9 * red[0].sum()
    columns = [np.flatnonzero(mask.any(axis=0)).mean() for mask in red]
    assert columns[2] > columns[0] + 1.0


def test_marks_go_into_the_scene() -> None:
    with PressEnv() as env:
        workspace = env.workspace
        points = np.array([[0.01, 0.0, -0.02], [0.0, 0.01, 0.0]])
        ring = in_scene(Ring(points[0], 0.01), workspace)
        assert isinstance(ring, Ring)
        np.testing.assert_allclose(workspace.from_scene(ring.point), points[0], atol=1e-12)
        assert ring.radius == pytest.approx(0.01 / workspace.length)
        for kind in (Line, Points):
            moved = in_scene(kind(points), workspace)
            assert isinstance(moved, kind)
            np.testing.assert_allclose(workspace.from_scene(moved.points), points, atol=1e-12)
        patch = Patch(np.arange(3), "goal")
        assert in_scene(patch, workspace) is patch


def test_there_is_nothing_to_draw_before_the_first_episode() -> None:
    with PressEnv() as env, pytest.raises(ValueError, match="before an episode has begun"):
        EpisodePictures(env._episodes, 32, 32).draw()


def frames_of(path: Path) -> int:
    """How many frames a video has."""
    with opened_film(path) as clip:
        assert tuple(clip.size) == (64, 56)
        return round(clip.fps * clip.duration)


HAS_MOVIES = importlib.util.find_spec("moviepy") is not None
"""Without it, videos cannot be written; what is recorded can be looked at all the same."""


def record(env: Any, wrapper: Any, folder: Path, steps: int, action: np.ndarray) -> list[Any]:
    """Frames that `RecordVideo` collects in one episode, the video closed after it."""
    if not HAS_MOVIES:
        frames = []
        env.reset(seed=0)
        frames.append(env.render())
        for _ in range(steps):
            env.step(action)
            frames.append(env.render())
        env.close()
        return frames
    recorded = wrapper(env, str(folder / "videos"), disable_logger=True)
    recorded.reset(seed=0)
    for _ in range(steps):
        recorded.step(action)
    frames = list(recorded.recorded_frames)
    recorded.close()
    return frames


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_an_episode_can_be_filmed(tmp_path: Path) -> None:
    env = gym.make("Spatula/Press-v0", render_mode="rgb_array", **SIZE)
    frames = record(env, RecordVideo, tmp_path, 5, DOWN)
    assert len(frames) == 6
    assert all(frame.shape == (56, 64, 3) and frame.dtype == np.uint8 for frame in frames)
    assert (frames[0] != frames[5]).any()
    if HAS_MOVIES:
        (video,) = (tmp_path / "videos").glob("*.mp4")
        assert frames_of(video) == 6


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_many_episodes_can_be_filmed(tmp_path: Path) -> None:
    env = gym.make_vec("Spatula/Press-v0", num_envs=2, render_mode="rgb_array", **SIZE)
    frames = record(env, RecordVideos, tmp_path, 4, np.tile(DOWN, (2, 1)))
    assert len(frames) == 5
    if HAS_MOVIES:
        # All worlds in one picture.
        assert frames[0].shape[0] * frames[0].shape[1] == 2 * 56 * 64
        assert len(list((tmp_path / "videos").glob("*.mp4"))) == 1
    else:
        assert len(frames[0]) == 2
