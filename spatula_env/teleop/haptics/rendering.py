"""From what the tool feels to what the hand feels, once a millisecond. No device and no clock: it can be tested alone.

The simulation tells force and place of the tool a few hundred times a second, and the tool follows the hand by up to a
control period. A force that is just held is then late by as much, and a late spring gives back more energy than it
took. Three things keep the hand safe:

*Virtual coupling*: force and place of the tool are filtered, and a spring and a damper between hand and tool add what
the hand is ahead of the tool, along the force (J. E. Colgate, M. C. Stanley and J. M. Brown, "Issues in the haptic
display of tool use", IROS 1995; local models of contact: Y. Adachi, T. Kumano and K. Ogino, "Intermediate
representation for stiff virtual objects", VRAIS 1995). In the millisecond loop the hand thus meets a spring, and only
its anchor comes late.

*Energy tank*: the loop counts what the hand gives, and gives back no more (the passivity observer of B. Hannaford and
J.-H. Ryu, IEEE Trans. Robotics and Automation 18:1, 2002; the tank of M. Franken and others, IEEE Trans. Robotics
27:741, 2011). Gains alone would not do: the delay is a control period, and a gain that is passive with it could hardly
be felt.

*Watchdog*: a force fades when the simulation's heartbeat stays away.
"""

from __future__ import annotations

import math

from spatula_env.teleop.haptics.contact import ZERO, Contact, Vector, difference, dot, scaled
from spatula_env.teleop.haptics.settings import PERIOD, HapticSettings

LONGEST_STEP = 0.01
"""A filter does not take more time than this for one step; the loop was then held up [s]."""
SMALL_FORCE = 1e-9
"""Below this a force has no direction [N]."""


class EnergyTank:
    """Keeps account of the energy between hand and loop.

    Attributes:
        content: What may still be given to the hand [J].
        balance: What the hand has given less what it got, since the beginning [J].
    """

    def __init__(self, settings: HapticSettings) -> None:
        """A tank as at the beginning of a contact.

        Args:
            settings: Its sizes.
        """
        self._settings = settings
        self.content = settings.tank_start
        self.balance = 0.0

    def exchange(self, energy: float) -> None:
        """Take energy from the hand, or give some if it is negative [J]."""
        self.balance += energy
        counted = energy if energy > 0.0 else energy * (1.0 + self._settings.tank_margin)
        self.content = min(self.content + counted, self._settings.tank_size)

    def begin(self) -> None:
        """Forget what was left over, as a new contact begins; a debt stays."""
        self.content = min(self.content, self._settings.tank_start)

    def share(self) -> float:
        """What share, 0 to 1, of a force that gives energy to the hand may be rendered."""
        return min(1.0, max(0.0, self.content / self._settings.tank_soft))


