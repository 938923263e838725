"""What a task is, what it is told and what it answers.

Everything is in SI units and in the workspace frame: origin in the middle of the space the tool may move in,
x to the right, y away from the operator, z up. W counts worlds, V an organ's nodes, G the numbers in a goal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

Config = TypeVar("Config")


@dataclass(frozen=True, eq=False)
class Setting:
    """What stays the same in all episodes.

    Attributes:
        rest_nodes: (V, 3) the organ at rest [m].
        triangles: (T, 3) int32, counter-clockwise from outside.
        ground_height: z of the ground, or of the lowest node at rest where there is no ground [m].
        tool_low: (3,) lower corner of the tool's bounding box relative to the tool's position [m].
        tool_high: (3,) upper corner [m].
        workspace_low: (3,) lower corner of the space that the tool's position is kept in [m].
        workspace_high: (3,) upper corner [m].
    """

    rest_nodes: FloatArray
    triangles: NDArray[np.int32]
    ground_height: float
    tool_low: FloatArray
    tool_high: FloatArray
    workspace_low: FloatArray
    workspace_high: FloatArray


@dataclass(frozen=True, eq=False)
class Situation:
    """How things stand at the end of a control step.

    Attributes:
        tool_position: (W, 3) [m].
        tool_velocity: (W, 3) during the control step [m/s].
        contact_force: (W, 3) what the organ did to the tool, averaged over the control step [N].
        peak_force: (W,) its greatest magnitude in a physics step of the control step [N].
        contact_share: (W, F) share of the contact nodes of each of the tool's faces that are in contact.
        contact_depth: (W,) depth of the deepest contact, before the organ gives way [m].
        nodes: (W, V, 3) the organ [m].
        action: (W, A) what the agent asked for, in [-1, 1].
    """

    tool_position: FloatArray
    tool_velocity: FloatArray
    contact_force: FloatArray
    peak_force: FloatArray
    contact_share: FloatArray
    contact_depth: FloatArray
    nodes: FloatArray
    action: FloatArray


@dataclass(frozen=True, eq=False)
class Start:
    """How an episode begins.

    Attributes:
        goal: (W, G).
        tool_position: (W, 3) [m].
    """

    goal: FloatArray
    tool_position: FloatArray


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What a task makes of a situation.

    Attributes:
        terms: Reward terms before weighting, each (W,); the keys never change.
        achieved: (W, G) the goal that this situation would fulfil exactly.
        error: (W, G) goal minus achieved.
        within_tolerance: (W,) bool, what is achieved is the goal, for now.
        measures: Further quantities worth reporting, each (W,); the keys never change.
    """

    terms: dict[str, FloatArray]
    achieved: FloatArray
    error: FloatArray
    within_tolerance: BoolArray
    measures: dict[str, FloatArray]


class Task(Protocol):
    """What an environment needs from a task."""

    @property
    def goal_names(self) -> tuple[str, ...]:
        """Names of the G numbers in a goal."""

    @property
    def goal_low(self) -> NDArray[np.float32]:
        """(G,) least values of what can be achieved."""

    @property
    def goal_high(self) -> NDArray[np.float32]:
        """(G,) greatest values of what can be achieved."""

    @property
    def weights(self) -> Mapping[str, float]:
        """The weight of each reward term."""

    @property
    def hold_time(self) -> float:
        """How long the goal must be held without a break for success [s]."""

    def sample(self, generator: np.random.Generator, count: int) -> Start:
        """Draw the beginnings of `count` episodes."""

    def check_goal(self, goal: FloatArray) -> None:
        """Raise ValueError if a goal (G,) cannot be asked for."""

    def evaluate(self, situation: Situation, goal: FloatArray) -> Evaluation:
        """Judge a situation by the goals (W, G)."""

    def compute_reward(self, achieved: NDArray[Any], desired: NDArray[Any]) -> NDArray[np.float32]:
        """The sparse reward of goals (..., G): 0 where the goal is achieved, -1 elsewhere."""

    def target_points(self, goal: FloatArray) -> FloatArray:
        """(K, 3) points that show a goal (G,) in a picture, to be joined by lines [m]."""


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
