"""What contact and the nodes of tissue tell each other: instructions on rows of lanes.

Each is the body of a loop over nodes. A surface node that contact held is held through the next step's
substeps; see `docs/tissue.md`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba.extending import intrinsic

from spatula_env.sim.tissue.lanes import Build, Row, dot
from spatula_env.sim.tissue.nodal import instructions, vector

LONGEST_THROW = 0.005
"""How far from where it has been held contact is told that a node would be without it [u]. Enough to be found in the
tool; farther, and it might be found on the other side of it."""

GIVEN_BACK = 0.2
"""Of a debt, in a step: at once it would be a blow."""

LEAST_JUMP = 1e-12
"""Contact that changes a node's velocity by less, squared, leaves it alone [u2/s2]."""


def _throw_time(build: Build, hold: list[Row], dt: Any) -> Row:
    """How long a node that was held is let fly for contact: a step, or until `LONGEST_THROW`."""
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
        # A node that nothing holds any more was held for one step too long, which it is given back by and by.
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
    """Find in which direction contact has changed a surface node's velocity, and let go what it leaves alone."""
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
    """Put a surface node where it would be had nothing held it, for contact to hold it again."""
    return instructions(_emit_give_free, lanes, positions, velocities, free_velocities, holds, dt, node)
