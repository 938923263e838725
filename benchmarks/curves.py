"""Curves of force against depth, and how far they are apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray


COMPARED_FROM = 0.2
"""Curves are compared from this depth on [u]: at smaller depths, vertices of the organ come into contact one by one."""


@dataclass(frozen=True)
class Curve:
    """Force against depth of one slow press.

    Attributes:
        depths: (k,) depth of the tool's lower face below the top of the organ at rest [u].
        forces: (k,) mean upward force on the tool [kg u/s2].
        ripple: (k,) standard deviation of the force over the time it was averaged [kg u/s2].
    """

    depths: FloatArray
    forces: FloatArray
    ripple: FloatArray

    def difference(self, other: Curve) -> tuple[float, float]:
        """Greatest difference of another curve at the same depths, relative to this one's force, and its depth [u]."""
        chosen = self.depths >= COMPARED_FROM - 1e-9
        differences = np.abs(other.forces[chosen] / self.forces[chosen] - 1.0)
        return float(differences.max()), float(self.depths[chosen][differences.argmax()])

    @property
    def fall(self) -> float:
        """Greatest drop of the force from one depth to the next, relative to the greatest force."""
        return float(np.maximum(-np.diff(self.forces, prepend=0.0), 0.0).max() / self.forces.max())

    def as_dict(self) -> dict[str, list[float]]:
        """For JSON."""
        return {key: value.tolist() for key, value in vars(self).items()}
