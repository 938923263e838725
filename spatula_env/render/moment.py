"""A moment of a scene, from which a picture is made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from spatula_env.arrays import FloatArray

if TYPE_CHECKING:
    from spatula_env.tasks.marks import Mark


@dataclass(frozen=True, eq=False)
class Moment:
    """What is known of a scene with V nodes and N tools at one moment, in its frame.

    Attributes:
        nodes: (V, 3) of the organs [u].
        tool_positions: (N, 3), or (3,) of the only tool [u].
        tool_orientations: (N, 4), or (4,) of the only tool: quaternions xyzw.
        forces: (N, 3), or (3,), on the tools [N]; each is drawn as an arrow that its tool is pushed by.
        pressures: (n,) for each tool, on its contact nodes [Pa]; organs are coloured where they touch it, as
            `palette.PRESSURE` says.
        marks: What shows the goal [u].
        tool_scale: Factor on the lengths of the scene's tools.
        ground_height: Where the ground is, if not where the scene has it [u].
    """

    nodes: ArrayLike
    tool_positions: ArrayLike
    tool_orientations: ArrayLike
    forces: ArrayLike | None = None
    pressures: Sequence[FloatArray] | None = None
    marks: Sequence[Mark] = ()
    tool_scale: float = 1.0
    ground_height: float | None = None
