"""Forces on the tools after each physics step, for listeners that a control step is too long for: haptic devices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from spatula_env.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class PhysicsStep:
    """What there is to feel after a physics step, in the workspace frame.

    Attributes:
        time: Since the reset [s].
        grip: (3,) where the middle of the tools is [m].
        force: (3,) of the organ on all tools, averaged over the physics step [N].
    """

    time: float
    grip: FloatArray
    force: FloatArray


PhysicsListener: TypeAlias = Callable[[PhysicsStep], None]
