"""A step of the tissue in all worlds of a block."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from spatula_env._kernels import array_kernel, inline_kernel, kernel
from spatula_env.sim.lanes import tell_finite
from spatula_env.sim.tissue.held import give_free, take_contact
from spatula_env.sim.tissue.motion import lead_node, move_inner, move_surface
from spatula_env.sim.tissue.stress import find_deformation, find_neo_hookean, find_stress, relax_node

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Blocks(NamedTuple):
    """The arrays of O organs in all worlds: B blocks of `lanes` worlds each, in the tissue's precision.

    The nodes of all organs are numbered consecutively, organ after organ: N in all. So are the pairs of neighbours: K.

    Attributes:
        lanes: (lanes,) a tuple whose type gives the number of lanes.
        positions: (B, N, 3, lanes) [u].
        velocities: (B, N, 3, lanes) [u/s].
        leading: (2, B, N, 3, lanes) positions for forces: those of a little later than now, for viscosity [u].
        stresses: (B, N, 9, lanes) workspace.
        overstresses: (B, N, 6, lanes) the part of each node's stress that has relaxed; empty where nothing relaxes.
        histories: (B, N, R, 6, lanes) of R terms of relaxation.
        free_velocities: (B, N, 3, lanes) velocities passed to contact; for surface nodes, as are the next three [u/s].
        directions: (B, N, 3, lanes) unit vector along which contact holds a node, or zero.
        holds: (B, N, 3, lanes) change of velocity by which a node was held in the step [u/s].
        debts: (B, N, 3, lanes) velocity still to be added gradually to a node, because it was held too long [u/s].
        starts: (N + 1,) where each node's neighbours begin.
        neighbours: (K,) the neighbours of each node.
        pairs: (K, `nodal.PAIR_COLUMNS`).
        nodes: (N, `nodal.NODE_COLUMNS`).
        surface: (V,) the nodes on organs' surfaces: the vertices.
        surface_ends: (O,) the node after the last one on each organ's surface; an organ begins with its surface nodes.
        ends: (O,) the node after the last one of each organ.
        materials: (B, O, `nodal.MATERIAL_ROWS`, lanes).
        relaxation: (B, O, R, 2, lanes) factor on a history's distance from the stress in a step, and a term's share.
        general: (O,) whether an organ's material has c2 or c3, or relaxes.
        terms: (O,) number of terms of relaxation.
        steps: (B, O, S, `nodal.STEP_ROWS`, lanes) for each substep; zero in worlds that take fewer.
        substeps: (B, O) number of substeps in the world of a block that takes the most.
        dt: Length of a step [s].
        finite: (B, lanes) zero where all velocities are finite after a step, NaN otherwise.
    """

    lanes: tuple[int, ...]
    positions: NDArray[Any]
    velocities: NDArray[Any]
    leading: NDArray[Any]
    stresses: NDArray[Any]
    overstresses: NDArray[Any]
    histories: NDArray[Any]
    free_velocities: NDArray[Any]
    directions: NDArray[Any]
    holds: NDArray[Any]
    debts: NDArray[Any]
    starts: NDArray[np.int32]
    neighbours: NDArray[np.int32]
    pairs: NDArray[Any]
    nodes: NDArray[Any]
    surface: NDArray[np.int32]
    surface_ends: NDArray[np.int64]
    ends: NDArray[np.int64]
    materials: NDArray[Any]
    relaxation: NDArray[Any]
    general: NDArray[np.bool_]
    terms: NDArray[np.int64]
    steps: NDArray[Any]
    substeps: NDArray[np.int64]
    dt: Any
    finite: NDArray[Any]


@array_kernel
def begin_step(
    lanes: tuple[int, ...],
    positions: np.ndarray,
    velocities: np.ndarray,
    leading: np.ndarray,
    materials: np.ndarray,
    first: int,
    end: int,
) -> None:
    """Write the positions at which forces on an organ's nodes are evaluated, from their state after contact."""
    for i in range(first, end):
        lead_node(lanes, positions, velocities, leading, materials, i)


