"""From contacts to motion: the organ is moved out of the tool, and the momentum that takes is what the tool feels.

Both halves are projected Gauss-Seidel sweeps over unilateral constraints, over-relaxed (Young, Transactions of the
American Mathematical Society 76, 1954; for inequalities Cryer, SIAM Journal on Control 9, 1971). A constraint holds one
point of the organ's surface, s = sum of weight x vertex, on the far side of a plane with normal n through a point p:

- positions: (s - p) . n >= 0, by mass-weighted displacements. This is the enforced displacement of Fukuhara et al.
  (ROBOMECH Journal 1:6, 2014). It gives no velocity, so it adds no kinetic energy, however deep the tool came.
- velocities: (ds/dt - dp/dt) . n >= -gap / dt, by impulses. They are the only exchange of momentum between organ and
  tool, so the wrench on the tool is minus their sum.

Friction is Coulomb's, in the same sweeps: a tangential displacement (or impulse) that cancels the slip, limited to the
friction coefficient times the normal one. Limiting displacements as well as impulses makes friction static: a point
held inside the cone does not creep (Müller et al., Detailed rigid body simulation with extended position based
dynamics, Computer Graphics Forum 39(8), 2020, section 3.5).
"""

from __future__ import annotations

import numpy as np

from spatula_env._kernels import array_kernel
from spatula_env.contact.structures import (
    DISPLACEMENT,
    FOURTH,
    FRICTION,
    GAP,
    GROUND,
    IMPULSE,
    INERTIA,
    NORMAL,
    ORGANS,
    ORIGIN,
    OWNER,
    POINT,
    VELOCITY,
    WEIGHTS,
)

WORK, GREATEST_WORK, REST_HEIGHT, STAGE, ENERGY = 0, 1, 2, 3, 4
LEDGER_LENGTH = 5
"""Columns of an organ's ledger: what it had when a tool first touched it and the tools' work on it since, and the
greatest that was [kg u2/s2]; the sum of mass times height where counting began [kg u]; how far it has got, by the next
names; and its energy of motion and height at the end of the last step [kg u2/s2]."""

UNKNOWN, FREE, TOUCHED = 0.0, 1.0, 2.0
"""Stages of a ledger: nothing is known of the organ, no tool has touched it yet, or one has."""

OVER_RELAXATION = 1.4
"""Factor on what a sweep changes. Projected Gauss-Seidel converges with less than 2; where many constraints hold the
same few vertices, as under a spatula, it is after 25 sweeps with this factor where it would be after 50 with 1."""

GREATEST_PUSH = 2.0
"""Two points of organs are pushed apart in one solve by so many times what is missing at most."""

ENERGY_TOLERANCE = 0.002
"""Part of the greatest work so far that an organ may have more than was put in: rounding and friction of a solve."""


@array_kernel
def _project_onto_cone(
    x: float, y: float, z: float, nx: float, ny: float, nz: float, normal_part: float, friction: float
) -> tuple[float, float, float]:
    """normal_part n plus the tangential part of (x, y, z), the latter shortened to friction x normal_part."""
    along = x * nx + y * ny + z * nz
    tx, ty, tz = x - along * nx, y - along * ny, z - along * nz
    length_squared = tx * tx + ty * ty + tz * tz
    limit = friction * normal_part
    scale = limit / np.sqrt(length_squared) if length_squared > limit * limit else 1.0
    return normal_part * nx + scale * tx, normal_part * ny + scale * ty, normal_part * nz + scale * tz


