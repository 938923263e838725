"""Kinematics: the grip's position from three encoders, and the motor counts for a force on the grip.

The Falcon is a translational parallel manipulator of the kind described by Stamper ("A three degree of freedom
parallel manipulator with only translational degrees of freedom", PhD thesis, University of Maryland, 1997) and Tsai
("Robot Analysis", Wiley, 1999), with one more offset, `TANGENT`. Three equal legs stand around the z axis. In each, a
motor turns a thigh; a parallelogram, the shin, connects the thigh's end, the knee, to the grip and keeps the grip from
rotating. The lengths are those that libnifalcon uses.

Everything here is in the Falcon's frame (:mod:`spatula_env.teleop.falcon.frames`), in metres, newtons and radians. A
leg's own frame is the Falcon's, turned about z by the leg's azimuth and moved to its hip. With the grip at (u, v, w)
there::

    sine   = sqrt(1 - ((v + PLATE_TANGENT) / SHIN)^2)        the shin's share in the plane the thigh turns in
    reach  = SHIN_ENDS + SHIN sine                           from knee to grip in that plane
    theta  = atan2(w, U) - acos((U^2 + w^2 + THIGH^2 - reach^2) / (2 THIGH sqrt(U^2 + w^2))),    U = u + PLATE

which is the law of cosines in the triangle hip, knee, grip. theta = 0 is a thigh in the plane of the base.
"""

from __future__ import annotations

import math
from contextlib import suppress

from spatula_env.teleop.falcon.vector import Matrix, Vector, norm, solve, transpose

THIGH = 0.060
"""Distance from hip to knee [m]; a in the literature."""
SHIN = 0.1025
"""The parallelogram's long edge [m]; b."""
PLATE = 0.01443
"""Radial distance from the grip's middle to its joint [m]; c."""
SHIN_ENDS = 0.01125 + 0.01125
"""Total length of the two pieces that hold the parallelogram [m]; d + e."""
PLATE_TANGENT = -0.025
"""Offset of the grip's joint out of the leg's plane [m]; f."""
RADIUS = 0.0400
"""Radial distance from the z axis to a hip [m]; r."""
TANGENT = -0.02309
"""Tangential offset of a hip from the z axis [m]; s."""
AZIMUTHS: Vector = (math.radians(105.0), math.radians(-15.0), math.radians(-135.0))
"""Azimuths of the legs about z, in the order of the encoders and motors [rad]."""

COUNT_ANGLE = (0.01425 / 0.110) * 2.0 * math.pi / (320 * 4)
"""Angle of a thigh per encoder count [rad]: encoder of 320 lines read fourfold, geared 14.25 mm to 110 mm."""
ZERO_COUNT_ANGLE = math.radians(35.0)
"""Angle of a thigh at count 0 of its homed encoder [rad]."""

COUNTS_PER_TORQUE = -10_000.0
"""Motor counts per torque on the thigh [1/(N m)].

Not a calibration: libnifalcon chose the number so that forces felt like those of the vendor's program.
"""
MOTOR_LIMIT = 4095
"""Greatest magnitude of a motor count."""

LEAST_ANGLE = math.radians(-75.0)
GREATEST_ANGLE = math.radians(120.0)
"""Angles beyond these are impossible for a Falcon [rad]; the cube of `frames.HALF_WIDTH` needs -48 to 98 degrees."""

CONVERGED = 1e-13
"""Newton's iteration ends when a step is this short [m]."""
MOST_ITERATIONS = 60
SHORTEST_FRACTION = 2.0**-20
"""Smallest fraction to which a Newton step is shortened before the iteration is given up."""

_LEGS = tuple((math.cos(azimuth), math.sin(azimuth)) for azimuth in AZIMUTHS)


class UnreachableError(ValueError):
    """The device cannot take this position or set of angles."""


def inverse(position: Vector) -> Vector:
    """Angles of the thighs that put the grip at a position.

    Args:
        position: Position of the grip, Falcon's frame [m].

    Returns:
        The three angles [rad].

    Raises:
        UnreachableError: If a leg does not reach that far.
    """
    angles, _ = inverse_with_jacobian(position)
    return angles


