"""Tools whose motion is set anew in every physics step."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import spatula_env

assert spatula_env.TASKS

START = {"tool_position": (0.0, 0.0, -0.02)}


@pytest.fixture(scope="module")
def press():
    env = gym.make("Spatula/Press-v0", randomization={"action_delay": (0.0, 0.1)}, max_episode_steps=100)
    yield env
    env.close()


def state(env) -> tuple:
    simulation = env.unwrapped.simulation
    return simulation.nodes, simulation.tool_positions


def test_the_same_action_all_the_time_is_that_action(press):
    action = np.array([0.1, -0.2, -0.5], dtype=np.float32)
    press.reset(seed=1, options=START)
    plain = [press.step(action) for _ in range(6)]
    stop = press.unwrapped.steer(lambda _: action)
    press.reset(seed=1, options=START)
    steered = [press.step(np.zeros(3, dtype=np.float32)) for _ in range(6)]
    stop()
    stop()
    for one, other in zip(plain, steered, strict=True):
        np.testing.assert_allclose(one[0], other[0], atol=1e-6)
        assert one[1] == pytest.approx(other[1], abs=1e-9)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_track_is_done_again_to_the_last_bit(press, seed):
    generator = np.random.default_rng(seed)
    tracks = []

    def wander(grip):
        assert grip.shape == (3,)
        tracks.append(np.clip(generator.normal(size=3) * 0.3 - [0.0, 0.0, 0.4], -1.0, 1.0).astype(np.float32))
        return tracks[-1]

    stop = press.unwrapped.steer(wander)
    press.reset(seed=seed, options=START)
    first = [(press.step(np.zeros(3, dtype=np.float32))[:2], state(press)) for _ in range(8)]
    stop()
    assert len(tracks) == 8 * press.unwrapped.steps_per_action
    rows = iter(tracks)
    stop = press.unwrapped.steer(lambda _: next(rows))
    press.reset(seed=seed, options=START)
    second = [(press.step(np.ones(3, dtype=np.float32))[:2], state(press)) for _ in range(8)]
    stop()
    for ((observation, reward), there), ((same, rewarded), again) in zip(first, second, strict=True):
        np.testing.assert_array_equal(observation, same)
        assert reward == rewarded
        for one, other in zip(there, again, strict=True):
            np.testing.assert_array_equal(one, other)


def test_a_pilot_is_kept_in_the_workspace_and_its_actions_are_checked(press):
    press.reset(seed=0)
    stop = press.unwrapped.steer(lambda _: np.array([0.0, 1.0, 0.0]))
    for _ in range(30):
        press.step(np.zeros(3, dtype=np.float32))
    stop()
    assert press.unwrapped.grip[1] == pytest.approx(0.0508, abs=1e-9)
    stop = press.unwrapped.steer(lambda _: np.zeros(2))
    with pytest.raises(ValueError, match="shape"):
        press.step(np.zeros(3, dtype=np.float32))
    stop()
    press.step(np.zeros(3, dtype=np.float32))
