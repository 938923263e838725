"""Passivity of contact: tools leave no more energy in an organ than the work that they do on it.

Sweeps end before they have converged, and contact planes turn: both may throw an organ off with energy that nothing has
supplied. Each organ has a ledger of the energy that was put in. Any excess over it is taken away again, first from the
organ's motion as a whole and then from the motion of its nodes relative to each other.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types

from spatula_env._kernels import ARRAYS, array_kernel, inline_kernel, kernel
from spatula_env.contact.response import sum_impulses
from spatula_env.contact.settings import GRAVITY, MEAN_EDGE
from spatula_env.contact.structures import (
    FOURTH,
    IMPULSE,
    ORGANS,
    OWNER,
    POINT,
    WEIGHTS,
    WORLD_CONTACTS,
)

F8_2 = ARRAYS["f8_2"]

WORK, GREATEST_WORK, REST_HEIGHT, STAGE, ENERGY = 0, 1, 2, 3, 4
LEDGER_LENGTH = 5
"""Columns of an organ's ledger: the energy that it had when a tool first touched it plus the tools' work on it since
[kg u2/s2]; the greatest value of that so far [kg u2/s2]; the sum of mass times height when counting began [kg u]; the
stage, by the names below; and its kinetic and potential energy at the end of the last step [kg u2/s2]."""

UNKNOWN, FREE, TOUCHED = 0.0, 1.0, 2.0
"""Stages of a ledger: counting has not begun, no tool has touched the organ yet, or one has."""

ENERGY_TOLERANCE = 0.002
"""Energy that an organ may have in excess of what was put in, as a part of the greatest work so far: it allows for
rounding and for the friction of a solve."""

ROUNDING = 1e-12
"""Energies whose relative difference is less than this count as equal."""


class MotionSums(NamedTuple):
    """Sums over an organ's free nodes.

    Attributes:
        mass: Sum of the masses [kg].
        height: Sum of mass times height, less its value when counting began [kg u].
        x: First component of the momentum [kg u/s].
        y: Second component of the momentum [kg u/s].
        z: Third component of the momentum [kg u/s].
        squares: Sum of mass times squared velocity [kg u2/s2].
    """

    mass: float
    height: float
    x: float
    y: float
    z: float
    squares: float


@array_kernel
def sum_motion(
    first: int, end: int, inverse_mass: np.ndarray, vertices: np.ndarray, velocities: np.ndarray, rest_height: float
) -> MotionSums:
    """Compute the `MotionSums` of an organ; arguments as in `limit_energy`, and `REST_HEIGHT` of the ledger."""
    mass, height, squares = 0.0, -rest_height, 0.0
    px, py, pz = 0.0, 0.0, 0.0
    for i in range(first, end):
        if inverse_mass[i] == 0.0:
            continue
        m = 1.0 / inverse_mass[i]
        x, y, z = velocities[i, 0], velocities[i, 1], velocities[i, 2]
        mass += m
        height += m * vertices[i, 2]
        px += m * x
        py += m * y
        pz += m * z
        squares += m * (x * x + y * y + z * z)
    return MotionSums(mass, height, px, py, pz, squares)


@array_kernel
def energy_of(sums: Any, gravity: float) -> float:
    """Kinetic and potential energy of an organ [kg u2/s2], from its `MotionSums` and gravity [u/s2]."""
    energy: float = 0.5 * sums.squares + gravity * sums.height
    return energy


@array_kernel
def passive_share(
    first: int,
    end: int,
    inverse_mass: np.ndarray,
    sums: Any,
    nodal_impulses: np.ndarray,
    step_work: float,
    gravity: float,
    mean_edge: float,
    ledger: np.ndarray,
) -> float:
    """The share of a step's impulses that an organ's motion as a whole may have, given the work that they do.

    A tool that turns by as much as a radian in a step pushes along planes that its faces had on their way, and may
    throw the organ off with more energy than the tool supplies. The motion of the nodes relative to each other is left
    to `limit_energy`.

    Args:
        first: Index of the organ's first vertex.
        end: Index after its last one.
        inverse_mass: (V,) [1/kg]; fixed nodes have zero.
        sums: `MotionSums` of the organ, with all impulses.
        nodal_impulses: (V, 3) of the tools [kg u/s].
        step_work: Work of these impulses [kg u2/s2]; the ledger includes it already.
        gravity: Gravity [u/s2].
        mean_edge: Mean edge of the organ with the smallest mean edge [u].
        ledger: (5,) the organ's, indexed by the column names of this module.

    Returns:
        The share from 0 to 1; 1 unless the motion would have more energy than was supplied.
    """
    mass, px, py, pz = sums.mass, sums.x, sums.y, sums.z
    if mass == 0.0:
        return 1.0
    least = 0.5 * mass * mean_edge**2
    allowed = ledger[WORK] + ENERGY_TOLERANCE * max(ledger[GREATEST_WORK], least) - gravity * sums.height
    if 0.5 * (px * px + py * py + pz * pz) / mass <= allowed:
        return 1.0
    jx, jy, jz = 0.0, 0.0, 0.0
    for i in range(first, end):
        if inverse_mass[i] != 0.0:
            jx += nodal_impulses[i, 0]
            jy += nodal_impulses[i, 1]
            jz += nodal_impulses[i, 2]
    # Taking away a share x of the impulses leaves `excess + squares x^2 / 2 - slope x` of excess energy.
    squares = (jx * jx + jy * jy + jz * jz) / mass
    slope = (px * jx + py * jy + pz * jz) / mass - step_work
    excess = 0.5 * (px * px + py * py + pz * pz) / mass - allowed
    if squares == 0.0 or slope <= 0.0:
        return 1.0
    root = slope * slope - 2.0 * squares * excess
    taken: float = (slope - np.sqrt(root)) / squares if root > 0.0 else slope / squares
    return 1.0 - min(taken, 1.0)


@array_kernel
def scale_impulses(count: int, rows: np.ndarray, features: np.ndarray, first: int, end: int, share: float) -> None:
    """Scale the impulses of the tools' constraints on one organ, with vertices from `first` to `end`, by a share."""
    for c in range(count):
        if features[c, OWNER] >= 0 and first <= features[c, 0] < end:
            for axis in range(3):
                rows[c, IMPULSE + axis] *= share