@array_kernel
def find_stresses(
    lanes: tuple[int, ...],
    leading: np.ndarray,
    stresses: np.ndarray,
    overstresses: np.ndarray,
    starts: np.ndarray,
    neighbours: np.ndarray,
    pairs: np.ndarray,
    nodes: np.ndarray,
    materials: np.ndarray,
    general: bool,
    first: int,
    end: int,
) -> None:
    """Write the stresses of an organ's nodes."""
    if general:
        for i in range(first, end):
            find_stress(lanes, leading, stresses, overstresses, starts, neighbours, pairs, nodes, materials, i)
    else:
        for i in range(first, end):
            find_neo_hookean(lanes, leading, stresses, overstresses, starts, neighbours, pairs, nodes, materials, i)


@array_kernel
def move_nodes(
    lanes: tuple[int, ...],
    directions: np.ndarray,
    holds: np.ndarray,
    debts: np.ndarray,
    positions: np.ndarray,
    velocities: np.ndarray,
    leading: np.ndarray,
    next_leading: np.ndarray,
    stresses: np.ndarray,
    starts: np.ndarray,
    neighbours: np.ndarray,
    pairs: np.ndarray,
    nodes: np.ndarray,
    materials: np.ndarray,
    steps: np.ndarray,
    first: int,
    surface_end: int,
    end: int,
    substep: int,
) -> None:
    """Advance an organ's nodes by a substep."""
    for i in range(first, surface_end):
        move_surface(
            lanes, directions, holds, debts, positions, velocities, leading, next_leading, stresses, starts, neighbours,
            pairs, nodes, materials, steps, i, substep,
        )  # fmt: skip
    for i in range(surface_end, end):
        move_inner(
            lanes, positions, velocities, leading, next_leading, stresses, starts, neighbours, pairs, nodes, materials,
            steps, i, substep,
        )  # fmt: skip


@array_kernel
def take_contacts(
    lanes: tuple[int, ...],
    positions: np.ndarray,
    velocities: np.ndarray,
    free_velocities: np.ndarray,
    directions: np.ndarray,
    holds: np.ndarray,
    debts: np.ndarray,
    dt: float,
    first: int,
    end: int,
) -> None:
    """Take over the changes that contact has made to an organ's surface nodes."""
    for i in range(first, end):
        take_contact(lanes, positions, velocities, free_velocities, directions, holds, debts, dt, i)


@array_kernel
def give_frees(
    lanes: tuple[int, ...],
    positions: np.ndarray,
    velocities: np.ndarray,
    free_velocities: np.ndarray,
    holds: np.ndarray,
    dt: float,
    first: int,
    end: int,
) -> None:
    """Move an organ's surface nodes to where they would be if nothing had held them."""
    for i in range(first, end):
        give_free(lanes, positions, velocities, free_velocities, holds, dt, i)


@array_kernel
def relax_nodes(
    lanes: tuple[int, ...],
    positions: np.ndarray,
    overstresses: np.ndarray,
    histories: np.ndarray,
    starts: np.ndarray,
    neighbours: np.ndarray,
    pairs: np.ndarray,
    materials: np.ndarray,
    relaxation: np.ndarray,
    terms: int,
    first: int,
    end: int,
) -> None:
    """Let the stresses of an organ's nodes relax for a step."""
    for i in range(first, end):
        relax_node(
            lanes, positions, overstresses, histories, starts, neighbours, pairs, materials, relaxation, terms, i
        )


