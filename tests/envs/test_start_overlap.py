"""No episode begins with a tool in the organ, or below the stop above the ground."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import spatula_env
from spatula_env.envs import PressEnv, PressVectorEnv

OVERLAP = r"options\['tool_position'\] must keep the tools out of the organ at rest, which one of them overlaps; got"
BELOW = r"options\['tool_position'\] must keep the tools above the stop above the ground, which .* m below; got"
ABOVE = (0.0, 0.0, 0.0)


@pytest.mark.parametrize("height", [-0.0508, -0.03, -0.0245])
def test_a_start_in_the_organ_is_refused_and_changes_nothing(height: float) -> None:
    with PressEnv(engine="batch", randomization="default") as env:
        env.reset(seed=3)
        expected = env.save()
        for seed in (None, 5):
            with pytest.raises(ValueError, match=OVERLAP):
                env.reset(seed=seed, options={"tool_position": (0.0, 0.0, height)})
        then = env.step(np.zeros(3))
        after = env.reset()
        env.restore(expected)
        assert (env.step(np.zeros(3))[0] == then[0]).all()  # type: ignore[operator, union-attr]
        assert (env.reset()[0] == after[0]).all()  # type: ignore[operator, union-attr]


def test_a_start_that_hardly_touches_is_taken() -> None:
    with PressEnv(engine="batch") as env:
        # The spatula's underside is 1.25 mm below its middle, and the organ's top 25 mm below the workspace's.
        env.reset(seed=0, options={"tool_position": (0.0, 0.0, -0.0237)})
        with pytest.raises(ValueError, match=OVERLAP):
            env.reset(seed=0, options={"tool_position": (0.0, 0.0, -0.0239)})


def test_only_worlds_that_begin_are_looked_at_and_the_one_at_fault_is_named() -> None:
    env = PressVectorEnv(3)
    env.reset(seed=1)
    expected = env.reset()[0].tolist()  # type: ignore[union-attr]
    env.reset(seed=1)
    positions = np.array([ABOVE, (0.0, 0.0, -0.03), ABOVE])
    with pytest.raises(ValueError, match=OVERLAP + r" \[ 0.    0.   -0.03\] in world 1"):
        env.reset(seed=9, options={"tool_position": positions})
    assert env.reset()[0].tolist() == expected  # type: ignore[union-attr]
    env.reset(options={"tool_position": positions, "reset_mask": np.array([True, False, True])})
    assert env.grips[[0, 2]] == pytest.approx(np.zeros((2, 3)))


@pytest.mark.parametrize("task", spatula_env.TASKS)
@pytest.mark.parametrize("randomization", ["none", "default"])
def test_a_tasks_own_starts_are_free_and_deep_ones_are_not(task: str, randomization: str) -> None:
    with gym.make(f"Spatula/{task}-v0", engine="batch", randomization=randomization) as env:
        made: Any = env.unwrapped
        for seed in range(4):
            first, _ = env.reset(seed=seed)
            grip = made.grip
            second, _ = env.reset(seed=seed, options={"tool_position": grip.astype(np.float32)})
            assert second == pytest.approx(first, abs=1e-6)
            with pytest.raises(ValueError, match=f"{OVERLAP}|{BELOW}"):
                env.reset(seed=seed, options={"tool_position": (0.0, 0.0, made.workspace.low[2])})


def test_a_start_below_the_stop_is_refused() -> None:
    with gym.make("Spatula/Retract-v0", engine="batch") as env:
        with pytest.raises(ValueError, match=f"^{BELOW}"):
            env.reset(seed=0, options={"tool_position": (0.0508, 0.0508, -0.0508)})