class ForceRenderer:
    """Makes the force on the hand, step by step.

    Attributes:
        tank: The energy account.
        stalls: How often a force was let go because the simulation did not go on.
        limited: In how many steps the tank held a force back.
        stiffness: Of the coupling as it is felt, within the device's limit [N/m].
        damping: Likewise [N s/m].
        greatest_force: Likewise [N].
    """

    def __init__(
        self,
        settings: HapticSettings,
        greatest_force: float = math.inf,
        greatest_stiffness: float = math.inf,
        greatest_damping: float = math.inf,
    ) -> None:
        """Start without any force.

        Args:
            settings: The gains.
            greatest_force: The device's limit [N].
            greatest_stiffness: The device's limit [N/m].
            greatest_damping: The device's limit [N s/m].
        """
        self.settings = settings
        self.tank = EnergyTank(settings)
        self.stalls = self.limited = 0
        self.greatest_force = min(settings.greatest_force, greatest_force)
        self.stiffness = min(settings.force_scale * settings.stiffness, greatest_stiffness)
        self.damping = min(settings.damping, greatest_damping)
        self._time: float | None = None
        self._hand: Vector = ZERO
        self._sent: Vector = ZERO
        self._acting: Vector = ZERO
        self._force: Vector = ZERO
        self._anchor: Vector | None = None
        self._last_force_time = -math.inf
        self._is_stalled = False

    def step(self, now: float, position: Vector, velocity: Vector, contact: Contact | None) -> Vector:
        """The force for the coming millisecond.

        Args:
            now: The time by the device's clock [s].
            position: Of the hand [m].
            velocity: Of the hand [m/s].
            contact: The last that is known of the simulation; None if there is nothing yet.

        Returns:
            What the grip is to do to the hand [N].
        """
        moved = ZERO if self._time is None else difference(position, self._hand)
        if self._time is not None:
            # Of the places themselves, as a filtered velocity is late. A force goes out with the packet of the next
            # step, which brings the place too: what has acted since the last place is the force of the step before it.
            self.tank.exchange(-dot(self._acting, moved))
        self._acting = self._sent
        step = PERIOD if self._time is None else min(max(now - self._time, 0.0), LONGEST_STEP)
        self._time, self._hand = now, position
        force = self._coupled(step, position, velocity, contact)
        force = scaled(self._alive(now, contact, force), force)
        force = _shortened(force, self.greatest_force)
        if now - self._last_force_time > self.settings.rest_time:
            self.tank.begin()
        if force != ZERO:
            self._last_force_time = now
            # The filtered velocity turns round late, the last millisecond's way is rough: if either says that the hand
            # goes where the force pushes, the tank has a say.
            if dot(force, velocity) > 0.0 or dot(force, moved) > 0.0:
                share = self.tank.share()
                self.limited += share < 1.0
                force = scaled(share, force)
        self._sent = force
        return force

    def _coupled(self, step: float, position: Vector, velocity: Vector, contact: Contact | None) -> Vector:
        """The filtered force of the simulation, and spring and damper of the coupling."""
        settings = self.settings
        told = ZERO if contact is None else scaled(settings.force_scale, contact.force)
        share = 1.0 - math.exp(-2.0 * math.pi * settings.cutoff * step)
        self._force = _towards(self._force, told, share)
        place = None if contact is None else contact.position
        if place is None:
            self._anchor = None
        else:
            self._anchor = place if self._anchor is None else _towards(self._anchor, place, share)
        magnitude = math.sqrt(dot(self._force, self._force))
        if magnitude < SMALL_FORCE:
            self._force = ZERO
            return ZERO
        direction = scaled(1.0 / magnitude, self._force)
        engaged = min(1.0, magnitude / settings.full_contact)
        ahead = 0.0 if self._anchor is None else dot(difference(self._anchor, position), direction)
        pushed = magnitude + engaged * (self.stiffness * ahead - self.damping * dot(velocity, direction))
        # An organ pushes and does not pull: neither spring nor damper may turn the force round.
        return scaled(max(0.0, pushed), direction)

    def _alive(self, now: float, contact: Contact | None, force: Vector) -> float:
        """1 while the simulation's heart beats, 0 when it does not, and in between fading."""
        if contact is None:
            return 0.0
        silent = (now - contact.time) / self.settings.stall_time
        if silent < 1.0:
            self._is_stalled = False
            return min(1.0, 2.0 * (1.0 - silent))
        if not self._is_stalled and force != ZERO:
            self._is_stalled = True
            self.stalls += 1
        # The hand must not be pushed by what was, when it goes on.
        self._force = ZERO
        return 0.0


def _towards(value: Vector, target: Vector, share: float) -> Vector:
    return (
        value[0] + share * (target[0] - value[0]),
        value[1] + share * (target[1] - value[1]),
        value[2] + share * (target[2] - value[2]),
    )


def _shortened(force: Vector, greatest: float) -> Vector:
    magnitude = math.sqrt(dot(force, force))
    return force if magnitude <= greatest else scaled(greatest / magnitude, force)
