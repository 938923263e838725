"""Options of the wrong type, or out of range, are refused by name when an environment is made."""

from __future__ import annotations

import re
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import spatula_env  # noqa: F401
from spatula_env.envs import EnvSettings, ObservationSettings, PressEnv
from spatula_env.tasks import clamp, fissure, palpate, press, retract

NO_NUMBERS: list[Any] = ["fast", "1", True, np.True_, [3.0], np.array([3.0]), {"a": 1}, 1j, np.nan]
NUMBERS = ("max_speed", "max_rotation_rate", "max_jaw_speed", "control_frequency")
NUMBERS_OR_NONE = ("max_force", "episode_time", "damage_limit")
OBSERVATION = ("noise", "delay", "history", "organ_points", "tool_points")
NO_BOOLEANS: list[Any] = ["yes", "false", "", [], 0.5, None, 0, 1, 2, np.array([True])]
NO_SIZES: list[Any] = [0, -5, "480", 10.5, 10**6, None, True, [480]]


@pytest.mark.parametrize("value", NO_NUMBERS, ids=repr)
@pytest.mark.parametrize("name", [*NUMBERS, *NUMBERS_OR_NONE])
def test_options_that_are_numbers(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"^{name} must be .*, got {re.escape(repr(np.asarray(value).tolist()))}"):
        EnvSettings(**{name: value})


@pytest.mark.parametrize("name", NUMBERS)
def test_only_some_may_be_none(name: str) -> None:
    with pytest.raises(ValueError, match=f"^{name} must be positive and finite, got None"):
        EnvSettings(**{name: None})
    assert all(vars(EnvSettings(**{one: None}))[one] is None for one in NUMBERS_OR_NONE)


@pytest.mark.parametrize("value", [*NO_NUMBERS, None], ids=repr)
@pytest.mark.parametrize("name", OBSERVATION)
def test_options_of_observations(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=rf"^observation\.{name} must be .*, got "):
        ObservationSettings(**{name: value})


@pytest.mark.parametrize("name", ["history", "organ_points", "tool_points"])
def test_what_no_memory_holds_is_refused(name: str) -> None:
    with pytest.raises(
        ValueError, match=rf"^observation\.{name} must be an integer of at least 1 and at most \d+, got 1000000000"
    ):
        ObservationSettings(**{name: 10**9})


@pytest.mark.parametrize("value", [[8, 10**6], ["48", 48], [48, True], 48, "48"], ids=repr)
def test_sizes_of_observed_pictures(value: Any) -> None:
    with pytest.raises(ValueError, match=r"^observation\.image_size must be .*, got "):
        ObservationSettings(image_size=value)


@pytest.mark.parametrize("module", [press, retract, clamp, fissure, palpate])
@pytest.mark.parametrize("value", [*NO_NUMBERS, None, "12", ("1", "2"), (True, 2)], ids=repr)
def test_options_of_tasks(module: Any, value: Any) -> None:
    name = module.__name__.rpartition(".")[2].capitalize()
    for config in (getattr(module, f"{name}Config"), getattr(module, f"{name}Weights")):
        for field, default in vars(config()).items():
            if isinstance(default, float | tuple):
                with pytest.raises(ValueError, match=rf"^(weights\.)?{field} must be .*, got "):
                    config(**{field: value})


@pytest.mark.parametrize("value", NO_BOOLEANS, ids=repr)
def test_options_that_are_booleans(value: Any) -> None:
    with pytest.raises(ValueError, match=r"^terminate_on_success must be True or False, got "):
        EnvSettings(terminate_on_success=value)


@pytest.mark.parametrize("value", NO_SIZES, ids=repr)
@pytest.mark.parametrize("name", ["width", "height"])
def test_sizes_of_pictures(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"^{name} must be an integer of at least 1 and at most 8192, got "):
        EnvSettings(**{name: value})


@pytest.mark.parametrize("value", [1e-300, 0.1, 0.49])
def test_a_control_step_has_an_end(value: float) -> None:
    with pytest.raises(ValueError, match=rf"^control_frequency must be 0\.5 Hz at least, got {value}"):
        EnvSettings(control_frequency=value)


@pytest.mark.parametrize("value", ["12", ("1", "2"), True, (False, True), "x"], ids=repr)
def test_ranges_of_what_is_drawn(value: Any) -> None:
    with pytest.raises(ValueError, match=r"^randomization\.friction must be two numbers .*, got "):
        PressEnv(engine="batch", randomization={"friction": value})


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"terminate_on_success": "yes"}, "terminate_on_success must be True or False, got 'yes'"),
        ({"max_speed": "fast"}, "max_speed must be positive and finite, got 'fast'"),
        ({"width": True}, "width must be an integer of at least 1 and at most 8192, got True"),
        ({"control_frequency": 1e-300}, "control_frequency must be 0.5 Hz at least, got 1e-300"),
        ({"task": {"hold_time": "long"}}, "hold_time must be positive and finite, got 'long'"),
        ({"observation": {"noise": "much"}}, "observation.noise must be zero or more and finite, got 'much'"),
    ],
)
def test_gymnasium_passes_the_words_on(many: bool, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        if many:
            gym.make_vec("Spatula/Press-v0", num_envs=2, **options)
        else:
            gym.make("Spatula/Press-v0", engine="batch", **options)


@pytest.mark.parametrize("value", [1, None, [], np.zeros(2), {}, "Next_Step"], ids=repr)
def test_autoreset_modes(value: Any) -> None:
    with pytest.raises(ValueError, match=r"^autoreset_mode must be one of "):
        gym.make_vec("Spatula/Press-v0", num_envs=2, autoreset_mode=value)