@array_kernel
def limit_energy(
    first: int,
    end: int,
    inverse_mass: np.ndarray,
    sums: Any,
    velocities: np.ndarray,
    gravity: float,
    mean_edge: float,
    ledger: np.ndarray,
) -> float:
    """Dissipate the kinetic energy of an organ that exceeds the work put into it.

    A tool that is too fast to pass on its speed moves the organ by displacements. These stretch the organ without a
    force on the tool; once let go, the organ would return that energy as motion. As in a passivity controller
    (Hannaford and Ryu, IEEE Transactions on Robotics and Automation 18(1), 2002), the excess over the work that was put
    in is dissipated: the nodes' velocities relative to the organ's mean velocity are scaled down, which keeps its
    momentum.

    Args:
        first: Index of the organ's first vertex.
        end: Index after its last one.
        inverse_mass: (V,) [1/kg]; fixed nodes have zero.
        sums: `MotionSums` of the organ.
        velocities: (V, 3); changed [u/s].
        gravity: Gravity [u/s2].
        mean_edge: Mean edge of the organ with the smallest mean edge [u].
        ledger: (5,) the organ's, indexed by the column names of this module.

    Returns:
        The energy that was dissipated [kg u2/s2].
    """
    mass = sums.mass
    if mass == 0.0:
        return 0.0
    px, py, pz = sums.x / mass, sums.y / mass, sums.z / mass
    of_mean = 0.5 * mass * (px * px + py * py + pz * pz)
    of_nodes = max(0.5 * sums.squares - of_mean, 0.0)
    least = 0.5 * mass * mean_edge**2
    allowed = ledger[WORK] + ENERGY_TOLERANCE * max(ledger[GREATEST_WORK], least)
    excess = of_mean + of_nodes + gravity * sums.height - allowed
    if excess <= 0.0 or of_nodes == 0.0:
        return 0.0
    excess = min(excess, of_nodes)
    scale = np.sqrt(1.0 - excess / of_nodes)
    for i in range(first, end):
        if inverse_mass[i] > 0.0:
            velocities[i, 0] = px + scale * (velocities[i, 0] - px)
            velocities[i, 1] = py + scale * (velocities[i, 1] - py)
            velocities[i, 2] = pz + scale * (velocities[i, 2] - pz)
    dissipated: float = excess
    return dissipated


