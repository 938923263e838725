"""The gains of the haptic loop."""

from __future__ import annotations

import math
from dataclasses import dataclass

PERIOD = 1e-3
"""Period of the haptic loop [s]."""


@dataclass(frozen=True)
class HapticSettings:
    """The gains of the haptic loop. The device's own greatest force, stiffness and damping limit them further.

    Attributes:
        force_scale: Ratio of force on the hand to force on the tool.
        greatest_force: Greatest magnitude of a force on the hand [N].
        stiffness: Assumed rate at which an organ's force grows where the hand is ahead of the tool, until its own
            stiffness is known [N/m]. Scaled like forces.
        damping: Damping of the hand's motion above the frequency `drift`, in contact only [N s/m]. Not scaled.
        drift: Motion below this frequency is not damped [Hz].
        cutoff: Cutoff of the low-pass filter that smooths the simulation's steps [Hz].
        full_contact: Contact force from which on the damper acts fully; below, it acts in proportion to the squared
            force, so that there is no drag without contact, and a light touch is not damped [N].
        lead: Share by which a force may exceed the simulation's where the hand is ahead of the tool. A tool has a
            greatest speed and lags behind a fast hand: what it would feel there is unknown.
        least_lead: Amount by which it may exceed it in any case [N]. Not scaled.
        slew: Greatest rate of change of a force, unless it fades [N/s].
        ramp: Time in which a force fades out when it is released, or when the simulation stops [s].
        resume: Time in which it comes back [s].
        stall_time: A force begins to fade this long after the last heartbeat of the simulation, or after two and a half
            of its usual pulses if that is longer, up to `longest_stall` [s].
        longest_stall: See `stall_time`. A simulation whose pulse is longer than this is not rendered at all [s].
        energy_allowance: Greatest energy that the hand can be given beyond what it gave [J].
        energy_leak: Rate at which energy debts are forgiven [W].
        energy_hoard: Energy that may be given back beyond what the organ could store [J].
        weight: Weight of the device's grip, which the motors bear while there is a heartbeat [N]. Best a little less
            than the true weight, so that a grip that is let go sinks.
        friction: Coulomb friction of the device, half of which is compensated in motion [N]. Never set it higher than
            the true friction, or the grip would keep going by itself.
        wall_stiffness: Stiffness of soft walls where the workspace ends and where the tool meets a stop; 0 for none
            [N/m].
        wall_force: Greatest force of a wall along an axis [N].
        rest_time: A contact is over when there has been no force for this long [s].
    """

    force_scale: float = 1.0
    greatest_force: float = 8.0
    stiffness: float = 60.0
    damping: float = 2.0
    drift: float = 3.0
    cutoff: float = 60.0
    full_contact: float = 0.2
    lead: float = 0.2
    least_lead: float = 0.05
    slew: float = 90.0
    ramp: float = 0.02
    resume: float = 0.05
    stall_time: float = 0.0125
    longest_stall: float = 0.025
    energy_allowance: float = 2.5e-4
    energy_leak: float = 1e-5
    energy_hoard: float = 1e-3
    weight: float = 0.0
    friction: float = 0.0
    wall_stiffness: float = 200.0
    wall_force: float = 2.0
    rest_time: float = 0.1

    def __post_init__(self) -> None:
        """Check the values."""
        for name in (
            "force_scale",
            "greatest_force",
            "damping",
            "lead",
            "least_lead",
            "energy_allowance",
            "energy_leak",
            "energy_hoard",
            "weight",
            "wall_stiffness",
            "wall_force",
            "friction",
        ):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be zero or more and finite, got {getattr(self, name)!r}")
        for name in ("stiffness", "drift", "full_contact", "slew", "ramp", "resume", "rest_time"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be positive and finite, got {getattr(self, name)!r}")
        nyquist = 0.5 / PERIOD
        if not 0.0 < self.cutoff < nyquist:
            raise ValueError(f"cutoff must be positive and below {nyquist:g} Hz, got {self.cutoff!r}")
        if not 5.0 * PERIOD <= self.stall_time <= self.longest_stall < math.inf:
            raise ValueError(
                f"stall_time must be at least {5.0 * PERIOD:g} s and longest_stall, {self.longest_stall!r}, at most; "
                f"got {self.stall_time!r}"
            )
