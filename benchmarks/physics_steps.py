"""Makes worlds take their control steps one physics step at a time, so that each step can be inspected."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from spatula_env.sim.worlds import Loads


def look_after_every_step(worlds: Any, look: Callable[[Loads], None]) -> None:
    """Replace the `advance` of some worlds by one that makes physics steps one by one.

    Its results are as before, except for the mean pressures, of which a single step reports only the greatest.

    Args:
        worlds: The worlds; changed in place.
        look: Called after each physics step with its loads.
    """
    advance = worlds.advance

    # The further arguments, callbacks that steer these worlds or listen to them, are always None here.
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
    """Combine the loads of physics steps into those of a control step.

    Args:
        parts: Loads of the physics steps, at least one. A world that has diverged in one of them is zero in all later
            ones, and in the result.
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
"""Fields that are averaged over a control step."""

GREATEST = ("peak_forces", "residuals", "peak_pressures")
"""Fields whose greatest value is taken. Overpressures are summed; all other fields are those of the last step."""
