"""Exchange between contact and the nodes of tissue, as instructions on rows of lanes.

Each intrinsic is the body of a loop over nodes. A surface node that contact held stays held through the substeps of the
next step; see `docs/tissue.md`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba.extending import intrinsic

from spatula_env.sim.tissue.lanes import Build, Row, dot
from spatula_env.sim.tissue.nodal import instructions, vector

LONGEST_THROW = 0.005
"""Greatest distance between a held node and the place, passed to contact, where it would be without being held [u]. It
suffices for the node to be found in the tool; farther away, it might be found on the tool's other side."""

GIVEN_BACK = 0.2
"""Share of a debt that is given back in a step: given back at once, it would be a blow."""

LEAST_JUMP = 1e-12
"""A node whose change of velocity by contact is less than this, squared, is not in contact [u2/s2]."""


def _throw_time(build: Build, hold: list[Row], dt: Any) -> Row:
    """Time for which a node that was held is moved on freely for contact: a step, or until `LONGEST_THROW`."""
    squared = dot(hold, hold)
    longest = build.constant(LONGEST_THROW) / squared.most(build.constant(LEAST_JUMP)).root()
    return longest.least(build.spread(dt))


def _emit_take_contact(
    build: Build,
    positions: Any,
    velocities: Any,
    free_velocities: Any,
    directions: Any,
    holds: Any,
    debts: Any,
    dt: Any,
    node: Any,
) -> None:
    velocity, hold = vector(build, velocities, node), vector(build, holds, node)
    jump = [v - free for v, free in zip(velocity, vector(build, free_velocities, node), strict=True)]
    squared, none = dot(jump, jump), build.constant(0.0)
    time = _throw_time(build, hold, dt)
    is_free = squared.is_less(build.constant(LEAST_JUMP))
    inverse = build.choose(is_free, none, build.constant(1.0) / squared.root())
    for axis in range(3):
        at_position, at_velocity, at_direction, at_hold, at_debt = (
            build.address(base, node, axis, 3) for base in (positions, velocities, directions, holds, debts)
        )
        build.store(jump[axis] * inverse, at_direction)
        # A node that contact releases was held for one step too long: it keeps the held motion, and is given back the
        # difference gradually, as a debt.
        owed = build.choose(is_free, hold[axis], none)
        build.store(build.load(at_position).plus(owed, time), at_position)
        build.store(velocity[axis] + owed, at_velocity)
        build.store((build.load(at_debt) * build.constant(1.0 - GIVEN_BACK)) - owed, at_debt)
        build.store(none, at_hold)


@intrinsic
def take_contact(
    typing_context: Any,
    lanes: Any,
    positions: Any,
    velocities: Any,
    free_velocities: Any,
    directions: Any,
    holds: Any,
    debts: Any,
    dt: Any,
    node: Any,
) -> tuple[Any, Callable[..., Any]]:
    """Find the direction in which contact has changed a surface node's velocity; release a node it left alone."""
    return instructions(
        _emit_take_contact, lanes, positions, velocities, free_velocities, directions, holds, debts, dt, node
    )


def _emit_give_free(
    build: Build, positions: Any, velocities: Any, free_velocities: Any, holds: Any, dt: Any, node: Any
) -> None:
    hold = vector(build, holds, node)
    time = _throw_time(build, hold, dt)
    for axis in range(3):
        at_position, at_velocity, at_free = (
            build.address(base, node, axis, 3) for base in (positions, velocities, free_velocities)
        )
        velocity = build.load(at_velocity) - hold[axis]
        build.store(velocity, at_velocity)
        build.store(velocity, at_free)
        build.store(build.load(at_position).plus(-hold[axis], time), at_position)


@intrinsic
def give_free(
    typing_context: Any,
    lanes: Any,
    positions: Any,
    velocities: Any,
    free_velocities: Any,
    holds: Any,
    dt: Any,
    node: Any,
) -> tuple[Any, Callable[..., Any]]:
    """Move a surface node to where it would be if nothing had held it, so that contact may hold it again."""
    return instructions(_emit_give_free, lanes, positions, velocities, free_velocities, holds, dt, node)
