"""A reset or a restored state of one of many worlds affects that world alone."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from vector_helpers import assert_alike

from spatula_env.envs import ClampVectorEnv, PressVectorEnv

FEW, MANY = 8, 72

OPTIONS: dict[str, dict[str, Any]] = {
    "plain": {},
    "drawn": {"randomization": "default", "obs_mode": "dict", "observation": {"history": 3, "delay": 0.05}},
    "points": {"obs_mode": "pointcloud", "reward": "sparse", "observation": {"organ_points": 8, "tool_points": 4}},
}


def size_of(value: Any) -> int:
    """Bytes of all arrays in dictionaries, tuples and lists."""
    if isinstance(value, dict):
        return sum(map(size_of, value.values()))
    if isinstance(value, tuple | list):
        return sum(map(size_of, value))
    return int(value.nbytes)


def most_memory(call: Callable[[], Any]) -> tuple[int, int]:
    """Peak memory that a call allocates, and size of what it returns [bytes]."""
    call()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        returned = call()
        return tracemalloc.get_traced_memory()[1] - before, size_of(returned)
    finally:
        tracemalloc.stop()


def mask_of(count: int, world: int) -> np.ndarray:
    return np.arange(count) == world


@pytest.mark.parametrize("name", OPTIONS)
def test_a_reset_of_one_world_copies_no_other(name: str) -> None:
    """Gymnasium requires observations and infos of all worlds; no other memory may grow with their number."""
    needed = {}
    for count in (FEW, MANY):
        env = PressVectorEnv(count, engine="batch", autoreset_mode="disabled", **OPTIONS[name])
        env.reset(seed=0)
        env.step(np.zeros((count, 3), dtype=np.float32))
        options = {"reset_mask": mask_of(count, 3), "tool_position": np.array([0.0, 0.0, -0.02])}
        needed[count] = np.array(most_memory(lambda env=env, options=options: env.reset(options=options)))
        env.close()
    grown, returned = needed[MANY] - needed[FEW]
    # The nodes of the other worlds alone would take eight times the memory that is allowed besides what is returned.
    assert grown <= returned + (MANY - FEW) * 1000
    assert returned > 0


def test_a_state_of_one_world_copies_no_other() -> None:
    needed = {}
    for count in (FEW, MANY):
        env = PressVectorEnv(count, engine="batch")
        env.reset(seed=0)
        state = env.save(np.array([2]))
        calls = (lambda env=env: env.save(np.array([2])) and (), lambda env=env, state=state: env.restore(state, [1]))
        needed[count] = np.array([most_memory(call) for call in calls])
        env.close()
    for grown, returned in needed[MANY] - needed[FEW]:
        assert grown <= returned + (MANY - FEW) * 1000


@pytest.mark.parametrize("name", OPTIONS)
def test_worlds_begun_one_by_one_are_as_if_begun_at_once(name: str) -> None:
    """Results are those of worlds that begin together, to the last bit; what others hold stays as it was."""
    count = 3
    made = [ClampVectorEnv(count, engine="batch", autoreset_mode="disabled", **OPTIONS[name]) for _ in range(2)]
    together, apart = made
    together.reset(seed=0)
    apart.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (4, *apart.action_space.shape)).astype(np.float32)
    for action in actions[:2]:
        for env in made:
            env.step(action)
    at_once, infos_at_once = together.reset(seed=[5, 6, 7])
    seen = []
    for world in range(count):
        before = apart.save(np.delete(np.arange(count), world))
        observations, infos = apart.reset(seed=[5, 6, 7], options={"reset_mask": mask_of(count, world)})
        seen.append((observations, {key: values.copy() for key, values in infos.items()}))
        after = apart.save(np.delete(np.arange(count), world))
        for field in vars(before.episodes.situation):
            np.testing.assert_array_equal(
                getattr(after.episodes.situation, field), getattr(before.episodes.situation, field), err_msg=field
            )
    assert_alike(seen[-1][0], at_once, 0.0)
    for key, values in infos_at_once.items():
        rows = np.array([infos[key][world] for world, (_, infos) in enumerate(seen)])
        np.testing.assert_array_equal(rows, values, err_msg=key)
        if key.startswith("_"):
            for world, (_, infos) in enumerate(seen):
                assert infos[key].tolist() == mask_of(count, world).tolist()
    for action in actions[2:]:
        results = [env.step(action) for env in made]
        assert_alike(results[0][0], results[1][0], 0.0)
        np.testing.assert_array_equal(results[0][1], results[1][1])
    for env in made:
        env.close()


def test_what_was_returned_does_not_change_where_a_world_begins() -> None:
    env = PressVectorEnv(3, engine="batch", autoreset_mode="disabled")
    env.reset(seed=0)
    observations, _, _, _, infos = env.step(np.tile(np.float32([0.0, 0.0, -1.0]), (3, 1)))
    forces, positions = env._episodes.forces, env.grips
    kept = [np.array(observations), {key: np.array(value) for key, value in infos.items()}]
    felt, grips = forces.copy(), positions.copy()
    env.reset(seed=9, options={"reset_mask": mask_of(3, 1)})
    np.testing.assert_array_equal(observations, kept[0])
    for key, value in infos.items():
        np.testing.assert_array_equal(value, kept[1][key], err_msg=key)
    np.testing.assert_array_equal(forces, felt)
    np.testing.assert_array_equal(positions, grips)
    env.close()
