"""What a task is, what it is told and what it answers.

Everything is in SI units and in the workspace frame: origin in the middle of the space that the grip may move in,
x to the right, y away from the operator, z up. The *grip* is the point that the agent moves: the position of the tool
where there is one, the middle of the tools' positions where there are several.

W counts worlds, N tools, V an organ's nodes, F the faces of all tools, G the numbers in a goal, A those in an action.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spatula_env.geometry.rotations import conjugate, multiply, turn
from spatula_env.tasks.marks import Mark

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

Memory = dict[str, NDArray[Any]]
"""What a task remembers within episodes: arrays (W, ...) by name."""

Config = TypeVar("Config")


@dataclass(frozen=True, eq=False)
class ToolShape:
    """A tool.

    Attributes:
        vertices: (K, 3) corners, in the tool's frame [m].
        orientation: (4,) at the start, quaternion xyzw.
        offset: (3,) its position minus the grip's at the start [m].
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


@dataclass(frozen=True, eq=False)
class Setting:
    """What stays the same in an episode, and in all of them where nothing of it is drawn at random.

    Attributes:
        rest_nodes: (V, 3) the organ at rest [m].
        triangles: (T, 3) int32, counter-clockwise from outside.
        ground_height: z of the ground, or of the lowest node at rest where there is no ground [m].
        tools: The N tools.
        workspace_low: (3,) lower corner of the space that the grip is kept in [m].
        workspace_high: (3,) upper corner [m].
        period: Length of a control step [s].
        organ: The organ of the scene, a `geometry.Organ` or one of its kinds, which name the nodes of its parts; its
            lengths are in scene units. None where nobody asks for it.
        organ_position: (3,) where the origin of the organ's frame is [m].
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


@dataclass(frozen=True, eq=False)
class Situation:
    """How things stand at the end of a control step.

    Attributes:
        tool_position: (W, 3) of the grip [m].
        tool_velocity: (W, 3) of the grip during the control step [m/s].
        tool_orientation: (W, 4) of the first tool, quaternion xyzw.
        tool_rotation_rate: (W, 3) of the tools about the grip during the control step [rad/s].
        tool_positions: (W, N, 3) [m].
        tool_orientations: (W, N, 4).
        tool_scale: (W,) how large the tools are: a factor on all their lengths.
        control: (W, K) further coordinates that the control moves, such as the opening of jaws [m].
        control_rate: (W, K) of their change [m/s].
        contact_forces: (W, N, 3) what the organ did to each tool, averaged over the control step [N].
        contact_force: (W, 3) their sum [N].
        contact_torque: (W, 3) about the grip, averaged [N m].
        peak_force: (W,) greatest magnitude of the force on a tool in a physics step of the control step [N].
        peak_pressure: (W,) greatest contact pressure on a node of a tool in a physics step [Pa].
        mean_pressure: (W,) greatest of the tools' faces: mean normal force on it by its area [Pa].
        contact_share: (W, F) share of the contact nodes of each of the tools' faces that are in contact.
        contact_depth: (W,) depth of the deepest contact, before the organ gives way [m].
        nodes: (W, V, 3) the organ [m].
        rest_nodes: (W, V, 3) the organ at rest; (1, V, 3) where it is the same in all worlds [m].
        action: (W, A) what the agent asked for, in [-1, 1].
        elapsed: (W,) since the episode began [s].
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

    @staticmethod
    def at_rest(
        setting: Setting,
        tool_position: ArrayLike,
        tool_orientation: ArrayLike | None = None,
        *,
        action_size: int = 3,
        **changes: Any,
    ) -> Situation:
        """Tools that hold still and touch nothing, over organs at rest.

        Args:
            setting: Organ and tools.
            tool_position: (W, 3) of the grip [m].
            tool_orientation: (W, 4) of the first tool; by default as at the start.
            action_size: A.
            **changes: Other attributes than that, each with W rows.

        Returns:
            The situation.
        """
        grip = np.array(tool_position, dtype=np.float64)
        count, tools = len(grip), setting.tools
        if tool_orientation is None:
            tool_orientation = np.tile(tools[0].orientation, (count, 1))
        first = np.array(tool_orientation, dtype=np.float64)
        turned = multiply(first, conjugate(tools[0].orientation))
        nothing, zeros = np.zeros((count, 3)), np.zeros(count)
        situation = Situation(
            tool_position=grip,
            tool_velocity=nothing,
            tool_orientation=first,
            tool_rotation_rate=nothing,
            tool_positions=np.stack([grip + turn(turned, tool.offset) for tool in tools], axis=1),
            tool_orientations=np.stack([multiply(turned, tool.orientation) for tool in tools], axis=1),
            tool_scale=np.ones(count),
            control=np.zeros((count, 0)),
            control_rate=np.zeros((count, 0)),
            contact_forces=np.zeros((count, len(tools), 3)),
            contact_force=nothing,
            contact_torque=nothing,
            peak_force=zeros,
            peak_pressure=zeros,
            mean_pressure=zeros,
            contact_share=np.zeros((count, setting.face_count)),
            contact_depth=zeros,
            nodes=np.repeat(setting.rest_nodes[None], count, axis=0),
            rest_nodes=setting.rest_nodes[None],
            action=np.zeros((count, action_size)),
            elapsed=zeros,
        )
        return replace(situation, **changes)

    def rows(self, worlds: IntArray) -> Situation:
        """The situation of some of the worlds (n,)."""
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
        goal: (W, G).
        tool_position: (W, 3) of the grip [m].
        tool_orientation: (W, 4) of the first tool, the others turned with it; None: as the scene has it.
        control: (W, K) further coordinates of the control, such as the opening of jaws [m]; None: as the scene has
            them.
        drawn: (W, D) whatever else was drawn at random, for `Task.begin_memory`; None: nothing.
    """

    goal: FloatArray
    tool_position: FloatArray
    tool_orientation: FloatArray | None = None
    control: FloatArray | None = None
    drawn: FloatArray | None = None

    @staticmethod
    def joined(starts: Sequence[Start]) -> Start:
        """The beginnings of several lots of episodes, in a row."""

        def join(name: str) -> Any:
            parts = [getattr(start, name) for start in starts]
            return None if parts[0] is None else np.concatenate(parts)

        return Start(**{each.name: join(each.name) for each in fields(Start)})


@dataclass(frozen=True, eq=False)
class PartSpec:
    """A named piece of an observation.

    Attributes:
        name: Its key where observations are dictionaries.
        unit: Of all its numbers.
        low: (k,) least values.
        high: (k,) greatest values.
    """

    name: str
    unit: str
    low: NDArray[Any]
    high: NDArray[Any]

    @property
    def size(self) -> int:
        """How many numbers it holds."""
        return len(self.low)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What a task makes of a situation.

    Attributes:
        terms: Reward terms before weighting, each (W,); the keys never change.
        achieved: (W, G) the goal that this situation would fulfil exactly.
        error: (W, G) goal minus achieved.
        within_tolerance: (W,) bool, what is achieved is the goal, for now.
        measures: Further quantities worth reporting, each (W,); the keys never change.
        parts: The task's own pieces of the observation, each (W, k), by the names in `Task.extra_parts`.
    """

    terms: dict[str, FloatArray]
    achieved: FloatArray
    error: FloatArray
    within_tolerance: BoolArray
    measures: dict[str, FloatArray]
    parts: dict[str, FloatArray] = field(default_factory=dict)


