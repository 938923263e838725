"""The gains of the haptic loop."""

from __future__ import annotations

import math
from dataclasses import dataclass

PERIOD = 1e-3
"""Of the haptic loop [s]."""


@dataclass(frozen=True)
class HapticSettings:
    """The gains of the haptic loop. The device's own greatest force, stiffness and damping limit them further.

    Attributes:
        force_scale: Force on the hand over force on the tool.
        greatest_force: Greatest magnitude of a force on the hand [N].
        stiffness: Of the virtual coupling: by how much the force on the tool is taken to grow where the hand is ahead
            of the tool, against the force [N/m]. About the organ's own is best; then the hand feels at once what the
            tool will feel when it has caught up. Scaled as forces are.
        damping: Of the coupling: resists motion of the hand along the force, in contact only [N s/m]. Not scaled.
        cutoff: Of the low-pass filter that makes a curve of the simulation's steps [Hz].
        full_contact: Contact force from which on the coupling acts in full; below it acts in proportion, so that
            nothing drags where nothing is touched [N].
        stall_time: A force is zero so long after the last heartbeat of the simulation; it fades from half of that
            time on. With the time that a packet takes it has ended on the device after 20 ms [s].
        tank_start: Energy that the tank holds at first, and so the most that the hand can ever be given beyond what it
            gave; when a contact begins it holds no more than this [J].
        tank_size: The most energy that the tank holds; what more is taken counts as dissipated [J].
        tank_soft: Forces that give energy to the hand are weakened below this content, and zero when the tank is
            empty [J].
        tank_margin: By how much more than it seems energy counts that is given to the hand: motors and packets are not
            exact [1].
        rest_time: A contact is over when there has been no force for so long [s].
    """

    force_scale: float = 1.0
    greatest_force: float = 8.0
    stiffness: float = 100.0
    damping: float = 2.0
    cutoff: float = 30.0
    full_contact: float = 0.2
    stall_time: float = 0.017
    tank_start: float = 0.0
    tank_size: float = 0.2
    tank_soft: float = 1e-3
    tank_margin: float = 0.05
    rest_time: float = 0.1

    def __post_init__(self) -> None:
        """Check the values."""
        for name in ("force_scale", "greatest_force", "stiffness", "damping", "tank_start", "tank_margin"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be zero or more and finite, got {getattr(self, name)!r}")
        for name in ("full_contact", "tank_size", "tank_soft", "rest_time"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be positive and finite, got {getattr(self, name)!r}")
        nyquist = 0.5 / PERIOD
        if not 0.0 < self.cutoff < nyquist:
            raise ValueError(f"cutoff must be positive and below {nyquist:g} Hz, got {self.cutoff!r}")
        if not 5.0 * PERIOD <= self.stall_time < math.inf:
            raise ValueError(f"stall_time must be at least {5.0 * PERIOD:g} s and finite, got {self.stall_time!r}")
