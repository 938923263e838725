"""The part of a physics step that follows the engine's, in each world: move the tools, resolve contact, add up loads.

Contact differs from world to world and is resolved world by world, in double precision, whichever engine has moved the
organs. The worlds of a block share a workspace: they are processed one after the other, on one thread.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.experimental import structref

from spatula_env._kernels import inline_kernel, kernel
from spatula_env.contact.motion import Motions, OrganMotion, StepOutcome, copy_points, turn_by
from spatula_env.contact.pressure import tool_pressures
from spatula_env.contact.settings import CONTACT_COUNT, CROSSED_FOR, PENETRATION, RESIDUAL, STOPPED
from spatula_env.contact.step import resolve_step
from spatula_env.sim.drive import restrain


class State(NamedTuple):
    """The state of W worlds.

    Attributes:
        nodes: (W, V, 3) [u].
        velocities: (W, V, 3) of the nodes [u/s].
        tool_positions: (W, N, 3) [u].
        tool_orientations: (W, N, 4).
        tool_forces: (W, N, 3) on each tool in the last step [kg u/s2].
        diverged: (W,) worlds that are skipped.
    """

    nodes: np.ndarray
    velocities: np.ndarray
    tool_positions: np.ndarray
    tool_orientations: np.ndarray
    tool_forces: np.ndarray
    diverged: np.ndarray


class Drive(NamedTuple):
    """The prescribed motion of the tools of W worlds, and its limits.

    Attributes:
        linear: (W, N, 3) [u/s].
        angular: (W, N, 3) [rad/s].
        pressure_limits: (W,) pressure beyond which overpressure is counted [kg/(u s2)].
        force_limits: (W,) see `drive.restrain` [kg u/s2].
    """

    linear: np.ndarray
    angular: np.ndarray
    pressure_limits: np.ndarray
    force_limits: np.ndarray


class Sums(NamedTuple):
    """Sums over the physics steps of a control step in W worlds: as `worlds.Loads`, with sums in place of averages.

    Attributes:
        forces: (W, N, 3).
        torques: (W, N, 3).
        peak_forces: (W, N).
        penetrations: (W,) of the last step.
        residuals: (W,).
        ground_forces: (W, 3).
        peak_pressures: (W,).
        overpressures: (W,).
        restrained: (W,).
        crossed_for: (W,) how long organs have crossed after the last step [s].
        face_pressures: (W, N, F) normal force on each face divided by its area; F: faces of the tool with the most.
        node_pressures: (W, N, n) of the last step; n: contact nodes of the tool with the most.
    """

    forces: np.ndarray
    torques: np.ndarray
    peak_forces: np.ndarray
    penetrations: np.ndarray
    residuals: np.ndarray
    ground_forces: np.ndarray
    peak_pressures: np.ndarray
    overpressures: np.ndarray
    restrained: np.ndarray
    crossed_for: np.ndarray
    face_pressures: np.ndarray
    node_pressures: np.ndarray


class LastStep(NamedTuple):
    """The last step of the last world of each of B blocks; where a block has one world, of every world.

    The first six are the fields of `contact.motion.Motions`.

    Attributes:
        start_positions: (B, N, 3) of the tools [u].
        start_orientations: (B, N, 4).
        positions: (B, N, 3) at the end [u].
        orientations: (B, N, 4).
        linear: (B, N, 3) the tools' velocities [u/s].
        angular: (B, N, 3) [rad/s].
        nodes: (B, V, 3) at the end [u].
        impulses: (B, V, 3) impulses of the tools on the nodes [kg u/s].
        wrenches: (B, N + 1, 6) impulses of the organs on the tools and, last, on the ground [kg u/s, kg u2/s2].
        result: (B, 7) by the column names of `contact.settings`.
    """

    start_positions: np.ndarray
    start_orientations: np.ndarray
    positions: np.ndarray
    orientations: np.ndarray
    linear: np.ndarray
    angular: np.ndarray
    nodes: np.ndarray
    impulses: np.ndarray
    wrenches: np.ndarray
    result: np.ndarray


@structref.register
class CouplingType(types.StructRef):
    """Numba type of `Coupling`."""


class Coupling(structref.StructRefProxy):
    """Everything that couples the engine with the tools, as a structure that can be passed to a kernel at no cost.

    Fields:
        contacts: `WorldContacts` of each of the W worlds.
        with_tools: Whether there is contact with the tools, or only with the ground.
        first_step: Code of the detectors' first step; see `contact.step.resolve_step`.
        dt: Length of a step [s].
        state: `State` of the worlds; written.
        drive: `Drive`, the prescribed motion of the tools.
        sums: `Sums`, added to.
        last: `LastStep`; written, and a workspace of each block.
    """


structref.define_proxy(
    Coupling,
    CouplingType,
    ["contacts", "with_tools", "first_step", "dt", "state", "drive", "sums", "last"],
)


@kernel()
def make_coupling(
    contacts: Any,
    with_tools: bool,
    first_step: int,
    dt: float,
    state: State,
    drive: Drive,
    sums: Sums,
    last: LastStep,
) -> Any:
    """Make a `Coupling` of these fields."""
    return Coupling(contacts, with_tools, first_step, dt, state, drive, sums, last)


@inline_kernel
def drive_tools(
    state: State, drive: Drive, sums: Sums, last: LastStep, dt: float, block: int, w: int, share: float
) -> bool:
    """Write the motion of a world's tools in the coming step into the block's `LastStep`; see `couple_worlds`.

    Returns:
        Whether too great a force restrains the prescribed motion.
    """
    positions, orientations = state.tool_positions[w], state.tool_orientations[w]
    linear, angular = last.linear[block], last.angular[block]
    restrained: bool = restrain(
        positions, drive.linear[w], drive.angular[w], state.tool_forces[w], drive.force_limits[w], linear, angular
    )
    if restrained:
        sums.restrained[w] += share
    for k in range(positions.shape[0]):
        for axis in range(3):
            last.start_positions[block, k, axis] = positions[k, axis]
            last.positions[block, k, axis] = positions[k, axis] + linear[k, axis] * dt
        for entry in range(4):
            last.start_orientations[block, k, entry] = orientations[k, entry]
        turn_by(orientations[k], angular[k], dt, last.orientations[block, k])
    return restrained


@inline_kernel
def add_loads(
    contact: Any, state: State, drive: Drive, sums: Sums, last: LastStep, dt: float, block: int, w: int
) -> None:
    """Add the loads on a world's tools in the step that has just been made, and move the tools to its end."""
    positions, orientations, wrenches = last.positions[block], last.orientations[block], last.wrenches[block]
    tool_count, push_count = positions.shape[0], int(last.result[block, CONTACT_COUNT])
    greatest = 0.0
    for k in range(tool_count):
        squared = 0.0
        for axis in range(3):
            force = wrenches[k, axis] / dt
            sums.forces[w, k, axis] += force
            sums.torques[w, k, axis] += wrenches[k, 3 + axis] / dt
            state.tool_forces[w, k, axis] = force
            squared += wrenches[k, axis] ** 2
        sums.peak_forces[w, k] = max(sums.peak_forces[w, k], np.sqrt(squared) / dt)
        if squared > 0.0:
            greatest = max(greatest, tool_pressures(
                contact, k, push_count, positions[k], orientations[k], sums.node_pressures[w, k],
                sums.face_pressures[w, k],
            ))  # fmt: skip
        else:
            sums.node_pressures[w, k] = 0.0
    sums.peak_pressures[w] = max(sums.peak_pressures[w], greatest)
    sums.overpressures[w] += max(greatest - drive.pressure_limits[w], 0.0) * dt
    for k in range(tool_count):
        for axis in range(3):
            state.tool_positions[w, k, axis] = positions[k, axis]
        for entry in range(4):
            state.tool_orientations[w, k, entry] = orientations[k, entry]


