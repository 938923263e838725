"""Moving tissue: organs rise and sink with the breath and with the pulse."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray, IntArray

BREATHING_FREQUENCY = 0.25
"""Breaths per second, 15 a minute, within the 12 to 20 of an adult at rest [Hz]."""

PULSE_FREQUENCY = 1.2
"""Heartbeats per second, 72 a minute [Hz]."""

PARTS = (("breathing", BREATHING_FREQUENCY), ("pulse", PULSE_FREQUENCY))
"""The randomised quantities that are amplitudes of the motion, and its frequencies [Hz]; their phases are drawn too."""


def phase_name(part: str) -> str:
    """Name of the randomised quantity that is the phase of a part of the motion."""
    return f"{part}_phase"


class Sway:
    """Height of the bed of each of W worlds, on which organ and ground are, above its mean.

    The bed moves up and down as a whole: an organ that breathes under a tool is the same as a tool that moves over a
    resting organ, apart from the inertia of the organ, whose acceleration is below 0.1 m/s2 for the greatest amplitudes
    allowed. So the physics stays in the frame of the bed. Actions, and the observed places of tools and of the organ,
    are in the frame of the robot, which stands still.
    """

    def __init__(self, drawn: Mapping[str, FloatArray], *, moving: bool) -> None:
        """Use the quantities drawn for the worlds.

        Args:
            drawn: (W,) amplitudes [m] and phases [rad], by name; read at every call.
            moving: Whether any bed ever moves.
        """
        self._drawn, self.moving = drawn, moving

    def heights(self, times: FloatArray, worlds: IntArray | None = None) -> FloatArray:
        """Heights (n,) of the beds of some worlds (n,), or of all, at times (n,) of the episodes [s], in [m]."""
        chosen = slice(None) if worlds is None else worlds
        heights = np.zeros(len(times))
        for name, frequency in PARTS:
            angle = 2.0 * math.pi * frequency * times + self._drawn[phase_name(name)][chosen]
            heights += self._drawn[name][chosen] * np.sin(angle)
        return heights

    def velocities(self, times: FloatArray, period: float) -> FloatArray:
        """Mean vertical velocities (W,) of all beds during the control steps that begin at times (W,) [m/s]."""
        return np.asarray((self.heights(times + period) - self.heights(times)) / period)
