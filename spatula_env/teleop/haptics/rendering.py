"""From what the tool feels to what the hand feels, once a millisecond. No device and no clock: it can be tested alone.

The simulation tells force and place of the tool a few hundred times a second. What the hand feels is, along the force
and, with a stiffness of its own, across it::

    F = share * life * (f + lead),   lead = k (x_tool - x_hand) - b v_hand,   -f <= lead <= 0.2 f + a little

- f is the simulation's force and k the organ's own stiffness (`local_contact`): the force where the hand is.
- The lead is bounded. A hand that is quicker than the tool may be is ahead of what is known, and a spring that goes on
  growing there shows a force that the organ never makes.
- `share` keeps the exchange of energy in balance (`passivity`), `life` ends what the simulation does not renew
  (`heartbeat`), and nothing changes faster than a limit, so that no way to end a force is a kick.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from spatula_env.teleop.haptics.contact import ZERO, Contact, Vector, difference, dot, scaled
from spatula_env.teleop.haptics.heartbeat import Heartbeat
from spatula_env.teleop.haptics.local_contact import LocalContact
from spatula_env.teleop.haptics.passivity import EnergyAccount
from spatula_env.teleop.haptics.settings import PERIOD, HapticSettings

LONGEST_STEP = 0.01
"""A filter does not take more time than this for one step; the loop was then held up [s]."""
SMALLEST_FORCE = 1e-4
"""What is less of a force that ends is nothing [N]."""
LASTING = 0.5
"""What is slower is not on its way [Hz]."""
MOST_LEAD = 2.0
"""Of how many times the organ's force a lead may be."""
DAMPED = 0.3
"""Share of the organ's force that a damper makes at most."""
SLOW_MOTION = 0.02
"""Speed at which half of the friction that is made up for is [m/s]."""
FULL_SHARE = 0.999
"""A share that is less is a force held back."""


