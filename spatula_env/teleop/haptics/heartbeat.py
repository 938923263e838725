"""Whether the simulation goes on, and how fast."""

from __future__ import annotations

import math

from spatula_env.teleop.haptics.settings import HapticSettings

PATIENCE = 2.5
"""So many of its usual pulses a simulation may be silent."""
ATTENTION = 8.0
"""So many pulses are remembered."""
RECOVERED = 0.8
"""A simulation that was too slow is felt again when its pulse is shorter than this share of the longest allowed."""


class Heartbeat:
    """Fades forces out while the simulation is silent or too slow, and in again afterwards.

    Attributes:
        pulse: Usual time from one heartbeat to the next [s]; 0 before there are two.
        life: 0 to 1: what is left of a force.
        stalls: How often a force was let go.
        is_slow: Whether the simulation is too slow to be felt.
    """

    def __init__(self, settings: HapticSettings) -> None:
        """No heart beats yet.

        Args:
            settings: The times.
        """
        self._settings = settings
        self.pulse = self.life = 0.0
        self.stalls = 0
        self.is_slow = False
        self._last = -math.inf
        self._was_alive = False

    def listen(self, now: float, step: float, beat: float | None) -> float:
        """Go on.

        Args:
            now: The time [s].
            step: Since the last time [s].
            beat: When the heart beat last [s]; None: nothing is to be felt.

        Returns:
            `life`.
        """
        settings = self._settings
        if beat is not None and beat != self._last:
            pause = beat - self._last
            # A stall is no pulse.
            if pause < 0.0 or pause > 4.0 * settings.longest_stall:
                self.pulse = self.pulse if math.isfinite(self._last) else 0.0
            else:
                self.pulse += (pause - self.pulse) / (ATTENTION if self.pulse else 1.0)
            self._last = beat
        bound = (RECOVERED if self.is_slow else 1.0) * settings.longest_stall
        self.is_slow = self.pulse > bound
        patience = min(max(settings.stall_time, PATIENCE * self.pulse), settings.longest_stall)
        alive = beat is not None and now - beat < patience and not self.is_slow
        if beat is not None and self._was_alive and not alive:
            self.stalls += 1
        self._was_alive = alive
        change = step / settings.resume if alive else -step / settings.ramp
        self.life = min(1.0, max(0.0, self.life + change))
        return self.life