@inline_kernel
def couple_worlds(
    coupling: Any,
    block: int,
    first: int,
    end: int,
    share: float,
    free_nodes: np.ndarray,
    free_velocities: np.ndarray,
) -> None:
    """Finish a physics step in the worlds of a block, after the engine's.

    Args:
        coupling: `Coupling` of the worlds; written.
        block: Index of the block.
        first: Its first world.
        end: The world after its last one.
        share: Length of the physics step as a fraction of the control step.
        free_nodes: (n, V, 3) or more: nodes of the worlds from `first` on, moved by the engine without contact [u].
        free_velocities: (n, V, 3) or more: their velocities [u/s].
    """
    # Reading the fields of a structure counts references, so it is done once here and not for every world.
    contacts, state, drive, sums, last = (
        coupling.contacts, coupling.state, coupling.drive, coupling.sums, coupling.last,
    )  # fmt: skip
    with_tools, first_step, dt = coupling.with_tools, coupling.first_step, coupling.dt
    resolved, wrenches, result = last.nodes[block], last.wrenches[block], last.result[block]
    ground = last.positions.shape[1] if with_tools else 0
    for w in range(first, end):
        if state.diverged[w]:
            continue
        restrained = with_tools and drive_tools(state, drive, sums, last, dt, block, w, share)
        motions = Motions(
            last.start_positions[block, :ground], last.start_orientations[block, :ground],
            last.positions[block, :ground], last.orientations[block, :ground], last.linear[block, :ground],
            last.angular[block, :ground],
        )  # fmt: skip
        organs = OrganMotion(
            state.nodes[w], free_nodes[w - first], free_velocities[w - first], resolved, state.velocities[w]
        )
        status = resolve_step(
            contacts[w], first_step, motions, organs, StepOutcome(last.impulses[block], wrenches, result)
        )
        if status != 0:
            state.diverged[w] = True
            continue
        copy_points(resolved, state.nodes[w])
        sums.penetrations[w], sums.crossed_for[w] = result[PENETRATION], result[CROSSED_FOR]
        sums.residuals[w] = max(sums.residuals[w], result[RESIDUAL])
        if result[STOPPED] > 0.0 and not restrained:
            sums.restrained[w] += share
        for axis in range(3):
            sums.ground_forces[w, axis] -= wrenches[ground, axis] / dt
        if with_tools:
            add_loads(contacts[w], state, drive, sums, last, dt, block, w)


# Compiled when first called, because the type of a coupling follows from its contents.
@kernel(nogil=True)
def couple_block(
    block: int, lanes: int, coupling: Any, share: float, free_nodes: np.ndarray, free_velocities: np.ndarray
) -> None:
    """Finish a physics step in the worlds of a block; see `couple_worlds`.

    Args:
        block: Index of the block.
        lanes: Worlds in a block.
        coupling: See `couple_worlds`.
        share: See `couple_worlds`.
        free_nodes: (W, V, 3) nodes of all worlds, moved by the engine without contact [u].
        free_velocities: (W, V, 3) their velocities [u/s].
    """
    first = block * lanes
    end = min(first + lanes, free_nodes.shape[0])
    couple_worlds(coupling, block, first, end, share, free_nodes[first:end], free_velocities[first:end])


@kernel(nogil=True)
def drive_worlds(coupling: Any, share: float) -> None:
    """Write the tools' motion in the coming step, for an engine that has the tools itself; every block is one world."""
    state, drive, sums, last = coupling.state, coupling.drive, coupling.sums, coupling.last
    for w in range(state.diverged.shape[0]):
        if not state.diverged[w]:
            drive_tools(state, drive, sums, last, coupling.dt, w, w, share)
