"""Force rendering: from what the tool feels to what the hand feels, once a millisecond.

Needs no device and no clock, so it can be tested alone. The simulation reports the tool's force and position a few
hundred times a second. The rendered force along the contact force (and, with a stiffness of its own, across it) is::

    F = share * life * (f + lead),   lead = k (x_tool - x_hand) - b v_hand,   -f <= lead <= 0.2 f + a little

- f is the simulation's force and k the organ's own stiffness (`local_contact`): together the force at the hand.
- The lead is bounded. A hand that moves faster than the tool can is ahead of what is known, and a spring that keeps
  growing there would render a force that the organ never produces.
- `share` keeps the exchange of energy in balance (`passivity`), `life` ends forces that the simulation does not renew
  (`heartbeat`), and all changes are rate-limited, so that no force ends with a kick.
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
"""Longest time step of the filters; longer steps mean that the loop was held up [s]."""
SMALLEST_FORCE = 1e-4
"""A force that is ending is set to zero below this [N]."""
LASTING = 0.5
"""A lead that changes more slowly than this is lasting rather than transient [Hz]."""
MOST_LEAD = 2.0
"""Bound of the lead, as a multiple of the organ's force."""
DAMPED = 0.3
"""Bound of the damping force, as a share of the organ's force."""
SLOW_MOTION = 0.02
"""Speed at which half of the friction compensation acts [m/s]."""
FULL_SHARE = 0.999
"""A smaller share counts as a force held back."""


class ForceRenderer:
    """Computes the force on the hand, step by step.

    Attributes:
        account: Energy account.
        heartbeat: Heartbeat of the simulation.
        contact: Local model of the organ.
        limited: Number of steps in which passivity control reduced a force.
        support: Part of the last force that is not the organ's: weight and friction compensation, and walls [N].
        damping: Damping on the hand, within the device's limit [N s/m].
        greatest_force: Greatest force on the hand, within the device's limit [N].
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
        """Start without a force.

        Args:
            settings: The gains.
            greatest_force: The device's limit [N].
            greatest_stiffness: The device's limit [N/m].
            greatest_damping: The device's limit [N s/m].
            workspace_low: Lowest corner of the device's workspace [m]; None if it is unknown.
            workspace_high: Highest corner of the device's workspace [m]; None likewise.
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
            now: The current time by the device's clock [s].
            position: Position of the hand [m].
            velocity: Velocity of the hand [m/s].
            contact: Last report of the simulation; None if there is none, or if there is nothing to render.

        Returns:
            Force of the grip on the hand [N].
        """
        step = PERIOD if self._time is None else min(max(now - self._time, 0.0), LONGEST_STEP)
        # Use position differences, as a filtered velocity lags. A force is sent with the packet of the next step, which
        # also returns the position: so the force that has acted since the last position is that of the step before.
        self.account.exchange(self._acting, position, step)
        self._acting = self._sent
        self._time, self._hand = now, position
        life = self.heartbeat.listen(now, step, None if contact is None else contact.time)
        if contact is not None:
            self.account.bring(self.contact.hear(contact))
        elif life == 0.0:
            self.contact.forget()
        wanted = scaled(life, self._contact_force(step, position, velocity))
        self._sent = self._slewed(_shortened(wanted, self.greatest_force), step)
        # A force that has faded because the simulation stopped does not end a contact.
        if self.contact.is_touching:
            self._last_force_time = now
        elif now - self._last_force_time > self.settings.rest_time:
            self.account.begin()
            self.contact.begin()
        self._walls = _limited(self._walls, self._pushed_back(position, contact), self.settings.slew * step)
        self.support = scaled(life, _sum(self._bearing(velocity), self._walls))
        return _shortened(_sum(self._sent, self.support), self.greatest_force)

    def _pushed_back(self, position: Vector, contact: Contact | None) -> Vector:
        """Force of soft walls where the device's workspace ends and where the tool cannot follow."""
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
        """Force that bears the grip's weight and part of its friction; not part of the energy account."""
        settings = self.settings
        if settings.friction == 0.0:
            return 0.0, 0.0, settings.weight
        # Compensate half of the friction, and less in slow motion, where the velocity is mostly noise.
        speed = math.sqrt(dot(velocity, velocity))
        x, y, z = scaled(0.5 * settings.friction / (speed + SLOW_MOTION), velocity)
        return x, y, z + settings.weight

    def _contact_force(self, step: float, position: Vector, velocity: Vector) -> Vector:
        """The organ's force at the hand's position, reduced to the share that may be rendered."""
        settings, contact = self.settings, self.contact
        pulse = self.heartbeat.pulse
        # Damp only the fast part of a motion: this is passive too, and does not drag on a hand that moves steadily.
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
        # Proportional to the squared force: a light contact comes and goes with a tremor, and a damper that follows it
        # along one axis would exert a mean force along the others.
        damping = min(1.0, size / settings.full_contact) ** 2 * self.damping
        ahead = contact.ahead(position)
        # Bounded symmetrically: a damper that is only cut at zero force would exert a mean force.
        damper = _shortened(scaled(damping, difference(velocity, self._slow)), DAMPED * size)
        push, along = dot(force, normal), dot(ahead, normal)
        # A hand that stays ahead, as where the tool meets a stop, is not in transit: the organ does not feel that part.
        if contact.shift != self._shift:
            # After a new match the hand is where the tool is.
            self._shift, self._lasting = contact.shift, 0.0
        share = min(1.0, 2.0 * math.pi * LASTING * step)
        self._lasting += share * (along - self._lasting)
        spring = min(stiffness * (along - max(0.0, self._lasting)), most)
        # An organ pushes and does not pull: the lead must not reverse the force. Nor may it be much greater than the
        # force itself, as a one-sided bound would exert a mean force.
        pushing = max(push, 0.0)
        lead = max(-pushing, min(spring - dot(damper, normal), most, MOST_LEAD * pushing))
        aside = _across(force, normal)
        side = _across(ahead, normal)
        side_spring = _shortened(scaled(side_stiffness, side), most)
        side_lead = _shortened(difference(side_spring, _across(damper, normal)), most)
        held = (aside[0] + side_spring[0], aside[1] + side_spring[1], aside[2] + side_spring[2])
        holding = max(stiffness, scale * settings.stiffness)
        stored = 0.5 * max(0.0, push + spring) ** 2 / holding + 0.5 * dot(held, held) / max(holding, side_stiffness)
        # An organ that swings against the tool has more to give than the tool has stored in it.
        share = self.account.allow(min(stored, abs(contact.work)), step)
        self.limited += share < FULL_SHARE
        return (
            share * (force[0] + lead * normal[0] + side_lead[0]),
            share * (force[1] + lead * normal[1] + side_lead[1]),
            share * (force[2] + lead * normal[2] + side_lead[2]),
        )

    def _slewed(self, wanted: Vector, step: float) -> Vector:
        """Move from the last force towards the wanted one, no faster than the limit."""
        change = difference(wanted, self._sent)
        size = math.sqrt(dot(change, change))
        # Forces that fade out use the fade time, and forces that would create energy end at once.
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
    """Displacement from a position back into an interval; 0 inside it, or if the interval is empty."""
    return 0.0 if low > high else min(high, max(low, place)) - place


def _each(choose: Callable[[float, float], float], first: Vector, second: Vector) -> Vector:
    return choose(first[0], second[0]), choose(first[1], second[1]), choose(first[2], second[2])


def _limited(last: Vector, wanted: Vector, most: float) -> Vector:
    """Move from one vector towards another, by a bounded amount along each axis."""
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
