"""Data passed between the simulation and the haptic loop."""

from __future__ import annotations

from dataclasses import dataclass

Vector = tuple[float, float, float]
"""Three coordinates, device frame. Tuples, because for three numbers they are several times faster than arrays."""

ZERO: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Contact:
    """What the tool feels at one moment, in the device frame.

    Attributes:
        time: When it was reported, by the device's clock; serves as the simulation's heartbeat [s].
        position: Grip position that corresponds to the tool's position [m]; None if unknown, or if hand and tool are
            not coupled, as while the clutch is held.
        force: Force of the organ on the tool [N].
        low: Lowest corner of the grip positions that the tool can follow [m]; None if there are no bounds.
        high: Highest corner of these positions [m].
        shift: Part of `position` that comes from how hand and tool are matched [m]. The rest moves only when the tool
            moves.
    """

    time: float
    position: Vector | None = None
    force: Vector = ZERO
    low: Vector | None = None
    high: Vector | None = None
    shift: Vector = ZERO


@dataclass(frozen=True)
class LoopStatistics:
    """Statistics of how regularly the haptic loop ran.

    Attributes:
        cycles: Number of cycles.
        median_period: Median time from one cycle to the next [s].
        late_period: 99th percentile of the periods [s].
        longest_period: Longest period [s].
        stalls: Number of times that a force was released because the simulation stopped reporting.
        limited: Number of cycles in which passivity control reduced a force.
        balance: Energy that the hand has given to the loop, minus what it got back, by the loop's own account [J].
        pulse: Typical time from one heartbeat of the simulation to the next [s].
        is_slow: Whether the simulation is too slow for its forces to be rendered.
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
    """The vector from the second point to the first."""
    return first[0] - second[0], first[1] - second[1], first[2] - second[2]


def scaled(factor: float, vector: Vector) -> Vector:
    """A multiple of a vector."""
    return factor * vector[0], factor * vector[1], factor * vector[2]