def inverse_with_jacobian(position: Vector) -> tuple[Vector, Matrix]:
    """Angles of the thighs, and their derivatives with respect to the grip's position.

    Args:
        position: Position of the grip, Falcon's frame [m].

    Returns:
        The three angles [rad], and their derivatives, one row for each leg [rad/m].

    Raises:
        UnreachableError: If a leg does not reach that far, or is stretched so far that the derivative is unbounded.
    """
    x, y, z = position
    angles = []
    rows = []
    for cosine, sine in _LEGS:
        radial = cosine * x + sine * y - RADIUS + PLATE
        sideways = cosine * y - sine * x - TANGENT + PLATE_TANGENT
        in_plane_squared = SHIN * SHIN - sideways * sideways
        distance_squared = radial * radial + z * z
        if not (in_plane_squared > 0.0 and distance_squared > 0.0):
            raise _unreachable(position)
        in_plane = math.sqrt(in_plane_squared)
        distance = math.sqrt(distance_squared)
        reach = SHIN_ENDS + in_plane
        projection = (distance_squared + THIGH * THIGH - reach * reach) / (2.0 * THIGH)
        ratio = projection / distance
        if not -1.0 < ratio < 1.0:
            raise _unreachable(position)
        angles.append(math.atan2(z, radial) - math.acos(ratio))

        # The total differential of theta in (radial, sideways, z), then the chain rule to (x, y, z).
        slope = 1.0 / math.sqrt(1.0 - ratio * ratio)
        by_distance = slope * (1.0 / THIGH - ratio / distance)
        by_radial = by_distance * radial / distance - z / distance_squared
        by_z = by_distance * z / distance + radial / distance_squared
        by_sideways = slope * reach * sideways / (in_plane * THIGH * distance)
        rows.append((by_radial * cosine - by_sideways * sine, by_radial * sine + by_sideways * cosine, by_z))
    return (angles[0], angles[1], angles[2]), (rows[0], rows[1], rows[2])


def forward(angles: Vector, start: Vector | None = None) -> Vector:
    """Position of the grip, by Newton's method on `inverse_with_jacobian`.

    Args:
        angles: The three angles [rad].
        start: Starting point, preferably the last known position [m]. None starts on the z axis.

    Returns:
        Position of the grip, Falcon's frame, to within `CONVERGED` [m].

    Raises:
        UnreachableError: If no position has these angles.
    """
    return forward_with_jacobian(angles, start)[0]


def forward_with_jacobian(angles: Vector, start: Vector | None = None) -> tuple[Vector, Matrix]:
    """Position of the grip, and the angles' derivatives there; see `forward`, `inverse_with_jacobian`."""
    if not (LEAST_ANGLE <= min(angles) and max(angles) <= GREATEST_ANGLE):
        raise _impossible(angles)
    if start is not None:
        # From a distant start, Newton may end at the edge of the workspace; then start again on the z axis.
        with suppress(UnreachableError):
            return _newton(angles, start)
    return _newton(angles, _on_axis(angles))


def _newton(angles: Vector, position: Vector) -> tuple[Vector, Matrix]:
    """Position of the grip at these angles and the derivatives there, from a starting position; see `forward`."""
    first, second, third = angles
    current, jacobian = inverse_with_jacobian(position)
    missing = (first - current[0], second - current[1], third - current[2])
    for _ in range(MOST_ITERATIONS):
        try:
            step = solve(jacobian, missing)
        except ZeroDivisionError:
            raise _impossible(angles) from None
        fraction = 1.0
        length = norm(step)
        # Near the edge of the workspace a full step may leave it or increase the residual: shorten it until it helps.
        while True:
            trial = (
                position[0] + fraction * step[0],
                position[1] + fraction * step[1],
                position[2] + fraction * step[2],
            )
            try:
                trial_angles, trial_jacobian = inverse_with_jacobian(trial)
            except UnreachableError:
                pass
            else:
                trial_missing = (first - trial_angles[0], second - trial_angles[1], third - trial_angles[2])
                # Near convergence, rounding decides which residual is smaller: take a step that short anyway, as the
                # last one.
                if norm(trial_missing) < norm(missing) or length < CONVERGED:
                    break
            fraction *= 0.5
            if fraction < SHORTEST_FRACTION:
                raise _impossible(angles)
        position = trial
        missing, jacobian = trial_missing, trial_jacobian
        if length < CONVERGED:
            return position, jacobian
    raise _impossible(angles)


