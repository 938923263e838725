"""The Falcon's mechanism, computed from vectors along its links.

Frame: the Falcon's, x right, y up, z towards the operator, origin on the base, metres. Each of the three legs is a
chain::

    axis -> hip -> (thigh) -> knee -> (shin: a piece, a parallelogram's edge, a piece) -> grip's joint -> grip's middle

The thigh turns in the leg's plane, which contains the z direction and is turned about z by the leg's azimuth. The
pieces at the two ends of the shin stay in that plane; the parallelogram's edge leaves it sideways. Within the plane,
the knee is an intersection of two circles: that of the thigh about the hip, and that of the shin's projection about
the grip's joint.

A leg pushes the grip through the parallelogram's edge: its ends are hinges, so its force acts along it. Hence a
torque t on the thigh pushes the grip along the edge with t / arm, where arm is the lever of that line about the hip::

    force = t edge / (edge . d(knee)/d(theta))

No inverse kinematics is differentiated. The driver's kinematics does it that way, and shares no code with this
module. The lengths are those of libnifalcon.
"""

from __future__ import annotations

from functools import lru_cache
from math import atan2, cos, pi, sin, sqrt

Point = tuple[float, float, float]
_Leg = tuple[float, Point, float]

HIP_FROM_AXIS = 0.0400
HIP_SIDEWAYS = -0.02309
THIGH_LENGTH = 0.0600
SHIN_PIECES = 0.01125 + 0.01125
SHIN_EDGE = 0.1025
JOINT_FROM_MIDDLE = 0.01443
JOINT_SIDEWAYS = -0.025
AZIMUTHS = (105.0, -15.0, -135.0)
"""Lengths [m] and azimuths [deg] of the mechanism."""

DEGREES_PER_COUNT = 360.0 / (4 * 320) * 14.25 / 110.0
ZERO_DEGREES = 35.0
"""Degrees that the thigh turns per encoder count, and the thigh's angle at count 0 [deg]."""
NEWTON_METRES_PER_COUNT = -1e-4
"""Torque on a thigh per motor count [N m]."""

FIRST_STOP = -75.0
LAST_STOP = 115.0
"""Stops of the thighs [deg]. Assumed: wider than the cube of +-40 mm needs."""

SURE_REACH = 0.04
SURE_MIDDLE = 0.12
"""Half edge of a cube that all legs reach everywhere, and the position of its centre on the z axis [m]."""

_RADIAL = tuple((cos(azimuth * pi / 180.0), sin(azimuth * pi / 180.0)) for azimuth in AZIMUTHS)


class OutOfReachError(ValueError):
    """The mechanism cannot take this pose."""


def leg_angles(grip: Point) -> Point:
    """Angles of the thighs that place the grip at a position.

    Args:
        grip: Position of the grip's middle [m].

    Returns:
        The angles [deg].

    Raises:
        OutOfReachError: If a leg is too short, or would be beyond a stop.
    """
    first, second, third = _legs(grip)
    return first[0], second[0], third[0]


def is_within_reach(grip: Point) -> bool:
    """Whether the mechanism can place the grip at a position.

    Args:
        grip: Position of the grip's middle [m].
    """
    x, y, z = grip
    if abs(x) <= SURE_REACH and abs(y) <= SURE_REACH and abs(z - SURE_MIDDLE) <= SURE_REACH:
        return True
    try:
        _legs(grip)
    except OutOfReachError:
        return False
    return True


def encoder_counts(grip: Point) -> tuple[int, int, int]:
    """Encoder counts relative to the true zeros.

    Args:
        grip: Position of the grip's middle [m].

    Returns:
        The counts.

    Raises:
        OutOfReachError: If the grip cannot reach the position.
    """
    first, second, third = leg_angles(grip)
    return (
        round((first - ZERO_DEGREES) / DEGREES_PER_COUNT),
        round((second - ZERO_DEGREES) / DEGREES_PER_COUNT),
        round((third - ZERO_DEGREES) / DEGREES_PER_COUNT),
    )


def grip_force(grip: Point, motors: tuple[int, int, int]) -> Point:
    """Force of the grip on the hand while the motors push.

    Args:
        grip: Position of the grip's middle [m].
        motors: Motor counts.

    Returns:
        The force [N].

    Raises:
        OutOfReachError: If the grip cannot reach the position.
    """
    x = y = z = 0.0
    for (_, edge, arm), count in zip(_legs(grip), motors, strict=True):
        if count:
            tension = NEWTON_METRES_PER_COUNT * count / arm
            x += tension * edge[0]
            y += tension * edge[1]
            z += tension * edge[2]
    return x, y, z


# Cached because encoders, motors and stops evaluate the same position one after the other.
@lru_cache(maxsize=4)
def _legs(grip: Point) -> tuple[_Leg, _Leg, _Leg]:
    """The three legs' states; see `_leg`."""
    return _leg(0, grip), _leg(1, grip), _leg(2, grip)


def _leg(leg: int, grip: Point) -> _Leg:
    """State of one leg.

    Returns:
        The thigh's angle [deg], the parallelogram's edge from knee to grip [m], and the component of the knee's
        motion per radian along that edge, times the edge's length [m2].
    """
    radial_x, radial_y = _RADIAL[leg]
    # Vector from the hip to the grip's joint: outwards, sideways (a quarter turn further), up.
    outwards = grip[0] * radial_x + grip[1] * radial_y + JOINT_FROM_MIDDLE - HIP_FROM_AXIS
    sideways = grip[1] * radial_x - grip[0] * radial_y + JOINT_SIDEWAYS - HIP_SIDEWAYS
    up = grip[2]

    share = SHIN_EDGE**2 - sideways**2
    if share <= 0.0:
        raise OutOfReachError(f"leg {leg} does not reach {sideways:.4f} m sideways")
    edge_in_plane = sqrt(share)
    shin = SHIN_PIECES + edge_in_plane

    # The two circles intersect on a chord perpendicular to the line from hip to joint.
    span = sqrt(outwards**2 + up**2)
    foot = (span**2 + THIGH_LENGTH**2 - shin**2) / (2.0 * span)
    half_chord_squared = THIGH_LENGTH**2 - foot**2
    if half_chord_squared <= 0.0:
        raise OutOfReachError(f"leg {leg} does not reach {span:.4f} m from its hip")
    half_chord = sqrt(half_chord_squared)
    along_outwards, along_up = outwards / span, up / span
    # Take the intersection on the outer side, where the knee of a Falcon is.
    knee_outwards = foot * along_outwards + half_chord * along_up
    knee_up = foot * along_up - half_chord * along_outwards

    angle = atan2(knee_up, knee_outwards) * 180.0 / pi
    if not FIRST_STOP <= angle <= LAST_STOP:
        raise OutOfReachError(f"leg {leg} would be beyond its stop, at {angle:.1f} degrees")

    direction_outwards = (outwards - knee_outwards) / shin
    direction_up = (up - knee_up) / shin
    edge_outwards, edge_up = edge_in_plane * direction_outwards, edge_in_plane * direction_up
    # Per radian of the thigh, the knee moves by the thigh vector turned by 90 degrees.
    arm = edge_up * knee_outwards - edge_outwards * knee_up
    edge = (
        edge_outwards * radial_x - sideways * radial_y,
        edge_outwards * radial_y + sideways * radial_x,
        edge_up,
    )
    return angle, edge, arm
