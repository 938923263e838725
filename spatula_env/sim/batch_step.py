"""One control step of many worlds in one call: integrate the organs, move the tools, resolve contact, add up loads.

A block of worlds is taken through all physics steps of the control step before the next one: its state stays in the
processor's cache meanwhile. Organs are integrated for the whole block at once (see `batch_body`). Contact differs from
world to world and is resolved world by world, in double precision, by the kernel that `Simulation` uses.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from spatula_env._kernels import inline_kernel
from spatula_env.contact.motion import turn_by
from spatula_env.contact.step import PENETRATION, RESIDUAL, RESULT_LENGTH, resolve_step
from spatula_env.sim.batch_body import advance_block, read_block, write_block

FORCE, TORQUE, PEAK, LOAD_LENGTH = 0, 3, 6, 7
"""Columns of a tool's loads: force [kg u/s2] and torque [kg u2/s2], averaged, and the greatest force [kg u/s2]."""

DEEPEST, WORST_RESIDUAL, GROUND_FORCE, SUMMARY_LENGTH = 0, 1, 2, 5
"""Columns of a world's summary: greatest depth of a contact node in the last step, before correction, and how far tools
were in organs after correction, at most in any step [u]; mean force of the ground on the organs [kg u/s2]."""


@inline_kernel
def advance_worlds_of_block(
    block: int,
    positions: np.ndarray,
    velocities: np.ndarray,
    predicted: np.ndarray,
    movable: np.ndarray,
    links: np.ndarray,
    factors: np.ndarray,
    gravity: np.ndarray,
    stiffness: np.ndarray,
    dt: float,
    inverse_dt: float,
    finite: np.ndarray,
    contacts: Any,
    with_tools: bool,
    mode: int,
    first_step: int,
    step_length: float,
    steps: int,
    nodes: np.ndarray,
    node_velocities: np.ndarray,
    tool_positions: np.ndarray,
    tool_orientations: np.ndarray,
    linear_velocities: np.ndarray,
    angular_velocities: np.ndarray,
    loads: np.ndarray,
    summaries: np.ndarray,
    diverged: np.ndarray,
) -> None:
    """Take the worlds of one block through a control step.

    Args:
        block: Its index.
        positions: (V, C, lanes) of the block, and so on to `finite`: see `batch_body.advance_block`.
        velocities: See there.
        predicted: See there.
        movable: See there.
        links: See there.
        factors: See there.
        gravity: See there.
        stiffness: See there.
        dt: See there.
        inverse_dt: See there.
        finite: See there.
        contacts: `WorldContacts` of each of the W worlds.
        with_tools: Whether tools count, or only the ground.
        mode: See `contact.step.resolve_step`.
        first_step: See there.
        step_length: Of a physics step, in double precision [s].
        steps: Physics steps in the control step.
        nodes: (W, V, 3) written: after contact [u].
        node_velocities: (W, V, 3) written [u/s].
        tool_positions: (W, N, 3) written [u].
        tool_orientations: (W, N, 4) written.
        linear_velocities: (W, N, 3) of the tools [u/s].
        angular_velocities: (W, N, 3) [rad/s].
        loads: (W, N, 7) written, by the column names of this module.
        summaries: (W, 5) written.
        diverged: (W,) worlds that are left alone, as they have diverged; written.
    """
    lanes, node_count, tool_count = positions.shape[2], nodes.shape[1], tool_positions.shape[1]
    first = block * lanes
    end = min(first + lanes, nodes.shape[0])
    free_nodes, free_velocities = np.empty((end - first, node_count, 3)), np.empty((end - first, node_count, 3))
    resolved, impulses = np.empty((node_count, 3)), np.empty((node_count, 3))
    ends, turned = np.empty((tool_count, 3)), np.empty((tool_count, 4))
    wrenches, result = np.empty((tool_count + 1, 6)), np.empty(RESULT_LENGTH)
    ground = 0 if not with_tools else tool_count
    loads[first:end] = 0.0
    summaries[first:end] = 0.0
    for _ in range(steps):
        advance_block(
            positions, velocities, predicted, movable, links, factors, gravity,
            stiffness, dt, inverse_dt, finite,
        )  # fmt: skip
        # All worlds at once: what stands side by side in memory are the worlds.
        read_block(positions, free_nodes)
        read_block(velocities, free_velocities)
        for w in range(first, end):
            lane = w - first
            if diverged[w]:
                continue
            if finite[lane] != 0.0:
                diverged[w] = True
                continue
            for k in range(tool_count):
                for axis in range(3):
                    ends[k, axis] = tool_positions[w, k, axis] + linear_velocities[w, k, axis] * step_length
                turn_by(tool_orientations[w, k], angular_velocities[w, k], step_length, turned[k])
            status = resolve_step(
                contacts[w], with_tools, mode, first_step, True, tool_positions[w], tool_orientations[w], ends, turned,
                linear_velocities[w], angular_velocities[w], nodes[w], free_nodes[lane], free_velocities[lane],
                resolved, node_velocities[w], impulses, wrenches, result,
            )  # fmt: skip
            if status != 0:
                diverged[w] = True
                continue
            nodes[w] = resolved
            summaries[w, DEEPEST] = result[PENETRATION]
            summaries[w, WORST_RESIDUAL] = max(summaries[w, WORST_RESIDUAL], result[RESIDUAL])
            for axis in range(3):
                summaries[w, GROUND_FORCE + axis] -= wrenches[ground, axis] / step_length
            if not with_tools:
                continue
            for k in range(tool_count):
                squared = 0.0
                for axis in range(3):
                    loads[w, k, FORCE + axis] += wrenches[k, axis] / step_length
                    loads[w, k, TORQUE + axis] += wrenches[k, 3 + axis] / step_length
                    squared += wrenches[k, axis] ** 2
                loads[w, k, PEAK] = max(loads[w, k, PEAK], np.sqrt(squared) / step_length)
            tool_positions[w] = ends
            tool_orientations[w] = turned
        write_block(positions, nodes[first:end])
        write_block(velocities, node_velocities[first:end])
    for w in range(first, end):
        for axis in range(3):
            summaries[w, GROUND_FORCE + axis] /= steps
            for k in range(tool_count):
                loads[w, k, FORCE + axis] /= steps
                loads[w, k, TORQUE + axis] /= steps