class ForceRenderer:
    """Makes the force on the hand, step by step.

    Attributes:
        account: Of energy.
        heartbeat: Of the simulation.
        contact: With the organ.
        limited: In how many steps passivity held a force back.
        support: What of the last force is not the organ's: it bears the grip, makes up for friction, and is walls [N].
        damping: As it is felt, within the device's limit [N s/m].
        greatest_force: Likewise [N].
    """

    def __init__(
        self,
        settings: HapticSettings,
        greatest_force: float = math.inf,
        greatest_stiffness: float = math.inf,
        greatest_damping: float = math.inf,
        workspace_low: Vector | None = None,
        workspace_high: Vector | None = None,
    ) -> None:
        """Start without any force.

        Args:
            settings: The gains.
            greatest_force: The device's limit [N].
            greatest_stiffness: The device's limit [N/m].
            greatest_damping: The device's limit [N s/m].
            workspace_low: Lowest corner of the device's workspace [m]; None: it is not known.
            workspace_high: The highest.
        """
        self.settings = settings
        self.account = EnergyAccount(settings)
        self.heartbeat = Heartbeat(settings)
        self.contact = LocalContact(settings)
        self.limited = 0
        self.support: Vector = ZERO
        self.greatest_force = min(settings.greatest_force, greatest_force)
        self.damping = min(settings.damping, greatest_damping)
        self._greatest_stiffness = greatest_stiffness
        self._low: Vector = workspace_low if workspace_low is not None else (-math.inf, -math.inf, -math.inf)
        self._high: Vector = workspace_high if workspace_high is not None else (math.inf, math.inf, math.inf)
        self._walls: Vector = ZERO
        self._time: float | None = None
        self._hand: Vector = ZERO
        self._sent: Vector = ZERO
        self._acting: Vector = ZERO
        self._slow: Vector = ZERO
        self._lasting = 0.0
        self._shift: Vector = ZERO
        self._last_force_time = -math.inf

    def step(self, now: float, position: Vector, velocity: Vector, contact: Contact | None) -> Vector:
        """The force for the coming millisecond.

        Args:
            now: The time by the device's clock [s].
            position: Of the hand [m].
            velocity: Of the hand [m/s].
            contact: The last that is known of the simulation; None if there is nothing, or nothing to be felt.

        Returns:
            What the grip is to do to the hand [N].
        """
        step = PERIOD if self._time is None else min(max(now - self._time, 0.0), LONGEST_STEP)
        if self._time is not None:
            # Of the places themselves, as a filtered velocity is late. A force goes out with the packet of the next
            # step, which brings the place too: what has acted since the last place is the force of the step before it.
            self.account.exchange(-dot(self._acting, difference(position, self._hand)), step)
        self._acting = self._sent
        self._time, self._hand = now, position
        life = self.heartbeat.listen(now, step, None if contact is None else contact.time)
        if contact is not None:
            self.contact.hear(contact)
        elif life == 0.0:
            self.contact.forget()
        wanted = scaled(life, self._contact_force(step, position, velocity))
        self._sent = self._slewed(_shortened(wanted, self.greatest_force), step)
        # A force that has faded because the simulation stands still is no end of a contact.
        if self.contact.is_touching:
            self._last_force_time = now
        elif now - self._last_force_time > self.settings.rest_time:
            self.account.begin()
            self.contact.begin()
        self._walls = _limited(self._walls, self._pushed_back(position, contact), self.settings.slew * step)
        self.support = scaled(life, _sum(self._bearing(velocity), self._walls))
        return _shortened(_sum(self._sent, self.support), self.greatest_force)

    def _pushed_back(self, position: Vector, contact: Contact | None) -> Vector:
        """Soft walls where the device's workspace ends, and where the tool does not follow."""
        stiffness, most = self.settings.wall_stiffness, self.settings.wall_force
        if stiffness == 0.0:
            return ZERO
        low, high = self._low, self._high
        if contact is not None and contact.low is not None and contact.high is not None:
            low, high = _each(max, low, contact.low), _each(min, high, contact.high)
        x, y, z = (
            min(most, max(-most, stiffness * _outside(place, least, greatest)))
            for place, least, greatest in zip(position, low, high, strict=True)
        )
        return x, y, z

    def _bearing(self, velocity: Vector) -> Vector:
        """What bears the grip's weight, and makes up for some of its friction; no part of the account of energy."""
        settings = self.settings
        if settings.friction == 0.0:
            return 0.0, 0.0, settings.weight
        # Half of the friction, and little of it in slow motion, where the velocity is mostly noise.
        speed = math.sqrt(dot(velocity, velocity))
        x, y, z = scaled(0.5 * settings.friction / (speed + SLOW_MOTION), velocity)
        return x, y, z + settings.weight

    def _contact_force(self, step: float, position: Vector, velocity: Vector) -> Vector:
        """The organ's force at the place of the hand, as much of it as may be rendered."""
        settings, contact = self.settings, self.contact
        pulse = self.heartbeat.pulse
        # A damper of what is fast in a motion is passive too, and no drag to a hand that goes on.
        slow = min(1.0, 2.0 * math.pi * settings.drift * step)
        self._slow = (
            self._slow[0] + slow * (velocity[0] - self._slow[0]),
            self._slow[1] + slow * (velocity[1] - self._slow[1]),
            self._slow[2] + slow * (velocity[2] - self._slow[2]),
        )
        contact.follow(step, settings.cutoff if pulse == 0.0 else min(settings.cutoff, 0.25 / pulse))
        force, normal, scale = contact.force, contact.direction, settings.force_scale
        if force == ZERO:
            self.account.allow(0.0, step)
            self._lasting = 0.0
            return ZERO
        stiffness = min(scale * contact.stiffness, self._greatest_stiffness)
        side_stiffness = min(scale * contact.side_stiffness, self._greatest_stiffness)
        size = math.sqrt(dot(force, force))
        most = settings.lead * size + settings.least_lead
        # As the square of the force: what is light comes and goes with a tremor, and a damper that does so along one
        # axis would push on average along the others.
        damping = min(1.0, size / settings.full_contact) ** 2 * self.damping
        ahead = contact.ahead(position)
        # Bounded evenly: a damper that is cut at zero force alone would push on average.
        damper = _shortened(scaled(damping, difference(velocity, self._slow)), DAMPED * size)
        push, along = dot(force, normal), dot(ahead, normal)
        # A hand that stays ahead, as where the tool meets a stop, is not on its way: the organ feels no more of it.
        if contact.shift != self._shift:
            # Matched anew, the hand is where the tool is.
            self._shift, self._lasting = contact.shift, 0.0
        share = min(1.0, 2.0 * math.pi * LASTING * step)
        self._lasting += share * (along - self._lasting)
        spring = min(stiffness * (along - max(0.0, self._lasting)), most)
        # An organ pushes and does not pull: the lead must not turn the force round. Nor may it be much greater than the
        # force itself, as a bound on one side alone would push on average.
        pushing = max(push, 0.0)
        lead = max(-pushing, min(spring - dot(damper, normal), most, MOST_LEAD * pushing))
        aside = _across(force, normal)
        side = _across(ahead, normal)
        side_spring = _shortened(scaled(side_stiffness, side), most)
        side_lead = _shortened(difference(side_spring, _across(damper, normal)), most)
        held = (aside[0] + side_spring[0], aside[1] + side_spring[1], aside[2] + side_spring[2])
        holding = max(stiffness, scale * settings.stiffness)
        stored = 0.5 * max(0.0, push + spring) ** 2 / holding + 0.5 * dot(held, held) / max(holding, side_stiffness)
        share = self.account.allow(max(0.0, min(stored, contact.work)), step)
        self.limited += share < FULL_SHARE
        return (
            share * (force[0] + lead * normal[0] + side_lead[0]),
            share * (force[1] + lead * normal[1] + side_lead[1]),
            share * (force[2] + lead * normal[2] + side_lead[2]),
        )

    def _slewed(self, wanted: Vector, step: float) -> Vector:
        """A force on the way from the last one to one that is wanted, no faster than may be."""
        change = difference(wanted, self._sent)
        size = math.sqrt(dot(change, change))
        # What fades out does so in its own time, and what would give energy from nowhere ends at once.
        ends = self.heartbeat.life < 1.0 or self.account.share < FULL_SHARE
        fades = ends and dot(wanted, wanted) < dot(self._sent, self._sent)
        most = (self.greatest_force / self.settings.ramp if fades else self.settings.slew) * step
        if size <= most:
            return wanted
        reached = (
            self._sent[0] + most / size * change[0],
            self._sent[1] + most / size * change[1],
            self._sent[2] + most / size * change[2],
        )
        return ZERO if wanted == ZERO and dot(reached, reached) < SMALLEST_FORCE**2 else reached


