"""The state of a scene at one moment, from which a picture is made; and that of many worlds at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from spatula_env.arrays import BoolArray, FloatArray

if TYPE_CHECKING:
    from spatula_env.tasks.marks import Mark


@dataclass(frozen=True, eq=False)
class Moment:
    """The visible state of a scene with V nodes and N tools at one moment, in the scene's frame.

    Attributes:
        nodes: (V, 3) of the organs [u].
        tool_positions: (N, 3), or (3,) of the only tool [u].
        tool_orientations: (N, 4), or (4,) of the only tool: quaternions xyzw.
        forces: (N, 3), or (3,), on the tools [N]; each is drawn as an arrow from its tool.
        pressures: (n,) for each tool, on its contact nodes [Pa]; organs are coloured where they touch the tool, with
            the colours of `palette.PRESSURE`.
        marks: Marks that show the goal [u].
        tool_scale: Factor on the lengths of the scene's tools.
        ground_height: Height of the ground, if it differs from the scene's [u].
    """

    nodes: ArrayLike
    tool_positions: ArrayLike
    tool_orientations: ArrayLike
    forces: ArrayLike | None = None
    pressures: Sequence[FloatArray] | None = None
    marks: Sequence[Mark] = ()
    tool_scale: float = 1.0
    ground_height: float | None = None


@dataclass(frozen=True, eq=False)
class Moments:
    """The visible state of n worlds of a scene with V nodes and N tools.

    Nodes and positions of tools may be in a frame of another origin and another unit than the scene's: such arrays need
    not be copied.

    Attributes:
        nodes: (n, V, 3) of the organs; numbers that are not finite count as zero.
        tool_positions: (n, N, 3).
        tool_orientations: (n, N, 4) quaternions xyzw.
        tool_scales: (n,) factors on the lengths of the scene's tools; None for 1.
        ground_heights: (n,) heights of the ground; None for the scene's [u].
        patches: (n, V) nodes on patches, by the patches' role; a node on several has the colour of the last.
        origin: Origin of that frame in the scene [u].
        unit: Unit of that frame [u].
    """

    nodes: FloatArray
    tool_positions: FloatArray
    tool_orientations: FloatArray
    tool_scales: FloatArray | None = None
    ground_heights: FloatArray | None = None
    patches: Mapping[str, BoolArray] = field(default_factory=dict)
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unit: float = 1.0
