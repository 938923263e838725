"""Snapshots of environments: everything that the next step depends on, saved and restored world by world."""

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
"""Physics of n worlds; one state per world in older snapshots of single environments, and in those with PyBullet."""

Rows = dict[str, "NDArray[Any]"]
"""Arrays (n, ...) by name."""

MAY_DIFFER = ("render_mode", "width", "height", "episode_time")
"""Options in which the restored environment may differ from the saved one."""


@dataclass(frozen=True, eq=False)
class EpisodesState:
    """State of the episodes of n worlds, apart from the physics.

    Attributes:
        counters: "goals" (n, G), "elapsed", "held" and "succeeded" (n,), and the delayed actions, "asked" (n, D, A).
        memory: Memory of the task.
        safety: Sums of cost, work and violations, in the last step and in the episode.
        node_pressures: For each tool, pressures on its contact nodes in the last physics step (n, K) [Pa].
        drawn: Randomised quantities, by the names in `randomization.NEUTRAL`.
        generators: (n,) generators of measurement errors; None where there are none.
        situation: Latest situation.
        frames: Last frames of observations (n, depth, ...), if they are delayed or stacked.
        observation: Last observation returned.
        info: Last info returned.
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

    It can be pickled and sent to another process. Restoring does not change it, so it can be restored any number of
    times.

    Attributes:
        name: Name of the task.
        settings: All options of the environment.
        physics: Organs, tools and contact.
        episodes: State of the episodes.
        generators: (n,) generators of further episodes; None where nothing has been drawn.
        seeds: (n,) seeds of these generators.
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
        """Number n of worlds."""
        return len(self.over)

    def rows(self, rows: ArrayLike) -> EnvState:
        """Select the states of some of the n worlds.

        Args:
            rows: (k,) indices from 0 to n - 1, which may be repeated, or a mask of n booleans.

        Returns:
            The state of k worlds.

        Raises:
            ValueError: If a row does not exist, or none is given.
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
    """Check that a state belongs to an environment like this one.

    Args:
        state: State to restore.
        name: Name of this environment's task.
        settings: Options of this environment.
        setting: Organ and tools of this environment.

    Raises:
        TypeError: If it is not a state of an environment.
        ValueError: If it belongs to another environment; the message says what differs.
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
    """Save the physics of some worlds (n,), such that they continue exactly as they will after a restore.

    PyBullet's results cannot be read to the last bit: its velocities keep rounding errors of all earlier steps. So a
    simulation in PyBullet is set to its own saved state, which clears these errors, and original and copy continue
    alike. This changes how the original continues, by an amount of the size of such errors.
    """
    state = physics.save(worlds)
    if not physics.engine.abilities.restores_exactly:
        physics.restore(state, worlds)
    return state


def joined(physics: Physics) -> WorldsState:
    """The joint state of n worlds, from either form of a snapshot."""
    return SimulationState.joined(physics) if isinstance(physics, tuple) else physics


def _take(tree: Any, rows: IntArray) -> Any:
    """Select rows of all arrays in nested dictionaries and tuples, and copy generators, one for each row."""
    if isinstance(tree, dict):
        return {name: _take(values, rows) for name, values in tree.items()}
    if isinstance(tree, tuple) and all(one is None or isinstance(one, np.random.Generator) for one in tree) and tree:
        return tuple(copy.deepcopy(tree[row]) for row in rows.tolist())
    if isinstance(tree, tuple):
        return tuple(_take(values, rows) for values in tree)
    return tree[rows]