def torques(force: Vector, jacobian: Matrix) -> Vector:
    """Torques on the thighs that make the grip push the hand with a force.

    Power is equal on both sides: torques . angular rates = force . velocity, with rates = jacobian . velocity.

    Args:
        force: Force of the grip on the hand, Falcon's frame [N].
        jacobian: Derivatives from `inverse_with_jacobian` at the grip's position [rad/m].

    Returns:
        The three torques [N m].

    Raises:
        UnreachableError: If the pose is singular, so that no torques produce such a force.
    """
    try:
        return solve(transpose(jacobian), force)
    except ZeroDivisionError:
        raise UnreachableError("the legs line up here, so that some forces cannot be made") from None


def torques_to_counts(
    values: Vector, limit: int = MOTOR_LIMIT, owed: Vector = (0.0, 0.0, 0.0)
) -> tuple[tuple[int, int, int], float, Vector]:
    """Motor counts for torques; if one is too large, all three are scaled down together to keep the direction.

    A count is about 2 mN at the grip, a tenth of a light touch. What rounding leaves out is owed to the next packet, so
    that the mean over a few packets is exact.

    Args:
        values: The three torques [N m].
        limit: Greatest magnitude of a count.
        owed: What the last packet left out [counts].

    Returns:
        The counts, the scale factor, at most 1, and what these counts leave out, at most half a count each.
    """
    first, second, third = (COUNTS_PER_TORQUE * value for value in values)
    greatest = max(abs(first), abs(second), abs(third))
    scale = limit / greatest if greatest > limit else 1.0
    first, second, third = first * scale + owed[0], second * scale + owed[1], third * scale + owed[2]
    counts = _rounded(first, limit), _rounded(second, limit), _rounded(third, limit)
    return counts, scale, (_bounded(first - counts[0]), _bounded(second - counts[1]), _bounded(third - counts[2]))


def counts_to_angles(counts: tuple[int, int, int]) -> Vector:
    """Angles of the thighs from homed encoders.

    Args:
        counts: Counts of the three encoders.

    Returns:
        The angles [rad].
    """
    first, second, third = counts
    return (
        ZERO_COUNT_ANGLE + first * COUNT_ANGLE,
        ZERO_COUNT_ANGLE + second * COUNT_ANGLE,
        ZERO_COUNT_ANGLE + third * COUNT_ANGLE,
    )


def angles_to_counts(angles: Vector) -> tuple[int, int, int]:
    """Counts that homed encoders show at some angles of the thighs.

    Args:
        angles: The three angles [rad].

    Returns:
        The nearest counts.
    """
    first, second, third = ((angle - ZERO_COUNT_ANGLE) / COUNT_ANGLE for angle in angles)
    return round(first), round(second), round(third)


def _rounded(value: float, limit: int) -> int:
    return min(limit, max(-limit, round(value)))


def _bounded(part: float) -> float:
    return min(0.5, max(-0.5, part))


def _on_axis(angles: Vector) -> Vector:
    """A point on the z axis whose angles are roughly the mean of the three.

    Interpolates linearly between the angles at z = 0.09 and 0.17 m. The result is within reach whatever the angles are.
    """
    mean = math.degrees(sum(angles) / 3.0)
    return 0.0, 0.0, min(max(0.0913 + 0.00118 * mean, 0.04), 0.175)


def _unreachable(position: Vector) -> UnreachableError:
    return UnreachableError(f"the Falcon does not reach ({', '.join(f'{value:.4f}' for value in position)}) m")


def _impossible(angles: Vector) -> UnreachableError:
    degrees = ", ".join(f"{math.degrees(angle):.2f}" for angle in angles)
    return UnreachableError(f"the legs of a Falcon cannot stand at ({degrees}) degrees")
