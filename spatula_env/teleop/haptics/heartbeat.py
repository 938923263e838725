"""Watches whether the simulation is running, and how fast."""

from __future__ import annotations

import math

from spatula_env.teleop.haptics.settings import HapticSettings

PATIENCE = 2.5
"""Number of its usual pulses that a simulation may be silent."""
ATTENTION = 8.0
"""Number of pulses over which the usual pulse is averaged."""
RECOVERED = 0.8
"""A simulation that was too slow is rendered again once its pulse is below this share of the longest allowed."""


class Heartbeat:
    """Fades forces out while the simulation is silent or too slow, and back in afterwards.

    Attributes:
        pulse: Usual time from one heartbeat to the next [s]; 0 before there have been two.
        life: Factor on the force, 0 to 1.
        stalls: Number of times that a force was released.
        is_slow: Whether the simulation is too slow for its forces to be rendered.
    """

    def __init__(self, settings: HapticSettings) -> None:
        """Start without a heartbeat.

        Args:
            settings: The time limits.
        """
        self._settings = settings
        self.pulse = self.life = 0.0
        self.stalls = 0
        self.is_slow = False
        self._last = -math.inf
        self._was_alive = False

    def listen(self, now: float, step: float, beat: float | None) -> float:
        """Advance by one step.

        Args:
            now: The current time [s].
            step: Time since the last call [s].
            beat: Time of the last heartbeat [s]; None if there is nothing to render.

        Returns:
            `life`.
        """
        settings = self._settings
        if beat is not None and beat != self._last:
            pause = beat - self._last
            # The pause of a stall does not count as a pulse.
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