@array_kernel
def sum_heights(first: int, end: int, inverse_mass: np.ndarray, vertices: np.ndarray) -> float:
    """Sum of mass times height of an organ's free nodes [kg u]."""
    total = 0.0
    for i in range(first, end):
        if inverse_mass[i] > 0.0:
            total += vertices[i, 2] / inverse_mass[i]
    return total


@array_kernel
def pass_on_work(
    features: np.ndarray,
    row: np.ndarray,
    first_vertices: np.ndarray,
    inverse_mass: np.ndarray,
    velocities_before: np.ndarray,
    velocities: np.ndarray,
    ledger: np.ndarray,
) -> None:
    """Add the work of a constraint between two organs to their ledgers: impulse times mean velocity, for each node.

    Summed over all impulses on a node, this is the change of its kinetic energy. Arguments as in `keep_ledger`, with
    the features and the row of one constraint. A constraint within one organ is not counted.
    """
    organs = first_vertices.shape[0]
    of_first, of_last = organs - 1, organs - 1
    while features[0] < first_vertices[of_first]:
        of_first -= 1
    while features[FOURTH] < first_vertices[of_last]:
        of_last -= 1
    if of_first == of_last:
        return
    for corner in range(4):
        weight = row[WEIGHTS + corner]
        if corner == 3:
            weight = -(row[WEIGHTS] + row[WEIGHTS + 1] + row[WEIGHTS + 2])
        vertex, o = features[corner], organs - 1
        if inverse_mass[vertex] == 0.0:
            continue
        while vertex < first_vertices[o]:
            o -= 1
        for axis in range(3):
            mean = 0.5 * (velocities_before[vertex, axis] + velocities[vertex, axis])
            ledger[o, WORK] += weight * row[IMPULSE + axis] * mean


@array_kernel
def keep_ledger(
    count: int,
    rows: np.ndarray,
    features: np.ndarray,
    first_vertices: np.ndarray,
    inverse_mass: np.ndarray,
    start: np.ndarray,
    positions: np.ndarray,
    linear_velocities: np.ndarray,
    angular_velocities: np.ndarray,
    velocities_before: np.ndarray,
    velocities: np.ndarray,
    ledger: np.ndarray,
) -> None:
    """Add the work of a step's impulses to the organs' ledgers.

    Args:
        count: Number of constraints.
        rows: See `structures.ConstraintTable`; `response.sum_impulses` must have been called with them.
        features: See `structures.ConstraintTable`.
        first_vertices: (O,) index of each organ's first vertex.
        inverse_mass: (V,) [1/kg].
        start: (V, 3) nodes at the start of the step [u].
        positions: (N, 3) of the tools at the end of the step [u].
        linear_velocities: (N, 3) of the tools [u/s].
        angular_velocities: (N, 3) of the tools [rad/s].
        velocities_before: (V, 3) of the nodes without contact [u/s].
        velocities: (V, 3) of the nodes with contact [u/s].
        ledger: (O, 5) written.
    """
    organs = first_vertices.shape[0]
    for o in range(organs):
        if ledger[o, STAGE] == UNKNOWN:
            end = first_vertices[o + 1] if o + 1 < organs else start.shape[0]
            ledger[o, REST_HEIGHT], ledger[o, STAGE] = sum_heights(first_vertices[o], end, inverse_mass, start), FREE
    for c in range(count):
        owner = features[c, OWNER]
        if owner == ORGANS:
            pass_on_work(features[c], rows[c], first_vertices, inverse_mass, velocities_before, velocities, ledger)
        if owner < 0:
            continue
        row, o = rows[c], organs - 1
        while features[c, 0] < first_vertices[o]:
            o -= 1
        ledger[o, STAGE] = TOUCHED
        v, w = linear_velocities[owner], angular_velocities[owner]
        x, y, z = (
            row[POINT] - positions[owner, 0],
            row[POINT + 1] - positions[owner, 1],
            row[POINT + 2] - positions[owner, 2],
        )
        ledger[o, WORK] += row[IMPULSE] * (v[0] + w[1] * z - w[2] * y)
        ledger[o, WORK] += row[IMPULSE + 1] * (v[1] + w[2] * x - w[0] * z)
        ledger[o, WORK] += row[IMPULSE + 2] * (v[2] + w[0] * y - w[1] * x)
    for o in range(organs):
        ledger[o, GREATEST_WORK] = max(ledger[o, GREATEST_WORK], ledger[o, WORK])