@array_kernel
def _push(
    row: np.ndarray,
    i: int,
    j: int,
    k: int,
    fourth: int,
    inverse_mass: np.ndarray,
    dx: float,
    dy: float,
    dz: float,
    of: np.ndarray,
) -> None:
    """Apply a displacement or an impulse to the vertices that carry a constrained point."""
    wi, wj, wk = (
        row[WEIGHTS] * inverse_mass[i],
        row[WEIGHTS + 1] * inverse_mass[j],
        row[WEIGHTS + 2] * inverse_mass[k],
    )
    of[i, 0] += wi * dx
    of[i, 1] += wi * dy
    of[i, 2] += wi * dz
    of[j, 0] += wj * dx
    of[j, 1] += wj * dy
    of[j, 2] += wj * dz
    of[k, 0] += wk * dx
    of[k, 1] += wk * dy
    of[k, 2] += wk * dz
    if fourth >= 0:
        wl = -(row[WEIGHTS] + row[WEIGHTS + 1] + row[WEIGHTS + 2]) * inverse_mass[fourth]
        of[fourth, 0] += wl * dx
        of[fourth, 1] += wl * dy
        of[fourth, 2] += wl * dz


@array_kernel
def measure_gaps(
    count: int,
    rows: np.ndarray,
    features: np.ndarray,
    inverse_mass: np.ndarray,
    mean_inverse_mass: float,
    vertices: np.ndarray,
) -> float:
    """Write gap and inertia of all constraints, and return the greatest violation [u].

    Beside a fixed vertex a point of a triangle hardly moves however far the free vertices are moved. The inertia is
    therefore reckoned as if fixed vertices were like others: what cannot be moved is not thrown.
    """
    worst = 0.0
    for c in range(count):
        row = rows[c]
        i, j, k = features[c, 0], features[c, 1], features[c, 2]
        a, b, d = row[WEIGHTS], row[WEIGHTS + 1], row[WEIGHTS + 2]
        fourth = features[c, FOURTH]
        e = -(a + b + d) if fourth >= 0 else 0.0
        gap = 0.0
        for axis in range(3):
            s = a * vertices[i, axis] + b * vertices[j, axis] + d * vertices[k, axis]
            s += e * vertices[fourth, axis] if fourth >= 0 else 0.0
            gap += (s - row[POINT + axis]) * row[NORMAL + axis]
        row[GAP] = gap
        mobility = a * a * inverse_mass[i] + b * b * inverse_mass[j] + d * d * inverse_mass[k]
        mobility += e * e * inverse_mass[fourth] if fourth >= 0 else 0.0
        row[INERTIA] = 0.0
        if mobility > 0.0:
            worst = max(worst, -gap)
            mobility += a * a * mean_inverse_mass if inverse_mass[i] == 0.0 else 0.0
            mobility += b * b * mean_inverse_mass if inverse_mass[j] == 0.0 else 0.0
            mobility += d * d * mean_inverse_mass if inverse_mass[k] == 0.0 else 0.0
            if fourth >= 0 and inverse_mass[fourth] == 0.0:
                mobility += e * e * mean_inverse_mass
            row[INERTIA] = 1.0 / mobility
    return worst


@array_kernel
def start_pushed(
    count: int, rows: np.ndarray, features: np.ndarray, inverse_mass: np.ndarray, column: int, of: np.ndarray
) -> None:
    """Begin a solve with multipliers that are there already, in three columns from `column`.

    They are brought into the friction cone of the present normal and applied to positions or velocities (V, 3).
    """
    for c in range(count):
        row = rows[c]
        x, y, z = row[column], row[column + 1], row[column + 2]
        if x == 0.0 and y == 0.0 and z == 0.0:
            continue
        nx, ny, nz = row[NORMAL], row[NORMAL + 1], row[NORMAL + 2]
        along = max(x * nx + y * ny + z * nz, 0.0)
        x, y, z = _project_onto_cone(x, y, z, nx, ny, nz, along, row[FRICTION])
        row[column], row[column + 1], row[column + 2] = x, y, z
        _push(row, features[c, 0], features[c, 1], features[c, 2], features[c, FOURTH], inverse_mass, x, y, z, of)


