"""Distribution of the force on a tool over its contact nodes.

The response pushes at a few points, where the organ's vertices and edges meet the tool. Between them the organ is a
flat triangle, which does not determine how the force is distributed there. Here each push is spread over the nodes
around it on the face that it acts on, no farther than a mean edge of the organ. A node's part falls off with its
distance and grows with its share of the face. Nodes in contact take precedence if they are not too few. The nodes'
forces sum exactly to the force on the tool.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from spatula_env._kernels import ARRAYS, array_kernel, kernel
from spatula_env.contact.flags import fill_rotation
from spatula_env.contact.settings import DT, MEAN_EDGE
from spatula_env.contact.structures import CONSTRAINTS, IMPULSE, OWNER, PLANE, POINT, WORLD_CONTACTS

F8, F8_2, I4 = ARRAYS["f8"], ARRAYS["f8_2"], ARRAYS["i4"]

LEAST_PART = 0.25
"""A push is spread over the nodes in contact alone if they make up at least this part of the (weighted) area over which
it would be spread otherwise. A smaller area is not resolved by the organ's mesh: the pressure on the only node that
happens to be in contact would depend on how densely the face is covered with nodes."""


ANY_FACE = -2
"""Value of a face's index that stands for any face."""


@kernel(F8_2(CONSTRAINTS, types.int64))
def contact_table(constraints: Any, count: int) -> np.ndarray:
    """Copy the first `count` constraints after a step: (count, 8) of point [u], impulse on the organ, owner, plane."""
    table, rows, features = np.empty((count, 8)), constraints.table.rows, constraints.table.features
    for c in range(count):
        for axis in range(3):
            table[c, axis] = rows[c, POINT + axis]
            table[c, 3 + axis] = rows[c, IMPULSE + axis]
        table[c, 6] = features[c, OWNER]
        table[c, 7] = features[c, PLANE]
    return table


@array_kernel
def into_tool_frame(place: np.ndarray, position: np.ndarray, rotation: np.ndarray, point: np.ndarray) -> None:
    """Write a world point `place` (3,) in the frame of a tool with a position (3,) and rotation matrix (9,)."""
    x, y, z = place[0] - position[0], place[1] - position[1], place[2] - position[2]
    for axis in range(3):
        point[axis] = rotation[axis] * x + rotation[3 + axis] * y + rotation[6 + axis] * z


@array_kernel
def _fill_falloff(
    point: np.ndarray,
    plane: int,
    nodes: np.ndarray,
    face: np.ndarray,
    areas: np.ndarray,
    reach: float,
    first: int,
    end: int,
    shares: np.ndarray,
) -> bool:
    """Write the share of each node of a face in a push, regardless of which nodes are in contact; see `share_push`.

    Returns:
        Whether the face, or any face if it is `ANY_FACE`, has nodes between `first` and `end`.
    """
    x, y, z, squared = point[0], point[1], point[2], reach * reach
    has_nodes = False
    # Without a branch, so that the loop is vectorised.
    for i in range(first, end):
        u, v, w = nodes[i, 0] - x, nodes[i, 1] - y, nodes[i, 2] - z
        falloff = 1.0 - (u * u + v * v + w * w) / squared
        belongs = (face[i] == plane) | (plane == ANY_FACE)
        has_nodes |= belongs
        shares[i] = areas[i] * falloff * falloff if belongs & (falloff > 0.0) else 0.0
    return has_nodes


@array_kernel
def _nearest_node(point: np.ndarray, plane: int, nodes: np.ndarray, face: np.ndarray, first: int, end: int) -> int:
    """The node of a face, or of any face if it is `ANY_FACE`, from `first` to `end` that is nearest to a point (3,)."""
    nearest, least = 0, np.inf
    for i in range(first, end):
        x, y, z = nodes[i, 0] - point[0], nodes[i, 1] - point[1], nodes[i, 2] - point[2]
        away = x * x + y * y + z * z
        if away < least and (face[i] == plane or plane == ANY_FACE):
            nearest, least = i, away
    return nearest


