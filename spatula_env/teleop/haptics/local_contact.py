"""Local model of the organ between two physics steps: it yields with the stiffness that it has shown so far.

A force that is only held between two physics steps comes late. If the tool's position and force are known, and how fast
the force grows there, the force at the hand's position can be computed a thousand times a second (Y. Adachi, T. Kumano
and K. Ogino, "Intermediate representation for stiff virtual objects", VRAIS 1995). With the organ's own stiffness, the
low-pass filter that smooths the simulation's steps adds no delay either, as force and position are filtered alike. An
organ that sticks to the tool also resists sideways, several times as stiffly as along the force.
"""

from __future__ import annotations

import math

from spatula_env.teleop.haptics.contact import ZERO, Contact, Vector, difference, dot, scaled
from spatula_env.teleop.haptics.settings import HapticSettings

SMALL_FORCE = 1e-9
"""Forces below this have no direction [N]."""
MEMORY = 0.1
"""Time constant with which past forces and positions count for the stiffness estimate [s]."""
JITTER, CLEAR_MOTION = 4e-5, 1e-4
"""Root mean square motions below which the change of force says nothing about the stiffness along it, and from which on
it says much: to the jumps of an encoder's counts, an organ answers several times as stiffly as to a motion. To the side
such jumps do count: what a hand at rest meets there is how stiffly the organ sticks to the tool [m]."""
SOFTEST, STIFFEST = 5.0, 1000.0
"""Bounds of the estimated stiffness on the tool [N/m]."""
GREATEST_TOLD = 1e4
"""Components of a reported force beyond this are cut: no device renders them, and squares of them overflow [N]."""