@numba.njit(cache=True, error_model="numpy", nogil=True)
def advance_serially(
    positions: np.ndarray,
    velocities: np.ndarray,
    predicted: np.ndarray,
    movable: np.ndarray,
    links: np.ndarray,
    factors: np.ndarray,
    gravity: np.ndarray,
    stiffness: np.ndarray,
    dt: float,
    inverse_dt: float,
    finite: np.ndarray,
    contacts: Any,
    with_tools: bool,
    mode: int,
    first_step: int,
    step_length: float,
    steps: int,
    nodes: np.ndarray,
    node_velocities: np.ndarray,
    tool_positions: np.ndarray,
    tool_orientations: np.ndarray,
    linear_velocities: np.ndarray,
    angular_velocities: np.ndarray,
    loads: np.ndarray,
    summaries: np.ndarray,
    diverged: np.ndarray,
) -> None:
    """Take all worlds through a control step, block after block; arguments as of `advance_worlds_of_block`."""
    for b in range(positions.shape[0]):
        advance_worlds_of_block(
            b, positions[b], velocities[b], predicted[b], movable, links, factors,
            gravity[b], stiffness[b], dt, inverse_dt, finite[b], contacts, with_tools, mode, first_step, step_length,
            steps, nodes, node_velocities, tool_positions, tool_orientations, linear_velocities, angular_velocities,
            loads, summaries, diverged,
        )  # fmt: skip


@numba.njit(cache=True, error_model="numpy", parallel=True)
def advance_in_parallel(
    positions: np.ndarray,
    velocities: np.ndarray,
    predicted: np.ndarray,
    movable: np.ndarray,
    links: np.ndarray,
    factors: np.ndarray,
    gravity: np.ndarray,
    stiffness: np.ndarray,
    dt: float,
    inverse_dt: float,
    finite: np.ndarray,
    contacts: Any,
    with_tools: bool,
    mode: int,
    first_step: int,
    step_length: float,
    steps: int,
    nodes: np.ndarray,
    node_velocities: np.ndarray,
    tool_positions: np.ndarray,
    tool_orientations: np.ndarray,
    linear_velocities: np.ndarray,
    angular_velocities: np.ndarray,
    loads: np.ndarray,
    summaries: np.ndarray,
    diverged: np.ndarray,
) -> None:
    """Do what `advance_serially` does, the blocks shared out among Numba's threads."""
    for b in numba.prange(positions.shape[0]):
        advance_worlds_of_block(
            b, positions[b], velocities[b], predicted[b], movable, links, factors,
            gravity[b], stiffness[b], dt, inverse_dt, finite[b], contacts, with_tools, mode, first_step, step_length,
            steps, nodes, node_velocities, tool_positions, tool_orientations, linear_velocities, angular_velocities,
            loads, summaries, diverged,
        )  # fmt: skip
