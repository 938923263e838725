"""Mechanical effects between motors and hand in a real device: weight, friction and elastic links.

Encoders and motors are at one end of the links, the hand at the other. Frame and units are those of `hand`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from spatula_env.teleop.emulator.hand import Energies, Hand
from spatula_env.teleop.emulator.legs import Point

SUBSTEP = 1.25e-4
"""Greatest time step for elastic links [s]; a hundredth of the period of a mode of 80 Hz."""
REVERSAL = 2e-3
"""Speed at which Coulomb friction has risen to about 0.7 of its full value [m/s]."""


@dataclass(frozen=True)
class Mechanism:
    """Non-ideal properties of a mechanism. The defaults are made up, of the magnitude that users report.

    Attributes:
        weight: Weight of grip and links as felt at the grip; pulls down [N].
        coulomb: Coulomb friction, independent of speed [N].
        viscous: Viscous friction [N s/m].
        mode: Frequency at which the links swing between the motors and a hand at rest [Hz]; 0 for rigid links.
        damping_ratio: Damping ratio of that mode [1].
        mass: Moving mass on the motors' side [kg].
        strength: Ratio of the motors' actual force to the commanded force [1].
    """

    weight: float = 0.9
    coulomb: float = 0.15
    viscous: float = 1.0
    mode: float = 60.0
    damping_ratio: float = 0.1
    mass: float = 0.06
    strength: float = 1.0

    def __post_init__(self) -> None:
        """Check the values."""
        for name in ("weight", "coulomb", "viscous", "mode", "damping_ratio", "strength"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be zero or more and finite, got {getattr(self, name)!r}")
        if not 0.0 < self.mass < math.inf:
            raise ValueError(f"mass must be positive and finite, got {self.mass!r}")


class HandOnMechanism:
    """A `Hand` at the far end of a mechanism, as motors and encoders see it.

    Attributes:
        position: Position of the motors' end, which the encoders measure [m].
        velocity: Velocity of that end [m/s].
        energies: The motors' work on the mechanism; the other terms are those of the hand.
        hand: The hand at the other end.
    """

    def __init__(self, hand: Hand, mechanism: Mechanism) -> None:
        """Attach a hand to a mechanism.

        Args:
            hand: The hand that holds the grip.
            mechanism: Properties of the mechanism between motors and hand.
        """
        self.hand = hand
        self.mechanism = mechanism
        self.position: Point = hand.position
        self.velocity: Point = hand.velocity
        self.energies = Energies()
        turning = 2.0 * math.pi * mechanism.mode
        self._stiffness = mechanism.mass * turning**2
        self._damping = 2.0 * mechanism.damping_ratio * mechanism.mass * turning

    def advance(self, time: float, step: float, motor_force: Point) -> None:
        """See `Hand`."""
        strength = self.mechanism.strength
        push_x, push_y, push_z = motor_force = (
            strength * motor_force[0],
            strength * motor_force[1],
            strength * motor_force[2],
        )
        count = max(1, math.ceil(step / SUBSTEP))
        short = step / count
        x, y, z = self.position
        for index in range(count):
            self._advance(time + index * short, short, motor_force)
        # The motor force is constant over the step, so its work is force times displacement.
        last = self.position
        self.energies.motors += push_x * (last[0] - x) + push_y * (last[1] - y) + push_z * (last[2] - z)
        inner = self.hand.energies
        self.energies.arm, self.energies.dissipated, self.energies.stops = inner.arm, inner.dissipated, inner.stops

    def _advance(self, time: float, step: float, motor_force: Point) -> None:
        mechanism, hand = self.mechanism, self.hand
        push_x, push_y, push_z = motor_force
        u, v, w = self.velocity
        # Friction acts along the motion; Coulomb friction is smoothed near reversal so that it is defined at rest.
        resistance = mechanism.viscous + mechanism.coulomb / math.sqrt(u * u + v * v + w * w + REVERSAL * REVERSAL)
        if mechanism.mode == 0.0:
            force = (push_x - resistance * u, push_y - resistance * v - mechanism.weight, push_z - resistance * w)
            hand.advance(time, step, force)
            self.position, self.velocity = hand.position, hand.velocity
            return
        stiffness, damping = self._stiffness, self._damping
        x, y, z = self.position
        there_x, there_y, there_z = hand.position
        other_u, other_v, other_w = hand.velocity
        # Force of the links on the hand.
        link_x = stiffness * (x - there_x) + damping * (u - other_u)
        link_y = stiffness * (y - there_y) + damping * (v - other_v)
        link_z = stiffness * (z - there_z) + damping * (w - other_w)
        # Friction is integrated implicitly, so that it can stop a motion but not reverse it.
        gain = step / mechanism.mass
        share = 1.0 / (1.0 + resistance * gain)
        u = share * (u + gain * (push_x - link_x))
        v = share * (v + gain * (push_y - link_y - mechanism.weight))
        w = share * (w + gain * (push_z - link_z))
        self.velocity = (u, v, w)
        self.position = (x + step * u, y + step * v, z + step * w)
        hand.advance(time, step, (link_x, link_y, link_z))
