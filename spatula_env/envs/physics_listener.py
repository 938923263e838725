"""Forces on the tools after each physics step, for listeners such as haptic devices that need this rate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from spatula_env.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class PhysicsStep:
    """Measurements after a physics step, in the workspace frame.

    Attributes:
        time: Time since the reset [s].
        grip: (3,) position of the grip, the middle of the tools [m].
        force: (3,) of the organ on all tools, averaged over the physics step [N].
    """

    time: float
    grip: FloatArray
    force: FloatArray


PhysicsListener: TypeAlias = Callable[[PhysicsStep], None]