@array_kernel
def solve_positions(
    order: np.ndarray,
    rows: np.ndarray,
    features: np.ndarray,
    inverse_mass: np.ndarray,
    vertices: np.ndarray,
    sweeps: int,
    tolerance: float,
    frictional: int,
    over_relaxation: float = OVER_RELAXATION,
) -> int:
    """Move the vertices until a sweep moves no constrained point by more than `tolerance`.

    Args:
        order: Which constraints are solved, in this order.
        rows: See `structures.Constraints`; displacements are added to, inertia must have been measured.
        features: See there.
        inverse_mass: (V,) [1/kg].
        vertices: (V, 3) positions; changed [u].
        sweeps: Greatest number of sweeps.
        tolerance: [u].
        frictional: After so many sweeps friction stays as it is, and what keeps surfaces apart is solved for alone.
        over_relaxation: Factor on what a sweep changes.

    Returns:
        How many sweeps it took.
    """
    # Between organs some of what is asked for may contradict the rest, and sweeps would push ever farther.
    for c in order:
        if features[c, OWNER] == ORGANS:
            row = rows[c]
            begun, apart = 0.0, 0.0
            for axis in range(3):
                begun += row[DISPLACEMENT + axis] * row[NORMAL + axis]
                apart += row[POINT + axis] * row[NORMAL + axis]
            row[IMPULSE] = begun + row[INERTIA] * (apart + GREATEST_PUSH * max(-row[GAP], 0.0))
    done = sweeps
    for sweep in range(sweeps):
        # The first sweep settles what stands alone, and the last one leaves nothing overdone.
        relaxation = 1.0 if sweep == 0 or sweep == sweeps - 1 else over_relaxation
        sticks = sweep < frictional
        moved = 0.0
        for c in order:
            row = rows[c]
            i, j, k, fourth = features[c, 0], features[c, 1], features[c, 2], features[c, FOURTH]
            a, b, d = row[WEIGHTS], row[WEIGHTS + 1], row[WEIGHTS + 2]
            nx, ny, nz = row[NORMAL], row[NORMAL + 1], row[NORMAL + 2]
            sx = a * vertices[i, 0] + b * vertices[j, 0] + d * vertices[k, 0]
            sy = a * vertices[i, 1] + b * vertices[j, 1] + d * vertices[k, 1]
            sz = a * vertices[i, 2] + b * vertices[j, 2] + d * vertices[k, 2]
            if fourth >= 0:
                e = a + b + d
                sx, sy, sz = sx - e * vertices[fourth, 0], sy - e * vertices[fourth, 1], sz - e * vertices[fourth, 2]
            violation = (row[POINT] - sx) * nx + (row[POINT + 1] - sy) * ny + (row[POINT + 2] - sz) * nz
            ox, oy, oz = row[DISPLACEMENT], row[DISPLACEMENT + 1], row[DISPLACEMENT + 2]
            before = ox * nx + oy * ny + oz * nz
            inertia = row[INERTIA]
            if (violation <= 0.0 and before <= 0.0) or inertia == 0.0:
                continue
            along = max(before + relaxation * violation * inertia, 0.0)
            if fourth >= 0:
                along = min(along, row[IMPULSE])
            if row[FRICTION] > 0.0 and sticks:
                x, y, z = _project_onto_cone(
                    ox - relaxation * (sx - row[ORIGIN]) * inertia,
                    oy - relaxation * (sy - row[ORIGIN + 1]) * inertia,
                    oz - relaxation * (sz - row[ORIGIN + 2]) * inertia,
                    nx, ny, nz, along, row[FRICTION],
                )  # fmt: skip
            elif row[FRICTION] > 0.0 and along > 0.0:
                x, y, z = ox + (along - before) * nx, oy + (along - before) * ny, oz + (along - before) * nz
            else:
                x, y, z = along * nx, along * ny, along * nz
            dx, dy, dz = x - ox, y - oy, z - oz
            row[DISPLACEMENT], row[DISPLACEMENT + 1], row[DISPLACEMENT + 2] = x, y, z
            moved = max(moved, (dx * dx + dy * dy + dz * dz) / (inertia * inertia))
            _push(row, i, j, k, fourth, inverse_mass, dx, dy, dz, vertices)
        if moved <= tolerance * tolerance:
            done = sweep + 1
            break
    for c in order:
        if features[c, OWNER] == ORGANS:
            rows[c, IMPULSE] = 0.0
    return done


