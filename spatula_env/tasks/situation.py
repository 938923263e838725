"""Input of tasks: the setting, how episodes begin, and the situation at the end of a control step.

Everything is in SI units and in the workspace frame: origin in the middle of the space in which the grip may move, x to
the right, y away from the operator, z up. The *grip* is the point that the agent moves: the position of a single tool,
or the mean of the positions of several tools.

W counts worlds, N tools, V an organ's nodes, F the faces of all tools, G the numbers of a goal, A those of an action.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spatula_env.arrays import FloatArray, IntArray
from spatula_env.geometry.rotations import conjugate, multiply, turn
from spatula_env.tasks.surface import surface_heights


@dataclass(frozen=True, eq=False)
class ToolShape:
    """Shape of a tool.

    Attributes:
        vertices: (K, 3) corners, in the tool's frame [m].
        orientation: (4,) at the start, quaternion xyzw.
        offset: (3,) its position relative to the grip at the start [m].
        nodes: (n, 3) contact nodes, in the tool's frame [m].
        normals: (n, 3) outward normals of their faces.
        face: (n,) index of each node's face among the faces of this tool that carry nodes.
        triangles: (M, 3) of its surface, counter-clockwise from outside.
    """

    vertices: FloatArray
    orientation: FloatArray
    offset: FloatArray
    nodes: FloatArray
    normals: FloatArray
    face: NDArray[np.int32]
    triangles: NDArray[np.int32]

    @property
    def corners_about_grip(self) -> FloatArray:
        """(K, 3) corners at the start, relative to the grip [m]."""
        return turn(self.orientation, self.vertices) + self.offset

    def face_towards(self, direction: ArrayLike) -> int:
        """Index of the face with nodes that is turned towards a direction (3,) of the workspace frame, at the start."""
        normals = turn(self.orientation, self.normals) @ np.asarray(direction, dtype=np.float64)
        return int(self.face[np.argmax(normals)])


@dataclass(frozen=True, eq=False)
class Setting:
    """What stays constant within an episode, and across all episodes unless it is randomised.

    Attributes:
        rest_nodes: (V, 3) the organ at rest [m].
        triangles: (T, 3) int32, counter-clockwise from outside.
        ground_height: z of the ground, or of the lowest node at rest if there is no ground [m].
        tools: The N tools.
        workspace_low: (3,) lower corner of the space within which the grip is kept [m].
        workspace_high: (3,) upper corner [m].
        period: Length of a control step [s].
        organ: The organ of the scene, a `geometry.Organ` or one of its subclasses, which name the nodes of their parts;
            its lengths are in scene units. None if it is not needed.
        organ_position: (3,) position of the origin of the organ's frame [m].
        length: Metres in a scene unit of length.
    """

    rest_nodes: FloatArray
    triangles: NDArray[np.int32]
    ground_height: float
    tools: tuple[ToolShape, ...]
    workspace_low: FloatArray
    workspace_high: FloatArray
    period: float = 0.05
    organ: Any = None
    organ_position: FloatArray = field(default_factory=lambda: np.zeros(3))
    length: float = 0.02

    @property
    def tool_low(self) -> FloatArray:
        """(3,) lower corner of the bounding box of all tools at the start, relative to the grip [m]."""
        return np.asarray(np.concatenate([tool.corners_about_grip for tool in self.tools]).min(axis=0))

    @property
    def tool_high(self) -> FloatArray:
        """(3,) upper corner [m]."""
        return np.asarray(np.concatenate([tool.corners_about_grip for tool in self.tools]).max(axis=0))

    @property
    def face_count(self) -> int:
        """F."""
        return sum(int(tool.face.max()) + 1 for tool in self.tools)

    def room_around(self, place: ArrayLike) -> float:
        """Distance that the grip can move from a place (2,) along any horizontal axis within the workspace [m]."""
        middle = np.asarray(place, dtype=np.float64)
        return float(np.minimum(self.workspace_high[:2] - middle, middle - self.workspace_low[:2]).min())

    def surface_heights(self, nodes: FloatArray, places: FloatArray) -> FloatArray:
        """Height of the organ's surface.

        Args:
            nodes: (W, V, 3) nodes of the organ, or (1, V, 3) if they are the same for all places [m].
            places: (W, 2) x and y [m].

        Returns:
            (W,) heights [m]; the ground's height where there is no organ.
        """
        nodes, places = np.ascontiguousarray(nodes), np.ascontiguousarray(places)
        heights: FloatArray = surface_heights(nodes, np.array(self.triangles), places, self.ground_height)
        return heights


@dataclass(frozen=True, eq=False)
class Situation:
    """State of W worlds at the end of a control step.

    Attributes:
        tool_position: (W, 3) position of the grip [m].
        tool_velocity: (W, 3) velocity of the grip during the control step [m/s].
        tool_orientation: (W, 4) orientation of the first tool, quaternion xyzw.
        tool_rotation_rate: (W, 3) rate of rotation of the tools about the grip during the control step [rad/s].
        tool_positions: (W, N, 3) positions of the tools [m].
        tool_orientations: (W, N, 4) orientations of the tools.
        tool_scale: (W,) factor on all lengths of the tools.
        control: (W, K) further coordinates that the control changes, such as the opening of jaws [m].
        control_rate: (W, K) rates of change of these [m/s].
        contact_forces: (W, N, 3) forces of the organ on each tool, averaged over the control step [N].
        contact_force: (W, 3) their sum [N].
        contact_torque: (W, 3) torque about the grip, averaged [N m].
        peak_force: (W,) greatest magnitude of the force on a tool in a physics step of the control step [N].
        peak_pressure: (W,) greatest contact pressure on a node of a tool in a physics step [Pa].
        mean_pressure: (W,) greatest mean pressure on a face of a tool: its normal force divided by its area [Pa].
        contact_share: (W, F) share of the contact nodes of each of the tools' faces that are in contact.
        contact_depth: (W,) depth of the deepest contact, before it is resolved [m].
        nodes: (W, V, 3) nodes of the organ [m].
        rest_nodes: (W, V, 3) nodes of the organ at rest; (1, V, 3) if they are the same in all worlds [m].
        action: (W, A) the agent's action, in [-1, 1].
        elapsed: (W,) time since the episode began [s].
    """

    tool_position: FloatArray
    tool_velocity: FloatArray
    tool_orientation: FloatArray
    tool_rotation_rate: FloatArray
    tool_positions: FloatArray
    tool_orientations: FloatArray
    tool_scale: FloatArray
    control: FloatArray
    control_rate: FloatArray
    contact_forces: FloatArray
    contact_force: FloatArray
    contact_torque: FloatArray
    peak_force: FloatArray
    peak_pressure: FloatArray
    mean_pressure: FloatArray
    contact_share: FloatArray
    contact_depth: FloatArray
    nodes: FloatArray
    rest_nodes: FloatArray
    action: FloatArray
    elapsed: FloatArray

    def lowest_corner(self, shape: ToolShape) -> FloatArray:
        """(W,) heights of the lowest corner of the first tool, which has a given shape, however it is turned [m]."""
        return np.asarray(self.corners(shape)[:, :, 2].min(axis=1))

    def corners(self, shape: ToolShape) -> FloatArray:
        """(W, K, 3) corners of the first tool, which has a given shape [m]."""
        turned = turn(self.tool_orientations[:, 0, None], self.tool_scale[:, None, None] * shape.vertices)
        return np.asarray(self.tool_positions[:, :1] + turned)

    @staticmethod
    def at_rest(
        setting: Setting,
        tool_position: ArrayLike,
        tool_orientation: ArrayLike | None = None,
        *,
        action_size: int = 3,
        **changes: Any,
    ) -> Situation:
        """Make the situation of tools at rest without contact, over organs at rest. No two attributes share an array.

        Args:
            setting: Organ and tools.
            tool_position: (W, 3) position of the grip [m].
            tool_orientation: (W, 4) orientation of the first tool; by default as at the start.
            action_size: Size A of an action.
            **changes: Values of other attributes, each with W rows.

        Returns:
            The situation.
        """
        grip = np.array(tool_position, dtype=np.float64)
        count, tools = len(grip), setting.tools
        if tool_orientation is None:
            tool_orientation = np.tile(tools[0].orientation, (count, 1))
        first = np.array(tool_orientation, dtype=np.float64)
        turned = multiply(first, conjugate(tools[0].orientation))
        situation = Situation(
            tool_position=grip,
            tool_velocity=np.zeros((count, 3)),
            tool_orientation=first,
            tool_rotation_rate=np.zeros((count, 3)),
            tool_positions=np.stack([grip + turn(turned, tool.offset) for tool in tools], axis=1),
            tool_orientations=np.stack([multiply(turned, tool.orientation) for tool in tools], axis=1),
            tool_scale=np.ones(count),
            control=np.zeros((count, 0)),
            control_rate=np.zeros((count, 0)),
            contact_forces=np.zeros((count, len(tools), 3)),
            contact_force=np.zeros((count, 3)),
            contact_torque=np.zeros((count, 3)),
            peak_force=np.zeros(count),
            peak_pressure=np.zeros(count),
            mean_pressure=np.zeros(count),
            contact_share=np.zeros((count, setting.face_count)),
            contact_depth=np.zeros(count),
            nodes=np.repeat(setting.rest_nodes[None], count, axis=0),
            rest_nodes=setting.rest_nodes[None],
            action=np.zeros((count, action_size)),
            elapsed=np.zeros(count),
        )
        return replace(situation, **changes)

    @property
    def force(self) -> FloatArray:
        """(W,) magnitude of the contact force [N]."""
        return np.asarray(np.sqrt((self.contact_force**2).sum(axis=1)))

    @property
    def effort(self) -> FloatArray:
        """(W,) squared length of the action."""
        return np.asarray((self.action**2).sum(axis=1))

    def rows(self, worlds: IntArray) -> Situation:
        """Select the situation of some worlds (n,)."""
        count = len(self.tool_position)
        picked = {
            name: values if name == "rest_nodes" and len(values) < count else values[worlds]
            for name, values in vars(self).items()
        }
        return Situation(**picked)


@dataclass(frozen=True, eq=False)
class Start:
    """How episodes begin.

    Attributes:
        goal: (W, G) goals.
        tool_position: (W, 3) position of the grip [m].
        tool_orientation: (W, 4) of the first tool, with which the others turn; None for that of the scene.
        control: (W, K) further coordinates of the control, such as the opening of jaws [m]; None for those of the
            scene.
        drawn: (W, D) further values drawn at random, for `Task.begin_memory`; None for none.
    """

    goal: FloatArray
    tool_position: FloatArray
    tool_orientation: FloatArray | None = None
    control: FloatArray | None = None
    drawn: FloatArray | None = None

    @staticmethod
    def joined(starts: Sequence[Start]) -> Start:
        """Concatenate the starts of several groups of episodes."""

        def join(name: str) -> Any:
            parts = [getattr(start, name) for start in starts]
            return None if parts[0] is None else np.concatenate(parts)

        return Start(**{each.name: join(each.name) for each in fields(Start)})
