"""An energy account between hand and loop, which determines the share of a force that may be rendered.

The loop may give back to the hand the energy that it has taken, plus a small allowance. Time-domain passivity control
(B. Hannaford and J.-H. Ryu, IEEE Trans. Robotics and Automation 18:1, 2002) and energy tanks (M. Franken and others,
IEEE Trans. Robotics 27:741, 2011) act on the instantaneous force, and so switch it with the sign of the last
millisecond's motion. Here the account is compared with the energy that the organ could give back: an organ that pushes
with a force f at a stiffness k stores f^2 / 2k, and no more than the tool's work on it. If the account covers less, the
organ is rendered softer by that share, on the way in and out alike: a softer spring is as passive as a stiff one and
just as smooth. In an exact exchange the share stays constant, because account and stored energy rise and fall together;
only energy made from nothing lowers it. An organ that others have pressed in, a policy or the hand before a clutch,
brings what it has stored. If an organ is held, as after a pause of the simulation in which the hand
moved on, the share recovers slowly, up to twice what the account covers of the whole. If the account is empty, the
share is zero, so nothing is given beyond the allowance, however much the organ stores.
"""

from __future__ import annotations

from spatula_env.teleop.haptics.contact import ZERO, Vector, difference, dot
from spatula_env.teleop.haptics.settings import HapticSettings

SEED = 5e-6
"""Energy that each contact may use although the account is empty, or no contact could begin [J]."""
TRUST_TIME, MOST_TRUST = 1.0, 2.0
"""Time in which the factor for energy that is not given back grows by one [s], and greatest factor [1]."""
HOLD_TIME = 1.0
"""Time constant with which the energy that an organ has stored is forgotten [s]."""
CLEAR_MOTION = 9e-5
"""Motion of the hand that is more than encoders going back and forth; a count of a Falcon's leg is 20 to 40 um, and two
legs may change at once [m]."""
SAME_PLACE = 1e-6
"""Positions nearer to each other than this are of the same counts [m]."""
FALL_TIME, RISE_TIME = 0.003, 0.3
"""Shortest times in which the share goes from 1 to 0 and from 0 to 1 [s]."""


class EnergyAccount:
    """Energy that the hand has given, minus what it got back.

    Attributes:
        balance: Energy given by the hand minus energy returned to it, since the start [J].
        content: Part of it that counts: surplus beyond what is needed is dropped, and debts are slowly forgiven [J].
        share: Share of the force that may be rendered, 0 to 1.
    """

    def __init__(self, settings: HapticSettings) -> None:
        """Start with an empty account.

        Args:
            settings: The allowances.
        """
        self._settings = settings
        self.balance = self.content = 0.0
        self.share = 1.0
        self._held = 0.0
        self._trust = 1.0
        self._last: Vector | None = None
        self._place: Vector = ZERO
        self._booked = 0.0

    def exchange(self, force: Vector, position: Vector, step: float) -> None:
        """Book the work of a force on the hand since the last call.

        A hand at rest makes an encoder go back and forth between two counts, and a force that depends on the count
        would seem to do work, up to a hundred times what it really does. So what was exchanged on a way that ended
        where it began, without ever having been clearly away from there, is taken back.

        Args:
            force: Force on the hand since the last call [N].
            position: Position of the hand now [m].
            step: Time since the last call [s].
        """
        if self._last is None:
            self._last = self._place = position
        energy = -dot(force, difference(position, self._last))
        self._last = position
        self._booked += energy
        away = difference(position, self._place)
        far = dot(away, away)
        if far > CLEAR_MOTION**2:
            self._place, self._booked = position, 0.0
        elif far < SAME_PLACE**2:
            energy -= self._booked
            self._booked = 0.0
        self.balance += energy
        self.content += energy
        if self.content < 0.0:
            self.content = min(0.0, self.content + self._settings.energy_leak * step)

    def bring(self, energy: float) -> None:
        """Book energy that an organ has stored before the hand was coupled to it, and may give to the hand [J]."""
        self.content += energy
        self._held = max(self._held, energy)

    def begin(self) -> None:
        """Drop a surplus, as a new contact begins; a debt remains."""
        self.content = min(self.content, 0.0)
        self._trust = 1.0

    def allow(self, stored: float, step: float) -> float:
        """Share of a force that may be rendered.

        Args:
            stored: Energy that the organ would give back if it were released completely [J].
            step: Time since the last call [s].

        Returns:
            `share`, 0 to 1.
        """
        settings = self._settings
        # The stored energy fluctuates with a tremor, so what an organ stored recently it may store again.
        self._held = max(stored, self._held - self._held * step / HOLD_TIME)
        # An organ that has yielded may stiffen again when released: it was given more than it seems to store.
        self.content = min(self.content, 2.0 * self._held + settings.energy_hoard)
        borne = max(0.0, self.content + settings.energy_allowance) + SEED
        if borne >= stored:
            wanted, self._trust = 1.0, max(1.0, self._trust - step / TRUST_TIME)
        else:
            # An organ is seldom released all at once: trust more and more that not all of its energy is given back.
            # Even so, there is no force when the account is empty.
            self._trust = min(MOST_TRUST, self._trust + step / TRUST_TIME)
            wanted = min(1.0, self._trust * borne / stored)
        self.share += min(step / RISE_TIME, max(-step / FALL_TIME, wanted - self.share))
        return self.share
