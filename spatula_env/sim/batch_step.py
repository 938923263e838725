"""One control step of many worlds in one call: integrate the organs, move the tools, resolve contact, add up loads.

A block of worlds is taken through all physics steps of the control step before the next one: its state stays in the
processor's cache meanwhile. Organs are integrated for the whole block at once (see `batch_body`). Contact differs from
world to world and is resolved world by world, in double precision, by the kernel that `Simulation` uses.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from spatula_env._kernels import kernel
from spatula_env.contact.motion import turn_by
from spatula_env.contact.pressure import tool_pressures
from spatula_env.contact.step import CONTACT_COUNT, PENETRATION, RESIDUAL, RESULT_LENGTH, resolve_step
from spatula_env.contact.step import CROSSED_FOR as LAST_CROSSED_FOR
from spatula_env.sim.batch_body import advance_block, read_block, write_block
from spatula_env.sim.drive import restrain

FORCE, TORQUE, PEAK, LOAD_LENGTH = 0, 3, 6, 7
"""Columns of a tool's loads: force [kg u/s2] and torque [kg u2/s2], averaged, and the greatest force [kg u/s2]."""

DEEPEST, WORST_RESIDUAL, GROUND_FORCE, PEAK_PRESSURE, OVERPRESSURE, RESTRAINED, CROSSED_FOR, SUMMARY_LENGTH = (
    0,
    1,
    2,
    5,
    6,
    7,
    8,
    9,
)
"""Columns of a world's summary: greatest depth of a contact node in the last step, before correction, and
greatest depth left after it, at most in any step [u]; mean force of the ground on the organs [kg u/s2]; greatest
pressure on a contact node in any step [kg/(u s2)], and the integral over time of what the greatest pressure exceeds the
world's limit by [kg/(u s)]; share of the steps in which too great a force kept tools from pushing on; for how long
organs have crossed [s]."""