@array_kernel
def solve_velocities(
    order: np.ndarray,
    rows: np.ndarray,
    features: np.ndarray,
    inverse_mass: np.ndarray,
    velocities: np.ndarray,
    dt: float,
    sweeps: int,
    tolerance: float,
    over_relaxation: float = OVER_RELAXATION,
) -> int:
    """Change the vertices' velocities by impulses until a sweep changes none by more than `tolerance`.

    Args:
        order: Which constraints are solved, in this order.
        rows: See `structures.Constraints`; impulses are added to, gap and inertia must have been measured.
        features: See there.
        inverse_mass: (V,) [1/kg].
        velocities: (V, 3) of the vertices; changed [u/s].
        dt: Length of the step [s].
        sweeps: Greatest number of sweeps.
        tolerance: [u/s].
        over_relaxation: Factor on what a sweep changes.

    Returns:
        How many sweeps it took.
    """
    for sweep in range(sweeps):
        # The first sweep settles what stands alone, and the last one leaves nothing overdone.
        relaxation = 1.0 if sweep == 0 or sweep == sweeps - 1 else over_relaxation
        moved = 0.0
        for c in order:
            row = rows[c]
            i, j, k, fourth = features[c, 0], features[c, 1], features[c, 2], features[c, FOURTH]
            a, b, d = row[WEIGHTS], row[WEIGHTS + 1], row[WEIGHTS + 2]
            nx, ny, nz = row[NORMAL], row[NORMAL + 1], row[NORMAL + 2]
            vx = a * velocities[i, 0] + b * velocities[j, 0] + d * velocities[k, 0] - row[VELOCITY]
            vy = a * velocities[i, 1] + b * velocities[j, 1] + d * velocities[k, 1] - row[VELOCITY + 1]
            vz = a * velocities[i, 2] + b * velocities[j, 2] + d * velocities[k, 2] - row[VELOCITY + 2]
            if fourth >= 0:
                e = a + b + d
                vx -= e * velocities[fourth, 0]
                vy -= e * velocities[fourth, 1]
                vz -= e * velocities[fourth, 2]
            closing = -(vx * nx + vy * ny + vz * nz) - max(row[GAP], 0.0) / dt
            ox, oy, oz = row[IMPULSE], row[IMPULSE + 1], row[IMPULSE + 2]
            before = ox * nx + oy * ny + oz * nz
            inertia = row[INERTIA]
            if (closing <= 0.0 and before <= 0.0) or inertia == 0.0:
                continue
            along = max(before + relaxation * closing * inertia, 0.0)
            if row[FRICTION] > 0.0:
                x, y, z = _project_onto_cone(
                    ox - relaxation * vx * inertia,
                    oy - relaxation * vy * inertia,
                    oz - relaxation * vz * inertia,
                    nx, ny, nz, along, row[FRICTION],
                )  # fmt: skip
            else:
                x, y, z = along * nx, along * ny, along * nz
            dx, dy, dz = x - ox, y - oy, z - oz
            row[IMPULSE], row[IMPULSE + 1], row[IMPULSE + 2] = x, y, z
            moved = max(moved, (dx * dx + dy * dy + dz * dz) / (inertia * inertia))
            _push(row, i, j, k, fourth, inverse_mass, dx, dy, dz, velocities)
        if moved <= tolerance * tolerance:
            return sweep + 1
    return sweeps


