"""Safety measures: cost of fast loading and needless pressure, dose of lasting pressure, and work done on organs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import BoolArray, FloatArray, IntArray
from spatula_env.pressure_limits import VIOLATION_PRESSURE
from spatula_env.tasks.situation import Situation

if TYPE_CHECKING:
    from spatula_env.envs.control import Motion
    from spatula_env.envs.workspace_frames import Frames
    from spatula_env.sim.worlds import Loads


class Safety:
    """Accumulates the load on the organs of W worlds within an episode; none of it enters a reward."""

    _STEP = ("cost", "dose", "work")
    _TOTALS = ("cost", "dose", "work", "violation_time", "peak_force", "peak_pressure")

    def __init__(self, count: int, tools: int, loading_limit: float) -> None:
        """Start with zeros.

        Args:
            count: Number of worlds, W.
            tools: Number of tools, N.
            loading_limit: Rate at which the force on a tool may grow without causing a cost [N/s].
        """
        self._loading_limit = loading_limit
        self._forces: FloatArray = np.zeros((count, tools))
        self._now = {name: np.zeros(count) for name in self._STEP}
        self._violation: BoolArray = np.zeros(count, dtype=np.bool_)
        self._episode = {name: np.zeros(count) for name in self._TOTALS}

    def begin(self, worlds: IntArray) -> None:
        """Reset the sums of some worlds (n,)."""
        for values in (*self._now.values(), *self._episode.values(), self._forces):
            values[worlds] = 0.0
        self._violation[worlds] = False

    def count(
        self,
        situation: Situation,
        motion: Motion,
        loads: Loads,
        frames: Frames,
        period: float,
        pressure_limits: FloatArray,
        worlds: IntArray,
    ) -> None:
        """Add a control step of some worlds (n,).

        Args:
            situation: Situation at the end of the step, of all W worlds.
            motion: Motion of the tools.
            loads: Loads on the tools.
            frames: Frames of the worlds.
            period: Length of the step [s].
            pressure_limits: (W,) pressures that the goals require [Pa].
            worlds: (n,) worlds to update.
        """
        forces = np.sqrt((situation.contact_forces**2).sum(axis=2))
        loading = (forces - self._forces).max(axis=1) / period
        # Excess over the limits, relative to them.
        beyond = np.maximum(loading / self._loading_limit - 1.0, 0.0)
        beyond += np.maximum(situation.peak_pressure / pressure_limits - 1.0, 0.0)
        self._forces[worlds] = forces[worlds]
        self._now["cost"][worlds] = beyond[worlds] * period
        torques = frames.vectors_from_scene(loads.torques, frames.torque)
        power = -(situation.contact_forces * motion.linear + torques * motion.angular).sum(axis=(1, 2))
        self._now["dose"][worlds] = (loads.overpressures * frames.pressure)[worlds]
        self._now["work"][worlds] = power[worlds] * period
        self._violation[worlds] = (situation.peak_pressure > VIOLATION_PRESSURE)[worlds]
        episode = self._episode
        for name in self._STEP:
            episode[name][worlds] += self._now[name][worlds]
        episode["violation_time"][worlds] += period * self._violation[worlds]
        for name, values in (("peak_force", situation.peak_force), ("peak_pressure", situation.peak_pressure)):
            episode[name][worlds] = np.maximum(episode[name], values)[worlds]

    def save(self, worlds: IntArray) -> dict[str, NDArray[Any]]:
        """Copy the sums of some worlds (n,)."""
        return {name: values[worlds] for name, values in self._all().items()}

    def restore(self, counted: Mapping[str, NDArray[Any]], worlds: IntArray) -> None:
        """Restore in some worlds (n,) what `save` returned."""
        for name, values in self._all().items():
            values[worlds] = counted[name]

    def _all(self) -> dict[str, NDArray[Any]]:
        episode = {f"episode_{name}": values for name, values in self._episode.items()}
        return {**self._now, **episode, "violation": self._violation, "forces": self._forces}

    def damaged(self, worlds: IntArray, dose: float | None, pressure: float | None) -> BoolArray:
        """(n,) whether the episodes in some worlds exceed a dose [Pa s] or have met a pressure beyond a limit [Pa]."""
        damaged = np.zeros(len(worlds), dtype=np.bool_)
        for name, limit in (("dose", dose), ("peak_pressure", pressure)):
            if limit is not None:
                damaged |= self._episode[name][worlds] > limit
        return damaged

    def dose_share(self, limit: float, worlds: IntArray) -> FloatArray:
        """(n,) doses of the episodes in some worlds, relative to a limit [Pa s]; 1 for any dose if that is zero."""
        dose = self._episode["dose"][worlds]
        return np.asarray(dose / limit if limit > 0.0 else (dose > 0.0).astype(np.float64))

    def within(self, budget: float, worlds: IntArray) -> BoolArray:
        """(n,) whether the episodes' costs are within a budget [s] in some worlds."""
        return np.asarray(self._episode["cost"][worlds] <= budget)

    def info(self, worlds: IntArray) -> dict[str, NDArray[Any]]:
        """Entries of info on some worlds (n,)."""
        return {
            **{name: values[worlds] for name, values in self._now.items()},
            "violation": self._violation[worlds],
            **{f"episode_{name}": values[worlds] for name, values in self._episode.items()},
        }
