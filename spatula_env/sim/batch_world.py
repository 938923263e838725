"""The batch engine's soft body in a single world, for `Simulation`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spatula_env.sim.batch_body import BatchBody
from spatula_env.sim.soft_body import join, soft_body

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray

    from spatula_env.scenes import Scene

    FloatArray = NDArray[np.float64]


class BatchWorld:
    """A scene's organs in one world of a `BatchBody`; see `world.SoftWorld`."""

    def __init__(self, scene: Scene, dtype: DTypeLike = np.float32) -> None:
        """Load the organs.

        Args:
            scene: What is in it.
            dtype: float32 or float64.
        """
        body = join([soft_body(placed) for placed in scene.organs])
        self._body = BatchBody(body, dt=scene.dt, gravity=scene.gravity, dtype=dtype)
        self._inverse_masses = body.inverse_masses

    @property
    def inverse_masses(self) -> FloatArray:
        """(V,) of the nodes [1/kg]; zero for a node that is held fixed."""
        return self._inverse_masses

    def step(self, positions: FloatArray, velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `world.SoftWorld.step`."""
        self._body.set_state(positions, velocities)
        self._body.step()
        if not self._body.finite[0]:
            raise FloatingPointError("the nodes' velocities are not finite")
        return self._body.positions[0], self._body.velocities[0]

    def set_state(self, positions: FloatArray, velocities: FloatArray) -> None:
        """See `world.SoftWorld.set_state`; nothing is kept from step to step anyway."""

    def close(self) -> None:
        """See `world.SoftWorld.close`; there is nothing to free."""