@array_kernel
def passive_share(
    first: int,
    end: int,
    inverse_mass: np.ndarray,
    vertices: np.ndarray,
    velocities: np.ndarray,
    nodal_impulses: np.ndarray,
    step_work: float,
    gravity: float,
    mean_edge: float,
    ledger: np.ndarray,
) -> float:
    """Which share of a step's impulses an organ's motion as a whole can have, for the work that they do.

    A tool that turns by a radian in a step pushes along planes that it had on its way, and may throw the organ off
    with more energy than it gives. What the nodes do relative to each other is left to `limit_energy`.

    Args:
        first: Index of the organ's first vertex.
        end: Index after its last one.
        inverse_mass: (V,) [1/kg]; fixed nodes have zero.
        vertices: (V, 3) [u].
        velocities: (V, 3) with all impulses [u/s].
        nodal_impulses: (V, 3) of the tools [kg u/s].
        step_work: What they do [kg u2/s2]; it is in the ledger.
        gravity: [u/s2].
        mean_edge: Of the organ with the smallest [u].
        ledger: (5,) the organ's, by the column names of this module.

    Returns:
        From 0 to 1; 1 unless energy would come from nothing.
    """
    height, mass = -ledger[REST_HEIGHT], 0.0
    px, py, pz = 0.0, 0.0, 0.0
    jx, jy, jz = 0.0, 0.0, 0.0
    for i in range(first, end):
        if inverse_mass[i] == 0.0:
            continue
        m = 1.0 / inverse_mass[i]
        mass += m
        height += m * vertices[i, 2]
        px += m * velocities[i, 0]
        py += m * velocities[i, 1]
        pz += m * velocities[i, 2]
        jx += nodal_impulses[i, 0]
        jy += nodal_impulses[i, 1]
        jz += nodal_impulses[i, 2]
    if mass == 0.0:
        return 1.0
    least = 0.5 * mass * mean_edge**2
    allowed = ledger[WORK] + ENERGY_TOLERANCE * max(ledger[GREATEST_WORK], least) - gravity * height
    if 0.5 * (px * px + py * py + pz * pz) / mass <= allowed:
        return 1.0
    # Taking away the share x of the impulses leaves squares x^2 / 2 - x slope too much.
    squares = (jx * jx + jy * jy + jz * jz) / mass
    slope = (px * jx + py * jy + pz * jz) / mass - step_work
    excess = 0.5 * (px * px + py * py + pz * pz) / mass - allowed
    if squares == 0.0 or slope <= 0.0:
        return 1.0
    root = slope * slope - 2.0 * squares * excess
    taken = (slope - np.sqrt(root)) / squares if root > 0.0 else slope / squares
    return 1.0 - min(taken, 1.0)


@array_kernel
def scale_impulses(count: int, rows: np.ndarray, features: np.ndarray, first: int, end: int, share: float) -> None:
    """Leave a share of what the tools' constraints with one organ's vertices, from first to end, have given it."""
    for c in range(count):
        if features[c, OWNER] >= 0 and first <= features[c, 0] < end:
            for axis in range(3):
                rows[c, IMPULSE + axis] *= share


