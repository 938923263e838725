"""Safety: the cost of lasting pressures, and the work done on organs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import BoolArray, IntArray
from spatula_env.tasks.situation import Situation

if TYPE_CHECKING:
    from spatula_env.envs.control import Motion
    from spatula_env.envs.workspace_frames import Frames
    from spatula_env.sim.worlds import Loads

COST_PRESSURE = 2670.0
"""Pressure from which on cost is counted, 20 mmHg [Pa]. Rats whose brains were retracted with no more for 15 minutes
were spared damage (J. Rosenorn and N. Diemer, J Neurosurg 63:608, 1985): that is a dose, and no limit for a moment."""

VIOLATION_PRESSURE = 4000.0
"""Pressure that is flagged, 30 mmHg [Pa]: with it, for as long, five brains of six had infarcts (the same source)."""


class Safety:
    """Counts what the organs of W worlds suffer in an episode; none of it enters a reward."""

    _STEP = ("cost", "work")
    _TOTALS = ("cost", "work", "violation_time", "peak_force", "peak_pressure")

    def __init__(self, count: int) -> None:
        """Nothing suffered yet.

        Args:
            count: W.
        """
        self._now = {name: np.zeros(count) for name in self._STEP}
        self._violation: BoolArray = np.zeros(count, dtype=np.bool_)
        self._episode = {name: np.zeros(count) for name in self._TOTALS}

    def begin(self, worlds: IntArray) -> None:
        """Start counting anew in some worlds (n,)."""
        for values in (*self._now.values(), *self._episode.values()):
            values[worlds] = 0.0
        self._violation[worlds] = False

    def count(
        self,
        situation: Situation,
        motion: Motion,
        loads: Loads,
        frames: Frames,
        period: float,
        worlds: IntArray,
    ) -> None:
        """Add a control step of some worlds (n,)."""
        torques = frames.vectors_from_scene(loads.torques, frames.torque)
        power = -(situation.contact_forces * motion.linear + torques * motion.angular).sum(axis=(1, 2))
        self._now["cost"][worlds] = (loads.overpressures * frames.pressure)[worlds]
        self._now["work"][worlds] = power[worlds] * period
        self._violation[worlds] = (situation.peak_pressure > VIOLATION_PRESSURE)[worlds]
        episode = self._episode
        for name in self._STEP:
            episode[name][worlds] += self._now[name][worlds]
        episode["violation_time"][worlds] += period * self._violation[worlds]
        for name, values in (("peak_force", situation.peak_force), ("peak_pressure", situation.peak_pressure)):
            episode[name][worlds] = np.maximum(episode[name], values)[worlds]

    def save(self, worlds: IntArray) -> dict[str, NDArray[Any]]:
        """What has been counted in some worlds (n,), as copies."""
        return {name: values[worlds] for name, values in self._all().items()}

    def restore(self, counted: Mapping[str, NDArray[Any]], worlds: IntArray) -> None:
        """Go back, in some worlds (n,), to what `save` returned."""
        for name, values in self._all().items():
            values[worlds] = counted[name]

    def _all(self) -> dict[str, NDArray[Any]]:
        episode = {f"episode_{name}": values for name, values in self._episode.items()}
        return {**self._now, **episode, "violation": self._violation}

    def damaged(self, limit: float) -> BoolArray:
        """(W,) whether an episode's cost exceeds a limit [Pa s]."""
        return np.asarray(self._episode["cost"] > limit)

    def info(self, worlds: IntArray, limit: float | None) -> dict[str, NDArray[Any]]:
        """What there is to tell of some worlds (n,)."""
        cost = self._episode["cost"][worlds]
        return {
            **{name: values[worlds] for name, values in self._now.items()},
            "violation": self._violation[worlds],
            "is_damaged": cost > (np.inf if limit is None else limit),
            **{f"episode_{name}": values[worlds] for name, values in self._episode.items()},
        }
