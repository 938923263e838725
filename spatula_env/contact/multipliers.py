"""Constraints that outlive their query: multipliers that warm-start later solves, and contacts of earlier queries."""

from __future__ import annotations

from typing import Any

import numpy as np

from spatula_env._kernels import array_kernel, inline_kernel
from spatula_env.contact.motion import copy_points
from spatula_env.contact.structures import (
    DISPLACEMENT,
    FOURTH,
    FRICTION,
    GAP,
    IMPULSE,
    NORMAL,
    ORIGIN,
    OWNER,
    POINT,
    WEIGHTS,
    copy_constraint,
    copy_first,
    reserve,
)

MOST_PASSED = 512
"""Most contacts that are remembered from earlier queries of a step."""


@array_kernel
def start_warm(count: int, table: Any, column: int, known: int, warm: Any, scale: float) -> None:
    """Warm-start constraints: write `scale` times the displacements kept under the same names, from `column` on.

    Both tables are sorted by owner, so each constraint is looked for among those of its owner.
    """
    rows, features, names = table.rows, table.features, table.names
    warm_rows, warm_features, warm_names = warm.rows, warm.features, warm.names
    hint, first, end = 0, 0, 0
    for c in range(count):
        owner = features[c, OWNER]
        if c == 0 or owner != features[c - 1, OWNER]:
            first = end
            while first < known and warm_features[first, OWNER] < owner:
                first += 1
            end = first
            while end < known and warm_features[end, OWNER] == owner:
                end += 1
            hint = first
        for k in range(end - first):
            e = hint + k if hint + k < end else hint + k - (end - first)
            if names[c] == warm_names[e]:
                for axis in range(3):
                    rows[c, column + axis] = scale * warm_rows[e, DISPLACEMENT + axis]
                hint = e + 1 if e + 1 < end else first
                break


@array_kernel
def _push_part(
    rows: np.ndarray, features: np.ndarray, e: int, part: float, inverse_mass: np.ndarray, vertices: np.ndarray
) -> None:
    """Apply a fraction `part` of a kept constraint's displacement to its vertices in `vertices` (V, 3) [u]."""
    summed = 0.0
    for corner in range(3):
        vertex = features[e, corner]
        summed += rows[e, WEIGHTS + corner]
        moved = part * rows[e, WEIGHTS + corner] * inverse_mass[vertex]
        for axis in range(3):
            vertices[vertex, axis] += moved * rows[e, DISPLACEMENT + axis]
    fourth = features[e, FOURTH]
    if fourth >= 0:
        for axis in range(3):
            vertices[fourth, axis] -= part * summed * inverse_mass[fourth] * rows[e, DISPLACEMENT + axis]


@array_kernel
def _height_over(rows: np.ndarray, features: np.ndarray, e: int, vertices: np.ndarray) -> float:
    """Height of a kept constraint's point over its plane, with vertices (V, 3) [u]."""
    height, fourth = 0.0, features[e, FOURTH]
    summed = rows[e, WEIGHTS] + rows[e, WEIGHTS + 1] + rows[e, WEIGHTS + 2]
    for axis in range(3):
        s = -summed * vertices[fourth, axis] if fourth >= 0 else 0.0
        for corner in range(3):
            s += rows[e, WEIGHTS + corner] * vertices[features[e, corner], axis]
        height += (s - rows[e, POINT + axis]) * rows[e, NORMAL + axis]
    return height


@array_kernel
def greatest_kept_depth(known: int, warm: Any, vertices: np.ndarray) -> float:
    """Greatest depth of the surface behind the planes of the kept constraints, with vertices (V, 3) [u]."""
    rows, features, deepest = warm.rows, warm.features, 0.0
    for e in range(known):
        deepest = max(deepest, -_height_over(rows, features, e, vertices))
    return deepest


@array_kernel
def expect_vertices(
    known: int,
    warm: Any,
    inverse_mass: np.ndarray,
    start_positions: np.ndarray,
    linear_velocities: np.ndarray,
    angular_velocities: np.ndarray,
    dt: float,
    part: float,
    thrown: np.ndarray,
    expected: np.ndarray,
) -> None:
    """Predict where contact will put the organs' vertices: it will undo about as much motion as in the last step.

    Springs that a tool holds compressed throw the surface deep into the tool in every step, and the position that it is
    thrown to says little about where it touches. Where a contact now pushes less, its last displacement would lift the
    surface off the plane; it is then applied only so far that the surface stays slightly behind the plane, where the
    contact is found.

    Args:
        known: Number of constraints kept from the last step.
        warm: `ConstraintTable` of them; their points are moved on with the tools.
        inverse_mass: (V,) [1/kg].
        start_positions: (N, 3) of the tools before this step [u].
        linear_velocities: (N, 3) of the tools [u/s].
        angular_velocities: (N, 3) of the tools [rad/s].
        dt: Length of the step [s].
        part: Greatest part of a displacement that is applied.
        thrown: (V, 3) positions of the vertices without contact [u].
        expected: (V, 3) written: the predicted positions [u].
    """
    rows, features = warm.rows, warm.features
    copy_points(thrown, expected)
    for e in range(known):
        _push_part(rows, features, e, 1.0, inverse_mass, expected)
    for e in range(known):
        owner, row = features[e, OWNER], rows[e]
        if owner >= 0:
            v, w, origin = linear_velocities[owner], angular_velocities[owner], start_positions[owner]
            x, y, z = row[POINT] - origin[0], row[POINT + 1] - origin[1], row[POINT + 2] - origin[2]
            row[POINT] += dt * (v[0] + w[1] * z - w[2] * y)
            row[POINT + 1] += dt * (v[1] + w[2] * x - w[0] * z)
            row[POINT + 2] += dt * (v[2] + w[0] * y - w[1] * x)
        before, after = _height_over(rows, features, e, thrown), _height_over(rows, features, e, expected)
        share = part
        if before >= 0.0:
            share = 0.0
        elif after > 0.0:
            share = part * before / (before - after)
        row[GAP] = share
    copy_points(thrown, expected)
    for e in range(known):
        _push_part(rows, features, e, rows[e, GAP], inverse_mass, expected)


