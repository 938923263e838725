"""The operator's hand on the grip, with an account of the energy it exchanges.

Frame: the Falcon's (see :mod:`spatula_env.teleop.emulator.legs`); metres, newtons, kilograms, seconds, joules.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

from spatula_env.teleop.emulator.legs import Point, is_within_reach

Motion = Callable[[float], Point]
"""Position as a function of time."""

GRIP_MASS = 0.090
"""Apparent mass of the mechanism at the grip, a value found by others for gravity compensation [kg]."""
PUSHED_IN: Point = (0.0, 0.0, 0.085)
PULLED_OUT: Point = (0.0, 0.0, 0.170)
MIDDLE: Point = (0.0, 0.0, 0.120)
"""Grip positions on the z axis [m]."""
FREE = (False, False, False)
"""No axis on which a stop was hit."""


@dataclass
class Energies:
    """Energies exchanged since the start [J].

    For an `ElasticHand`, up to rounding: kinetic energy = motors + arm - dissipated - stops.

    Attributes:
        motors: Work of the motors on the hand; a passive device and controller never give out more than they have
            taken in.
        arm: Work of the arm's spring on the hand.
        dissipated: Energy lost in the hand's damping.
        stops: Energy lost when a mechanical stop ends a motion.
    """

    motors: float = 0.0
    arm: float = 0.0
    dissipated: float = 0.0
    stops: float = 0.0


class Hand(Protocol):
    """Model of what holds the grip.

    Attributes:
        position: Position of the grip [m].
        velocity: Velocity of the grip [m/s].
        energies: Energies exchanged so far.
    """

    position: Point
    velocity: Point
    energies: Energies

    def advance(self, time: float, step: float, motor_force: Point) -> None:
        """Advance by one step.

        Args:
            time: Time at the beginning of the step, since the emulator was made [s].
            step: Length of the step [s].
            motor_force: Force of the grip on the hand during the step [N].
        """


class ElasticHand:
    """A mass that the arm pulls, by a spring, towards the operator's target; its damping acts against the room.

    Integrated by the implicit midpoint rule, which is stable for any spring and conserves energy: the work of the
    motors goes, up to rounding, into motion, spring, damping and stops (`Energies`).

    Attributes:
        position: Position of the grip [m].
        velocity: Velocity of the grip [m/s].
        energies: Energies exchanged so far.
        mass: Mass of hand and grip [kg].
        stiffness: Stiffness of the arm [N/m]; 0 for a grip that is not held.
        damping: Damping of the arm [N s/m].
        target: Where the operator wants the grip, as a function of time; None for the initial position.
    """

    def __init__(
        self,
        target: Motion | None = None,
        *,
        position: Point = MIDDLE,
        mass: float = GRIP_MASS + 0.2,
        stiffness: float = 300.0,
        damping: float = 6.0,
    ) -> None:
        """Take hold of the grip.

        Args:
            target: Where the operator wants the grip, as a function of time.
            position: Initial position [m].
            mass: Mass of hand and grip, positive [kg].
            stiffness: Stiffness of the arm [N/m].
            damping: Damping of the arm [N s/m].

        Raises:
            ValueError: If the mass is not positive, or stiffness or damping is negative.
        """
        if not mass > 0.0:
            raise ValueError(f"mass must be positive, got {mass!r}")
        if not (stiffness >= 0.0 and damping >= 0.0):
            raise ValueError(f"stiffness and damping must not be negative, got {stiffness!r} and {damping!r}")
        self.position = position
        self.velocity: Point = (0.0, 0.0, 0.0)
        self.energies = Energies()
        self.mass = mass
        self.stiffness = stiffness
        self.damping = damping
        self.target = target
        self._rest = position

    @property
    def kinetic_energy(self) -> float:
        """Kinetic energy of hand and grip [J]."""
        return 0.5 * self.mass * _dot(self.velocity, self.velocity)

    def advance(self, time: float, step: float, motor_force: Point) -> None:
        """See `Hand`."""
        goal_x, goal_y, goal_z = self._rest if self.target is None else self.target(time + 0.5 * step)
        mass, stiffness = self.mass, self.stiffness
        inertia = 2.0 * mass / step
        share = 1.0 / (inertia + 0.5 * step * stiffness + self.damping)
        old = x, y, z = self.position
        u, v, w = self.velocity
        push_x, push_y, push_z = motor_force
        # The mean velocity of the step; written out by components because this is the innermost loop.
        mean_x = share * (inertia * u + push_x + stiffness * (goal_x - x))
        mean_y = share * (inertia * v + push_y + stiffness * (goal_y - y))
        mean_z = share * (inertia * w + push_z + stiffness * (goal_z - z))
        reached, stopped = _until_stop(old, (mean_x * step, mean_y * step, mean_z * step))

        moved_x, moved_y, moved_z = reached[0] - x, reached[1] - y, reached[2] - z
        motors = push_x * moved_x + push_y * moved_y + push_z * moved_z
        arm = stiffness * (
            (goal_x - 0.5 * (x + reached[0])) * moved_x
            + (goal_y - 0.5 * (y + reached[1])) * moved_y
            + (goal_z - 0.5 * (z + reached[2])) * moved_z
        )
        before = 0.5 * mass * (u * u + v * v + w * w)
        u = 0.0 if stopped[0] else 2.0 * mean_x - u
        v = 0.0 if stopped[1] else 2.0 * mean_y - v
        w = 0.0 if stopped[2] else 2.0 * mean_z - w
        lost = before + motors + arm - 0.5 * mass * (u * u + v * v + w * w)
        self.position, self.velocity = reached, (u, v, w)
        energies = self.energies
        energies.motors += motors
        energies.arm += arm
        if stopped == FREE:
            energies.dissipated += lost
        else:
            energies.stops += lost


class GuidedHand:
    """A hand so strong that the grip follows a given motion exactly, whatever the motors do.

    Attributes:
        position: Position of the grip [m].
        velocity: Velocity of the grip [m/s].
        energies: Energies exchanged so far; only the motors' work is counted.
        motion: Position of the grip as a function of time.
    """

    def __init__(self, motion: Motion, start: float = 0.0) -> None:
        """Take hold of the grip.

        Args:
            motion: Position of the grip as a function of time; has to stay within reach.
            start: Initial time [s].
        """
        self.motion = motion
        self.position = motion(start)
        self.velocity: Point = (0.0, 0.0, 0.0)
        self.energies = Energies()

    def advance(self, time: float, step: float, motor_force: Point) -> None:
        """See `Hand`."""
        x, y, z = self.motion(time + step)
        old = self.position
        moved = (x - old[0], y - old[1], z - old[2])
        self.energies.motors += _dot(motor_force, moved)
        self.velocity = (moved[0] / step, moved[1] / step, moved[2] / step)
        self.position = (x, y, z)


def homing_motion(then: Motion | None = None, start: float = 0.05, duration: float = 1.0) -> Motion:
    """The motion that homes a Falcon: pull the grip all the way out, push it all the way in, go to the middle.

    Args:
        then: The motion that follows, with time starting at 0; None to stay in the middle.
        start: When the operator begins [s].
        duration: Duration of the homing motion [s].

    Returns:
        The motion.
    """
    corners = ((0.0, MIDDLE), (0.3, PULLED_OUT), (0.4, PULLED_OUT), (0.8, PUSHED_IN), (0.9, PUSHED_IN), (1.0, MIDDLE))

    def motion(time: float) -> Point:
        share = (time - start) / duration
        if share >= 1.0:
            return MIDDLE if then is None else then(time - start - duration)
        if share <= 0.0:
            return MIDDLE
        for (first, here), (last, there) in pairwise(corners):
            if share <= last:
                way = (share - first) / (last - first)
                smooth = way * way * (3.0 - 2.0 * way)
                return 0.0, 0.0, here[2] + smooth * (there[2] - here[2])
        raise AssertionError("the corners end at 1")

    return motion


def _until_stop(position: Point, moved: Point) -> tuple[Point, tuple[bool, bool, bool]]:
    """Move the grip as far as the mechanism allows, along each axis on its own if not along all at once.

    Returns:
        The new place, and along which axes a stop was hit.
    """
    x, y, z = position
    free = (x + moved[0], y + moved[1], z + moved[2])
    if is_within_reach(free):
        return free, FREE
    stopped = [False, False, False]
    reached = [x, y, z]
    for axis in range(3):
        reached[axis] += moved[axis]
        if not is_within_reach((reached[0], reached[1], reached[2])):
            reached[axis] = position[axis]
            stopped[axis] = True
    return (reached[0], reached[1], reached[2]), (stopped[0], stopped[1], stopped[2])


def _dot(first: Point, second: Point) -> float:
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]
