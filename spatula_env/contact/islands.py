"""Islands: groups of constraints that can be solved apart from each other.

The constraints of two tools are in one island if the tools hold a common vertex, directly or through other tools. The
constraints of organs with themselves and each other count as those of one further tool.

Islands share no vertex, so each is solved by itself, until its own constraints have converged. Of several tools, the
one that takes longest is then swept alone, and constraints that hold already are not processed again.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from spatula_env._kernels import array_kernel, inline_kernel
from spatula_env.contact.structures import GAP, GROUND, INERTIA, NORMAL, ORGANS, OWNER, POINT


class IslandRoom(NamedTuple):
    """Room for islands of constraints of N tools with V vertices.

    Attributes:
        starts: (N + 2,) int64, where each island begins in the order of constraints, and where the last one ends.
        holders: (V,) int64 workspace, all -1 between two calls.
        parents: (N + 1,) int64 workspace.
        sizes: (N + 1,) int64 workspace.
    """

    starts: np.ndarray
    holders: np.ndarray
    parents: np.ndarray
    sizes: np.ndarray


@inline_kernel
def island_room(step: Any, tool_count: int, vertex_count: int) -> IslandRoom:
    """The `IslandRoom` in a `StepRoom`, for these numbers of tools and vertices."""
    islands = step.islands
    return IslandRoom(
        islands[0, : tool_count + 2], step.holders[:vertex_count], islands[1, : tool_count + 1],
        islands[2, : tool_count + 1],
    )  # fmt: skip


@array_kernel
def _root(parents: np.ndarray, tool: int) -> int:
    """The root of a tool's island in the union-find forest `parents`."""
    while parents[tool] != tool:
        tool = parents[tool]
    return tool


@array_kernel
def _island_of(c: int, features: np.ndarray, tool_count: int, room: Any) -> int:
    """The root of a constraint's island; -1 for a constraint of the ground at a vertex that no tool holds."""
    owner = features[c, OWNER]
    if owner == GROUND:
        owner = room.holders[features[c, 0]]
    elif owner == ORGANS:
        owner = tool_count
    return _root(room.parents, owner) if owner >= 0 else -1


@array_kernel
def _join(count: int, features: np.ndarray, inverse_mass: np.ndarray, tool_count: int, room: Any) -> None:
    """Write which tool holds each vertex, and join tools that hold a common one; arguments as in `find_islands`."""
    holders, parents = room.holders, room.parents
    for k in range(tool_count + 1):
        parents[k] = k
    for c in range(count):
        owner = features[c, OWNER]
        if owner == GROUND:
            continue
        corners = 3
        if owner == ORGANS:
            owner, corners = tool_count, 4
        for corner in range(corners):
            vertex = features[c, corner]
            if inverse_mass[vertex] == 0.0:
                continue
            if holders[vertex] < 0:
                holders[vertex] = owner
            elif holders[vertex] != owner:
                mine, other = _root(parents, owner), _root(parents, holders[vertex])
                parents[max(mine, other)] = min(mine, other)


@array_kernel
def find_islands(
    count: int, features: np.ndarray, inverse_mass: np.ndarray, tool_count: int, order: np.ndarray, room: Any
) -> int:
    """Sort constraints into islands, keeping their order within an island.

    Args:
        count: Number of constraints.
        features: See `structures.ConstraintTable`.
        inverse_mass: (V,) [1/kg]; fixed vertices have zero, and connect nothing.
        tool_count: N.
        order: (count,) int64 written: indices of constraints, first those of the ground at vertices that no tool
            holds, which belong to no island.
        room: `IslandRoom`, of which `starts` is written.

    Returns:
        The number of islands.
    """
    starts, sizes, lone = room.starts, room.sizes, 0
    _join(count, features, inverse_mass, tool_count, room)
    for k in range(tool_count + 1):
        sizes[k] = 0
    for c in range(count):
        island = _island_of(c, features, tool_count, room)
        if island >= 0:
            sizes[island] += 1
        else:
            lone += 1
    islands = 0
    starts[0] = lone
    for k in range(tool_count + 1):
        if sizes[k] > 0:
            starts[islands + 1] = starts[islands] + sizes[k]
            sizes[k] = starts[islands]
            islands += 1
    lone = 0
    for c in range(count):
        island = _island_of(c, features, tool_count, room)
        if island < 0:
            order[lone] = c
            lone += 1
        else:
            order[sizes[island]] = c
            sizes[island] += 1
    for c in range(count):
        if features[c, OWNER] != GROUND:
            for corner in range(4 if features[c, OWNER] == ORGANS else 3):
                room.holders[features[c, corner]] = -1
    return islands


@array_kernel
def greatest_violation(order: np.ndarray, rows: np.ndarray, features: np.ndarray) -> float:
    """The greatest violation of some constraints, whose gaps have been measured [u].

    Constraints between organs count as violated only by what exceeds half the distance at which organs are kept apart;
    the other half is enough to keep them from crossing.
    """
    worst = 0.0
    for c in order:
        row = rows[c]
        if row[INERTIA] > 0.0:
            slack = 0.0
            if features[c, OWNER] == ORGANS:
                for axis in range(3):
                    slack += 0.5 * row[POINT + axis] * row[NORMAL + axis]
            worst = max(worst, -row[GAP] - slack)
    return worst