def _sum(first: Vector, second: Vector) -> Vector:
    return first[0] + second[0], first[1] + second[1], first[2] + second[2]


def _outside(place: float, low: float, high: float) -> float:
    """The way back from a place into an interval, 0 within it, or where it has no inside."""
    return 0.0 if low > high else min(high, max(low, place)) - place


def _each(choose: Callable[[float, float], float], first: Vector, second: Vector) -> Vector:
    return choose(first[0], second[0]), choose(first[1], second[1]), choose(first[2], second[2])


def _limited(last: Vector, wanted: Vector, most: float) -> Vector:
    """A vector on the way from one to another, no further than may be along each axis."""
    return (
        last[0] + min(most, max(-most, wanted[0] - last[0])),
        last[1] + min(most, max(-most, wanted[1] - last[1])),
        last[2] + min(most, max(-most, wanted[2] - last[2])),
    )


def _across(vector: Vector, normal: Vector) -> Vector:
    """The part of a vector that is perpendicular to a unit vector."""
    along = dot(vector, normal)
    return vector[0] - along * normal[0], vector[1] - along * normal[1], vector[2] - along * normal[2]


def _shortened(force: Vector, greatest: float) -> Vector:
    magnitude = math.sqrt(dot(force, force))
    return force if magnitude <= greatest else scaled(greatest / magnitude, force)