@inline_kernel
def keep_warm(count: int, table: Any, warm: Any) -> int:
    """Keep the constraints with displacements in `Constraints`, to warm-start later solves. Returns their number."""
    reserve(warm, 0, count)
    return int(_copy_pushing(count, table, warm.table))


@array_kernel
def _copy_pushing(count: int, table: Any, into: Any) -> int:
    """Copy the constraints that push to the first places of another table. Returns how many there are."""
    rows, kept = table.rows, 0
    for c in range(count):
        if rows[c, DISPLACEMENT] != 0.0 or rows[c, DISPLACEMENT + 1] != 0.0 or rows[c, DISPLACEMENT + 2] != 0.0:
            copy_constraint(table, c, into, kept)
            kept += 1
    return kept


@array_kernel
def add_passed(count: int, passed: int, table: Any, earlier: Any, positions: np.ndarray) -> int:
    """Append the contacts that pushed in an earlier query of the step and are not in the table, without friction.

    Their planes are moved on with the tools, which are at positions (N, 3) now. Returns the new count.
    """
    rows, features, names, current = table.rows, table.features, table.names, count
    for e in range(passed):
        known = False
        for c in range(current):
            if names[c] == earlier.names[e] and features[c, OWNER] == earlier.features[e, OWNER]:
                known = True
                break
        if not known:
            copy_constraint(earlier, e, table, count)
            rows[count, FRICTION] = 0.0
            for axis in range(3):
                rows[count, IMPULSE + axis] = 0.0
                rows[count, POINT + axis] += positions[features[count, OWNER], axis] - rows[count, ORIGIN + axis]
            count += 1
    return count


@array_kernel
def note_passed(count: int, passed: int, table: Any, earlier: Any, position: np.ndarray) -> int:
    """Keep the tools' contacts that have just pushed, for the velocity solve at the end of the step.

    The column of their origin is overwritten by the tool's position (N, 3) at this query. Returns how many are kept.
    """
    rows, features, names = table.rows, table.features, table.names
    earlier_rows = earlier.rows
    for c in range(count):
        pushed = 0.0
        for axis in range(3):
            pushed += rows[c, DISPLACEMENT + axis] * rows[c, NORMAL + axis]
        if features[c, OWNER] < 0 or pushed <= 0.0:
            continue
        place = passed
        for e in range(passed):
            if names[c] == earlier.names[e] and features[c, OWNER] == earlier.features[e, OWNER]:
                place = e
                break
        if place == MOST_PASSED:
            continue
        x, y, z = 0.0, 0.0, 0.0
        if place < passed:
            x, y, z = earlier_rows[place, IMPULSE], earlier_rows[place, IMPULSE + 1], earlier_rows[place, IMPULSE + 2]
        copy_constraint(table, c, earlier, place)
        earlier_rows[place, IMPULSE], earlier_rows[place, IMPULSE + 1], earlier_rows[place, IMPULSE + 2] = x, y, z
        for axis in range(3):
            earlier_rows[place, ORIGIN + axis] = position[features[c, OWNER], axis]
        passed = max(passed, place + 1)
    return passed


@array_kernel
def sum_passed(passed: int, earlier: Any) -> None:
    """Sum the kept contacts' displacements over the queries so far in the columns of the impulse.

    It is called after each query.
    """
    earlier_rows = earlier.rows
    for e in range(passed):
        for axis in range(3):
            earlier_rows[e, IMPULSE + axis] += earlier_rows[e, DISPLACEMENT + axis]
            earlier_rows[e, DISPLACEMENT + axis] = 0.0


@inline_kernel
def keep_for_next(count: int, trial: Any, passed: int, earlier: Any, warm: Any) -> None:
    """Keep the displacements of a step's contacts, summed over all of its queries, for the next step.

    Args:
        count: Number of constraints that pushed in the last query. Only these are kept.
        trial: `ConstraintTable` of them.
        passed: Number of constraints that pushed in earlier queries.
        earlier: `ConstraintTable` of them, see `sum_passed`.
        warm: `Constraints`, written.
    """
    reserve(warm, 0, count)
    copy_first(count, trial, warm.table)
    _add_displacements(count, warm.table, passed, earlier)


@array_kernel
def _add_displacements(count: int, table: Any, passed: int, earlier: Any) -> None:
    """Add the displacements of the same contacts in earlier queries to those of the table."""
    rows, features, names = table.rows, table.features, table.names
    for c in range(count):
        for e in range(passed):
            if names[c] == earlier.names[e] and features[c, OWNER] == earlier.features[e, OWNER]:
                for axis in range(3):
                    rows[c, DISPLACEMENT + axis] += earlier.rows[e, IMPULSE + axis]
                break
