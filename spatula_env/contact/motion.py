"""Motions of organs and tools in a step, their extent, and helpers for points and orientations."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import types

from spatula_env._kernels import ARRAYS, array_kernel, kernel

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray

NODES_AT_ONCE = 16
"""Number of nodes that are examined between two checks whether the answer is known already."""


class Motions(NamedTuple):
    """Motions of the N tools in one step. Contact stops them where the organs cannot give way: see `step.stop_tools`.

    Attributes:
        start_positions: (N, 3) [u].
        start_orientations: (N, 4) unit quaternions xyzw.
        positions: (N, 3) at the end of the step [u].
        orientations: (N, 4).
        linear_velocities: (N, 3) [u/s].
        angular_velocities: (N, 3) world frame [rad/s].
    """

    start_positions: FloatArray
    start_orientations: FloatArray
    positions: FloatArray
    orientations: FloatArray
    linear_velocities: FloatArray
    angular_velocities: FloatArray


class OrganMotion(NamedTuple):
    """Motion of the V nodes of all organs in one step.

    Attributes:
        start: (V, 3) positions at its start [u].
        free_vertices: (V, 3) positions at its end, without contact [u].
        free_velocities: (V, 3) velocities at its end, without contact [u/s].
        vertices: (V, 3) written: positions at its end [u].
        velocities: (V, 3) written: velocities at its end [u/s].
    """

    start: FloatArray
    free_vertices: FloatArray
    free_velocities: FloatArray
    vertices: FloatArray
    velocities: FloatArray


class StepOutcome(NamedTuple):
    """Result of resolving the contacts of a step; written.

    Attributes:
        nodal_impulses: (V, 3) impulses of the tools on the nodes [kg u/s].
        wrenches: (N + 1, 6) impulse, and its moment about the tool's origin, of the organs on each tool; in the last
            row the impulse on the ground, with a moment of zero [kg u/s, kg u2/s].
        numbers: (7,) indexed by the column names of the result in `settings`.
    """

    nodal_impulses: FloatArray
    wrenches: FloatArray
    numbers: FloatArray


MOTIONS = types.NamedUniTuple(ARRAYS["f8_2"], 6, Motions)
ORGAN_MOTION = types.NamedUniTuple(ARRAYS["f8_2"], 5, OrganMotion)
STEP_OUTCOME = types.NamedTuple([ARRAYS["f8_2"], ARRAYS["f8_2"], ARRAYS["f8"]], StepOutcome)


@array_kernel
def _squared_shift(before: np.ndarray, now: np.ndarray, i: int) -> float:
    """The squared distance between the positions of vertex `i` in two arrays (V, 3) [u2]."""
    x, y, z = now[i, 0] - before[i, 0], now[i, 1] - before[i, 1], now[i, 2] - before[i, 2]
    squared: float = x * x + y * y + z * z
    return squared


@kernel("f8(f8[:,::1], f8[:,::1])")
def largest_shift(before: np.ndarray, now: np.ndarray) -> float:
    """The greatest distance that any vertex has moved between two times.

    Args:
        before: (V, 3) positions at the first time [u].
        now: (V, 3) positions at the second time [u].

    Returns:
        The distance [u].
    """
    count = before.shape[0]
    largest, of_odd = 0.0, 0.0
    # Two running maxima, of even and of odd vertices, so that one comparison need not wait for the other.
    for i in range(0, count - 1, 2):
        squared, other = _squared_shift(before, now, i), _squared_shift(before, now, i + 1)
        largest = squared if squared > largest else largest
        of_odd = other if other > of_odd else of_odd
    if count % 2 == 1:
        squared = _squared_shift(before, now, count - 1)
        largest = squared if squared > largest else largest
    return float(np.sqrt(max(largest, of_odd)))


@kernel("b1(f8[::1], f8[::1], f8, f8[:,::1], f8[:,::1])")
def tool_passes(
    start_position: np.ndarray, position: np.ndarray, radius: float, before: np.ndarray, now: np.ndarray
) -> bool:
    """Whether the box around a tool's path overlaps the box around the organs' motion.

    Args:
        start_position: (3,) of the tool before the motion [u].
        position: (3,) of the tool after it [u].
        radius: Radius of a ball around the tool's origin that contains the tool [u].
        before: (V, 3) vertices of the organs before the motion [u].
        now: (V, 3) vertices of the organs after it [u].

    Returns:
        False if tool and organs cannot have met.
    """
    # The boxes overlap if along each axis some node is not above the tool's box and some node is not below it. All axes
    # are checked in one loop, in the order in which nodes lie in memory.
    least_x, greatest_x = max(start_position[0], position[0]) + radius, min(start_position[0], position[0]) - radius
    least_y, greatest_y = max(start_position[1], position[1]) + radius, min(start_position[1], position[1]) - radius
    least_z, greatest_z = max(start_position[2], position[2]) + radius, min(start_position[2], position[2]) - radius
    below_x, below_y, below_z = False, False, False
    above_x, above_y, above_z = False, False, False
    for i in range(before.shape[0]):
        x, y, z = before[i, 0], before[i, 1], before[i, 2]
        u, v, w = now[i, 0], now[i, 1], now[i, 2]
        below_x |= (x <= least_x) | (u <= least_x)
        below_y |= (y <= least_y) | (v <= least_y)
        below_z |= (z <= least_z) | (w <= least_z)
        above_x |= (x >= greatest_x) | (u >= greatest_x)
        above_y |= (y >= greatest_y) | (v >= greatest_y)
        above_z |= (z >= greatest_z) | (w >= greatest_z)
        # Beside an organ a few nodes decide; checking after every one would take longer than examining it.
        if i % NODES_AT_ONCE == 0 and below_x and below_y and below_z and above_x and above_y and above_z:
            return True
    return below_x and below_y and below_z and above_x and above_y and above_z


@array_kernel
def copy_points(points: np.ndarray, into: np.ndarray) -> None:
    """Copy points (V, 3) into an array of that shape.

    An assignment of whole arrays would make Numba compile checks of their shapes, which takes seconds.
    """
    # Flat views, so that the loop is vectorised.
    numbers, copied = points.reshape(points.size), into.reshape(into.size)
    for k in range(numbers.shape[0]):
        copied[k] = numbers[k]


@array_kernel
def turn_between(first: np.ndarray, second: np.ndarray, fraction: float, result: np.ndarray) -> None:
    """Write the orientation at a fraction of the turn from one unit quaternion (4,) to another, the short way."""
    if fraction == 0.0 or fraction == 1.0:
        for k in range(4):
            result[k] = first[k] if fraction == 0.0 else second[k]
        return
    cosine = first[0] * second[0] + first[1] * second[1] + first[2] * second[2] + first[3] * second[3]
    sign = -1.0 if cosine < 0.0 else 1.0
    angle = np.arccos(min(abs(cosine), 1.0))
    if angle < 1e-8:
        a, b = 1.0 - fraction, sign * fraction
    else:
        a, b = np.sin((1.0 - fraction) * angle) / np.sin(angle), sign * np.sin(fraction * angle) / np.sin(angle)
    length = 0.0
    for k in range(4):
        result[k] = a * first[k] + b * second[k]
        length += result[k] * result[k]
    for k in range(4):
        result[k] /= np.sqrt(length)


@array_kernel
def turn_by(orientation: np.ndarray, angular_velocity: np.ndarray, dt: float, result: np.ndarray) -> None:
    """Write the orientation after turning at a constant angular velocity; see `transforms.integrate_rotation`."""
    x, y, z = 0.5 * dt * angular_velocity[0], 0.5 * dt * angular_velocity[1], 0.5 * dt * angular_velocity[2]
    if x == 0.0 and y == 0.0 and z == 0.0:
        for k in range(4):
            result[k] = orientation[k]
        return
    angle = np.sqrt(x * x + y * y + z * z)
    factor = np.sin(angle) / angle if angle > 1e-6 else 1.0 - angle * angle / 6.0
    x, y, z, w = factor * x, factor * y, factor * z, np.cos(angle)
    a, b, c, d = orientation[0], orientation[1], orientation[2], orientation[3]
    result[0] = w * a + x * d + y * c - z * b
    result[1] = w * b - x * c + y * d + z * a
    result[2] = w * c + x * b - y * a + z * d
    result[3] = w * d - x * a - y * b - z * c
    length = np.sqrt(result[0] ** 2 + result[1] ** 2 + result[2] ** 2 + result[3] ** 2)
    for k in range(4):
        result[k] /= length