@array_kernel
def limit_energy(
    first: int,
    end: int,
    inverse_mass: np.ndarray,
    vertices: np.ndarray,
    velocities: np.ndarray,
    gravity: float,
    mean_edge: float,
    ledger: np.ndarray,
) -> float:
    """Take from an organ's motion what energy it cannot have.

    A tool too fast to hand on its speed moves the organ by displacements, which stretch it without the tool feeling
    it; let go, the organ would give that back as motion. As a passivity controller does (Hannaford and Ryu, IEEE
    Transactions on Robotics and Automation 18(1), 2002), what exceeds the work that was put in is dissipated: the
    nodes' velocities relative to the organ's mean are scaled down, which leaves its momentum alone.

    Args:
        first: Index of the organ's first vertex.
        end: Index after its last one.
        inverse_mass: (V,) [1/kg]; fixed nodes have zero.
        vertices: (V, 3) [u].
        velocities: (V, 3); changed [u/s].
        gravity: [u/s2].
        mean_edge: Of the organ with the smallest [u].
        ledger: (5,) the organ's, by the column names of this module.

    Returns:
        What was dissipated [kg u2/s2].
    """
    height, mass, squares = -ledger[REST_HEIGHT], 0.0, 0.0
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
    if mass == 0.0:
        return 0.0
    px, py, pz = px / mass, py / mass, pz / mass
    of_mean = 0.5 * mass * (px * px + py * py + pz * pz)
    of_nodes = max(0.5 * squares - of_mean, 0.0)
    least = 0.5 * mass * mean_edge**2
    allowed = ledger[WORK] + ENERGY_TOLERANCE * max(ledger[GREATEST_WORK], least)
    excess = of_mean + of_nodes + gravity * height - allowed
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
def energy_of(
    first: int,
    end: int,
    inverse_mass: np.ndarray,
    vertices: np.ndarray,
    velocities: np.ndarray,
    gravity: float,
    rest_height: float,
) -> float:
    """An organ's energy of motion and height [kg u2/s2]; arguments as of `limit_energy`."""
    squares, height = 0.0, -rest_height
    for i in range(first, end):
        if inverse_mass[i] > 0.0:
            m = 1.0 / inverse_mass[i]
            height += m * vertices[i, 2]
            squares += m * (velocities[i, 0] ** 2 + velocities[i, 1] ** 2 + velocities[i, 2] ** 2)
    return 0.5 * squares + gravity * height


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
    """Add to two organs' ledgers the work of a constraint between them: impulse times mean velocity, of each.

    Over all impulses on a node that is the change of its energy of motion. Arguments as of `keep_ledger`, and one
    constraint's features and row. Within one organ nothing is passed on.
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
    """Add to each organ's ledger the work of a step's impulses, which must have been summed up.

    Args:
        count: How many constraints.
        rows: See `structures.Constraints`.
        features: See there.
        first_vertices: (O,) index of each organ's first vertex.
        inverse_mass: (V,) [1/kg].
        start: (V, 3) nodes at the start of the step [u].
        positions: (N, 3) of the tools at the end of the step [u].
        linear_velocities: (N, 3) [u/s].
        angular_velocities: (N, 3) [rad/s].
        velocities_before: (V, 3) of the nodes without contact [u/s].
        velocities: (V, 3) with it [u/s].
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


@array_kernel
def sum_impulses(
    count: int,
    rows: np.ndarray,
    features: np.ndarray,
    tool_count: int,
    positions: np.ndarray,
    vertices: np.ndarray,
    nodal_impulses: np.ndarray,
    wrenches: np.ndarray,
) -> None:
    """Add up the impulses of a solve, for each node and each tool."""
    nodal_impulses[:] = 0.0
    wrenches[:] = 0.0
    for c in range(count):
        row = rows[c]
        x, y, z = row[IMPULSE], row[IMPULSE + 1], row[IMPULSE + 2]
        if x == 0.0 and y == 0.0 and z == 0.0:
            continue
        owner = features[c, OWNER]
        if owner == ORGANS:
            continue
        into = wrenches[owner] if owner != GROUND else wrenches[tool_count]
        into[0] -= x
        into[1] -= y
        into[2] -= z
        if owner == GROUND:
            continue
        for axis in range(3):
            row[POINT + axis] = 0.0
        for corner in range(3):
            weight, vertex = row[WEIGHTS + corner], features[c, corner]
            for axis in range(3):
                nodal_impulses[vertex, axis] += weight * row[IMPULSE + axis]
                row[POINT + axis] += weight * vertices[vertex, axis]
        ax, ay, az = (
            row[POINT] - positions[owner, 0],
            row[POINT + 1] - positions[owner, 1],
            row[POINT + 2] - positions[owner, 2],
        )
        into[3] -= ay * z - az * y
        into[4] -= az * x - ax * z
        into[5] -= ax * y - ay * x