@kernel(nogil=True)
def advance_blocks(
    first_block: int,
    end_block: int,
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
    pressure_limits: np.ndarray,
    force_limits: np.ndarray,
    tool_forces: np.ndarray,
    loads: np.ndarray,
    summaries: np.ndarray,
    face_pressures: np.ndarray,
    pressures: np.ndarray,
    diverged: np.ndarray,
) -> None:
    """Take the worlds of some blocks through a control step, block after block. Others may be taken at the same time.

    Args:
        first_block: Index of the first one.
        end_block: Index after the last one.
        positions: (B, V, C, lanes) of all blocks, and so on to `finite`: see `batch_body.advance_block`.
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
        pressure_limits: (W,) from which on pressure is overpressure [kg/(u s2)].
        force_limits: (W,) see `drive.restrain` [kg u/s2].
        tool_forces: (W, N, 3) on each tool in the last physics step, before this one and, written, of it [kg u/s2].
        loads: (W, N, 7) written, by the column names of this module.
        summaries: (W, 9) written, by the column names of this module.
        face_pressures: (W, N, F) written, F the faces of the tool with the most: normal force on each face by its area,
            averaged [kg/(u s2)].
        pressures: (W, N, n) written: on each node in the last step, n those of the tool with the most [kg/(u s2)].
        diverged: (W,) worlds that are left alone, as they have diverged; written.
    """
    lanes, node_count, tool_count = positions.shape[3], nodes.shape[1], tool_positions.shape[1]
    free_nodes, free_velocities = np.empty((lanes, node_count, 3)), np.empty((lanes, node_count, 3))
    resolved, impulses = np.empty((node_count, 3)), np.empty((node_count, 3))
    ends, turned = np.empty((tool_count, 3)), np.empty((tool_count, 4))
    linear, angular = np.empty((tool_count, 3)), np.empty((tool_count, 3))
    wrenches, result = np.empty((tool_count + 1, 6)), np.empty(RESULT_LENGTH)
    ground = 0 if not with_tools else tool_count
    for block in range(first_block, end_block):
        first = block * lanes
        end = min(first + lanes, nodes.shape[0])
        loads[first:end] = 0.0
        summaries[first:end] = 0.0
        face_pressures[first:end] = 0.0
        pressures[first:end] = 0.0
        for _ in range(steps):
            advance_block(
                positions[block], velocities[block], predicted[block], movable, links, factors, gravity[block],
                stiffness[block], dt, inverse_dt, finite[block],
            )  # fmt: skip
            # All worlds at once: what stands side by side in memory are the worlds.
            read_block(positions[block], free_nodes[: end - first])
            read_block(velocities[block], free_velocities[: end - first])
            for w in range(first, end):
                lane = w - first
                if diverged[w]:
                    continue
                if finite[block, lane] != 0.0:
                    diverged[w] = True
                    continue
                if restrain(
                    tool_positions[w], linear_velocities[w], angular_velocities[w], tool_forces[w], force_limits[w],
                    linear, angular,
                ):  # fmt: skip
                    summaries[w, RESTRAINED] += 1.0 / steps
                for k in range(tool_count):
                    for axis in range(3):
                        ends[k, axis] = tool_positions[w, k, axis] + linear[k, axis] * step_length
                    turn_by(tool_orientations[w, k], angular[k], step_length, turned[k])
                status = resolve_step(
                    contacts[w], with_tools, mode, first_step, True, tool_positions[w], tool_orientations[w], ends,
                    turned, linear, angular, nodes[w], free_nodes[lane], free_velocities[lane], resolved,
                    node_velocities[w], impulses, wrenches, result,
                )  # fmt: skip
                if status != 0:
                    diverged[w] = True
                    continue
                for i in range(node_count):
                    for axis in range(3):
                        nodes[w, i, axis] = resolved[i, axis]
                summaries[w, DEEPEST], summaries[w, CROSSED_FOR] = result[PENETRATION], result[LAST_CROSSED_FOR]
                summaries[w, WORST_RESIDUAL] = max(summaries[w, WORST_RESIDUAL], result[RESIDUAL])
                for axis in range(3):
                    summaries[w, GROUND_FORCE + axis] -= wrenches[ground, axis] / step_length
                if not with_tools:
                    continue
                greatest = 0.0
                for k in range(tool_count):
                    squared = 0.0
                    for axis in range(3):
                        loads[w, k, FORCE + axis] += wrenches[k, axis] / step_length
                        loads[w, k, TORQUE + axis] += wrenches[k, 3 + axis] / step_length
                        tool_forces[w, k, axis] = wrenches[k, axis] / step_length
                        squared += wrenches[k, axis] ** 2
                    loads[w, k, PEAK] = max(loads[w, k, PEAK], np.sqrt(squared) / step_length)
                    if squared > 0.0:
                        greatest = max(greatest, tool_pressures(
                            contacts[w], k, int(result[CONTACT_COUNT]), ends[k], turned[k], pressures[w, k],
                            face_pressures[w, k],
                        ))  # fmt: skip
                    else:
                        pressures[w, k] = 0.0
                summaries[w, PEAK_PRESSURE] = max(summaries[w, PEAK_PRESSURE], greatest)
                summaries[w, OVERPRESSURE] += max(greatest - pressure_limits[w], 0.0) * step_length
                for k in range(tool_count):
                    for axis in range(3):
                        tool_positions[w, k, axis] = ends[k, axis]
                    for entry in range(4):
                        tool_orientations[w, k, entry] = turned[k, entry]
            write_block(positions[block], nodes[first:end])
            write_block(velocities[block], node_velocities[first:end])
        for w in range(first, end):
            for axis in range(3):
                summaries[w, GROUND_FORCE + axis] /= steps
                for k in range(tool_count):
                    loads[w, k, FORCE + axis] /= steps
                    loads[w, k, TORQUE + axis] /= steps
            for k in range(tool_count):
                for face in range(face_pressures.shape[2]):
                    face_pressures[w, k, face] /= steps
