from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import spatula_env
from spatula_env import Simulation, scenes
from spatula_env.envs.physics_listener import PhysicsStep

assert spatula_env.TASKS

DOWN = np.array([0.0, 0.0, -1.0], dtype=np.float32)


@pytest.fixture(params=["bullet", "batch"])
def env(request: pytest.FixtureRequest) -> Iterator[gym.Env[Any, Any]]:
    made = gym.make("Spatula/Press-v0", engine=request.param)
    made.reset(seed=0, options={"tool_position": (0.0, 0.0, -0.02)})
    yield made
    made.close()


def test_every_physics_step_is_told(env: gym.Env[Any, Any]) -> None:
    made: Any = env.unwrapped
    heard: list[PhysicsStep] = []
    made.listen(heard.append)
    _, _, _, _, info = env.step(DOWN)
    assert len(heard) == made.steps_per_action
    np.testing.assert_allclose(np.diff([step.time for step in heard]), made.simulation.dt)
    np.testing.assert_array_equal(heard[-1].grip, made.grip)
    # 5 mm in a control step, in equal parts.
    np.testing.assert_allclose(np.diff([step.grip[2] for step in heard]), -0.1 * made.simulation.dt, rtol=1e-6)
    for _ in range(3):
        heard.clear()
        _, _, _, _, info = env.step(DOWN)
    # What an observation tells is the mean of what was told.
    assert np.linalg.norm(np.mean([step.force for step in heard], axis=0)) == pytest.approx(info["force"], rel=1e-6)
    assert heard[-1].force[2] > 0.0
    assert max(np.linalg.norm(step.force) for step in heard) == pytest.approx(info["peak_force"], rel=1e-6)


def test_the_grip_is_where_it_is_observed(env: gym.Env[Any, Any]) -> None:
    observation, _, _, _, _ = env.step(DOWN)
    made: Any = env.unwrapped
    np.testing.assert_allclose(made.grip, observation[made.observation_builder.slices["tool_position"]], atol=1e-7)


def test_listening_ends(env: gym.Env[Any, Any]) -> None:
    made: Any = env.unwrapped
    heard: list[str] = []
    stop = made.listen(lambda _: heard.append("first"))
    made.listen(lambda _: heard.append("second"))
    env.step(DOWN)
    assert heard[:2] == ["first", "second"]
    stop()
    stop()
    heard.clear()
    env.step(DOWN)
    assert set(heard) == {"second"}


def test_an_exception_is_passed_on(env: gym.Env[Any, Any]) -> None:
    made: Any = env.unwrapped
    before = made.simulation.time
    stop = made.listen(lambda _: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        env.step(DOWN)
    assert made.simulation.time == pytest.approx(before + made.simulation.dt)
    stop()
    env.step(DOWN)


def test_a_simulation_tells_its_reports() -> None:
    simulation = Simulation(scenes.seed(), engine="batch")
    heard: list[Any] = []
    simulation.listeners.append(heard.append)
    # One that ends in its own call does not make another one miss its own.
    simulation.listeners.insert(0, lambda _: simulation.listeners.pop(0))
    assert simulation.step() is heard[0]
    assert simulation.step() is heard[1]
    simulation.close()
