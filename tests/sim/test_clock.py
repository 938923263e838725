"""Times of simulations."""

from __future__ import annotations

import copy
import pickle

import gymnasium
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env import Simulation, scenes
from spatula_env.sim.batch import BatchSimulation
from spatula_env.sim.clock import later


@given(st.lists(st.integers(1, 50), min_size=1, max_size=30), st.sampled_from([1 / 240, 1 / 60, 0.005, 1e-3]))
def test_a_time_is_so_many_steps_however_they_were_taken(parts, dt):
    time = 0.0
    for steps in parts:
        time = later(time, steps, dt)
    assert time == sum(parts) * dt


def test_a_time_between_steps_stays_between_them():
    assert later([0.001, 1.0], 3, 1 / 240) == pytest.approx([0.001 + 3 / 240, 1.0 + 3 / 240], abs=1e-15)


def test_alone_and_among_others_it_is_the_same_time():
    env = gymnasium.make("Spatula/Press-v0", engine="batch")
    envs = gymnasium.make_vec("Spatula/Press-v0", num_envs=2)
    env.reset(seed=0)
    envs.reset(seed=0)
    still = np.zeros(env.action_space.shape, dtype=np.float32)
    for count in range(1, 31):
        one, many = env.step(still)[4], envs.step(np.stack([still, still]))[4]
        assert one["time"] == many["time"][0] == 12 * count * (1 / 240)
    env.close()
    envs.close()


@pytest.mark.parametrize(
    "make", [lambda: Simulation(scenes.seed(), engine="batch"), lambda: BatchSimulation(scenes.seed(), 2)]
)
@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, pickle.dumps])
def test_what_cannot_be_copied_says_what_to_do(make, duplicate):
    with pytest.raises(TypeError, match=r"Simulation can be neither copied nor pickled: make another one of its scene"):
        duplicate(make())


def test_no_world_is_written_to_twice():
    worlds = BatchSimulation(scenes.seed(), 3)
    state = worlds.save([0, 1])
    for call in (lambda: worlds.reset([1, 1]), lambda: worlds.restore(state, [2, 2])):
        with pytest.raises(ValueError, match=r"worlds must be named once each, got \["):
            call()
    worlds.restore(state, [2, 0])
