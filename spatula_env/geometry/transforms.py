"""Rotations, and the checks of vectors and quaternions that users give.

Quaternions are unit quaternions in the order ``(x, y, z, w)``, the order PyBullet uses. A quaternion rotates
vectors from the body's frame to the world's: ``world = rotate(orientation, body) + position``. ``q`` and
``-q`` are the same rotation, and functions return whichever comes first.

Only :func:`as_quaternion`, :func:`as_vector3` and the ``quaternion_from_*`` functions check their arguments.
The others run inside simulation steps and expect unit quaternions.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from spatula_env.arrays import FloatArray
from spatula_env.geometry.checks import as_floats

UNIT_TOLERANCE = 1e-6
"""Greatest deviation from 1 of the length of a quaternion given by a user."""


def as_vector3(value: ArrayLike, name: str) -> FloatArray:
    """Check that a value is a finite vector of three numbers.

    Args:
        value: The value to check, shape (3,).
        name: What to call it in error messages.

    Returns:
        A new array of shape (3,), float64.

    Raises:
        ValueError: If the value has another shape, is not numeric, or is not finite.
    """
    return _as_finite(value, name, 3)


def as_quaternion(value: ArrayLike, name: str) -> FloatArray:
    """Check that a value is a unit quaternion ``(x, y, z, w)`` and normalise it.

    Args:
        value: The value to check, shape (4,), of length 1 within :data:`UNIT_TOLERANCE`.
        name: What to call it in error messages.

    Returns:
        A new array of shape (4,), float64, of length 1 to rounding.

    Raises:
        ValueError: If the value has another shape, is not numeric, is not finite, or is not of unit length.
    """
    quaternion = _as_finite(value, name, 4)
    length = math.sqrt(float(quaternion @ quaternion))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise ValueError(
            f"{name} must be a unit quaternion (x, y, z, w), of length 1 within {UNIT_TOLERANCE:g}, "
            f"got {quaternion.tolist()} of length {length:.9g}"
        )
    return quaternion / length


def quaternion_multiply(first: FloatArray, second: FloatArray) -> FloatArray:
    """Multiply two quaternions: the rotation that turns by ``second``, then by ``first``.

    Args:
        first: Quaternion of shape (4,).
        second: Quaternion of shape (4,).

    Returns:
        Their Hamilton product, shape (4,).
    """
    x1, y1, z1, w1 = first.tolist()
    x2, y2, z2, w2 = second.tolist()
    return np.array(
        [
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        ]
    )


def quaternion_conjugate(quaternion: FloatArray) -> FloatArray:
    """Conjugate a quaternion, which for a unit quaternion is the inverse rotation.

    Args:
        quaternion: Quaternion of shape (4,).

    Returns:
        The conjugate, shape (4,).
    """
    return np.array([-quaternion[0], -quaternion[1], -quaternion[2], quaternion[3]])


def rotation_matrix(quaternion: FloatArray) -> FloatArray:
    """Matrix of a rotation: its columns are the body's axes seen from the world.

    Args:
        quaternion: Unit quaternion of shape (4,).

    Returns:
        Orthogonal matrix of shape (3, 3) and determinant 1.
    """
    x, y, z, w = quaternion.tolist()
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def rotate(quaternion: FloatArray, points: ArrayLike) -> FloatArray:
    """Rotate points or vectors from the body's frame to the world's.

    Args:
        quaternion: Unit quaternion of shape (4,).
        points: Points of shape (..., 3), any unit.

    Returns:
        The rotated points, of the shape and in the unit of ``points``.
    """
    rotated: FloatArray = np.asarray(points, dtype=np.float64) @ rotation_matrix(quaternion).T
    return rotated


def quaternion_from_axis_angle(axis: ArrayLike, angle: float) -> FloatArray:
    """Quaternion of a turn about an axis.

    Args:
        axis: Direction of the axis, shape (3,), any length but zero.
        angle: Angle of the turn by the right-hand rule [rad].

    Returns:
        Unit quaternion of shape (4,).

    Raises:
        ValueError: If the axis is not three finite numbers or has no length, or the angle is not finite.
    """
    if not math.isfinite(angle):
        raise ValueError(f"angle must be finite, got {angle}")
    direction = _as_direction(axis, "axis")
    return np.append(math.sin(0.5 * angle) * direction, math.cos(0.5 * angle))


def quaternion_from_two_vectors(start: ArrayLike, end: ArrayLike) -> FloatArray:
    """Quaternion of the smallest rotation that turns one direction into another.

    For opposite directions, where any perpendicular axis is possible, one is chosen that depends on ``start``
    alone.

    Args:
        start: Direction to turn, shape (3,), any length but zero.
        end: Direction to reach, shape (3,), any length but zero.

    Returns:
        Unit quaternion of shape (4,).

    Raises:
        ValueError: If a vector is not three finite numbers or has no length.
    """
    a = _as_direction(start, "start")
    b = _as_direction(end, "end")
    # |a - b| and |a + b| are twice the sine and cosine of half the angle. Unlike 1 + a.b they keep their
    # precision when the vectors are nearly parallel or nearly opposite.
    difference, total = a - b, a + b
    axis = np.cross(a, b)
    length = float(np.linalg.norm(axis))
    if length > 1e-14:
        axis /= length
    elif float(a @ b) > 0.0:
        return np.array([0.0, 0.0, 0.0, 1.0])
    else:
        axis = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
    if float(a @ b) < 0.0:
        # Near opposite vectors the cross product is mostly rounding; only what is perpendicular to them
        # counts.
        difference_direction = difference / np.linalg.norm(difference)
        axis -= (axis @ difference_direction) * difference_direction
        axis /= np.linalg.norm(axis)
    quaternion = np.append(0.5 * np.linalg.norm(difference) * axis, 0.5 * np.linalg.norm(total))
    return quaternion / float(np.linalg.norm(quaternion))


def quaternion_from_matrix(matrix: ArrayLike) -> FloatArray:
    """Quaternion of a rotation matrix.

    The largest component is computed from the diagonal, and the others from it, which avoids division by a
    small number (S. W. Shepperd, Quaternion from rotation matrix, Journal of Guidance and Control 1(3), 1978).

    Args:
        matrix: Rotation matrix of shape (3, 3), orthogonal within 1e-6.

    Returns:
        Unit quaternion of shape (4,).

    Raises:
        ValueError: If the matrix has another shape, is not finite, not orthogonal, or mirrors.
    """
    m = np.array(matrix, dtype=np.float64)
    if m.shape != (3, 3):
        raise ValueError(f"matrix must have shape (3, 3), got {m.shape}")
    error = float(np.abs(m @ m.T - np.eye(3)).max())
    if not error <= UNIT_TOLERANCE:
        raise ValueError(f"matrix must be orthogonal within {UNIT_TOLERANCE:g}, got an error of {error:.3g}")
    if np.linalg.det(m) < 0.0:
        raise ValueError("matrix must be a rotation, got one that mirrors (determinant -1)")
    trace = float(np.trace(m))
    squares = np.append(1.0 + 2.0 * np.diag(m) - trace, 1.0 + trace)
    vector = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    largest = int(np.argmax(squares))
    if largest == 3:
        quaternion = np.append(vector, squares[3])
    else:
        quaternion = np.append(m[largest] + m[:, largest], vector[largest])
        quaternion[largest] = squares[largest]
    return quaternion / float(np.linalg.norm(quaternion))


def integrate_rotation(quaternion: FloatArray, angular_velocity: FloatArray, dt: float) -> FloatArray:
    """Turn an orientation at a constant angular velocity for some time.

    This is the exact solution of ``dq/dt = (omega, 0) q / 2``, for turns by any angle.

    Args:
        quaternion: Unit quaternion of shape (4,).
        angular_velocity: Angular velocity in the world's frame, shape (3,) [rad/s].
        dt: Duration [s].

    Returns:
        Unit quaternion of shape (4,).
    """
    half_turn = (0.5 * dt) * np.asarray(angular_velocity, dtype=np.float64)
    half_angle = math.sqrt(float(half_turn @ half_turn))
    # sin(x) / x by its series where the quotient would be 0 / 0.
    factor = math.sin(half_angle) / half_angle if half_angle > 1e-6 else 1.0 - half_angle * half_angle / 6.0
    turned = quaternion_multiply(np.append(factor * half_turn, math.cos(half_angle)), quaternion)
    return turned / math.sqrt(float(turned @ turned))


def slerp(start: FloatArray, end: FloatArray, fraction: float) -> FloatArray:
    """Interpolate between two orientations at a constant rate, the shorter way round.

    Args:
        start: Unit quaternion of shape (4,).
        end: Unit quaternion of shape (4,).
        fraction: How far to go, 0 at ``start`` and 1 at ``end``.

    Returns:
        Unit quaternion of shape (4,).

    Raises:
        ValueError: If ``fraction`` is not in [0, 1].
    """
    if not 0.0 <= fraction <= 1.0:
        raise ValueError(f"fraction must be in [0, 1], got {fraction}")
    target = end if float(start @ end) >= 0.0 else -end
    angle = 2.0 * math.atan2(float(np.linalg.norm(start - target)), float(np.linalg.norm(start + target)))
    if angle < 1e-9:
        # The arc is straight up to rounding, and sin(angle) below would lose its precision.
        blend = (1.0 - fraction) * start + fraction * target
    else:
        blend = math.sin((1.0 - fraction) * angle) * start + math.sin(fraction * angle) * target
    return blend / float(np.linalg.norm(blend))


def random_quaternion(generator: np.random.Generator) -> FloatArray:
    """Draw an orientation uniformly from all rotations.

    Method: K. Shoemake, Uniform random rotations, Graphics Gems III, 1992.

    Args:
        generator: Source of random numbers; three are drawn.

    Returns:
        Unit quaternion of shape (4,).
    """
    split, first, second = generator.random(3).tolist()
    small, large = math.sqrt(1.0 - split), math.sqrt(split)
    first, second = 2.0 * math.pi * first, 2.0 * math.pi * second
    return np.array(
        [small * math.sin(first), small * math.cos(first), large * math.sin(second), large * math.cos(second)]
    )


def _as_finite(value: ArrayLike, name: str, count: int) -> FloatArray:
    """Copy ``count`` finite numbers into an array, or raise ValueError."""
    try:
        array = as_floats(value)
    except ValueError as error:
        raise ValueError(f"{name} must be {count} numbers, got {value!r}") from error
    if array.shape != (count,):
        raise ValueError(f"{name} must have shape ({count},), got shape {array.shape}")
    # A plain loop over three or four floats is cheaper than NumPy's isfinite and all.
    if not all(map(math.isfinite, array.tolist())):
        raise ValueError(f"{name} must be finite, got {array.tolist()}")
    return array


def _as_direction(value: ArrayLike, name: str) -> FloatArray:
    """Check a vector and scale it to unit length, or raise ValueError."""
    vector = as_vector3(value, name)
    largest = float(np.abs(vector).max())
    if largest == 0.0:
        raise ValueError(f"{name} must have a length, got {vector.tolist()}")
    vector /= largest  # so that squares neither overflow nor vanish
    return vector / float(np.linalg.norm(vector))
