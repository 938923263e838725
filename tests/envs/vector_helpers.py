"""Shared helpers of the tests of vector environments."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import TimeLimit

import spatula_env
from spatula_env.envs import PressEnv, vector
from spatula_env.sim.engine import ContactName
from spatula_env.sim.worlds import Loads, Worlds

gym.register_envs(spatula_env)

ENGINES = ("bullet", "batch")
COUNT = 3

GOAL = (0.006, -0.004, 0.008)
"""A shallow goal, and a start right above it: reached within a few steps."""
ABOVE_GOAL = (0.006, -0.004, -0.016)


class LentWorlds:
    """Worlds that are made once and lent to one environment after the other, and can be made to break down.

    Attributes:
        breaking: Which world diverges when it is advanced next, and then has nodes that are not finite.
    """

    def __init__(self, worlds: Worlds) -> None:
        self._worlds = worlds
        self.breaking: int | None = None
        self._broken: set[int] = set()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._worlds, name)

    @property
    def nodes(self) -> np.ndarray:
        nodes = self._worlds.nodes
        nodes[sorted(self._broken)] = np.nan
        return nodes

    def reset(self, worlds: np.ndarray) -> None:
        self._broken -= set(worlds.tolist())
        self._worlds.reset(worlds)

    def advance(self, linear: np.ndarray, angular: np.ndarray, steps: int, *limits: Any) -> Loads:
        loads = self._worlds.advance(linear, angular, steps, *limits)
        if self.breaking is not None:
            self._broken.add(self.breaking)
            self.breaking = None
        diverged = np.isin(np.arange(self._worlds.count), sorted(self._broken))
        loads.forces[diverged] = 0.0
        return replace(loads, diverged=loads.diverged | diverged)

    def close(self) -> None:
        """They are lent out again."""


@contextmanager
def lending() -> Iterator[None]:
    """Let vector environments share worlds, which take long to make with Bullet."""
    kept: dict[Any, Worlds] = {}

    def lend(scene: Any, count: int, *, engine: str, contact: ContactName) -> LentWorlds:
        key = (count, engine, contact)
        if key not in kept:
            kept[key] = Worlds(scene, count, engine=engine, contact=contact)
        worlds = LentWorlds(kept[key])
        worlds.reset(np.arange(count))
        return worlds

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(vector, "Worlds", lend)
        yield
    for worlds in kept.values():
        worlds.close()


def single_envs(engine: str, steps: int | None, **options: Any) -> list[gym.Env[Any, Any]]:
    """Environments for one agent, with a time limit."""
    made: list[gym.Env[Any, Any]] = [PressEnv(engine=engine, **options) for _ in range(COUNT)]
    return made if steps is None else [TimeLimit(env, steps) for env in made]


def pressing_actions(count: int, seed: int = 0, worlds: int = COUNT) -> np.ndarray:
    """(count, worlds, 3) at random, but downwards."""
    actions = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, worlds, 3)).astype(np.float32)
    actions[..., 2] = -np.abs(actions[..., 2])
    return actions


def assert_alike(mine: Any, theirs: Any, tolerance: float, where: str = "result") -> None:
    """Check that results have the same structure, kinds of numbers and values."""
    if isinstance(theirs, dict):
        assert set(mine) == set(theirs), where
        for name in theirs:
            assert_alike(mine[name], theirs[name], tolerance, f"{where}[{name!r}]")
    elif isinstance(theirs, np.ndarray) and theirs.dtype != object:
        assert mine.dtype == theirs.dtype, where
        assert mine.shape == theirs.shape, where
        if theirs.dtype == np.bool_:
            assert mine.tolist() == theirs.tolist(), where
        else:
            np.testing.assert_allclose(mine, theirs, rtol=tolerance, atol=tolerance, err_msg=where)
    elif isinstance(theirs, np.ndarray | tuple | list):
        assert len(mine) == len(theirs), where
        for k, (one, other) in enumerate(zip(mine, theirs, strict=True)):
            assert_alike(one, other, tolerance, f"{where}[{k}]")
    else:
        assert mine == theirs, where