@array_kernel
def share_push(
    point: np.ndarray,
    plane: int,
    nodes: np.ndarray,
    face: np.ndarray,
    areas: np.ndarray,
    flags: np.ndarray,
    reach: float,
    first: int,
    end: int,
    shares: np.ndarray,
) -> float:
    """Distribute a push over the nodes of a tool.

    Args:
        point: (3,) where the push acts, tool frame [u].
        plane: Index of the face that it acts on.
        nodes: (n, 3) tool frame [u].
        face: (n,) index of each node's face.
        areas: (n,) each node's share of its face's area [u2].
        flags: (n,) whether each node is in contact.
        reach: Distance over which a push is spread [u].
        first: Index of the first node that may belong to the face.
        end: Index after the last node that may belong to the face.
        shares: (n,) written: the nodes' shares, zero or more, from `first` to `end`; of all nodes if the face has
            none.

    Returns:
        The sum of the shares.
    """
    # Use the nodes of the face; if it has none, those of all faces.
    low, high, touches = first, end, True
    if not _fill_falloff(point, plane, nodes, face, areas, reach, low, high, shares):
        low, high, touches = 0, nodes.shape[0], False
        _fill_falloff(point, ANY_FACE, nodes, face, areas, reach, low, high, shares)
    total, touching = 0.0, 0.0
    for i in range(low, high):
        total += shares[i]
        touching += shares[i] if flags[i] and touches else 0.0
    if total == 0.0:
        shares[_nearest_node(point, plane if touches else ANY_FACE, nodes, face, low, high)] = 1.0
        return 1.0
    if touching == 0.0:
        return total
    # Nodes in contact take precedence; the others get a share only if those alone would be too small an area.
    others = max(LEAST_PART * total - touching, 0.0) / (total - touching) if touching < total else 0.0
    for i in range(low, high):
        if not flags[i]:
            shares[i] *= others
    return max(touching, LEAST_PART * total)


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
    """Distribute the forces of the organs on a tool over its nodes.

    Args:
        table: (C, 8) from `contact_table`.
        tool: Index of the tool.
        position: (3,) of the tool [u].
        rotation: (9,) rotation matrix of the tool, row by row.
        nodes: (n, 3) tool frame [u].
        face: (n,) index of each node's face.
        areas: (n,) each node's share of its face's area [u2].
        flags: (n,) whether each node is in contact.
        reach: Distance over which a push is spread [u].
        dt: Length of the step [s].
        forces: (n, 3) written: force on each node, world frame [kg u/s2].
    """
    forces[:] = 0.0
    count = nodes.shape[0]
    shares, point = np.empty(count), np.empty(3)
    for c in range(table.shape[0]):
        if table[c, 6] != tool or (table[c, 3] == 0.0 and table[c, 4] == 0.0 and table[c, 5] == 0.0):
            continue
        into_tool_frame(table[c, :3], position, rotation, point)
        total = share_push(point, int(table[c, 7]), nodes, face, areas, flags, reach, 0, count, shares)
        for i in range(count):
            if shares[i] > 0.0:
                for axis in range(3):
                    forces[i, axis] -= table[c, 3 + axis] * shares[i] / (total * dt)


@kernel(types.float64(WORLD_CONTACTS, types.int64, types.int64, F8, F8, F8, F8))
def tool_pressures(
    world: Any,
    tool: int,
    push_count: int,
    position: np.ndarray,
    orientation: np.ndarray,
    pressures: np.ndarray,
    face_pressures: np.ndarray,
) -> float:
    """Compute the pressure on a tool after a physics step.

    Args:
        world: `WorldContacts`.
        tool: Index of the tool.
        push_count: Number of constraints.
        position: (3,) of the tool [u].
        orientation: (4,) unit quaternion xyzw of the tool.
        pressures: (n,) or longer, written: pressure on each node, the component of the force of `spread_forces`
            against the node's face, divided by the node's share of the face's area; never negative [kg/(u s2)].
        face_pressures: (F,) or longer: the mean pressure on each face with nodes is added to it [kg/(u s2)].

    Returns:
        The greatest pressure on a node [kg/(u s2)].
    """
    shape, reach, dt = world.tools[tool].geometry, world.settings[MEAN_EDGE], world.settings[DT]
    nodes, normals, face, areas = shape.nodes, shape.normals, shape.face, shape.areas
    rows, features = world.constraints.table.rows, world.constraints.table.features
    count, organs = nodes.shape[0], world.first_vertices.shape[0]
    room = world.room.spread
    touching, shares, rotation, point, impulse = (
        room.touching[:count], room.shares[:count], room.rotation, room.point, room.impulse,
    )  # fmt: skip
    for i in range(count):
        touching[i] = False
    for organ in range(organs):
        flags = world.memories[tool * organs + organ].nodes.flags
        for i in range(count):
            touching[i] |= flags[i]
    fill_rotation(orientation, 1.0, rotation)
    for i in range(count):
        pressures[i] = 0.0
    plane, first, end = -1, 0, count
    for c in range(push_count):
        if features[c, OWNER] != tool:
            continue
        x, y, z = rows[c, IMPULSE], rows[c, IMPULSE + 1], rows[c, IMPULSE + 2]
        if x == 0.0 and y == 0.0 and z == 0.0:
            continue
        for axis in range(3):
            impulse[axis] = rotation[axis] * x + rotation[3 + axis] * y + rotation[6 + axis] * z
        if features[c, PLANE] != plane:
            # Pushes on one face mostly follow each other, so the range of its nodes is looked up once for all of them.
            plane, first, end = features[c, PLANE], count, 0
            for i in range(count):
                if face[i] == plane:
                    first, end = min(first, i), i + 1
        into_tool_frame(rows[c, POINT : POINT + 3], position, rotation, point)
        total = share_push(point, plane, nodes, face, areas, touching, reach, first, end, shares)
        low, high = (first, end) if first < end else (0, count)
        scale = 1.0 / (total * dt)
        for i in range(low, high):
            if shares[i] > 0.0:
                against = impulse[0] * normals[i, 0] + impulse[1] * normals[i, 1] + impulse[2] * normals[i, 2]
                pressures[i] += against * shares[i] * scale / areas[i]
    greatest, begin = 0.0, 0
    while begin < count:
        # The nodes of a face follow each other; if they did not, each run of them would add a mean of its own.
        force, area, index = 0.0, 0.0, begin
        while index < count and face[index] == face[begin]:
            pressures[index] = max(pressures[index], 0.0)
            greatest = max(greatest, pressures[index])
            force += pressures[index] * areas[index]
            area += areas[index]
            index += 1
        face_pressures[face[begin]] += force / area
        begin = index
    return greatest
