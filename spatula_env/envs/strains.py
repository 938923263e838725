"""Strain of material organs within an episode, as reported in `info` beside contact pressures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from spatula_env.envs.workspace_frames import Frames
    from spatula_env.sim.worlds import Worlds

NOW = ("peak_strain", "high_strain", "peak_stress", "high_stress", "strained_share", "strain_dose")
"""Entries of a step; see `spatula_env.SpatulaEnv`."""

EPISODE = ("episode_peak_strain", "episode_strain_dose")
"""Entries of an episode."""


class StrainCount:
    """Strains, stresses and their dose in W worlds of one organ; empty for engines that do not compute them."""

    def __init__(self, physics: Worlds) -> None:
        """Start with zeros.

        Args:
            physics: The worlds.
        """
        self._physics = physics
        self.is_told: bool = physics.engine.abilities.strains
        names = (*NOW, *EPISODE) if self.is_told else ()
        self._values: dict[str, FloatArray] = {name: np.zeros(physics.count) for name in names}

    def begin(self, worlds: IntArray, frames: Frames) -> None:
        """Reset some worlds (n,), whose organs have their final placement already."""
        for values in self._values.values():
            values[worlds] = 0.0
        self.count(worlds, frames, 0.0)

    def count(self, worlds: IntArray, frames: Frames, period: float) -> None:
        """Update some worlds (n,) at the end of a control step.

        Args:
            worlds: (n,) worlds to update.
            frames: Frames of all worlds.
            period: Length of the step [s].
        """
        if not self.is_told or not len(worlds):
            return
        found, values = self._physics.strains(worlds), self._values
        for name, each, unit in (
            ("peak_strain", found.peak_strains, 1.0),
            ("high_strain", found.high_strains, 1.0),
            ("peak_stress", found.peak_stresses, frames.pressure[worlds]),
            ("high_stress", found.high_stresses, frames.pressure[worlds]),
            ("strained_share", found.strained_shares, 1.0),
        ):
            values[name][worlds] = each[:, 0] * unit
        values["strain_dose"][worlds] = values["strained_share"][worlds] * period
        values["episode_strain_dose"][worlds] += values["strain_dose"][worlds]
        values["episode_peak_strain"][worlds] = np.maximum(values["episode_peak_strain"], values["peak_strain"])[worlds]

    def damaged(self, worlds: IntArray, limit: float | None) -> BoolArray:
        """(n,) whether the episodes in some worlds have met a strain beyond a limit."""
        if limit is None:
            return np.zeros(len(worlds), dtype=np.bool_)
        return np.asarray(self._values["episode_peak_strain"][worlds] > limit)

    def info(self, worlds: IntArray) -> dict[str, FloatArray]:
        """Entries of info on some worlds (n,)."""
        return {name: values[worlds] for name, values in self._values.items()}

    save = info

    def restore(self, counted: Mapping[str, NDArray[Any]], worlds: IntArray) -> None:
        """Restore in some worlds (n,) what `save` returned."""
        for name, values in self._values.items():
            values[worlds] = counted[name]
