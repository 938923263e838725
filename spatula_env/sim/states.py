"""Complete states of worlds, to be saved and restored: of many worlds together, or of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.contact.world import ContactMemory

if TYPE_CHECKING:
    from spatula_env.arrays import BoolArray, FloatArray, IntArray
    from spatula_env.contact.world import Multipliers, NearMemory


@dataclass(frozen=True)
class WorldMemory:
    """What the contact model remembers of one world from step to step.

    Attributes:
        flags: Contact flags of each tool (outer) and organ (inner).
        multipliers: Multipliers from which solves start (warm start).
        ledger: Account of the energy that the tools put in.
        near: Memory of contact of organs with themselves and each other.
        pace: Fraction of their motion that the tools make in the next step.
    """

    flags: tuple[BoolArray, ...]
    multipliers: Multipliers
    ledger: FloatArray
    near: NearMemory
    pace: float = 1.0


@dataclass(frozen=True)
class WorldsState:
    """The complete state of n worlds, which determines how they continue; made by `Worlds.save`.

    Attributes:
        nodes: (n, V, 3) [u].
        node_velocities: (n, V, 3) [u/s].
        tool_positions: (n, N, 3) of the N tools [u].
        tool_orientations: (n, N, 4).
        tool_forces: (n, N, 3) on each tool in the last physics step [kg u/s2].
        times: (n,) [s].
        memories: (n,) memories of the contact model.
        inner: (n,) the engine's state besides the surface nodes; None where there is none.
    """

    nodes: FloatArray
    node_velocities: FloatArray
    tool_positions: FloatArray
    tool_orientations: FloatArray
    tool_forces: FloatArray
    times: FloatArray
    memories: tuple[WorldMemory, ...]
    inner: tuple[Any, ...] | None = None

    def rows(self, rows: IntArray) -> WorldsState:
        """The states of some of the n worlds, by indices (k,)."""
        taken: dict[str, Any] = {}
        for each in fields(self):
            value = getattr(self, each.name)
            taken[each.name] = tuple(value[k] for k in rows.tolist()) if isinstance(value, tuple) else value
            if isinstance(value, np.ndarray):
                taken[each.name] = value[rows]
        return WorldsState(**taken)


@dataclass(frozen=True)
class SimulationState:
    """The complete state of a simulation, which determines how it continues; made by `Simulation.save`.

    Attributes:
        nodes: (V, 3) [u].
        node_velocities: (V, 3) [u/s].
        tool_positions: (N, 3) of the N tools [u].
        tool_orientations: (N, 4).
        contact: What the contact model remembers, and the forces of the last step.
        time: Time since the reset [s].
        inner: The engine's state besides the surface nodes; None where there is none.
    """

    nodes: FloatArray
    node_velocities: FloatArray
    tool_positions: FloatArray
    tool_orientations: FloatArray
    contact: ContactMemory
    time: float
    inner: Any = None

    @classmethod
    def of_world(cls, state: WorldsState, world: int = 0) -> SimulationState:
        """Extract the state of one of n worlds."""
        memory, tools = state.memories[world], len(state.tool_positions[world])
        organs = len(memory.flags) // tools
        forces = state.tool_forces[world]
        return cls(
            nodes=state.nodes[world],
            node_velocities=state.node_velocities[world],
            tool_positions=state.tool_positions[world],
            tool_orientations=state.tool_orientations[world],
            contact=ContactMemory(
                flags=tuple(memory.flags[k : k + organs] for k in range(0, tools * organs, organs)),
                multipliers=memory.multipliers,
                ledger=memory.ledger,
                wrenches=np.concatenate([forces, np.zeros_like(forces)], axis=1),
                near=memory.near,
                pace=memory.pace,
            ),
            time=float(state.times[world]),
            inner=None if state.inner is None else state.inner[world],
        )

    @staticmethod
    def joined(states: Sequence[SimulationState]) -> WorldsState:
        """Join the states of n worlds into one."""
        return WorldsState(
            nodes=np.stack([state.nodes for state in states]),
            node_velocities=np.stack([state.node_velocities for state in states]),
            tool_positions=np.stack([state.tool_positions for state in states]),
            tool_orientations=np.stack([state.tool_orientations for state in states]),
            tool_forces=np.stack([state.contact.wrenches[:, :3] for state in states]),
            times=np.array([state.time for state in states]),
            memories=tuple(
                WorldMemory(
                    flags=tuple(flags for row in state.contact.flags for flags in row),
                    multipliers=state.contact.multipliers,
                    ledger=state.contact.ledger,
                    near=state.contact.near,
                    pace=state.contact.pace,
                )
                for state in states
            ),
            inner=tuple(state.inner for state in states),
        )

    @property
    def flags(self) -> tuple[tuple[BoolArray, ...], ...]:
        """Contact flags of each tool (outer) and organ (inner)."""
        return self.contact.flags
