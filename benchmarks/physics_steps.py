"""Worlds whose control steps are taken one physics step at a time, so that each can be looked at."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from spatula_env.sim.worlds import Loads


def look_after_every_step(worlds: Any, look: Callable[[Loads], None]) -> None:
    """Have some worlds' `advance` make its physics steps one by one.

    Everything comes out as before but for the mean pressures, of which a single step tells only the greatest.

    Args:
        worlds: They are changed.
        look: Called after each physics step with its loads.
    """
    advance = worlds.advance

    # Nobody steers these worlds, or listens to them.
    def advance_and_look(
        linear: Any, angular: Any, steps: int, pressure_limits: Any, force_limits: Any, *nobody: None
    ) -> Loads:
        parts = []
        for _ in range(steps):
            parts.append(advance(linear, angular, 1, pressure_limits, force_limits))
            look(parts[-1])
        return join_loads(parts)

    worlds.advance = advance_and_look


def join_loads(parts: list[Loads]) -> Loads:
    """The loads of a control step from those of its physics steps.

    Args:
        parts: One at least. A world that has diverged in one is zero in all that follow, and comes out as zero.
    """
    last = parts[-1]
    stacked = {name: np.array([getattr(part, name) for part in parts]) for name in (*MEANS, *GREATEST)}
    joined: dict[str, Any] = {name: stacked[name].mean(axis=0) for name in MEANS}
    joined |= {name: stacked[name].max(axis=0) for name in GREATEST}
    joined["overpressures"] = np.sum([part.overpressures for part in parts], axis=0)
    for values in joined.values():
        values[last.diverged] = 0.0
    return Loads(**{**vars(last), **joined})


MEANS = ("forces", "torques", "ground_forces", "mean_pressures", "restrained")
"""What is averaged over a control step,"""

GREATEST = ("peak_forces", "residuals", "peak_pressures")
"""and of what the greatest counts. Overpressures are added up; of the rest the last step tells."""
