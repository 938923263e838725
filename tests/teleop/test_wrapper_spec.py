"""Specifications of environments with a device around them."""

from __future__ import annotations

import json
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from spatula_env.learning.policies import make_expert
from spatula_env.teleop.scripted import ScriptedOperator
from spatula_env.teleop.wrapper import FalconTeleop


def test_a_wrapper_with_a_named_device_is_made_again_from_its_specification() -> None:
    made = FalconTeleop(
        gym.make("Spatula/Press-v0", engine="batch"),
        "keyboard",
        scale=np.float32(0.5),
        release_time=2.0,  # type: ignore[arg-type]
    )
    assert made.spec is not None
    written = made.spec.to_json()
    (wrapper,) = json.loads(written)["additional_wrappers"]
    assert wrapper["kwargs"]["device"] == "keyboard"
    assert wrapper["kwargs"]["scale"] == 0.5
    again: Any = gym.make(EnvSpec.from_json(written))
    assert isinstance(again, FalconTeleop)
    assert again.device is not made.device
    assert (again.mode, again.spec) == (made.mode, made.spec)
    again.close()
    made.close()


def test_a_device_of_ones_own_is_not_held() -> None:
    env = gym.make("Spatula/Press-v0", engine="batch")
    made = FalconTeleop(env, ScriptedOperator(make_expert(env)), real_time=False)
    # Wrappers around it copy the specification, and never the device.
    around = gym.wrappers.RecordEpisodeStatistics(made)
    assert around.spec is not None
    written = around.spec.to_json()
    with pytest.raises(TypeError, match="device must be a device or the name of one, got None"):
        gym.make(EnvSpec.from_json(written))
    with pytest.raises(ValueError, match="device must be one of"):
        FalconTeleop(env, "joystick")
    around.close()
