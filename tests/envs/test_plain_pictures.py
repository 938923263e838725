from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import spatula_env
from spatula_env.envs import PressEnv
from spatula_env.envs.observed_pictures import observed_pictures
from spatula_env.envs.pictures import EpisodePictures
from spatula_env.envs.plain_pictures import PlainPictures
from spatula_env.envs.settings import OBS_MODES, PICTURE_STYLES
from spatula_env.learning.threads import numba_threads
from spatula_env.tasks.base import Task

gym.register_envs(spatula_env)

TASKS = ("Press", "Retract", "Fissure", "Clamp", "Palpate")
SMALL = (40, 36)


@contextmanager
def many(task: str, count: int = 3, obs_mode: str = "rgbd", **options: Any) -> Iterator[Any]:
    observation = {"image_size": SMALL, **options.pop("observation", {})}
    env = gym.make_vec(f"Spatula/{task}-v0", num_envs=count, obs_mode=obs_mode, observation=observation, **options)
    try:
        yield env
    finally:
        env.close()


def moved(env: Any, steps: int = 3, seed: int = 4) -> dict[str, np.ndarray]:
    env.reset(seed=seed)
    generator = np.random.default_rng(seed)
    for _ in range(steps):
        observation, *_ = env.step(generator.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32))
    return dict(observation)


def purple(image: np.ndarray) -> np.ndarray:
    red, green, blue = np.moveaxis(image.astype(int), -1, 0)
    return np.asarray((blue > red + 20) & (red > green + 5))


@pytest.mark.parametrize("obs_mode", OBS_MODES)
@pytest.mark.parametrize("task", TASKS)
def test_every_mode_of_every_task_is_in_its_space(task: str, obs_mode: str) -> None:
    with many(task, 2, obs_mode) as env:
        observation, _ = env.reset(seed=0)
        assert observation in env.observation_space
        observation, *_ = env.step(env.action_space.sample())
        assert observation in env.observation_space
        if obs_mode in ("rgb", "rgbd"):
            red, green, blue = np.moveaxis(observation["image"].astype(int), -1, 0)
            organ = (red > green + 30) & (red > blue + 20)
            assert (organ.mean(axis=(1, 2)) > 0.1).all()
        assert ("depth" in observation) == (obs_mode == "rgbd") if isinstance(observation, dict) else True


@pytest.mark.parametrize("style", PICTURE_STYLES)
def test_the_style_is_chosen(style: str) -> None:
    with many("Press", observation={"picture_style": style}) as env:
        observation = moved(env)
        episodes, every = env.unwrapped._episodes, np.arange(3)
        if style == "plain":
            images, depths = PlainPictures(episodes, SMALL[1], SMALL[0]).draw(every)
        else:
            images, depths = EpisodePictures(episodes, SMALL[1], SMALL[0]).rgbd()
        assert depths is not None
        assert (observation["image"] == images).all()
        assert (observation["depth"][..., 0] == np.clip(depths, 0.0, 1.0)).all()


def test_plain_is_the_default() -> None:
    with many("Press") as env, many("Press", observation={"picture_style": "plain"}) as same:
        assert (moved(env)["image"] == moved(same)["image"]).all()
    with pytest.raises(
        ValueError, match=r"observation\.picture_style must be one of \['plain', 'full'\], got 'beautiful'"
    ):
        PressEnv(obs_mode="rgb", observation={"picture_style": "beautiful"})


@pytest.mark.parametrize("task", TASKS)
def test_depth_in_metres_is_that_of_the_full_style(task: str) -> None:
    with many(task, randomization="default") as env:
        moved(env)
        episodes = env.unwrapped._episodes
        _, depths = PlainPictures(episodes, 84, 84).draw(np.arange(3))
        full = EpisodePictures(episodes, 84, 84).rgbd()[1]
        assert depths is not None and depths.shape == full.shape
        assert (np.abs(depths - full) < 1e-4).mean() > 0.75
        assert (np.abs(depths - full) < 2e-3).mean() > 0.9