@inline_kernel
def advance_block(blocks: Blocks, b: int) -> None:
    """Advance all worlds of a block by one step.

    Args:
        blocks: The arrays of all blocks; written.
        b: Index of the block.
    """
    lanes, starts, neighbours, pairs, nodes = (
        blocks.lanes, blocks.starts, blocks.neighbours, blocks.pairs, blocks.nodes,
    )  # fmt: skip
    positions, velocities, now, later = (
        blocks.positions[b], blocks.velocities[b], blocks.leading[0, b], blocks.leading[1, b],
    )  # fmt: skip
    stresses, overstresses, histories = blocks.stresses[b], blocks.overstresses[b], blocks.histories[b]
    free_velocities, directions, holds, debts = (
        blocks.free_velocities[b], blocks.directions[b], blocks.holds[b], blocks.debts[b],
    )  # fmt: skip
    first = 0
    for organ in range(blocks.ends.shape[0]):
        end, materials, steps = blocks.ends[organ], blocks.materials[b, organ], blocks.steps[b, organ]
        terms, general, surface_end = blocks.terms[organ], blocks.general[organ], blocks.surface_ends[organ]
        take_contacts(
            lanes, positions, velocities, free_velocities, directions, holds, debts, blocks.dt, first, surface_end
        )
        if terms > 0:
            relax_nodes(
                lanes, positions, overstresses, histories, starts, neighbours, pairs, materials,
                blocks.relaxation[b, organ], terms, first, end,
            )  # fmt: skip
        begin_step(lanes, positions, velocities, now, materials, first, end)
        for substep in range(blocks.substeps[b, organ]):
            find_stresses(
                lanes, now, stresses, overstresses, starts, neighbours, pairs, nodes, materials, general, first, end
            )
            move_nodes(
                lanes, directions, holds, debts, positions, velocities, now, later, stresses, starts, neighbours, pairs,
                nodes, materials, steps, first, surface_end, end, substep,
            )  # fmt: skip
            now, later = later, now
        give_frees(lanes, positions, velocities, free_velocities, holds, blocks.dt, first, surface_end)
        first = end
    tell_finite(velocities, blocks.finite[b])


@array_kernel
def read_block(block: np.ndarray, nodes: np.ndarray, values: np.ndarray) -> None:
    """Copy the values (n, V, 3) of some nodes (V,) of a block's first n worlds out of it (N, 3, lanes)."""
    for i in range(nodes.shape[0]):
        for axis in range(3):
            for lane in range(values.shape[0]):
                values[lane, i, axis] = block[nodes[i], axis, lane]


@array_kernel
def write_block(block: np.ndarray, nodes: np.ndarray, values: np.ndarray) -> None:
    """Copy the values (n, V, 3) of some nodes (V,) of a block's first n worlds into it (N, 3, lanes)."""
    for i in range(nodes.shape[0]):
        for axis in range(3):
            for lane in range(values.shape[0]):
                block[nodes[i], axis, lane] = values[lane, i, axis]


@array_kernel
def find_block_deformations(
    lanes: tuple[int, ...],
    positions: np.ndarray,
    deformations: np.ndarray,
    starts: np.ndarray,
    neighbours: np.ndarray,
    pairs: np.ndarray,
) -> None:
    """Write the deformation gradients (N, 9, lanes) at the nodes of a block."""
    for i in range(positions.shape[0]):
        find_deformation(lanes, positions, deformations, starts, neighbours, pairs, i)


# Compiled when first called, because a process rarely needs all precisions and numbers of lanes.
@kernel(nogil=True)
def find_deformations(blocks: Blocks) -> None:
    """Write the deformation gradients at all nodes into the workspace `Blocks.stresses`, row after row of each."""
    for b in range(blocks.positions.shape[0]):
        find_block_deformations(
            blocks.lanes, blocks.positions[b], blocks.stresses[b], blocks.starts, blocks.neighbours, blocks.pairs
        )


@kernel(nogil=True)
def advance_blocks(first_block: int, end_block: int, blocks: Blocks) -> None:
    """Advance some blocks by one step."""
    for b in range(first_block, end_block):
        advance_block(blocks, b)