@inline_kernel
def keep_passive(world: Any, count: int, motions: Any, organs: Any, outcome: Any) -> None:
    """Remove the energy that each organ has in excess of what tools have put in, from impulses and velocities.

    Args:
        world: `WorldContacts`; its ledger and constraints are written.
        count: Number of constraints.
        motions: `Motions` of the tools.
        organs: `OrganMotion`; velocities are changed.
        outcome: `StepOutcome`; impulses and wrenches are changed.
    """
    first_vertices, inverse_mass, ledger = world.first_vertices, world.inverse_mass, world.ledger
    table, tool_count = world.constraints.table, motions.positions.shape[0]
    rows, features, vertices, velocities = table.rows, table.features, organs.vertices, organs.velocities
    nodal_impulses, wrenches = outcome.nodal_impulses, outcome.wrenches
    mean_edge, gravity = world.settings[MEAN_EDGE], world.settings[GRAVITY]
    before = ledger.copy()
    keep_ledger(
        count, rows, features, first_vertices, inverse_mass, organs.start, motions.positions, motions.linear_velocities,
        motions.angular_velocities, organs.free_velocities, velocities, ledger,
    )  # fmt: skip
    for o in range(first_vertices.shape[0]):
        first = first_vertices[o]
        end = first_vertices[o + 1] if o + 1 < first_vertices.shape[0] else vertices.shape[0]
        sums = sum_motion(first, end, inverse_mass, vertices, velocities, ledger[o, REST_HEIGHT])
        if ledger[o, STAGE] != TOUCHED:
            # As long as no tool has touched it, the organ's energy counts as its own.
            ledger[o, ENERGY] = energy_of(sums, gravity)
            ledger[o, WORK] = max(ledger[o, WORK], ledger[o, ENERGY])
            ledger[o, GREATEST_WORK] = ledger[o, WORK]
            continue
        work = ledger[o, WORK] - before[o, WORK]
        share = passive_share(first, end, inverse_mass, sums, nodal_impulses, work, gravity, mean_edge, ledger[o])
        if share < 1.0:
            for i in range(first, end):
                for axis in range(3):
                    velocities[i, axis] -= (1.0 - share) * inverse_mass[i] * nodal_impulses[i, axis]
            ledger[o, WORK] = before[o, WORK] + share * work
            ledger[o, GREATEST_WORK] = max(before[o, GREATEST_WORK], ledger[o, WORK])
            scale_impulses(count, rows, features, first, end, share)
            sum_impulses(
                count, rows, features, tool_count, motions.positions, vertices, nodal_impulses, wrenches
            )  # fmt: skip
            sums = sum_motion(first, end, inverse_mass, vertices, velocities, ledger[o, REST_HEIGHT])
        if limit_energy(first, end, inverse_mass, sums, velocities, gravity, mean_edge, ledger[o]) > 0.0:
            sums = sum_motion(first, end, inverse_mass, vertices, velocities, ledger[o, REST_HEIGHT])
        ledger[o, ENERGY] = energy_of(sums, gravity)


@kernel(types.void(WORLD_CONTACTS, F8_2, F8_2))
def admit_energy(world: Any, vertices: np.ndarray, velocities: np.ndarray) -> None:
    """Enter into the ledgers the energy that organs were given by hand when they were put into a state.

    Args:
        world: `WorldContacts`; its ledgers are those of the saved state.
        vertices: (V, 3) nodes in the new state [u].
        velocities: (V, 3) their velocities [u/s].
    """
    first_vertices, inverse_mass, ledger = world.first_vertices, world.inverse_mass, world.ledger
    gravity = world.settings[GRAVITY]
    for o in range(first_vertices.shape[0]):
        first = first_vertices[o]
        end = first_vertices[o + 1] if o + 1 < first_vertices.shape[0] else vertices.shape[0]
        if ledger[o, STAGE] == UNKNOWN:
            ledger[o, REST_HEIGHT], ledger[o, STAGE] = sum_heights(first, end, inverse_mass, vertices), FREE
        sums = sum_motion(first, end, inverse_mass, vertices, velocities, ledger[o, REST_HEIGHT])
        energy = energy_of(sums, gravity)
        given = energy - ledger[o, ENERGY]
        # If the state is that which was saved, nothing was given.
        if given > ROUNDING * abs(energy):
            ledger[o, WORK] += given
            ledger[o, GREATEST_WORK] = max(ledger[o, GREATEST_WORK], ledger[o, WORK])
        ledger[o, ENERGY] = energy
