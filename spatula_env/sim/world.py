"""What an engine must offer to be stepped by `Simulation`."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class SoftWorld(Protocol):
    """Soft bodies that fall, stretch and swing, on their own: contact with tools and ground is not its business.

    The bodies' nodes are counted through, body after body, V in all. Positions are in scene units [u].
    """

    @property
    def inverse_masses(self) -> FloatArray:
        """(V,) of the nodes [1/kg]; zero for a node that is held fixed."""

    def step(self, positions: FloatArray, velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Advance by one time step, from where the last step or `set_state` ended or close to that.

        Args:
            positions: (V, 3) of the nodes at the start of the step [u].
            velocities: (V, 3) [u/s].

        Returns:
            Positions (V, 3) [u] and velocities (V, 3) [u/s] at the end of the step; not to be written to.

        Raises:
            FloatingPointError: If they are not finite.
        """

    def set_state(self, positions: FloatArray, velocities: FloatArray) -> None:
        """Replace the state of all nodes; what follows depends on nothing that was before."""

    def close(self) -> None:
        """Free what the engine holds. Closing twice is allowed."""
