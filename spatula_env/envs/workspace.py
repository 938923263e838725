"""The workspace: a cube above the organ, its frame, and the setting of a scene in this frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import FloatArray
from spatula_env.geometry.checks import check_positive
from spatula_env.tasks.situation import Setting, ToolShape

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.scenes import Scene

FALCON_WORKSPACE = 0.1016
"""Edge of the cube in which the Novint Falcon's grip moves, 4 inches [m]."""


@dataclass(frozen=True)
class Workspace:
    """A cube within which the grip is kept, and the frame whose origin is the cube's middle.

    The axes are those of the scene: x to the right, y away from the operator, z up. A Falcon's own axes are x
    to the right, y up, z towards the operator, so x = x_F, y = -z_F and z = y_F.

    Attributes:
        center: (3,) the cube's middle in the scene [u].
        length: Metres in a scene unit of length.
        size: Edge of the cube [m].
    """

    center: tuple[float, float, float]
    length: float
    size: float = FALCON_WORKSPACE

    def __post_init__(self) -> None:
        """Check the values."""
        check_positive(self.length, "length")
        check_positive(self.size, "size")

    @property
    def low(self) -> FloatArray:
        """(3,) lower corner [m]."""
        return np.full(3, -0.5 * self.size)

    @property
    def high(self) -> FloatArray:
        """(3,) upper corner [m]."""
        return np.full(3, 0.5 * self.size)

    def from_scene(self, points: ArrayLike) -> FloatArray:
        """Convert points (..., 3) of the scene [u] to the workspace frame [m]."""
        return (np.asarray(points, dtype=np.float64) - self.center) * self.length

    def to_scene(self, points: ArrayLike) -> FloatArray:
        """Convert points (..., 3) of the workspace frame [m] to the scene [u]."""
        return np.asarray(points, dtype=np.float64) / self.length + self.center


def place_workspace(scene: Scene, rest_nodes: FloatArray, height: float) -> Workspace:
    """Place the workspace above the organ's axis, with its middle at a height above the organ's top [m]."""
    x, y, _ = scene.organs[0].position
    top = float(rest_nodes[:, 2].max())
    return Workspace((x, y, top + height / scene.scale.length), scene.scale.length)


def setting_of(
    scene: Scene,
    workspace: Workspace,
    rest_nodes: FloatArray | None = None,
    triangles: NDArray[np.int32] | None = None,
    period: float = 0.05,
) -> Setting:
    """Make the setting of a scene, for its task.

    Args:
        scene: Scene with one organ.
        workspace: Workspace of its tools; see `place_workspace`.
        rest_nodes: (V, 3) nodes of the organ [u]; by default those of the scene, before it has come to rest.
        triangles: (T, 3) triangles of the organ; by default its own.
        period: Length of a control step [s].
    """
    length = scene.scale.length
    placed = scene.organs[0]
    rest = np.array(placed.vertices) if rest_nodes is None else rest_nodes
    grip = np.mean([tool.position for tool in scene.tools], axis=0)
    ground = float(rest[:, 2].min()) if scene.ground is None else scene.ground.height
    tools = tuple(
        ToolShape(
            vertices=np.array(tool.tool.vertices) * length,
            orientation=np.array(tool.orientation),
            offset=(np.array(tool.position) - grip) * length,
            nodes=np.array(tool.tool.nodes) * length,
            normals=np.array(tool.tool.normals),
            face=np.array(tool.tool.face),
            triangles=np.array(tool.tool.triangles),
        )
        for tool in scene.tools
    )
    return Setting(
        rest_nodes=workspace.from_scene(rest),
        triangles=np.array(placed.organ.triangles if triangles is None else triangles),
        ground_height=float(workspace.from_scene((0.0, 0.0, ground))[2]),
        tools=tools,
        workspace_low=workspace.low,
        workspace_high=workspace.high,
        period=period,
        organ=placed.organ,
        organ_position=workspace.from_scene(placed.position),
        length=length,
    )
