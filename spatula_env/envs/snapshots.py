"""Snapshots of environments: all that the next step depends on, saved and restored world by world."""

from __future__ import annotations

import copy
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.envs.indices import indices_below
from spatula_env.sim.states import SimulationState, WorldsState
from spatula_env.sim.worlds import Worlds

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from spatula_env.arrays import BoolArray, IntArray
    from spatula_env.envs.settings import EnvSettings
    from spatula_env.tasks.situation import Setting, Situation

Physics = WorldsState | tuple[SimulationState, ...]
"""Of n worlds; world by world in older snapshots of single environments, and of those with PyBullet."""

Rows = dict[str, "NDArray[Any]"]
"""Arrays (n, ...) by name."""

MAY_DIFFER = ("render_mode", "width", "height", "episode_time")
"""Options in which the environment that is restored may differ from the one that was saved."""


@dataclass(frozen=True, eq=False)
class EpisodesState:
    """How the episodes of n worlds stand, beside the physics.

    Attributes:
        counters: "goals" (n, G), "elapsed", "held" and "succeeded" (n,), and the actions that wait, "asked" (n, D, A).
        memory: What the task remembers.
        safety: What has been counted of cost, work and violations, in the last step and in all.
        node_pressures: For each tool, on its contact nodes in the last physics step (n, K) [Pa].
        drawn: What differs from episode to episode, by the names in `randomization.NEUTRAL`.
        generators: (n,) from which errors of measurement come; None where there are none.
        situation: As it was last looked at.
        frames: The last frames of observations (n, depth, ...), where they are shown late or more than once.
        observation: What was last returned.
        info: What was last returned.
    """

    counters: Rows
    memory: Rows
    safety: Rows
    node_pressures: tuple[NDArray[Any], ...]
    drawn: Rows
    generators: tuple[np.random.Generator | None, ...]
    situation: Situation
    frames: Rows
    observation: Rows
    info: Rows


@dataclass(frozen=True, eq=False)
class EnvState:
    """Everything that the next step of an environment depends on, in n of its worlds; made by `save`.

    It can be pickled, and sent to another process. Nothing in it changes when it is restored: it can be restored as
    often as one likes.

    Attributes:
        name: Of the task.
        settings: All options of the environment.
        physics: Organs, tools and contact.
        episodes: How the episodes stand.
        generators: (n,) from which further episodes come; None where nothing has been drawn.
        seeds: (n,) what these were started from.
        over: (n,) whether an episode has ended and waits for the next one to begin.
    """

    name: str
    settings: EnvSettings
    physics: Physics
    episodes: EpisodesState
    generators: tuple[np.random.Generator | None, ...]
    seeds: tuple[int | None, ...]
    over: BoolArray

    @property
    def count(self) -> int:
        """N."""
        return len(self.over)

    def rows(self, rows: ArrayLike) -> EnvState:
        """The states of some of the n worlds.

        Args:
            rows: (k,) which, by indices from 0 to n - 1, which may be repeated, or by a mask of n booleans.

        Returns:
            Of k worlds.

        Raises:
            ValueError: If there are no such rows, or none is named.
        """
        chosen = indices_below(self.count, rows)
        if chosen is None:
            raise ValueError(
                f"rows must be one or more indices from 0 to {self.count - 1}, or {self.count} booleans of which one "
                f"is true at least, got {rows!r}"
            )
        episodes = self.episodes
        taken = {
            each.name: _take(getattr(episodes, each.name), chosen)
            for each in fields(episodes)
            if each.name != "situation"
        }
        return replace(
            self,
            physics=joined(self.physics).rows(chosen),
            episodes=EpisodesState(**taken, situation=episodes.situation.rows(chosen)),
            generators=_take(self.generators, chosen),
            seeds=tuple(self.seeds[row] for row in chosen.tolist()),
            over=self.over[chosen],
        )


def check_fits(state: EnvState, name: str, settings: EnvSettings, setting: Setting) -> None:
    """Check that a state is one of an environment like this one.

    Args:
        state: To be restored.
        name: Of this environment's task.
        settings: Its options.
        setting: Its organ and tools.

    Raises:
        TypeError: If it is no state of an environment.
        ValueError: If it is that of another environment; says what differs.
    """
    if not isinstance(state, EnvState):
        raise TypeError(f"state must be what save() of an environment returned, got {state!r}")
    if state.name != name:
        raise ValueError(f"state must be of the task {name!r}, it is of {state.name!r}")
    for each in fields(settings):
        mine, theirs = getattr(settings, each.name), getattr(state.settings, each.name)
        if each.name not in MAY_DIFFER and mine != theirs:
            raise ValueError(f"state must be of an environment with {each.name}={mine!r}, it is of one with {theirs!r}")
    nodes, tools = state.episodes.situation.nodes.shape[1:], state.episodes.situation.tool_positions.shape[1:]
    mine = len(setting.rest_nodes), len(setting.tools)
    if (nodes[0], tools[0]) != mine:
        raise ValueError(
            f"state must be of a scene with {mine[0]} nodes and {mine[1]} tools, it has {nodes[0]} and {tools[0]}"
        )


def save_physics(physics: Worlds, worlds: IntArray) -> WorldsState:
    """The state of the physics in some worlds (n,), from where it goes on exactly as when it is restored.

    What PyBullet has computed cannot be read to the last bit: its velocities keep rounding errors of all that was
    before. So a simulation of PyBullet is put to its own state, which clears them, and both go on alike. That changes
    how it goes on, by as much as such errors do.
    """
    state = physics.save(worlds)
    if not physics.engine.abilities.restores_exactly:
        physics.restore(state, worlds)
    return state


def joined(physics: Physics) -> WorldsState:
    """The state of n worlds, however it was saved."""
    return SimulationState.joined(physics) if isinstance(physics, tuple) else physics


def _take(tree: Any, rows: IntArray) -> Any:
    """Rows of all arrays in dictionaries and tuples, and copies of generators, one for each row."""
    if isinstance(tree, dict):
        return {name: _take(values, rows) for name, values in tree.items()}
    if isinstance(tree, tuple) and all(one is None or isinstance(one, np.random.Generator) for one in tree) and tree:
        return tuple(copy.deepcopy(tree[row]) for row in rows.tolist())
    if isinstance(tree, tuple):
        return tuple(_take(values, rows) for values in tree)
    return tree[rows]
