"""What constraints hand on: multipliers to the next step's solves, and contacts to the end of their own step."""

from __future__ import annotations

from typing import Any

import numpy as np

from spatula_env._kernels import inline_kernel
from spatula_env.contact.structures import (
    DISPLACEMENT,
    FRICTION,
    GROUND,
    IMPULSE,
    NORMAL,
    ORIGIN,
    OWNER,
    POINT,
    reserve,
)

MOST_PASSED = 512
"""Most contacts remembered from earlier queries of a step."""


@inline_kernel
def start_warm(
    count: int,
    rows: np.ndarray,
    features: np.ndarray,
    names: np.ndarray,
    column: int,
    known: int,
    warm: Any,
    scale: float,
) -> None:
    """Give constraints multipliers, in three columns from `column`: `scale` times the displacements kept by name."""
    hint = 0
    for c in range(count):
        for k in range(known):
            e = hint + k if hint + k < known else hint + k - known
            if names[c] == warm.names[e] and features[c, OWNER] == warm.features[e, OWNER]:
                for axis in range(3):
                    rows[c, column + axis] = scale * warm.rows[e, DISPLACEMENT + axis]
                hint = e + 1 if e + 1 < known else 0
                break


@inline_kernel
def keep_warm(count: int, rows: np.ndarray, features: np.ndarray, names: np.ndarray, warm: Any) -> int:
    """Keep the displacements of a solve, for the velocity solve and for the next step; returns how many."""
    reserve(warm, 0, count)
    kept = 0
    for c in range(count):
        if rows[c, DISPLACEMENT] != 0.0 or rows[c, DISPLACEMENT + 1] != 0.0 or rows[c, DISPLACEMENT + 2] != 0.0:
            warm.names[kept] = names[c]
            warm.features[kept, OWNER] = features[c, OWNER]
            for axis in range(3):
                warm.rows[kept, DISPLACEMENT + axis] = rows[c, DISPLACEMENT + axis]
            kept += 1
    return kept


@inline_kernel
def add_passed(
    count: int,
    passed: int,
    constraints: Any,
    earlier: Any,
    positions: np.ndarray,
) -> int:
    """Append the contacts that pushed in an earlier query and are no longer there; without friction.

    Their planes have moved on with the tools, to positions (N, 3). Returns the new count.
    """
    rows, features, names = constraints.rows, constraints.features, constraints.names
    current = count
    for e in range(passed):
        known = False
        for c in range(current):
            if names[c] == earlier.names[e] and features[c, OWNER] == earlier.features[e, OWNER]:
                known = True
                break
        if not known:
            rows[count] = earlier.rows[e]
            features[count] = earlier.features[e]
            names[count] = earlier.names[e]
            rows[count, FRICTION] = 0.0
            for axis in range(3):
                rows[count, IMPULSE + axis] = 0.0
                rows[count, POINT + axis] += positions[features[count, OWNER], axis] - rows[count, ORIGIN + axis]
            count += 1
    return count


@inline_kernel
def note_passed(count: int, passed: int, constraints: Any, earlier: Any, position: np.ndarray) -> int:
    """Keep the tools' contacts that have just pushed, for the velocity solve at the end of the step.

    Returns how many are kept. Their origin becomes the tool's position (N, 3) at this query.
    """
    rows, features, names = constraints.rows, constraints.features, constraints.names
    for c in range(count):
        pushed = 0.0
        for axis in range(3):
            pushed += rows[c, DISPLACEMENT + axis] * rows[c, NORMAL + axis]
        if features[c, OWNER] == GROUND or pushed <= 0.0:
            continue
        place = passed
        for e in range(passed):
            if names[c] == earlier.names[e] and features[c, OWNER] == earlier.features[e, OWNER]:
                place = e
                break
        if place == MOST_PASSED:
            continue
        earlier.rows[place] = rows[c]
        earlier.features[place] = features[c]
        earlier.names[place] = names[c]
        for axis in range(3):
            earlier.rows[place, ORIGIN + axis] = position[features[c, OWNER], axis]
        passed = max(passed, place + 1)
    return passed
