"""What the agent sees: the parts of the observation, and the spaces they fill."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from spatula_env.tasks.surface import farthest_points

if TYPE_CHECKING:
    from spatula_env.tasks.base import Evaluation, FloatArray, Setting, Situation, Task

Observation = NDArray[np.float32] | dict[str, NDArray[np.float32]]
"""Of one world, or of many with a first axis that counts them."""

OBS_MODES = ("state", "dict")
"""How observations can be laid out: see `ObservationBuilder`."""

LANDMARKS = 16
"""Number of the organ's nodes that are followed."""

GREATEST_FORCE = 50.0
"""Observed forces are clipped to this along each axis [N]; 1 to 6 N is usual, and a Falcon renders 9 N."""

GREATEST_CONTACT_DEPTH = 0.05
"""Observed contact depths are clipped to this [m]."""

GREATEST_DISPLACEMENT = 0.1
"""Observed displacements of landmarks are clipped to this along each axis [m]."""


@dataclass(frozen=True, eq=False)
class Part:
    """A named piece of an observation.

    Attributes:
        name: Its key in an observation of mode "dict".
        unit: Of all its numbers.
        low: (size,) float32, least values.
        high: (size,) float32, greatest values.
    """

    name: str
    unit: str
    low: NDArray[np.float32]
    high: NDArray[np.float32]

    @property
    def size(self) -> int:
        """How many numbers it holds."""
        return len(self.low)

    @property
    def space(self) -> spaces.Box:
        """The box that it fills."""
        return spaces.Box(self.low, self.high, dtype=np.float32)


class ObservationBuilder:
    """Turns situations into observations.

    In mode "state" an observation is one vector of all parts, in mode "dict" a dictionary of them. A goal
    interface has "achieved_goal" and "desired_goal" as entries of a dictionary, beside "observation" or
    beside the parts; what depends on the goal then is no part, because hindsight replay replaces goals.

    Every number is clipped to the bounds of its space.

    Attributes:
        parts: In the order of the vector.
        space: Of the observations of one world.
        landmarks: (L,) indices of the nodes whose displacement is observed.
    """

    def __init__(
        self,
        setting: Setting,
        task: Task,
        face_count: int,
        max_speed: float,
        obs_mode: str,
        *,
        goal_interface: bool,
    ) -> None:
        """Lay out the observation.

        Args:
            setting: Organ and workspace.
            task: For the goals.
            face_count: How many faces of the tool carry contact nodes.
            max_speed: Of the tool along each axis [m/s].
            obs_mode: "state" or "dict".
            goal_interface: Whether goals are entries of their own.

        Raises:
            ValueError: If `obs_mode` is not one of those.
        """
        if obs_mode not in OBS_MODES:
            raise ValueError(f"obs_mode must be one of {list(OBS_MODES)}, got {obs_mode!r}")
        self._flat = obs_mode == "state"
        self._goal_interface = goal_interface
        rest = setting.rest_nodes
        upper = np.flatnonzero(rest[:, 2] >= 0.5 * (rest[:, 2].min() + rest[:, 2].max()))
        self.landmarks: NDArray[np.int64] = upper[farthest_points(rest[upper], min(LANDMARKS, len(upper)))]
        self._rest_landmarks = rest[self.landmarks]
        self._goal_part = _part("desired_goal", "m", task.goal_low, task.goal_high)
        count = 3 * len(self.landmarks)
        parts = [
            _part("tool_position", "m", setting.workspace_low, setting.workspace_high),
            _part("tool_velocity", "m/s", np.full(3, -max_speed), np.full(3, max_speed)),
            _part("contact_force", "N", np.full(3, -GREATEST_FORCE), np.full(3, GREATEST_FORCE)),
            _part("contact_share", "1", np.zeros(face_count), np.ones(face_count)),
            _part("contact_depth", "m", np.zeros(1), np.full(1, GREATEST_CONTACT_DEPTH)),
            _part(
                "landmarks",
                "m",
                np.full(count, -GREATEST_DISPLACEMENT),
                np.full(count, GREATEST_DISPLACEMENT),
            ),
        ]
        if not goal_interface:
            reach = task.goal_high - task.goal_low
            parts += [_part("goal", "m", task.goal_low, task.goal_high), _part("error", "m", -reach, reach)]
        self.parts = tuple(parts)
        self._low = np.concatenate([part.low for part in parts]).astype(np.float64)
        self._high = np.concatenate([part.high for part in parts]).astype(np.float64)
        ends = np.cumsum([part.size for part in parts]).tolist()
        self._slices = {part.name: slice(end - part.size, end) for part, end in zip(parts, ends, strict=True)}
        self.space: spaces.Space[Any] = self._make_space()

    @property
    def slices(self) -> Mapping[str, slice]:
        """Where each part is in the vector of all parts."""
        return dict(self._slices)

    def build(self, situation: Situation, goal: FloatArray, evaluation: Evaluation) -> Observation:
        """The observations of W worlds, as Gymnasium batches them.

        Args:
            situation: Of the worlds.
            goal: (W, G).
            evaluation: Of the situation.

        Returns:
            (W, size), or a dictionary of (W, size of the part); arrays of their own.
        """
        moved = situation.nodes[:, self.landmarks] - self._rest_landmarks
        values = [
            situation.tool_position,
            situation.tool_velocity,
            situation.contact_force,
            situation.contact_share,
            situation.contact_depth[:, None],
            moved.reshape(len(goal), -1),
        ]
        if not self._goal_interface:
            values += [goal, evaluation.error]
        wide = np.concatenate(values, axis=1)
        vectors = np.minimum(np.maximum(wide, self._low), self._high).astype(np.float32)
        if self._flat and not self._goal_interface:
            return vectors
        if self._flat:
            result = {"observation": vectors}
        else:
            result = {name: vectors[:, part].copy() for name, part in self._slices.items()}
        if self._goal_interface:
            result["achieved_goal"] = evaluation.achieved.astype(np.float32)
            result["desired_goal"] = goal.astype(np.float32)
        return result

    def _make_space(self) -> spaces.Space[Any]:
        flat = spaces.Box(self._low.astype(np.float32), self._high.astype(np.float32), dtype=np.float32)
        if self._flat and not self._goal_interface:
            return flat
        named: dict[str, spaces.Space[Any]] = {"observation": flat}
        if not self._flat:
            named = {part.name: part.space for part in self.parts}
        if self._goal_interface:
            named["achieved_goal"] = self._goal_part.space
            named["desired_goal"] = self._goal_part.space
        return spaces.Dict(named)


def _part(name: str, unit: str, low: NDArray[Any], high: NDArray[Any]) -> Part:
    return Part(name, unit, low.astype(np.float32), high.astype(np.float32))


def first_of(batch: Observation) -> Observation:
    """The observation of the first of the worlds in a batch."""
    if isinstance(batch, dict):
        return {name: values[0] for name, values in batch.items()}
    return np.asarray(batch[0])
