"""NumPy's numbers and arrays are taken wherever numbers come in, and become Python's own."""

from __future__ import annotations

import json
from dataclasses import fields
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from hypothesis import given
from hypothesis import strategies as st

import spatula_env
from spatula_env.envs import EnvSettings, ObservationSettings, PressEnv, PressVectorEnv
from spatula_env.tasks import clamp, fissure, palpate, press, retract
from spatula_env.tasks.plain import as_plain

NUMPY: dict[str, Any] = {
    "control_frequency": np.float32(20.0),
    "max_speed": np.array(0.125),
    "max_force": np.float64(2.0),
    "damage_limit": np.float32(64.0),
    "episode_time": np.int64(5),
    "terminate_on_success": np.bool_(True),
    "width": np.int64(48),
    "height": np.array(40),
    "observation": {
        "history": np.int64(2),
        "noise": np.float32(0.5),
        "image_size": np.array([36, 40]),
        "organ_points": np.int32(8),
    },
    "task": {
        "depth_range": np.array([0.0078125, 0.015625]),
        "hold_time": np.float32(0.5),
        "weights": {"hold": np.float64(1.0)},
    },
    "randomization": {"stiffness": np.array([0.75, 1.25]), "friction": np.float32(1.0), "organ_x": [np.float32(0)] * 2},
}
PYTHON: dict[str, Any] = {
    "control_frequency": 20.0,
    "max_speed": 0.125,
    "max_force": 2.0,
    "damage_limit": 64.0,
    "episode_time": 5,
    "terminate_on_success": True,
    "width": 48,
    "height": 40,
    "observation": {"history": 2, "noise": 0.5, "image_size": (36, 40), "organ_points": 8},
    "task": {"depth_range": (0.0078125, 0.015625), "hold_time": 0.5, "weights": {"hold": 1.0}},
    "randomization": {"stiffness": (0.75, 1.25), "friction": 1.0, "organ_x": (0.0, 0.0)},
}


def assert_plain(value: Any, where: str) -> None:
    if hasattr(value, "__dataclass_fields__"):
        for field in fields(value):
            assert_plain(getattr(value, field.name), f"{where}.{field.name}")
    elif isinstance(value, dict):
        for name, one in value.items():
            assert type(name) is str, where
            assert_plain(one, f"{where}[{name!r}]")
    elif isinstance(value, list | tuple):
        for one in value:
            assert_plain(one, where)
    else:
        assert type(value) in (int, float, bool, str, type(None)), (where, type(value))


@pytest.mark.parametrize("many", [False, True])
def test_options_become_pythons_own(many: bool) -> None:
    def make(options: dict[str, Any]) -> Any:
        if many:
            return gym.make_vec("Spatula/Press-v0", num_envs=np.int64(2), engine="batch", **options)  # type: ignore[arg-type]
        return gym.make("Spatula/Press-v0", engine="batch", **options)

    one, other = make(NUMPY), make(PYTHON)
    assert one.unwrapped.settings == other.unwrapped.settings
    assert_plain(one.unwrapped.settings, "settings")
    assert json.loads(one.spec.to_json()) == json.loads(other.spec.to_json())
    again = EnvSpec.from_json(one.spec.to_json())
    remade: Any = gym.make_vec(again) if many else gym.make(again)
    assert (remade.reset(seed=1)[0] == one.reset(seed=np.int64(1))[0]).all()
    assert (one.reset(seed=np.uint8(1))[0] == other.reset(seed=1)[0]).all()


def test_what_only_many_have_becomes_plain_too() -> None:
    made = gym.make_vec(
        "Spatula/Press-v0",
        num_envs=2,
        autoreset_mode=AutoresetMode.SAME_STEP,
        max_episode_steps=np.int64(7),
    )
    assert made.spec is not None
    written = json.loads(made.spec.to_json())
    assert written["kwargs"]["autoreset_mode"] == "same_step"
    assert written["max_episode_steps"] == 7
    again = gym.make_vec(EnvSpec.from_json(made.spec.to_json()))
    assert isinstance(again, PressVectorEnv)
    assert again.autoreset_mode is AutoresetMode.SAME_STEP
    assert again.max_episode_steps == 7


@pytest.mark.parametrize("module", [press, retract, clamp, fissure, palpate])
@pytest.mark.parametrize("kind", [np.float64, np.array])
def test_configurations_of_tasks_become_plain(module: Any, kind: Any) -> None:
    name = module.__name__.rpartition(".")[2].capitalize()
    for config in (getattr(module, f"{name}Config"), getattr(module, f"{name}Weights")):
        default = config()
        given: dict[str, Any] = {}
        for field in fields(config):
            value = getattr(default, field.name)
            if isinstance(value, float):
                given[field.name] = kind(value)
            elif isinstance(value, tuple):
                given[field.name] = np.array(value)
        assert given
        assert config(**given) == default
        assert_plain(config(**given), config.__name__)


def test_configurations_can_be_given_as_they_are() -> None:
    config = press.PressConfig(hold_time=np.float32(0.25), depth_range=np.array([0.006, 0.01]))  # type: ignore[arg-type]
    with PressEnv(engine="batch", task=config, observation=ObservationSettings(noise=np.float32(0.5))) as env:  # type: ignore[arg-type]
        assert_plain(env.settings, "settings")
        assert env.settings.task.hold_time == 0.25
    assert_plain(EnvSettings(observation={"image_size": np.array([48, 48])}), "settings")


numbers = st.one_of(st.integers(-9, 9), st.floats(-9.0, 9.0, width=32), st.booleans())


@given(
    st.recursive(numbers, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from("abc"), inner))
)
def test_plain_values_stay_as_they_are_and_others_become_equal_ones(value: Any) -> None:
    def as_numpy(one: Any) -> Any:
        if isinstance(one, list):
            return [as_numpy(each) for each in one]
        if isinstance(one, dict):
            return {np.str_(name): as_numpy(each) for name, each in one.items()}
        return np.array(one) if isinstance(one, int) else np.float32(one)

    assert as_plain(value) == value
    assert as_plain(as_numpy(value)) == value
    assert json.loads(json.dumps(as_plain(as_numpy(value)))) == value


@pytest.mark.parametrize("task", spatula_env.TASKS)
def test_what_reset_is_told_may_be_numpys(task: str) -> None:
    with gym.make(f"Spatula/{task}-v0", engine="batch") as env:
        env.reset(seed=0)
        made: Any = env.unwrapped
        goal, position = made.goal, made.grip
        for options in (
            {"goal": goal, "tool_position": position},
            {"goal": [np.float64(each) for each in goal], "tool_position": tuple(position.astype(np.float32))},
        ):
            env.reset(seed=np.int64(0), options=options)
            assert made.goal == pytest.approx(goal)
