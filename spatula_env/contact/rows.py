"""Writing and naming of the constraints of a query."""

from __future__ import annotations

from typing import Any

import numpy as np

from spatula_env._kernels import array_kernel
from spatula_env.contact.structures import (
    DISPLACEMENT,
    FOURTH,
    FRICTION,
    IMPULSE,
    NO_VERTEX,
    NORMAL,
    ORIGIN,
    OWNER,
    PLANE,
    POINT,
    VELOCITY,
    WEIGHTS,
)

ON_NODE, ON_VERTEX, ON_CORNER, ON_EDGE, ON_GROUND, ON_TRIANGLE, ON_EDGES, ON_SURFACE = 0, 1, 2, 3, 4, 5, 6, 7
"""Kinds of constraints, as encoded in their names."""


@array_kernel
def constraint_name(kind: int, of_tool: int, first: int, second: int) -> int:
    """A number that identifies a constraint by its kind and its features.

    These are a feature of the tool and two features of the organs, all with indices below 2**20.
    """
    name: int = (kind << 60) | (of_tool << 40) | (first << 20) | second
    return name


@array_kernel
def append_constraint(
    table: Any,
    count: int,
    corners: tuple[int, int, int],
    weights: tuple[float, float, float],
    normal: tuple[float, float, float],
    point: tuple[float, float, float],
    last: np.ndarray,
    placement: Any,
    plane: int,
    name: int,
) -> int:
    """Append a constraint of a tool and an organ.

    Args:
        table: `ConstraintTable` with room for it.
        count: Number of constraints so far.
        corners: Three vertices of the organ, counting its own.
        weights: Weights of these vertices.
        normal: Normal of the plane, towards the organ, tool frame.
        point: A point of the plane, tool frame [u].
        last: (3, V) the organ in the tool's frame at the last query [u].
        placement: `Placement` of the tool.
        plane: The tool's face.
        name: See `constraint_name`.

    Returns:
        The new count.
    """
    position, rotation = placement.position, placement.rotation
    linear_velocity, angular_velocity = placement.linear_velocity, placement.angular_velocity
    row, features = table.rows[count], table.features[count]
    a, b, c = corners
    first = placement.first_vertex
    features[0], features[1], features[2] = a + first, b + first, c + first
    features[FOURTH], features[OWNER], features[PLANE] = NO_VERTEX, placement.owner, plane
    table.names[count] = name
    row[WEIGHTS], row[WEIGHTS + 1], row[WEIGHTS + 2] = weights
    for axis in range(3):
        arm = rotation[3 * axis] * point[0] + rotation[3 * axis + 1] * point[1] + rotation[3 * axis + 2] * point[2]
        row[NORMAL + axis] = (
            rotation[3 * axis] * normal[0] + rotation[3 * axis + 1] * normal[1] + rotation[3 * axis + 2] * normal[2]
        )
        row[POINT + axis] = position[axis] + arm
        row[VELOCITY + axis] = arm
    rx, ry, rz = row[VELOCITY], row[VELOCITY + 1], row[VELOCITY + 2]
    row[VELOCITY] = linear_velocity[0] + angular_velocity[1] * rz - angular_velocity[2] * ry
    row[VELOCITY + 1] = linear_velocity[1] + angular_velocity[2] * rx - angular_velocity[0] * rz
    row[VELOCITY + 2] = linear_velocity[2] + angular_velocity[0] * ry - angular_velocity[1] * rx
    x = weights[0] * last[0, a] + weights[1] * last[0, b] + weights[2] * last[0, c]
    y = weights[0] * last[1, a] + weights[1] * last[1, b] + weights[2] * last[1, c]
    z = weights[0] * last[2, a] + weights[1] * last[2, b] + weights[2] * last[2, c]
    for axis in range(3):
        row[ORIGIN + axis] = (
            position[axis] + rotation[3 * axis] * x + rotation[3 * axis + 1] * y + rotation[3 * axis + 2] * z
        )
        row[DISPLACEMENT + axis] = 0.0
        row[IMPULSE + axis] = 0.0
    row[FRICTION] = placement.friction
    return count + 1