def test_a_world_of_many_looks_like_a_single_one_on_any_number_of_threads() -> None:
    options: dict[str, Any] = {"engine": "batch", "obs_mode": "rgbd", "randomization": "default"}
    with many("Retract", 5, randomization="default") as env:
        env.reset(seed=10)
        episodes, every = env.unwrapped._episodes, np.arange(5)
        pictures = PlainPictures(episodes, SMALL[1], SMALL[0])
        images, depths = pictures.draw(every)
        assert depths is not None
        for threads in (1, 2):
            with numba_threads(threads):
                again = pictures.draw(every)
            assert (again[0] == images).all() and again[1] is not None and (again[1] == depths).all()
        for world in (0, 4):
            with gym.make("Spatula/Retract-v0", observation={"image_size": SMALL}, **options) as single:
                observation, _ = single.reset(seed=10 + world)
            assert (observation["image"] == images[world]).all()
            assert (observation["depth"][..., 0] == np.clip(depths[world], 0.0, 1.0)).all()


def test_worlds_that_begin_anew_are_drawn_and_the_others_stay() -> None:
    with many("Clamp", 4, randomization="default", autoreset_mode="disabled") as env:
        before = moved(env)
        mask = np.array([False, True, False, True])
        after, _ = env.reset(seed=99, options={"reset_mask": mask})
        for name in ("image", "depth"):
            assert (after[name][~mask] == before[name][~mask]).all()
            assert all((after[name][world] != before[name][world]).any() for world in np.flatnonzero(mask))
        images, _ = PlainPictures(env.unwrapped._episodes, SMALL[1], SMALL[0]).draw(np.arange(4))
        assert (after["image"] == images).all()


@pytest.mark.parametrize("task", TASKS)
def test_patches_are_those_among_the_marks(task: str) -> None:
    with many(task) as env:
        moved(env)
        episodes = env.unwrapped._episodes
        known = episodes.patches(np.arange(3))
        asked = Task.patches(episodes.task, episodes.goals, episodes.situation, episodes._memory)
        assert known.keys() == asked.keys() == ({"target"} if task in ("Retract", "Clamp") else set())
        for role, inside in known.items():
            assert (inside == asked[role]).all() and inside.any(axis=1).all()
            assert (episodes.patches(np.array([2, 0]))[role] == inside[[2, 0]]).all()


# Retract's patches are on a flank, which is turned away from the camera in many worlds.
@pytest.mark.parametrize(("task", "least"), [("Retract", 2), ("Clamp", 6)])
def test_patches_are_seen(task: str, least: int) -> None:
    with many(task, 6, observation={"image_size": (84, 84)}) as env:
        images = moved(env)["image"]
        assert sum(purple(image).sum() > 10 for image in images) >= least
        full = EpisodePictures(env.unwrapped._episodes, 84, 84).rgbd()[0]
        for image, other in zip(images, full, strict=True):
            assert abs(int(purple(image).sum()) - int(purple(other).sum())) < 60


def test_where_physics_has_diverged_tools_are_seen() -> None:
    with many("Press", 2) as env:
        moved(env)
        episodes = env.unwrapped._episodes
        pictures = PlainPictures(episodes, *SMALL)
        before, _ = pictures.draw(np.arange(2))
        episodes.situation.nodes[0] = np.nan
        after, depths = pictures.draw(np.arange(2))
        assert depths is not None and np.isfinite(depths).all()
        assert (after[1] == before[1]).all()
        assert (after[0] != before[0]).any()


def test_there_is_nothing_to_draw_before_the_first_episode() -> None:
    with PressEnv() as env, pytest.raises(ValueError, match="before an episode has begun"):
        PlainPictures(env._episodes, 32, 32).draw(np.arange(1))


def test_depth_is_drawn_only_where_it_is_observed() -> None:
    with many("Press", 2, "rgb") as env:
        env.reset(seed=0)
        assert observed_pictures(env.unwrapped._episodes)(np.arange(2)).keys() == {"image"}
