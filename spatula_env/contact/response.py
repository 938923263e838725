"""Contact response: solve for the displacements and impulses that keep organs out of tools.

Both solves are projected Gauss-Seidel sweeps over unilateral constraints, over-relaxed (Young, Transactions of the
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

OVER_RELAXATION = 1.4
"""Relaxation factor of a sweep. Projected Gauss-Seidel converges with factors below 2; where many constraints hold the
same few vertices, as under a spatula, 25 sweeps with this factor achieve what 50 sweeps with 1 do."""

GREATEST_PUSH = 2.0
"""One solve pushes two points of organs apart by at most this multiple of their violation, plus their separation."""


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
    """Apply a constraint's displacement or impulse to the positions or velocities `of` (V, 3) of its vertices."""
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

    Beside a fixed vertex a point of a triangle hardly moves, however far the free vertices are moved. The inertia is
    therefore computed as if fixed vertices had the mean inverse mass: otherwise free vertices would be thrown far in
    order to move a point that cannot be moved.
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
    """Warm-start a solve: apply the multipliers that the three columns from `column` hold already.

    They are first projected onto the friction cone of the present normal, and then applied to positions or velocities
    `of` (V, 3).
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
def _bound_pushes(order: np.ndarray, rows: np.ndarray, features: np.ndarray) -> None:
    """Write the greatest multiplier of each constraint between organs in the place of its impulse.

    Such constraints may contradict each other, and without a bound sweeps would push ever farther.
    """
    for c in order:
        if features[c, OWNER] == ORGANS:
            row = rows[c]
            begun, apart = 0.0, 0.0
            for axis in range(3):
                begun += row[DISPLACEMENT + axis] * row[NORMAL + axis]
                apart += row[POINT + axis] * row[NORMAL + axis]
            row[IMPULSE] = begun + row[INERTIA] * (apart + GREATEST_PUSH * max(-row[GAP], 0.0))


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
        order: Indices of the constraints to solve, in the order in which they are solved.
        rows: See `structures.ConstraintTable`; displacements are added to, inertia must have been measured.
        features: See `structures.ConstraintTable`.
        inverse_mass: (V,) [1/kg].
        vertices: (V, 3) positions; changed [u].
        sweeps: Greatest number of sweeps.
        tolerance: Motion of a constrained point in a sweep at which the solve ends [u].
        frictional: After this many sweeps the friction multipliers stay as they are, and only the normal ones are
            solved for.
        over_relaxation: Relaxation factor of a sweep.

    Returns:
        The number of sweeps.
    """
    _bound_pushes(order, rows, features)
    done = sweeps
    for sweep in range(sweeps):
        # No over-relaxation in the first sweep, which solves constraints without neighbours exactly, nor in the last
        # one, so that no constraint is left overshot.
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
    """Change the vertices' velocities by impulses until a sweep changes no constrained point by more than `tolerance`.

    Args:
        order: Indices of the constraints to solve, in the order in which they are solved.
        rows: See `structures.ConstraintTable`; impulses are added to, gap and inertia must have been measured.
        features: See `structures.ConstraintTable`.
        inverse_mass: (V,) [1/kg].
        velocities: (V, 3) of the vertices; changed [u/s].
        dt: Length of the step [s].
        sweeps: Greatest number of sweeps.
        tolerance: Change of a constrained point's velocity in a sweep at which the solve ends [u/s].
        over_relaxation: Relaxation factor of a sweep.

    Returns:
        The number of sweeps.
    """
    for sweep in range(sweeps):
        # No over-relaxation in the first sweep, which solves constraints without neighbours exactly, nor in the last
        # one, so that no constraint is left overshot.
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
    """Sum the impulses of a solve for each node and each tool.

    Args:
        count: Number of constraints.
        rows: See `structures.ConstraintTable`; where a tool gives an impulse, POINT becomes the contact point.
        features: See `structures.ConstraintTable`.
        tool_count: N.
        positions: (N, 3) of the tools' origins, about which moments are taken [u].
        vertices: (V, 3) [u].
        nodal_impulses: (V, 3) written: impulses of the tools on the nodes [kg u/s].
        wrenches: (N + 1, 6) written: see `motion.StepOutcome`.
    """
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
