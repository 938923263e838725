"""Recordings of faults: a state, and the motion of the tools from there, to be repeated step by step.

A recording is an .npz file with `nodes` (V, 3) and `velocities` (V, 3) of the organs, `positions` (N, 3) and
`orientations` (N, 4) of the tools, and `linear` and `angular` (S, N, 3), the tools' velocities in each of S physics
steps. It may also hold the memory of the contact model; see `REMEMBERED`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.motions import RECORDED
from spatula_env.contact.world import ContactMemory, NearMemory
from spatula_env.sim.drive import restrain
from spatula_env.sim.simulation import SimulationState

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from spatula_env import Simulation

    FloatArray = NDArray[np.float64]

REMEMBERED = ("names", "features", "rows", "ledger", "wrenches", *(f"near_{name}" for name in NearMemory._fields))
"""Names of the arrays of the contact model's memory, besides the flags of each tool and organ, `flags_0_0` etc."""

BEFORE = 4
"""Number of control steps before the faulty stretch at which a recording begins."""

LONGEST = 24
"""Greatest number of control steps in a recording."""


def write_recording(path: Path, state: SimulationState, linear: FloatArray, angular: FloatArray) -> None:
    """Write a recording.

    Args:
        path: Path of the .npz file.
        state: Initial state.
        linear: (S, N, 3) linear velocities of the tools in each physics step [u/s].
        angular: (S, N, 3) angular velocities [rad/s].
    """
    moved = (state.nodes, state.node_velocities, state.tool_positions, state.tool_orientations, linear, angular)
    contact = state.contact
    remembered = (*contact.multipliers, contact.ledger, contact.wrenches, *map(np.array, contact.near))
    flags = {f"flags_{i}_{j}": flags for i, row in enumerate(contact.flags) for j, flags in enumerate(row)}
    arrays: dict[str, Any] = dict(zip((*RECORDED, *REMEMBERED), (*moved, *remembered), strict=True))
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, **arrays | flags)


def restore_recording(simulation: Simulation, path: Path) -> tuple[FloatArray, FloatArray]:
    """Put a simulation into the state of a recording.

    Args:
        simulation: A simulation of the scene that was recorded.
        path: Path of the .npz file.

    Returns:
        Linear [u/s] and angular [rad/s] velocities of the tools in each physics step, (S, N, 3) each.

    Raises:
        ValueError: If the file lacks an array, or does not fit the scene.
    """
    with np.load(path) as recorded:
        missing = [name for name in RECORDED if name not in recorded]
        if missing:
            raise ValueError(f"{path} must hold {list(RECORDED)}, it lacks {missing}")
        nodes, velocities, positions, orientations, linear, angular = (
            np.array(recorded[name], dtype=np.float64) for name in RECORDED
        )
        state = simulation.save()
        if all(name in recorded for name in REMEMBERED):
            names, features, rows, ledger, wrenches, *near = (recorded[name] for name in REMEMBERED)
            contact = ContactMemory(
                flags=tuple(
                    tuple(recorded[f"flags_{i}_{j}"] for j in range(len(row))) for i, row in enumerate(state.flags)
                ),
                multipliers=(names, features, rows),
                ledger=ledger,
                wrenches=wrenches,
                near=NearMemory(near[0], near[1], near[2], near[3], bool(near[4]), float(near[5])),
            )
            state = replace(state, contact=contact)
    simulation.restore(
        replace(
            state,
            nodes=nodes,
            node_velocities=velocities,
            tool_positions=positions,
            tool_orientations=orientations,
        )
    )
    return linear, angular


@dataclass
class _ControlStep:
    """A control step of all worlds: initial state, and velocities of the tools in each physics step, (W, N, 3) each."""

    state: Any
    linear: list[FloatArray]
    angular: list[FloatArray]


class Recorder:
    """Records the worst stretch of consecutive control steps with a fault in a world.

    Args:
        worlds: The worlds; they are watched from now on. Call `look_after_every_step` afterwards, so that physics steps
            are made one by one.
        path: Path of the .npz file, written whenever a stretch is worse than all before.
    """

    def __init__(self, worlds: Any, path: Path) -> None:
        self._worlds, self._path = worlds, path
        self._kept: deque[_ControlStep] = deque(maxlen=LONGEST)
        self._forces = np.zeros(worlds.tool_positions.shape)
        # For each world: control steps since its episode began and since its stretch began, and how bad the latter is.
        self._age, self._length = np.zeros(worlds.count, dtype=int), np.zeros(worlds.count, dtype=int)
        self._badness = np.zeros(worlds.count)
        self.worst = 0.0
        advance = worlds.advance

        def advance_and_keep(
            linear: Any, angular: Any, steps: int, pressure_limits: Any, force_limits: Any, *nobody: None
        ) -> Any:
            if force_limits is None:
                self._keep(linear, angular)
            else:
                self._keep(*self._restrained(linear, angular, force_limits))
            loads = advance(linear, angular, steps, pressure_limits, force_limits)
            self._forces = np.ascontiguousarray(loads.forces)
            return loads

        worlds.advance = advance_and_keep

    def begin_control_step(self) -> None:
        """Save the state of all worlds; to be called before every control step."""
        state = self._worlds.save(np.arange(self._worlds.count))
        self._kept.append(_ControlStep(state, [], []))
        self._forces = np.array(
            [SimulationState.of_world(state, world).contact.wrenches[:, :3] for world in range(len(self._age))]
        )
        self._age += 1

    def end_control_step(self, badness: FloatArray) -> None:
        """Extend or end the stretches of all worlds; to be called after every control step.

        Args:
            badness: (W,) how bad the control step was in each world, 0 if there was no fault.
        """
        bad = badness > 0.0
        self._length[bad] += 1
        self._badness = np.maximum(self._badness, badness)
        over = (self._length > 0) & (~bad | (self._length >= LONGEST - BEFORE))
        for world in np.flatnonzero(over).tolist():
            self._finish(world)

    def forget(self, worlds: Any) -> None:
        """End the stretches of worlds (n,) that are about to be reset."""
        for world in worlds:
            self._finish(world)
            # The reset happens in the next control step.
            self._age[world] = -1

    def _keep(self, linear: FloatArray, angular: FloatArray) -> None:
        self._kept[-1].linear.append(np.array(linear))
        self._kept[-1].angular.append(np.array(angular))

    def _restrained(self, linear: FloatArray, angular: FloatArray, limits: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Velocities (W, N, 3) after `drive.restrain`: limited where forces in the last physics step were too great."""
        linear, angular = np.array(linear, dtype=np.float64), np.array(angular, dtype=np.float64)
        slower, turning = np.empty_like(linear), np.empty_like(angular)
        positions = self._worlds.tool_positions
        for world, limit in enumerate(limits.tolist()):
            restrain(
                positions[world],
                linear[world],
                angular[world],
                self._forces[world],
                limit,
                slower[world],
                turning[world],
            )
        return slower, turning

    def _finish(self, world: int) -> None:
        """End the stretch of a world, and write it if it is the worst so far."""
        length, badness = int(self._length[world]), float(self._badness[world])
        self._length[world], self._badness[world] = 0, 0.0
        if badness <= self.worst:
            return
        self.worst = badness
        # The last control step may be the first one without a fault, which is not counted in the length.
        count = min(length + 1 + BEFORE, int(self._age[world]), len(self._kept))
        kept = list(self._kept)[-count:]
        write_recording(
            self._path,
            SimulationState.of_world(kept[0].state, world),
            np.array([v[world] for each in kept for v in each.linear]),
            np.array([w[world] for each in kept for w in each.angular]),
        )