class TaskConfig(Protocol):
    """What every task's configuration, a frozen dataclass, has."""

    @property
    def hold_time(self) -> float:
        """How long the goal must be held without a break for success [s]."""

    @property
    def weights(self) -> Any:
        """A dataclass with the weight of each reward term."""


class Task(ABC):
    """What is asked of the agent. A task is not changed by being asked: what it remembers is handed to it.

    Subclasses name their goal, and say how episodes begin, what a situation is worth and when a goal is fulfilled.

    Attributes:
        goal_names: Names of the G numbers in a goal.
        goal_units: Their units.
        extra_parts: The task's own pieces of the observation.
        setting: Where it is asked, as far as nothing of it is drawn at random.
    """

    goal_names: ClassVar[tuple[str, ...]]
    goal_units: ClassVar[tuple[str, ...]]
    extra_parts: tuple[PartSpec, ...] = ()

    def __init__(self, config: TaskConfig, setting: Setting, goal_low: ArrayLike, goal_high: ArrayLike) -> None:
        """Prepare for a setting.

        Args:
            config: What is asked.
            setting: Where.
            goal_low: (G,) least values of what can be achieved.
            goal_high: (G,) greatest values.
        """
        self.setting = setting
        self._hold_time = float(config.hold_time)
        self._weights = {name: float(value) for name, value in vars(config.weights).items()}
        self._goal_low: NDArray[np.float32] = np.array(goal_low, dtype=np.float32)
        self._goal_high: NDArray[np.float32] = np.array(goal_high, dtype=np.float32)

    @property
    def goal_low(self) -> NDArray[np.float32]:
        """(G,) least values of what can be achieved."""
        return self._goal_low.copy()

    @property
    def goal_high(self) -> NDArray[np.float32]:
        """(G,) greatest values of what can be achieved."""
        return self._goal_high.copy()

    @property
    def weights(self) -> Mapping[str, float]:
        """The weight of each reward term."""
        return self._weights

    @property
    def hold_time(self) -> float:
        """How long the goal must be held without a break for success [s]."""
        return self._hold_time

    @abstractmethod
    def sample(self, generator: np.random.Generator, count: int, setting: Setting) -> Start:
        """Draw the beginnings of `count` episodes in a setting, which may differ from the task's own."""

    @abstractmethod
    def evaluate(self, situation: Situation, goal: FloatArray, memory: Memory) -> Evaluation:
        """Judge a situation by the goals (W, G), once in each control step and once at the beginning.

        Args:
            situation: Of W worlds.
            goal: (W, G).
            memory: Of these worlds; changed in place.
        """

    @abstractmethod
    def fulfils(self, achieved: FloatArray, desired: FloatArray) -> BoolArray:
        """Whether what is achieved (..., G) is what is desired (..., G), for now: (...). From these numbers alone."""

    def check_goal(self, goal: FloatArray) -> None:
        """Raise ValueError if a goal (G,) cannot be asked for."""
        if (goal < self._goal_low).any() or (goal > self._goal_high).any():
            raise ValueError(f"goal must lie in {self._goal_low} to {self._goal_high}, got {goal}")

    def new_memory(self, count: int) -> Memory:
        """Room for what is remembered in `count` worlds within an episode; nothing by default."""
        return {}

    def begin_memory(  # noqa: B027
        self, memory: Memory, rows: IntArray, start: Start, settings: Sequence[Setting]
    ) -> None:
        """Forget the last episode in some worlds.

        Args:
            memory: Of all worlds; the rows are written.
            rows: (n,) which worlds.
            start: How their episodes begin, n of them.
            settings: Where, n of them.
        """

    def compute_reward(self, achieved: NDArray[Any], desired: NDArray[Any]) -> NDArray[np.float32]:
        """The sparse reward, from goals alone.

        Args:
            achieved: (..., G).
            desired: (..., G).

        Returns:
            (...) 0 where `achieved` fulfils `desired`, -1 elsewhere.
        """
        within = self.fulfils(as_seen(achieved), as_seen(desired))
        return np.asarray(within, dtype=np.float32) - np.float32(1.0)

    def marks(
        self, goal: FloatArray, situation: Situation | None = None, memory: Memory | None = None
    ) -> tuple[Mark, ...]:
        """What shows a goal (G,) in a picture.

        Args:
            goal: (G,).
            situation: Of the one world that is shown, W = 1; None: before anything has happened.
            memory: Of that world; None: nobody knows.
        """
        return ()