class LocalContact:
    """Smoothed force and position of the tool, and the organ's stiffness there.

    Attributes:
        stiffness: Estimated stiffness along the force [N/m]. Not scaled.
        side_stiffness: Stiffness across it, where the organ sticks to the tool; small where the tool slides [N/m]. Not
            scaled.
        force: Filtered force on the tool, scaled as it is to be rendered [N].
        direction: Unit vector in which the organ pushes: the direction of the recent mean force, which a sideways
            tremor does not turn.
        shift: Offset that comes from how hand and tool are matched; see `Contact` [m].
        work: Work of the tool on the organ since contact began, scaled as forces are; with what others had done before
            the hand was coupled to the tool [J].
    """

    def __init__(self, settings: HapticSettings) -> None:
        """Start without contact.

        Args:
            settings: The gains.
        """
        self._settings = settings
        self.stiffness = settings.stiffness
        self.side_stiffness = 2.5 * settings.stiffness
        self.force: Vector = ZERO
        self.direction: Vector = ZERO
        self.work = 0.0
        self._anchor: Vector | None = None
        self.shift: Vector = ZERO
        self._told_force: Vector = ZERO
        self._told_place: Vector | None = None
        self._told_time = -math.inf
        self._mean_place: Vector | None = None
        self._mean_force: Vector = ZERO
        self._variance = self._covariance = self._side_variance = self._side_covariance = 0.0

    def hear(self, contact: Contact) -> float:
        """Take the simulation's newest report; does nothing if it is known already.

        Args:
            contact: The newest report.

        Returns:
            Energy that the organ has stored already where the hand is coupled to a tool that presses into it, such as
            after a policy or a clutch, scaled as forces are; otherwise 0 [J].
        """
        if contact.time == self._told_time:
            return 0.0
        step = min(MEMORY, contact.time - self._told_time)
        self._told_time = contact.time
        x, y, z = contact.force
        told = _cut(x), _cut(y), _cut(z)
        force = scaled(self._settings.force_scale, told)
        self.shift = contact.shift
        # The position of the tool itself, however hand and tool are matched.
        place = None if contact.position is None else difference(contact.position, contact.shift)
        last, brought = self._told_place, 0.0
        moved = ZERO if place is None or last is None else difference(place, last)
        begins = place is not None and (last is None or self._told_force == ZERO)
        # No organ is so stiff that this motion alone could have loaded it.
        if begins and dot(told, told) > STIFFEST**2 * dot(moved, moved):
            stiffness = self._settings.force_scale * max(self.stiffness, self._settings.stiffness)
            self.work = brought = 0.5 * dot(force, force) / stiffness
        else:
            middle = scaled(
                0.5, (force[0] + self._told_force[0], force[1] + self._told_force[1], force[2] + self._told_force[2])
            )
            self.work -= dot(middle, moved)
        if place is None or dot(told, told) < SMALL_FORCE**2:
            self._mean_place = None
        else:
            self._learn(told, place, step)
        self._told_force, self._told_place = force, place
        return brought

    def follow(self, step: float, cutoff: float) -> None:
        """Advance the smoothed force and position towards those last reported.

        Args:
            step: Time step [s].
            cutoff: Cutoff frequency of the low-pass filter [Hz].
        """
        share = 1.0 - math.exp(-2.0 * math.pi * cutoff * step)
        self.force = _towards(self.force, self._told_force, share)
        place = self._told_place
        if place is None:
            self._anchor = None
        else:
            self._anchor = place if self._anchor is None else _towards(self._anchor, place, share)
        if dot(self.force, self.force) < SMALL_FORCE**2:
            self.force = ZERO

    def ahead(self, position: Vector) -> Vector:
        """Vector from the hand to the tool [m], which shows how far the hand is ahead; zero if they are not coupled."""
        return ZERO if self._anchor is None else difference(self._anchor, difference(position, self.shift))

    @property
    def is_touching(self) -> bool:
        """Whether the simulation has reported a force."""
        return self._told_force != ZERO

    def begin(self) -> None:
        """Begin a new contact."""
        self.work = 0.0

    def forget(self) -> None:
        """Discard the past, so that the next report counts as a new beginning."""
        self.force = self.direction = ZERO
        self._anchor = None
        self._told_force, self._told_place = ZERO, None
        self.work = 0.0
        self._mean_place = None

    def _learn(self, force: Vector, place: Vector, step: float) -> None:
        """Update the stiffness estimate from how force and position have recently varied together."""
        if self._mean_place is None:
            self._mean_place, self._mean_force = place, force
            self._variance = self._covariance = self._side_variance = self._side_covariance = 0.0
            self.direction = _unit(force)
            return
        share = 1.0 - math.exp(-step / MEMORY)
        normal = self.direction
        moved = difference(place, self._mean_place)
        grown = difference(force, self._mean_force)
        along, more = dot(moved, normal), dot(grown, normal)
        across, pulled = dot(moved, moved) - along * along, dot(moved, grown) - along * more
        self._variance += share * (along * along - self._variance)
        self._covariance += share * (along * more - self._covariance)
        self._side_variance += share * (across - self._side_variance)
        self._side_covariance += share * (pulled - self._side_covariance)
        self._mean_place = _towards(self._mean_place, place, share)
        self._mean_force = _towards(self._mean_force, force, share)
        self.direction = _unit(self._mean_force)
        self.stiffness = _corrected(self.stiffness, self._variance, self._covariance, share, SOFTEST, JITTER)
        self.side_stiffness = _corrected(self.side_stiffness, self._side_variance, self._side_covariance, share, 0.0)


def _cut(component: float) -> float:
    return min(GREATEST_TOLD, max(-GREATEST_TOLD, component))


def _unit(vector: Vector) -> Vector:
    size = math.sqrt(dot(vector, vector))
    return ZERO if size < SMALL_FORCE else scaled(1.0 / size, vector)


def _corrected(
    stiffness: float, variance: float, covariance: float, share: float, least: float, jitter: float = 0.0
) -> float:
    """A stiffness, updated by the covariance of position and force; motions up to `jitter` say nothing."""
    if variance <= 0.0:
        return stiffness
    found = min(STIFFEST, max(least, -covariance / variance))
    clear = max(0.0, variance - jitter**2) ** 2
    return stiffness + share * clear / (clear + CLEAR_MOTION**4) * (found - stiffness)


def _towards(value: Vector, target: Vector, share: float) -> Vector:
    return (
        value[0] + share * (target[0] - value[0]),
        value[1] + share * (target[1] - value[1]),
        value[2] + share * (target[2] - value[2]),
    )
