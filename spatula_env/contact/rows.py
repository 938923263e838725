"""Constraints of one query: how a row is written, and how it is named."""

from __future__ import annotations

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
"""Kinds of constraints, in their names."""


@array_kernel
def constraint_name(kind: int, of_tool: int, first: int, second: int) -> int:
    """A number that tells features apart: of the tool (up to 2**20), and two vertices of the organ (up to 2**20)."""
    name: int = (kind << 60) | (of_tool << 40) | (first << 20) | second
    return name


@array_kernel
def append_constraint(
    rows: np.ndarray,
    features: np.ndarray,
    names: np.ndarray,
    count: int,
    corners: tuple[int, int, int],
    weights: tuple[float, float, float],
    normal: tuple[float, float, float],
    point: tuple[float, float, float],
    memory_last: np.ndarray,
    first_vertex: int,
    position: np.ndarray,
    rotation: np.ndarray,
    linear_velocity: np.ndarray,
    angular_velocity: np.ndarray,
    friction: float,
    owner: int,
    plane: int,
    name: int,
) -> int:
    """Append a constraint; normal and point are in the tool's frame. Returns the new count."""
    row = rows[count]
    a, b, c = corners
    features[count, 0], features[count, 1], features[count, 2] = a + first_vertex, b + first_vertex, c + first_vertex
    features[count, FOURTH], features[count, OWNER], features[count, PLANE] = NO_VERTEX, owner, plane
    names[count] = name
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
    x = weights[0] * memory_last[0, a] + weights[1] * memory_last[0, b] + weights[2] * memory_last[0, c]
    y = weights[0] * memory_last[1, a] + weights[1] * memory_last[1, b] + weights[2] * memory_last[1, c]
    z = weights[0] * memory_last[2, a] + weights[1] * memory_last[2, b] + weights[2] * memory_last[2, c]
    for axis in range(3):
        row[ORIGIN + axis] = (
            position[axis] + rotation[3 * axis] * x + rotation[3 * axis + 1] * y + rotation[3 * axis + 2] * z
        )
        row[DISPLACEMENT + axis] = 0.0
        row[IMPULSE + axis] = 0.0
    row[FRICTION] = friction
    return count + 1
