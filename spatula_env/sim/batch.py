"""Many worlds of a scene with the engine "batch"."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.sim.states import WorldMemory, WorldsState
from spatula_env.sim.worlds import Worlds

if TYPE_CHECKING:
    from numpy.typing import DTypeLike

    from spatula_env.contact.flags import FirstStep
    from spatula_env.scenes import Scene
    from spatula_env.sim.engine import ContactName, Precision

__all__ = ["BatchSimulation", "BatchState", "WorldMemory"]

BatchState = WorldsState
"""Former name of `WorldsState`, kept so that existing pickles can be loaded."""


class BatchSimulation(Worlds):
    """`Worlds` with the engine "batch", whose precision is given as a NumPy dtype."""

    def __init__(
        self,
        scene: Scene,
        worlds: int,
        *,
        contact: ContactName = "flags",
        first_step: FirstStep = "inside",
        dtype: DTypeLike = np.float32,
        parallel: bool | None = None,
    ) -> None:
        """Load a scene into every world, its organs at rest; see `Worlds`.

        Args:
            scene: The organs, tools and ground.
            worlds: Number of worlds W.
            contact: "flags" or "second_step".
            first_step: What the flags method's first step looks for.
            dtype: Type in which organs are integrated, float32 or float64.
            parallel: Whether worlds are distributed over threads.

        Raises:
            ValueError: If an argument is not allowed.
        """
        precisions: dict[Any, Precision] = {np.dtype(np.float32): "single", np.dtype(np.float64): "double"}
        if np.dtype(dtype) not in precisions:
            raise ValueError(f"dtype must be float32 or float64, got {np.dtype(dtype)}")
        super().__init__(
            scene,
            worlds,
            engine="batch",
            contact=contact,
            first_step=first_step,
            precision=precisions[np.dtype(dtype)],
            parallel=parallel,
        )
