"""Motion of nodes in a substep, as instructions on rows of lanes, each the body of a loop over nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba.extending import intrinsic

from spatula_env.sim.tissue.lanes import Build, Row, dot
from spatula_env.sim.tissue.nodal import (
    MATERIAL_ROWS,
    NODE_COLUMNS,
    PAIR_COLUMNS,
    STABILISER,
    STEP_ROWS,
    VISCOUS_TIME,
    instructions,
    numbers,
    vector,
)


def _force(
    build: Build,
    positions: Any,
    stresses: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    nodes: Any,
    materials: Any,
    node: Any,
) -> list[Row]:
    """Force on a node by the stresses at the node and its neighbours, and by the stabiliser."""
    here, sums, draws = vector(build, positions, node), build.sums(3), build.sums(3)
    start, end = build.index(starts, node, 0, 1), build.index(starts, node, 1, 1)
    with build.each(start, end) as pair:
        neighbour = build.index(neighbours, pair, 0, 1)
        there = vector(build, positions, neighbour)
        gradient = numbers(build, pairs, pair, 3, PAIR_COLUMNS)
        weight = build.number(pairs, pair, 6, PAIR_COLUMNS)
        for axis in range(3):
            for k in range(3):
                sums[axis].add(build.load(build.address(stresses, neighbour, 3 * axis + k, 9)), gradient[k])
            draws[axis].add(there[axis] - here[axis], weight)
    gradient = numbers(build, nodes, node, 3, NODE_COLUMNS)
    stabiliser = build.load(build.address(materials, None, STABILISER, MATERIAL_ROWS))
    forces = []
    for axis in range(3):
        total = sums[axis].row
        for k in range(3):
            total = total.plus(build.load(build.address(stresses, node, 3 * axis + k, 9)), gradient[k])
        forces.append((stabiliser * draws[axis].row) - total)
    return forces


def _emit_move(
    build: Build,
    positions: Any,
    velocities: Any,
    leading: Any,
    next_leading: Any,
    stresses: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    nodes: Any,
    materials: Any,
    steps: Any,
    node: Any,
    substep: Any,
    touch: tuple[Any, Any, Any] | None = None,
) -> None:
    force = _force(build, leading, stresses, starts, neighbours, pairs, nodes, materials, node)
    length, push, fall, part = (build.load(build.address(steps, substep, row, STEP_ROWS)) for row in range(STEP_ROWS))
    inverse, moves = (build.number(nodes, node, column, NODE_COLUMNS) for column in range(2))
    lead = build.load(build.address(materials, None, VISCOUS_TIME, MATERIAL_ROWS))
    push = push * inverse
    gains = [push * force[axis] for axis in range(3)]
    gains[2] = gains[2].plus(-fall, moves)
    if touch is not None:
        directions, holds, debts = touch
        gains = [gain.plus(part, debt) for gain, debt in zip(gains, vector(build, debts, node), strict=True)]
        direction = vector(build, directions, node)
        # A change of velocity against the contact is held; one away from it is not.
        pressed = dot(gains, direction).least(build.constant(0.0))
        for axis in range(3):
            gains[axis] = gains[axis].plus(-pressed, direction[axis])
            at_hold = build.address(holds, node, axis, 3)
            build.store(build.load(at_hold).plus(-pressed, direction[axis]), at_hold)
    for axis in range(3):
        at_velocity, at_position, at_leading = (
            build.address(base, node, axis, 3) for base in (velocities, positions, next_leading)
        )
        velocity = build.load(at_velocity) + gains[axis]
        position = build.load(at_position).plus(length, velocity)
        build.store(velocity, at_velocity)
        build.store(position, at_position)
        build.store(position.plus(lead, velocity), at_leading)


def _emit_move_surface(build: Build, directions: Any, holds: Any, debts: Any, *given: Any) -> None:
    move: Callable[..., None] = _emit_move
    move(build, *given, touch=(directions, holds, debts))


@intrinsic
def move_inner(
    typing_context: Any,
    lanes: Any,
    positions: Any,
    velocities: Any,
    leading: Any,
    next_leading: Any,
    stresses: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    nodes: Any,
    materials: Any,
    steps: Any,
    node: Any,
    substep: Any,
) -> tuple[Any, Callable[..., Any]]:
    """Advance an inner node by a substep, and write the position at which forces are evaluated in the next one."""
    return instructions(
        _emit_move, lanes, positions, velocities, leading, next_leading, stresses, starts, neighbours, pairs, nodes,
        materials, steps, node, substep,
    )  # fmt: skip


@intrinsic
def move_surface(
    typing_context: Any,
    lanes: Any,
    directions: Any,
    holds: Any,
    debts: Any,
    positions: Any,
    velocities: Any,
    leading: Any,
    next_leading: Any,
    stresses: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    nodes: Any,
    materials: Any,
    steps: Any,
    node: Any,
    substep: Any,
) -> tuple[Any, Callable[..., Any]]:
    """Advance a surface node by a substep, held by what it touches."""
    return instructions(
        _emit_move_surface, lanes, directions, holds, debts, positions, velocities, leading, next_leading, stresses,
        starts, neighbours, pairs, nodes, materials, steps, node, substep,
    )  # fmt: skip


def _emit_lead(build: Build, positions: Any, velocities: Any, leading: Any, materials: Any, node: Any) -> None:
    lead = build.load(build.address(materials, None, VISCOUS_TIME, MATERIAL_ROWS))
    for axis in range(3):
        at_position, at_velocity, at_leading = (
            build.address(base, node, axis, 3) for base in (positions, velocities, leading)
        )
        build.store(build.load(at_position).plus(lead, build.load(at_velocity)), at_leading)


@intrinsic
def lead_node(
    typing_context: Any, lanes: Any, positions: Any, velocities: Any, leading: Any, materials: Any, node: Any
) -> tuple[Any, Callable[..., Any]]:
    """Write the position at which forces on a node are evaluated, from its position and velocity."""
    return instructions(_emit_lead, lanes, positions, velocities, leading, materials, node)
