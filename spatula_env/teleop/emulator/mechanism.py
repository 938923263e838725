"""What is between motors and hand in a real device: weight, friction, and links that bend.

Encoders and motors are at one end of the links, the hand at the other. Frame and units: those of `hand`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from spatula_env.teleop.emulator.hand import Energies, Hand
from spatula_env.teleop.emulator.legs import Point

SUBSTEP = 1.25e-4
"""Of the motion of bending links [s]; a hundredth of the period of a mode of 80 Hz."""
REVERSAL = 2e-3
"""Speed at which Coulomb friction is three quarters of what it is in motion [m/s]."""


@dataclass(frozen=True)
class Mechanism:
    """What a mechanism does besides what it is told. The defaults are made up, of the size that users report.

    Attributes:
        weight: Of grip and links, as it is felt at the grip; pulls down [N].
        coulomb: Friction that does not depend on speed [N].
        viscous: Friction that does [N s/m].
        mode: Frequency at which the links swing between motors and a hand that stands still [Hz]; 0: they are rigid.
        damping_ratio: Of that mode [1].
        mass: Of what moves on the motors' side [kg].
        strength: Of the motors: what they do over what they are told to [1].
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
    """A hand at the end of a mechanism, as motors and encoders have it: a `Hand`.

    Attributes:
        position: Of the motors' end, which the encoders see [m].
        velocity: Of it [m/s].
        energies: The motors' work on the mechanism; the rest is the hand's own account.
        hand: At the other end.
    """

    def __init__(self, hand: Hand, mechanism: Mechanism) -> None:
        """Put a hand to a mechanism.

        Args:
            hand: Who holds the grip.
            mechanism: What is between.
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
        motor_force = (strength * motor_force[0], strength * motor_force[1], strength * motor_force[2])
        count = max(1, math.ceil(step / SUBSTEP))
        short = step / count
        for index in range(count):
            before = self.position
            self._advance(time + index * short, short, motor_force)
            self.energies.motors += sum(
                force * (now - then) for force, now, then in zip(motor_force, self.position, before, strict=True)
            )
        inner = self.hand.energies
        self.energies.arm, self.energies.dissipated, self.energies.stops = inner.arm, inner.dissipated, inner.stops

    def _advance(self, time: float, step: float, motor_force: Point) -> None:
        mechanism = self.mechanism
        speed = math.sqrt(sum(each * each for each in self.velocity))
        # Along the motion, and less where it turns round, so that it has a value at rest.
        resistance = mechanism.viscous + mechanism.coulomb / math.sqrt(speed * speed + REVERSAL * REVERSAL)
        if mechanism.mode == 0.0:
            x, y, z = (
                force - resistance * each - mechanism.weight * down
                for force, each, down in zip(motor_force, self.velocity, (0.0, 1.0, 0.0), strict=True)
            )
            self.hand.advance(time, step, (x, y, z))
            self.position, self.velocity = self.hand.position, self.hand.velocity
            return
        links = [
            self._stiffness * (here - there) + self._damping * (quick - other)
            for here, there, quick, other in zip(
                self.position, self.hand.position, self.velocity, self.hand.velocity, strict=True
            )
        ]
        # Friction is implicit: it stops a motion and does not turn it round.
        share = 1.0 / (1.0 + resistance * step / mechanism.mass)
        vx, vy, vz = (
            share * (each + step / mechanism.mass * (force - link - mechanism.weight * down))
            for each, force, link, down in zip(self.velocity, motor_force, links, (0.0, 1.0, 0.0), strict=True)
        )
        self.velocity = (vx, vy, vz)
        x, y, z = self.position
        self.position = (x + step * vx, y + step * vy, z + step * vz)
        self.hand.advance(time, step, (links[0], links[1], links[2]))
