from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from films import opened_film

from spatula_env.envs import PressEnv, PressVectorEnv
from spatula_env.envs.pictures import in_scene
from spatula_env.render import Moment
from spatula_env.render.scene_view import SceneView

GOAL = (0.006, -0.004, 0.008)
ABOVE_GOAL = (0.006, -0.004, -0.016)
OPTIONS = {"goal": GOAL, "tool_position": ABOVE_GOAL}


@pytest.fixture(scope="module")
def env() -> Iterator[PressEnv]:
    with PressEnv(render_mode="rgb_array", width=96, height=80) as made:
        yield made


def render(env: PressEnv) -> np.ndarray:
    picture = env.render()
    assert picture is not None
    return picture


def changed(first: np.ndarray, second: np.ndarray) -> int:
    """How many pixels differ clearly."""
    return int((np.abs(first.astype(int) - second.astype(int)).max(axis=-1) > 20).sum())


def blue(picture: np.ndarray) -> int:
    """How many pixels have the colour of a force's arrow."""
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    return int(((blue - red > 60) & (blue - green > 30)).sum())


def test_a_picture_is_bytes_of_the_size_asked_for(env: PressEnv) -> None:
    env.reset(seed=0)
    picture = render(env)
    assert picture.shape == (80, 96, 3)
    assert picture.dtype == np.uint8


def test_equal_scenes_give_equal_pictures(env: PressEnv) -> None:
    env.reset(seed=0)
    first = render(env)
    assert (render(env) == first).all()
    env.reset(seed=1)
    assert changed(render(env), first) > 20
    env.reset(seed=0)
    assert (render(env) == first).all()


def test_the_organ_is_pink_and_in_the_middle_below(env: PressEnv) -> None:
    env.reset(seed=0)
    red, green, blue = render(env)[60, 48].astype(int)
    assert red > green + 30
    assert red > blue + 30


def test_the_goal_the_spatula_and_the_force_are_in_the_picture(env: PressEnv) -> None:
    env.reset(seed=0, options=OPTIONS)
    before = render(env)
    env.reset(seed=0, options=OPTIONS | {"goal": (-0.008, -0.004, 0.008)})
    assert changed(render(env), before) > 20
    env.reset(seed=0, options=OPTIONS | {"tool_position": (0.02, -0.004, -0.016)})
    assert changed(render(env), before) > 20
    env.reset(seed=0, options=OPTIONS)
    for _ in range(8):
        info = env.step(np.array([0.0, 0.0, -0.5]))[-1]
    assert info["force"] > 0.05
    simulation = env.simulation
    without_force = SceneView(simulation.scene, simulation.triangles, 96, 80).draw(
        Moment(
            simulation.nodes,
            simulation.tool_position,
            simulation.tool_orientation,
            marks=[in_scene(mark, env.workspace) for mark in env.task.marks(env.goal)],
        )
    )
    assert blue(render(env)) > blue(without_force) + 5
    assert blue(before) == 0


def test_the_depth_asked_for_shines_through_the_organ(env: PressEnv) -> None:
    env.reset(seed=0, options=OPTIONS)
    shallow = render(env)
    env.reset(seed=0, options=OPTIONS | {"goal": (*GOAL[:2], 0.018)})
    assert changed(render(env), shallow) > 10


def test_looking_changes_nothing(env: PressEnv) -> None:
    actions = np.random.default_rng(0).uniform(-1.0, 0.5, (6, 3))

    def episode(*, look: bool) -> list[list[float]]:
        env.reset(seed=4)
        shown = []
        for action in actions:
            if look:
                env.render()
            shown.append(env.step(action)[0].tolist())
        return [*shown, env.reset()[0].tolist()]

    assert episode(look=True) == episode(look=False)


def test_without_a_render_mode_there_is_no_picture() -> None:
    with PressEnv() as made:
        made.reset(seed=0)
        assert made.render() is None


def test_a_cut_shows_the_inside(env: PressEnv) -> None:
    env.reset(seed=0)
    simulation = env.simulation
    view = SceneView(simulation.scene, simulation.triangles, 96, 80)
    moment = Moment(simulation.nodes, simulation.tool_position, simulation.tool_orientation)
    whole, cut = view.draw(moment), view.draw(moment, cut=((0.0, 0.0, 3.0), (0.4, -1.0, 0.0)))
    # Dark red in the middle of the organ.
    assert cut[60, 48].astype(int).sum() < whole[60, 48].astype(int).sum() - 60


@pytest.mark.parametrize(("frequency", "rate"), [(20.0, 20), (7.5, 7.5), (0.5, 0.5), (240.0, 240), (60, 60)])
def test_the_rate_of_pictures_is_that_of_control(frequency: float, rate: float) -> None:
    with PressEnv(engine="batch", control_frequency=frequency) as one:
        assert one.metadata["render_fps"] == rate
        assert type(one.metadata["render_fps"]) is type(rate)
    many = PressVectorEnv(1, control_frequency=frequency)
    assert many.metadata["render_fps"] == rate


@pytest.mark.parametrize("frequency", [7.5, 0.5])
def test_slow_episodes_can_be_filmed(frequency: float, tmp_path: Path) -> None:
    pytest.importorskip("moviepy")
    made = gym.make(
        "Spatula/Press-v0", engine="batch", control_frequency=frequency, max_episode_steps=3, render_mode="rgb_array",
        width=64, height=48,
    )  # fmt: skip
    with gym.wrappers.RecordVideo(made, str(tmp_path / "films"), episode_trigger=lambda episode: True) as env:
        env.reset(seed=0)
        for _ in range(3):
            env.step(np.zeros(3))
    (film,) = tmp_path.glob("films/*.mp4")
    with opened_film(film) as clip:
        assert clip.fps == pytest.approx(frequency, rel=1e-3)
        assert clip.duration == pytest.approx(4 / frequency, rel=0.3)
