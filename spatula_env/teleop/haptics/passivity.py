"""An account of energy between hand and loop, and what share of a force it bears.

The loop may give the hand what it has taken, and a small allowance. Time-domain passivity control (B. Hannaford and
J.-H. Ryu, IEEE Trans. Robotics and Automation 18:1, 2002) and energy tanks (M. Franken and others, IEEE Trans. Robotics
27:741, 2011) act on the force of the moment, and so switch it with the sign of the last millisecond's motion. Here the
account is compared with what the organ could give back: an organ that pushes with a force f and a stiffness k holds
f^2 / 2k, and no more than the tool's work on it. If the account bears less, the organ is felt softer by that share, on
the way in and on the way out alike: a softer spring is as passive as a stiff one and no less smooth. In an exact
exchange the share stays what it is, because account and store go up and down together; only what is made from nothing
lowers it. Where an organ is held on, as after a pause of the simulation in which the hand went on, the share comes
back slowly, up to twice what the account bears of all of it. When the account is empty the share is zero, so nothing
is given beyond the allowance, whatever the organ holds.
"""

from __future__ import annotations

from spatula_env.teleop.haptics.settings import HapticSettings

SEED = 5e-6
"""So much energy each contact may use that has an empty account, or none could begin [J]."""
TRUST_TIME, MOST_TRUST = 1.0, 2.0
"""How slowly it is believed that less will be given back than an organ holds [s], and at most how much less [1]."""
HOLD_TIME = 1.0
"""In which it is forgotten what an organ has held [s]."""
FALL_TIME, RISE_TIME = 0.003, 0.3
"""In which a share goes from 1 to 0 and from 0 to 1, at the fastest [s]."""


class EnergyAccount:
    """What the hand has given, less what it got.

    Attributes:
        balance: What the hand has given less what it got, since the beginning [J].
        content: What of it counts: what was given beyond need is not hoarded, and debts are forgotten slowly [J].
        share: 0 to 1, of the force that may be rendered.
    """

    def __init__(self, settings: HapticSettings) -> None:
        """Nothing has been exchanged.

        Args:
            settings: The allowances.
        """
        self._settings = settings
        self.balance = self.content = 0.0
        self.share = 1.0
        self._held = 0.0
        self._trust = 1.0

    def exchange(self, energy: float, step: float) -> None:
        """Take energy from the hand, or give some if it is negative.

        Args:
            energy: How much [J].
            step: In what time [s].
        """
        self.balance += energy
        self.content += energy
        if self.content < 0.0:
            self.content = min(0.0, self.content + self._settings.energy_leak * step)

    def begin(self) -> None:
        """Forget what was left over, as a new contact begins; a debt stays."""
        self.content = min(self.content, 0.0)
        self._trust = 1.0

    def allow(self, stored: float, step: float) -> float:
        """The share of a force that may be rendered.

        Args:
            stored: What the organ could give back if all of it were [J].
            step: Since the last time [s].

        Returns:
            `share`, 0 to 1.
        """
        settings = self._settings
        # What an organ holds goes up and down with a tremor, and what it held lately it may hold again.
        self._held = max(stored, self._held - self._held * step / HOLD_TIME)
        # An organ that has yielded may harden again as it is let go: it was given more than it seems to hold.
        self.content = min(self.content, 2.0 * self._held + settings.energy_hoard)
        borne = max(0.0, self.content + settings.energy_allowance) + SEED
        if borne >= stored:
            wanted, self._trust = 1.0, max(1.0, self._trust - step / TRUST_TIME)
        else:
            # An organ is seldom let go of all at once. That the whole of it could be given back is believed less and
            # less; when the account is empty there is no force all the same.
            self._trust = min(MOST_TRUST, self._trust + step / TRUST_TIME)
            wanted = min(1.0, self._trust * borne / stored)
        self.share += min(step / RISE_TIME, max(-step / FALL_TIME, wanted - self.share))
        return self.share
