"""What the haptic loop is told about the simulation, and what it tells in return."""

from __future__ import annotations

from dataclasses import dataclass

Vector = tuple[float, float, float]
"""Three coordinates, device's frame. Tuples, as for three numbers they are several times faster than arrays."""

ZERO: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Contact:
    """What the tool feels at one moment, in the device's frame.

    Attributes:
        time: When it was told, by the device's clock; the heartbeat of the simulation [s].
        position: Where the grip would be if it were where the tool is [m]; None if that is not known, or if hand and
            tool are not coupled, as while the clutch is held.
        force: What the organ does to the tool [N].
        low: Lowest corner of where the grip may be for the tool to follow [m]; None if there is no such place.
        high: Highest corner of it [m].
        shift: How much of the position is a matter of how hand and tool are matched [m]. What is left moves only as the
            tool does.
    """

    time: float
    position: Vector | None = None
    force: Vector = ZERO
    low: Vector | None = None
    high: Vector | None = None
    shift: Vector = ZERO


@dataclass(frozen=True)
class LoopStatistics:
    """How regularly the haptic loop went round.

    Attributes:
        cycles: How often.
        median_period: From one cycle to the next [s].
        late_period: 99 of 100 are not longer [s].
        longest_period: The longest [s].
        stalls: How often a force was let go because the simulation did not go on.
        limited: In how many cycles passivity held a force back.
        balance: What the hand has given to the loop less what it got back, by the loop's own account [J].
        pulse: Usual time from one heartbeat of the simulation to the next [s].
        is_slow: Whether the simulation is too slow to be felt.
    """

    cycles: int
    median_period: float
    late_period: float
    longest_period: float
    stalls: int
    limited: int
    balance: float
    pulse: float = 0.0
    is_slow: bool = False


def dot(first: Vector, second: Vector) -> float:
    """The scalar product."""
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


def difference(first: Vector, second: Vector) -> Vector:
    """What leads from the second to the first."""
    return first[0] - second[0], first[1] - second[1], first[2] - second[2]


def scaled(factor: float, vector: Vector) -> Vector:
    """A multiple of a vector."""
    return factor * vector[0], factor * vector[1], factor * vector[2]
