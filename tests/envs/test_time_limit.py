"""Episodes last as long as they are told to, in seconds or in steps."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import SyncVectorEnv

from spatula_env.envs import PalpateEnv, PressEnv, PressVectorEnv
from spatula_env.envs.settings import EnvSettings
from spatula_env.learning.policies import make_expert

ID = "Spatula/Press-v0"


def limit_of(env: Any) -> int | None:
    """As LeRobot asks for it."""
    if isinstance(env, gym.vector.VectorEnv):
        (first, *others) = env.call("_max_episode_steps")
        assert all(each == first for each in others)
        return first
    return env.get_wrapper_attr("_max_episode_steps")


def make_one(**options: Any) -> Any:
    return gym.make(ID, engine="batch", **options)


def make_many(**options: Any) -> Any:
    return gym.make_vec(ID, num_envs=2, engine="batch", **options)


def make_each(**options: Any) -> Any:
    return gym.make_vec(ID, num_envs=2, engine="batch", vectorization_mode="sync", **options)


MAKERS = (make_one, make_many, make_each)


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize(
    ("options", "steps"),
    [
        ({}, 200),
        ({"max_episode_steps": None}, 200),
        ({"control_frequency": 60.0}, 600),
        ({"control_frequency": 7.5}, 75),
        ({"control_frequency": 0.5}, 5),
        ({"episode_time": 2.0}, 40),
        ({"episode_time": 0.01}, 1),
        ({"episode_time": None}, None),
        ({"max_episode_steps": 50}, 50),
        ({"max_episode_steps": 700}, 700),
        ({"max_episode_steps": 700, "control_frequency": 60.0}, 700),
        ({"max_episode_steps": 3, "episode_time": 10.0}, 3),
        ({"max_episode_steps": -1}, None),
    ],
)
def test_all_say_when_episodes_are_cut(make: Any, options: dict[str, Any], steps: int | None) -> None:
    env = make(**options)
    assert limit_of(env) == steps
    if make is not make_each:
        assert env.spec.max_episode_steps == steps
        again = EnvSpec.from_json(env.spec.to_json())
        remade = gym.make(again) if make is make_one else gym.make_vec(again)
        assert limit_of(remade) == steps
        remade.close()
    env.close()


def length_of(env: Any) -> int:
    """Of an episode in which nothing is done, in steps."""
    env.reset(seed=0)
    still = np.zeros(env.action_space.shape)
    for step in range(1, 10_000):
        truncated = env.step(still)[3]
        if np.all(truncated):
            return step
    raise AssertionError("it does not end")


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize(
    "options",
    [
        {"episode_time": 0.2},
        {"episode_time": 0.2, "control_frequency": 60.0},
        {"episode_time": 0.2, "max_episode_steps": 3},
        {"episode_time": 0.2, "max_episode_steps": 9},
    ],
)
def test_episodes_are_cut_then(make: Any, options: dict[str, Any]) -> None:
    env = make(**options)
    assert length_of(env) == limit_of(env)
    # The next one is as long.
    if make is make_one:
        assert length_of(env) == limit_of(env)
    env.close()


@pytest.mark.parametrize("make", MAKERS)
def test_minus_one_never_cuts(make: Any) -> None:
    env = make(episode_time=0.1, max_episode_steps=-1)
    env.reset(seed=0)
    assert not any(np.any(env.step(np.zeros(env.action_space.shape))[3]) for _ in range(4))
    env.close()


def test_classes_by_themselves_do_not_cut() -> None:
    assert EnvSettings().episode_time is None
    with PressEnv(engine="batch") as one:
        assert one._max_episode_steps is None
    assert PressVectorEnv(1).max_episode_steps is None
    with PressEnv(engine="batch", episode_time=0.1) as one:
        assert length_of(one) == 2
    with gym.wrappers.TimeLimit(PressEnv(engine="batch"), 300) as limited:
        assert limit_of(limited) == 300


class FarEnv(PressEnv):
    """With a constructor of its own."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"task": {"depth_range": (0.01, 0.012)}, **options})


def test_subclasses_know_what_make_was_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gym.envs.registration, "registry", dict(gym.envs.registration.registry))
    gym.register("Test/Far-v0", entry_point=FarEnv, kwargs={"episode_time": 5.0})
    gym.register("Test/FarInSteps-v0", entry_point=FarEnv, max_episode_steps=300)
    for id, options, steps in (
        ("Test/Far-v0", {}, 100),
        ("Test/Far-v0", {"max_episode_steps": 300}, 300),
        ("Test/Far-v0", {"max_episode_steps": -1}, None),
        ("Test/FarInSteps-v0", {}, 300),
        ("Test/FarInSteps-v0", {"max_episode_steps": -1}, None),
    ):
        with gym.make(id, engine="batch", **options) as env:
            assert limit_of(env) == steps, id


def test_gymnasiums_vector_environments_tell_it_for_each() -> None:
    env = SyncVectorEnv([lambda steps=steps: make_one(max_episode_steps=steps) for steps in (None, 3)])
    assert env.call("_max_episode_steps") == (200, 3)
    env.close()


@pytest.mark.parametrize("time", [0.0, -1.0, float("inf"), float("nan")])
def test_a_time_that_is_none_is_refused(time: float) -> None:
    with pytest.raises(ValueError, match="episode_time must be positive and finite"):
        PressEnv(engine="batch", episode_time=time)


def test_palpation_has_time_enough_at_any_frequency() -> None:
    # 200 steps are 3.3 s at 60 Hz, in which nobody can feel a path.
    env = gym.make("Spatula/Palpate-v0", engine="batch", control_frequency=60.0)
    assert isinstance(env.unwrapped, PalpateEnv)
    expert = make_expert(env)
    for seed in range(2):
        observation, info = env.reset(seed=seed)
        ended = False
        while not ended and not info["is_success"]:
            observation, _, terminated, truncated, info = env.step(expert(observation))
            ended = terminated or truncated
        assert info["is_success"]
        while not ended:
            _, _, terminated, truncated, info = env.step(np.zeros(env.action_space.shape, np.float32))
            ended = terminated or truncated
        assert info["time"] > 3.5
    env.close()
