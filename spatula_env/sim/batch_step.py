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
from spatula_env.contact.pressure import node_pressures
from spatula_env.contact.step import CONTACT_COUNT, MEAN_EDGE, PENETRATION, RESIDUAL, RESULT_LENGTH, resolve_step
from spatula_env.sim.batch_body import advance_block, read_block, write_block

FORCE, TORQUE, PEAK, LOAD_LENGTH = 0, 3, 6, 7
"""Columns of a tool's loads: force [kg u/s2] and torque [kg u2/s2], averaged, and the greatest force [kg u/s2]."""

DEEPEST, WORST_RESIDUAL, GROUND_FORCE, PEAK_PRESSURE, OVERPRESSURE, SUMMARY_LENGTH = 0, 1, 2, 5, 6, 7
"""Columns of a world's summary: greatest depth of a contact node in the last step, before correction, and how far tools
were in organs after correction, at most in any step [u]; mean force of the ground on the organs [kg u/s2]; greatest
pressure on a contact node in any step [kg/(u s2)], and the integral over time of what the greatest pressure exceeds the
world's limit by [kg/(u s)]."""


@inline_kernel
def add_pressures(
    contacts: Any,
    tool: int,
    push_count: int,
    position: np.ndarray,
    orientation: np.ndarray,
    areas: np.ndarray,
    dt: float,
    rotation: np.ndarray,
    touching: np.ndarray,
    shares: np.ndarray,
    pressures: np.ndarray,
    face_pressures: np.ndarray,
) -> float:
    """The pressure on a tool that is touched, after a physics step.

    Args:
        contacts: `WorldContacts`.
        tool: Its index.
        push_count: How many constraints count.
        position: (3,) of the tool [u].
        orientation: (4,) of the tool.
        areas: (n,) or more, of its nodes [u2].
        dt: Length of the step [s].
        rotation: (9,) workspace.
        touching: (n,) or more, workspace.
        shares: (n,) or more, workspace.
        pressures: (n,) or more, written [kg/(u s2)].
        face_pressures: (F,) or more, the mean pressure on each face is added [kg/(u s2)].

    Returns:
        The greatest pressure on a node [kg/(u s2)].
    """
    shape = contacts.tools[tool]
    nodes, face = shape.nodes, shape.face
    count, organs = nodes.shape[0], contacts.first_vertices.shape[0]
    touching[:count] = False
    for organ in range(organs):
        states = contacts.memories[tool * organs + organ].states
        for i in range(count):
            touching[i] |= states[0, i]
    write_rotation(orientation, rotation)
    greatest = node_pressures(
        contacts.constraints.rows, contacts.constraints.features, push_count, tool, position, rotation, nodes,
        shape.normals, face, areas, touching, contacts.settings[MEAN_EDGE], dt, shares, pressures,
    )  # fmt: skip
    begin = 0
    while begin < count:
        # Nodes of a face follow each other; where they do not, a face comes in several pieces.
        end, force, area = begin, 0.0, 0.0
        while end < count and face[end] == face[begin]:
            force += pressures[end] * areas[end]
            area += areas[end]
            end += 1
        face_pressures[face[begin]] += force / area
        begin = end
    return greatest


@inline_kernel
def write_rotation(orientation: np.ndarray, rotation: np.ndarray) -> None:
    """Write the rotation matrix (9,) of a unit quaternion (4,); see `transforms.rotation_matrix`."""
    x, y, z, w = orientation[0], orientation[1], orientation[2], orientation[3]
    rotation[0], rotation[1], rotation[2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
    rotation[3], rotation[4], rotation[5] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)
    rotation[6], rotation[7], rotation[8] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)


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
    areas: np.ndarray,
    pressure_limits: np.ndarray,
    loads: np.ndarray,
    summaries: np.ndarray,
    face_pressures: np.ndarray,
    pressures: np.ndarray,
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
        areas: (W, N, n) of the tools' nodes, n those of the tool with the most [u2].
        pressure_limits: (W,) from which on pressure is overpressure [kg/(u s2)].
        loads: (W, N, 7) written, by the column names of this module.
        summaries: (W, 7) written, by the column names of this module.
        face_pressures: (W, N, F) written, F the faces of the tool with the most: normal force on each face by its area,
            averaged [kg/(u s2)].
        pressures: (W, N, n) written: on each node in the last step [kg/(u s2)].
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
    most_nodes = areas.shape[2]
    shares, touching, rotation = np.empty(most_nodes), np.empty(most_nodes, dtype=np.bool_), np.empty(9)
    loads[first:end] = 0.0
    summaries[first:end] = 0.0
    face_pressures[first:end] = 0.0
    pressures[first:end] = 0.0
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
            greatest = 0.0
            for k in range(tool_count):
                squared = 0.0
                for axis in range(3):
                    loads[w, k, FORCE + axis] += wrenches[k, axis] / step_length
                    loads[w, k, TORQUE + axis] += wrenches[k, 3 + axis] / step_length
                    squared += wrenches[k, axis] ** 2
                loads[w, k, PEAK] = max(loads[w, k, PEAK], np.sqrt(squared) / step_length)
                if squared > 0.0:
                    greatest = max(greatest, add_pressures(
                        contacts[w], k, int(result[CONTACT_COUNT]), ends[k], turned[k], areas[w, k], step_length,
                        rotation, touching, shares, pressures[w, k], face_pressures[w, k],
                    ))  # fmt: skip
                else:
                    pressures[w, k] = 0.0
            summaries[w, PEAK_PRESSURE] = max(summaries[w, PEAK_PRESSURE], greatest)
            summaries[w, OVERPRESSURE] += max(greatest - pressure_limits[w], 0.0) * step_length
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
        face_pressures[w] /= steps


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
    areas: np.ndarray,
    pressure_limits: np.ndarray,
    loads: np.ndarray,
    summaries: np.ndarray,
    face_pressures: np.ndarray,
    pressures: np.ndarray,
    diverged: np.ndarray,
) -> None:
    """Take all worlds through a control step, block after block; arguments as of `advance_worlds_of_block`."""
    for b in range(positions.shape[0]):
        advance_worlds_of_block(
            b, positions[b], velocities[b], predicted[b], movable, links, factors,
            gravity[b], stiffness[b], dt, inverse_dt, finite[b], contacts, with_tools, mode, first_step, step_length,
            steps, nodes, node_velocities, tool_positions, tool_orientations, linear_velocities, angular_velocities,
            areas, pressure_limits, loads, summaries, face_pressures, pressures, diverged,
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
    areas: np.ndarray,
    pressure_limits: np.ndarray,
    loads: np.ndarray,
    summaries: np.ndarray,
    face_pressures: np.ndarray,
    pressures: np.ndarray,
    diverged: np.ndarray,
) -> None:
    """Do what `advance_serially` does, the blocks shared out among Numba's threads."""
    for b in numba.prange(positions.shape[0]):
        advance_worlds_of_block(
            b, positions[b], velocities[b], predicted[b], movable, links, factors,
            gravity[b], stiffness[b], dt, inverse_dt, finite[b], contacts, with_tools, mode, first_step, step_length,
            steps, nodes, node_velocities, tool_positions, tool_orientations, linear_velocities, angular_velocities,
            areas, pressure_limits, loads, summaries, face_pressures, pressures, diverged,
        )  # fmt: skip
