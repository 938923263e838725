"""The organ as the loop knows it between two physics steps: it gives way with the stiffness that it has shown.

A force that is only held between two physics steps comes late. Where the tool and its force are known, and how fast the
force grows there, the force at the place of the hand is known a thousand times a second (Y. Adachi, T. Kumano and
K. Ogino, "Intermediate representation for stiff virtual objects", VRAIS 1995). With the organ's own stiffness the
low-pass filter that makes a curve of the simulation's steps costs no time either: force and place are filtered alike.
An organ that sticks to the tool resists to the side as well, several times as stiffly as along the force.
"""

from __future__ import annotations

import math

from spatula_env.teleop.haptics.contact import ZERO, Contact, Vector, difference, dot, scaled
from spatula_env.teleop.haptics.settings import HapticSettings

SMALL_FORCE = 1e-9
"""Below this a force has no direction [N]."""
MEMORY = 0.1
"""For how long what was felt counts for the stiffness [s]."""
CLEAR_MOTION = 5e-5
"""A motion, root mean square, from which on what it did to the force says something about the stiffness [m]."""
SOFTEST, STIFFEST = 5.0, 1000.0
"""Nothing else is believed of a stiffness on the tool [N/m]."""


class LocalContact:
    """Force and place of the tool as a curve, and how stiff the organ is there.

    Attributes:
        stiffness: Along the force, as it has been found [N/m]. Not scaled.
        side_stiffness: Across it, where the organ sticks to the tool; little where the tool slides [N/m]. Not scaled.
        force: On the tool, filtered, scaled as it is to be felt [N].
        direction: Unit, in which the organ pushes: that of the force of late, which a tremor to the side does not turn.
        shift: As hand and tool are matched; see `Contact` [m].
        work: Of the tool on the organ since contact began, scaled as forces are [J].
    """

    def __init__(self, settings: HapticSettings) -> None:
        """Nothing is touched.

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

    def hear(self, contact: Contact) -> None:
        """Take what the simulation tells; nothing happens if it is known already.

        Args:
            contact: The newest.
        """
        if contact.time == self._told_time:
            return
        step = min(MEMORY, contact.time - self._told_time)
        self._told_time = contact.time
        force = scaled(self._settings.force_scale, contact.force)
        self.shift = contact.shift
        # Of the tool itself, wherever the hand is matched with it.
        place = None if contact.position is None else difference(contact.position, contact.shift)
        last = self._told_place
        if place is not None and last is not None:
            middle = scaled(
                0.5, (force[0] + self._told_force[0], force[1] + self._told_force[1], force[2] + self._told_force[2])
            )
            self.work -= dot(middle, difference(place, last))
        if place is None or dot(contact.force, contact.force) < SMALL_FORCE**2:
            self._mean_place = None
        else:
            self._learn(contact.force, place, step)
        self._told_force, self._told_place = force, place

    def follow(self, step: float, cutoff: float) -> None:
        """Go on with the curve through what was told.

        Args:
            step: How long [s].
            cutoff: Of the low-pass filter [Hz].
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
        """From the hand to the tool [m]: how far the hand is ahead; zero if hand and tool are not coupled."""
        return ZERO if self._anchor is None else difference(self._anchor, difference(position, self.shift))

    @property
    def is_touching(self) -> bool:
        """Whether the simulation has told a force."""
        return self._told_force != ZERO

    def begin(self) -> None:
        """A new contact begins."""
        self.work = 0.0

    def forget(self) -> None:
        """What is told next is a beginning, and no continuation."""
        self.force = self.direction = ZERO
        self._anchor = None
        self._told_force, self._told_place = ZERO, None
        self.work = 0.0
        self._mean_place = None

    def _learn(self, force: Vector, place: Vector, step: float) -> None:
        """Correct the stiffness by how force and place have varied together of late."""
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
        self.stiffness = _corrected(self.stiffness, self._variance, self._covariance, share, SOFTEST)
        self.side_stiffness = _corrected(self.side_stiffness, self._side_variance, self._side_covariance, share, 0.0)


def _unit(vector: Vector) -> Vector:
    size = math.sqrt(dot(vector, vector))
    return ZERO if size < SMALL_FORCE else scaled(1.0 / size, vector)


def _corrected(stiffness: float, variance: float, covariance: float, share: float, least: float) -> float:
    """A stiffness, corrected by how places and forces have varied together."""
    if variance <= 0.0:
        return stiffness
    found = min(STIFFEST, max(least, -covariance / variance))
    return stiffness + share * variance / (variance + CLEAR_MOTION**2) * (found - stiffness)


def _towards(value: Vector, target: Vector, share: float) -> Vector:
    return (
        value[0] + share * (target[0] - value[0]),
        value[1] + share * (target[1] - value[1]),
        value[2] + share * (target[2] - value[2]),
    )
