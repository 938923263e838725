"""Which constraints act on each other: those of tools that hold a vertex in common, by however many steps.

What shares no vertex is solved apart: each solve ends when its own constraints have settled. Of several tools the one
that takes longest is then swept alone, and none is looked at again that already holds.
"""

from __future__ import annotations

import numpy as np

from spatula_env._kernels import inline_kernel
from spatula_env.contact.structures import GAP, GROUND, INERTIA, OWNER


@inline_kernel
def _root(parents: np.ndarray, tool: int) -> int:
    """The tool that stands for a tool's island."""
    while parents[tool] != tool:
        tool = parents[tool]
    return tool


@inline_kernel
def find_islands(
    count: int,
    features: np.ndarray,
    inverse_mass: np.ndarray,
    tool_count: int,
    holders: np.ndarray,
    order: np.ndarray,
    starts: np.ndarray,
) -> int:
    """Sort constraints into islands; in an island they keep their order.

    Args:
        count: How many constraints.
        features: See `structures.Constraints`.
        inverse_mass: (V,) [1/kg]; fixed vertices have zero, and connect nothing.
        tool_count: N.
        holders: (V,) int64 workspace, all -1; left so.
        order: (count,) int64 written: indices of constraints, first those of the ground that no tool shares.
        starts: (N + 1,) int64 written: where the islands begin in `order`; last where they end.

    Returns:
        How many islands there are.
    """
    parents, roots = np.arange(tool_count), np.empty(count, np.int64)
    for c in range(count):
        owner = features[c, OWNER]
        if owner == GROUND:
            continue
        for corner in range(3):
            vertex = features[c, corner]
            if inverse_mass[vertex] == 0.0:
                continue
            if holders[vertex] < 0:
                holders[vertex] = owner
            elif holders[vertex] != owner:
                mine, other = _root(parents, owner), _root(parents, holders[vertex])
                parents[max(mine, other)] = min(mine, other)
    sizes, lone = np.zeros(tool_count, np.int64), 0
    for c in range(count):
        owner = features[c, OWNER]
        if owner == GROUND:
            owner = holders[features[c, 0]]
        roots[c] = _root(parents, owner) if owner >= 0 else -1
        if owner >= 0:
            sizes[roots[c]] += 1
        else:
            lone += 1
    islands = 0
    starts[0] = lone
    for k in range(tool_count):
        if sizes[k] > 0:
            starts[islands + 1] = starts[islands] + sizes[k]
            sizes[k] = starts[islands]
            islands += 1
    lone = 0
    for c in range(count):
        if roots[c] < 0:
            order[lone] = c
            lone += 1
        else:
            order[sizes[roots[c]]] = c
            sizes[roots[c]] += 1
        if features[c, OWNER] != GROUND:
            for corner in range(3):
                holders[features[c, corner]] = -1
    return islands


@inline_kernel
def greatest_violation(order: np.ndarray, rows: np.ndarray) -> float:
    """How deep the surface is behind the planes of some constraints, which have been measured, at most [u]."""
    worst = 0.0
    for c in order:
        if rows[c, INERTIA] > 0.0:
            worst = max(worst, -rows[c, GAP])
    return worst
