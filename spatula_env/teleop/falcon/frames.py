"""Conversions between the Falcon's frame and the device frame that all devices share.

The Falcon's own frame, in which the literature gives its kinematics, has its origin on the device's base: x to the
right, y up, z out of the device towards the operator. The device frame (:mod:`spatula_env.teleop.device`) has x to
the right, y away from the operator, z up, and its origin in the middle of the workspace, `CENTRE` in front of the
base. Hence::

    (x, y, z) of the device frame = (x, CENTRE - z, y) of the Falcon
"""

from __future__ import annotations

from spatula_env.teleop.falcon.vector import Vector

CENTRE = 0.12
"""Distance of the workspace's centre from the base, along the Falcon's z [m].

Programs for the Falcon use values between 0.11 and 0.15. With 0.12, the whole cube of +-`HALF_WIDTH` can be reached;
with 0.125, its far corners cannot.
"""

HALF_WIDTH = 0.04
"""Half edge of the cube that the grip can always reach [m]; CHAI3D gives the Falcon's workspace the same radius."""


def position_to_device(position: Vector) -> Vector:
    """Convert a position from the Falcon's frame to the device frame.

    Args:
        position: In the Falcon's frame [m].

    Returns:
        In the device frame [m].
    """
    x, y, z = position
    return x, CENTRE - z, y


def position_to_falcon(position: Vector) -> Vector:
    """Convert a position from the device frame to the Falcon's frame.

    Args:
        position: In the device frame [m].

    Returns:
        In the Falcon's frame [m].
    """
    x, y, z = position
    return x, z, CENTRE - y


def direction_to_device(vector: Vector) -> Vector:
    """Convert a velocity or force from the Falcon's frame to the device frame.

    Args:
        vector: In the Falcon's frame.

    Returns:
        In the device frame, same unit.
    """
    x, y, z = vector
    return x, -z, y


def direction_to_falcon(vector: Vector) -> Vector:
    """Convert a velocity or force from the device frame to the Falcon's frame.

    Args:
        vector: In the device frame.

    Returns:
        In the Falcon's frame, same unit.
    """
    x, y, z = vector
    return x, z, -y