def as_seen(goal: ArrayLike) -> FloatArray:
    """Goals as an agent sees them and a replay buffer stores them: rounded to single precision."""
    return np.asarray(goal, dtype=np.float32).astype(np.float64)


def sample_disc(generator: np.random.Generator, radius: float, count: int) -> FloatArray:
    """(count, 2) points, uniform in a disc around the origin."""
    distance = radius * np.sqrt(generator.uniform(size=count))
    angle = generator.uniform(0.0, 2.0 * np.pi, size=count)
    return np.column_stack([distance * np.cos(angle), distance * np.sin(angle)])


def closeness(distance: FloatArray, scale: float) -> FloatArray:
    """From 1 at distance 0 towards 0: 1 - tanh(distance / scale), which is 0.24 at `scale`."""
    return np.asarray(1.0 - np.tanh(distance / scale))


def weighted_sum(terms: Mapping[str, FloatArray], weights: Mapping[str, float]) -> FloatArray:
    """The dense reward (W,) of reward terms (W,)."""
    return np.asarray(sum(weight * terms[name] for name, weight in weights.items()))


def config_from_mapping(kind: type[Config], values: Mapping[str, Any] | Config | None, name: str) -> Config:
    """A configuration from what may come from a file or over the wire.

    Args:
        kind: The dataclass to make.
        values: Its fields by name, or the configuration itself, or None for the defaults.
        name: What to call the argument in an error.

    Returns:
        The configuration.

    Raises:
        ValueError: If there is no such field, or `values` is something else.
    """
    if values is None:
        return kind()
    if isinstance(values, kind):
        return values
    if not isinstance(values, Mapping):
        raise ValueError(f"{name} must be a mapping or a {kind.__name__}, got {values!r}")
    allowed = sorted(kind.__dataclass_fields__)  # type: ignore[attr-defined]
    unknown = sorted(str(key) for key in values if key not in allowed)
    if unknown:
        raise ValueError(f"{name} has no {', '.join(unknown)}; allowed are {', '.join(allowed)}")
    return kind(**values)


def check_weights(weights: Any) -> None:
    """Check that the weights in a dataclass of them are finite.

    Raises:
        ValueError: If one is not.
    """
    for name, value in vars(weights).items():
        if not np.isfinite(value):
            raise ValueError(f"weights.{name} must be finite, got {value!r}")


def check_range(value: Any, name: str) -> tuple[float, float]:
    """Two finite numbers in ascending order, as a tuple of floats.

    Raises:
        ValueError: If `value` is anything else.
    """
    try:
        low, high = (float(number) for number in value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be two numbers (least, greatest), got {value!r}") from error
    if not -np.inf < low <= high < np.inf:
        raise ValueError(f"{name} must be two finite numbers in ascending order, got {value!r}")
    return low, high
