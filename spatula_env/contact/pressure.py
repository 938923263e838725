"""How the force on a tool is spread over its contact nodes.

The response pushes at a few points: where the organ's vertices and edges meet the tool. Between them the organ is a
flat triangle, and how the force is spread there is not decided by it. Here each push is spread over the nodes around
it on the face that it acts on, no farther than a mean edge of the organ, in parts that fall off with the distance
and grow with a node's share of the face. Nodes in contact come first; forces sum to the tool's force exactly.
"""

from __future__ import annotations

import numpy as np
from numba import types

from spatula_env._kernels import ARRAYS, kernel
from spatula_env.contact.rigid import turn
from spatula_env.contact.structures import CONSTRAINTS, IMPULSE, OWNER, PLANE, POINT

F8, F8_2, I4 = ARRAYS["f8"], ARRAYS["f8_2"], ARRAYS["i4"]


@kernel(F8_2(CONSTRAINTS, types.int64))
def contact_table(constraints, count):  # type: ignore[no-untyped-def]
    """Copy the first `count` constraints after a step: (count, 8) of point [u], impulse on the organ, owner, plane."""
    table = np.empty((count, 8))
    for c in range(count):
        for axis in range(3):
            table[c, axis] = constraints.rows[c, POINT + axis]
            table[c, 3 + axis] = constraints.rows[c, IMPULSE + axis]
        table[c, 6] = constraints.features[c, OWNER]
        table[c, 7] = constraints.features[c, PLANE]
    return table


@kernel(types.void(F8_2, types.int64, F8, F8, F8_2, I4, F8, ARRAYS["b1"], types.float64, types.float64, F8_2))
def spread_forces(
    table: np.ndarray,
    tool: int,
    position: np.ndarray,
    rotation: np.ndarray,
    nodes: np.ndarray,
    face: np.ndarray,
    areas: np.ndarray,
    flags: np.ndarray,
    reach: float,
    dt: float,
    forces: np.ndarray,
) -> None:
    """Spread what the organs do to a tool over its nodes.

    Args:
        table: (C, 8) from `contact_table`.
        tool: Its index.
        position: (3,) of the tool [u].
        rotation: (9,) of the tool.
        nodes: (n, 3) tool frame [u].
        face: (n,).
        areas: (n,) [u2].
        flags: (n,) nodes in contact.
        reach: How far a push is spread [u].
        dt: Length of the step [s].
        forces: (n, 3) written, world frame [kg u/s2].
    """
    forces[:] = 0.0
    count = nodes.shape[0]
    places, shares = np.empty((count, 3)), np.empty(count)
    for i in range(count):
        places[i, 0], places[i, 1], places[i, 2] = turn(rotation, nodes[i])
    for c in range(table.shape[0]):
        if table[c, 6] != tool or (table[c, 3] == 0.0 and table[c, 4] == 0.0 and table[c, 5] == 0.0):
            continue
        total, nearest, least = 0.0, 0, np.inf
        for grade in range(3):
            # First the flagged nodes of the face, then all of them, then those of any face.
            total = 0.0
            for i in range(count):
                shares[i] = 0.0
                if (grade < 2 and face[i] != table[c, 7]) or (grade == 0 and not flags[i]):
                    continue
                away = 0.0
                for axis in range(3):
                    away += (places[i, axis] + position[axis] - table[c, axis]) ** 2
                if away < least:
                    nearest, least = i, away
                falloff = 1.0 - away / (reach * reach)
                if falloff > 0.0:
                    shares[i] = areas[i] * falloff * falloff
                    total += shares[i]
            if total > 0.0 or least < np.inf:
                break
        if total == 0.0:
            shares[nearest] = total = 1.0
        for i in range(count):
            if shares[i] > 0.0:
                for axis in range(3):
                    forces[i, axis] -= table[c, 3 + axis] * shares[i] / (total * dt)
