"""Observations: their parts, and their spaces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from spatula_env.envs.observed_ranges import ALL_PARTS, GROUPED, ObservedRanges, check_parts
from spatula_env.geometry.rotations import turn
from spatula_env.tasks.base import PartSpec
from spatula_env.tasks.surface import farthest_points, surface_samples

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray
    from spatula_env.envs.control import VelocityControl
    from spatula_env.envs.settings import ObservationSettings
    from spatula_env.tasks.base import Evaluation, Task
    from spatula_env.tasks.situation import Setting, Situation

Observation = NDArray[Any] | dict[str, NDArray[Any]]
"""Observation of one world, or of many with a leading axis for the worlds."""

LANDMARKS = 16
"""Number of the organ's nodes whose displacement is observed."""

GREATEST_PLACE = 0.2
"""Bound to which observed positions of points are clipped along each axis [m]."""

FARTHEST = 1.0
"""Bound to which observed distances from the camera are clipped [m]."""

NOISE: Mapping[str, float] = MappingProxyType(
    {
        "m": 1e-4,
        "m/s": 1e-3,
        "rad": 2e-3,
        "rad/s": 1e-2,
        "N": 0.02,
        "N m": 4e-4,
        "Pa": 50.0,
        "1": 0.01,
    }
)
"""Standard deviations of measurement noise by unit, at `noise=1`: 0.1 mm, 0.02 N and so on."""

EXACT_PARTS = ("goal", "hold_progress", "dose_share")
"""Parts that are not measured and have no noise. With a delay they come as late as the others."""

ROBOT_PARTS = (
    "tool_position",
    "tool_velocity",
    "tool_orientation",
    "tool_rotation_rate",
    "jaw_opening",
    "jaw_speed",
    "contact_force",
    "contact_torque",
    "path_ahead",
    "progress",
    "felt",
    "normal_force",
    "goal",
)
"""Parts that are known without looking at the organ: the entry "state" if pictures or points are observed."""

LEROBOT_KEYS: Mapping[str, str] = MappingProxyType(
    {
        "observation": "observation.state",
        "state": "observation.state",
        "sensors": "observation.state",
        "privileged": "observation.environment_state",
        "image": "observation.images.front",
        "depth": "observation.images.front_depth",
        "organ": "observation.points.organ",
        "tool": "observation.points.tool",
        "desired_goal": "observation.goal",
        "achieved_goal": "observation.achieved_goal",
        "action": "action",
    }
)
"""LeRobot's names for the entries of observations in its datasets."""


def lerobot_keys(space: spaces.Space[Any]) -> dict[str, str]:
    """Map an observation's entries to their names in a LeRobot dataset.

    Args:
        space: Observation space of one environment.

    Returns:
        New names by old ones, such as "observation.state" for a vector (called "observation" if it is the whole
        observation), "state" or "sensors"; "observation.images.front" for "image"; and "observation.<name>" for other
        parts.
    """
    names = list(space.spaces) if isinstance(space, spaces.Dict) else ["observation"]
    return {name: LEROBOT_KEYS.get(name, f"observation.{name}") for name in names}


@dataclass(frozen=True, eq=False)
class Part(PartSpec):
    """A part of the observation, with bounds in single precision."""

    @property
    def space(self) -> spaces.Box:
        """The part's space."""
        return spaces.Box(self.low, self.high, dtype=np.float32)


class ObservationBuilder:
    """Builds observations from situations.

    - "state": one vector of all parts.
    - "dict": a dictionary of the parts.
    - "rgb": a dictionary of a picture, "image" (height, width, 3) uint8, and "state", the vector of `ROBOT_PARTS`.
    - "rgbd": as "rgb", with "depth" (height, width, 1), the distance from the camera's plane [m].
    - "pointcloud": a dictionary of points on the organ's surface, "organ" (P, 3), on the tools' surfaces, "tool" (Q,
      3), always the same ones, in the workspace frame [m], and "state".

    With the goal interface, "achieved_goal" and "desired_goal" are entries of a dictionary, beside "observation" or
    beside the other entries; parts that depend on the goal are then left out, because hindsight replay replaces goals.
    The one exception is "hold_progress" if success ends episodes: hindsight replay cannot be used there anyway.

    Every number is clipped to the bounds of its space.

    `ObservationSettings.parts` selects parts. "sensors": those that are `sensed`. "grouped": the vector is split into
    the entries "sensors" and "privileged" of a dictionary, which replace the single vector, "observation" or "state".

    Attributes:
        parts: The parts in the order of the vector; with "grouped", those of "sensors" come first.
        space: Observation space of one world.
        landmarks: (L,) indices of the nodes whose displacement is observed.
        settings: Noise, delay, history, and sizes.
        needs_picture: Whether pictures are observed.
        needs_depth: Whether depth is observed.
    """

    def __init__(
        self,
        setting: Setting,
        task: Task,
        control: VelocityControl,
        obs_mode: str,
        settings: ObservationSettings,
        ranges: ObservedRanges | None = None,
        control_name: str = "",
        *,
        goal_interface: bool,
        hold_progress: bool,
        dose_share: bool = False,
    ) -> None:
        """Define the layout of the observation.

        Args:
            setting: Organ, tools and workspace.
            task: Task, for its goals and its own parts.
            control: Control, for its speeds and its further coordinates.
            obs_mode: Observation mode; see the class.
            settings: Noise, delay, history, sizes, and selection of parts.
            ranges: Ranges of forces, pressures and displacements, and observed faces; None for wide ranges and all
                faces.
            control_name: Name of the control in `ranges`.
            goal_interface: Whether goals are separate entries.
            hold_progress: Whether to observe for how long the goal has been held, which rewards or the end of an
                episode may depend on.
            dose_share: Whether to observe the episode's dose, on which its end may depend.

        Raises:
            ValueError: If the mode does not allow this selection of parts.
        """
        check_parts(settings.parts, obs_mode)
        self.settings = settings
        self._hold_progress, self._dose_share = hold_progress, dose_share
        self._mode = obs_mode
        self._control = control
        self._goal_interface = goal_interface
        self.needs_picture = obs_mode in ("rgb", "rgbd")
        self.needs_depth = obs_mode == "rgbd"
        rest = setting.rest_nodes
        upper = np.flatnonzero(rest[:, 2] >= 0.5 * (rest[:, 2].min() + rest[:, 2].max()))
        self.landmarks: NDArray[np.int64] = upper[farthest_points(rest[upper], min(LANDMARKS, len(upper)))]
        self._rest_landmarks = rest[self.landmarks]
        self._goal_space = spaces.Box(task.goal_low, task.goal_high, dtype=np.float32)
        ranges = ranges or ObservedRanges()
        self._faces = ranges.touched(control_name, setting.face_count)
        parts = self._chosen(self._list_parts(setting, task, ranges))
        self.parts = tuple(parts)
        self._low = np.concatenate([part.low for part in parts]).astype(np.float64)
        self._high = np.concatenate([part.high for part in parts]).astype(np.float64)
        ends = np.cumsum([part.size for part in parts]).tolist()
        self._slices = {part.name: slice(end - part.size, end) for part, end in zip(parts, ends, strict=True)}
        self._first_privileged = sum(part.size for part in parts if part.sensed)
        self._deviations = np.concatenate([_deviation(part) for part in parts])
        if obs_mode == "pointcloud":
            self._prepare_points(setting)
        self.frame_space: spaces.Space[Any] = self._make_space()
        self.space: spaces.Space[Any] = self._stacked(self.frame_space)

    def _list_parts(self, setting: Setting, task: Task, ranges: ObservedRanges) -> list[Part]:
        tools, control = len(setting.tools), self._control
        displaced = np.full(3 * len(self.landmarks), ranges.displacement)
        speed, force, torque = (
            np.full(3, control.max_speed),
            np.full(3 * tools, ranges.force),
            np.full(3, ranges.torque),
        )
        specs = [
            PartSpec("tool_position", "m", setting.workspace_low, setting.workspace_high, sensed=True),
            PartSpec("tool_velocity", "m/s", -speed, speed, sensed=True),
            *control.parts,
            PartSpec("contact_force", "N", -force, force, sensed=True),
            PartSpec("contact_torque", "N m", -torque, torque, sensed=True),
            PartSpec("contact_share", "1", np.zeros(len(self._faces)), np.ones(len(self._faces))),
            PartSpec("contact_depth", "m", np.zeros(1), np.full(1, ranges.contact_depth)),
            PartSpec("contact_pressure", "Pa", np.zeros(2), np.array([ranges.peak_pressure, ranges.mean_pressure])),
            PartSpec("landmarks", "m", -displaced, displaced),
            *task.extra_parts,
        ]
        self._extra = [part.name for part in task.extra_parts]
        if not self._goal_interface:
            low, high = task.goal_low, task.goal_high
            unit = " ".join(dict.fromkeys(task.goal_units))
            specs += [PartSpec("goal", unit, low, high, sensed=True), PartSpec("error", unit, low - high, high - low)]
        if self._hold_progress:
            specs.append(PartSpec("hold_progress", "1", np.zeros(1), np.ones(1)))
        if self._dose_share:
            specs.append(PartSpec("dose_share", "1", np.zeros(1), np.ones(1)))
        return [
            Part(spec.name, spec.unit, spec.low.astype(np.float32), spec.high.astype(np.float32), spec.sensed)
            for spec in specs
        ]

    def _chosen(self, parts: list[Part]) -> list[Part]:
        """The parts that the mode and the settings select."""
        choice = self.settings.parts
        if choice == GROUPED:
            return [part for part in parts if part.sensed] + [part for part in parts if not part.sensed]
        if self._mode in ("rgb", "rgbd", "pointcloud"):
            parts = [part for part in parts if part.name in ROBOT_PARTS]
        return parts if choice == ALL_PARTS else [part for part in parts if part.sensed]

    @property
    def slices(self) -> Mapping[str, slice]:
        """Position of each part in the vector of all parts; with "grouped", in that of "sensors" or of "privileged"."""
        if self.settings.parts != GROUPED:
            return dict(self._slices)
        first = self._first_privileged
        return {
            part.name: where if part.sensed else slice(where.start - first, where.stop - first)
            for part, where in zip(self.parts, self._slices.values(), strict=True)
        }

    def vectors_of(self, wide: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Split the vector of all parts (..., D) into the entries that hold it, in the modes that have such entries."""
        if self.settings.parts == GROUPED:
            first = self._first_privileged
            return {"sensors": wide[..., :first].copy(), "privileged": wide[..., first:].copy()}
        if self._mode == "state":
            return {"observation" if self._goal_interface else "": wide}
        return {"state": wide}

    def build(
        self,
        situation: Situation,
        goal: FloatArray,
        evaluation: Evaluation,
        held: FloatArray,
        noise: FloatArray | None = None,
        pictures: Mapping[str, NDArray[Any]] | None = None,
        dose: FloatArray | None = None,
        bed: FloatArray | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Build one frame of the observations of W worlds.

        Args:
            situation: Situation of the worlds.
            goal: (W, G) goals.
            evaluation: Evaluation of the situation.
            held: (W,) time for which the goal has been held, relative to the time needed for success, at most 1.
            noise: (W, size of the vector) measurement errors in standard deviations; None for none.
            pictures: "image" (W, height, width, 3) and "depth" (W, height, width, 1) [m], if they are needed.
            dose: (W,) dose of the episode, relative to its limit, if it is observed.
            bed: (W,) heights of the beds that organs and tools are placed relative to [m]; None if they never move.

        Returns:
            (W, ...) entries by name; a single vector has the name "". New arrays.
        """
        moved, position = situation.nodes[:, self.landmarks] - self._rest_landmarks, situation.tool_position
        if bed is not None:
            moved[..., 2] += bed[:, None]
            position = position + bed[:, None] * (0.0, 0.0, 1.0)
        count = len(goal)
        values = {
            "tool_position": position,
            "tool_velocity": situation.tool_velocity,
            **dict(zip((part.name for part in self._control.parts), self._control.observe(situation), strict=True)),
            "contact_force": situation.contact_forces.reshape(count, -1),
            "contact_torque": situation.contact_torque,
            "contact_share": situation.contact_share[:, self._faces],
            "contact_depth": situation.contact_depth[:, None],
            "contact_pressure": np.stack([situation.peak_pressure, situation.mean_pressure], axis=1),
            "landmarks": moved.reshape(count, -1),
            **{name: evaluation.parts[name] for name in self._extra},
            "goal": goal,
            "error": evaluation.error,
            "hold_progress": held[:, None],
        }
        if dose is not None:
            values["dose_share"] = dose[:, None]
        wide = np.concatenate([values[part.name] for part in self.parts], axis=1)
        if noise is not None:
            wide = wide + noise * self._deviations
        vectors = np.minimum(np.maximum(wide, self._low), self._high).astype(np.float32)
        result: dict[str, NDArray[Any]]
        if self._mode == "state":
            result = self.vectors_of(vectors)
        elif self._mode == "dict":
            result = {name: vectors[:, part].copy() for name, part in self._slices.items()}
        else:
            result = {**self._look(situation, pictures, bed), **self.vectors_of(vectors)}
        if self._goal_interface:
            result["achieved_goal"] = evaluation.achieved.astype(np.float32)
            result["desired_goal"] = goal.astype(np.float32)
        return result

    def _look(
        self, situation: Situation, pictures: Mapping[str, NDArray[Any]] | None, bed: FloatArray | None
    ) -> dict[str, NDArray[Any]]:
        if self._mode == "pointcloud":
            corners = situation.nodes[:, self._organ_corners]
            organ = np.einsum("wpka,pk->wpa", corners, self._organ_weights)
            scale = situation.tool_scale[:, None, None]
            tool = np.concatenate(
                [
                    turn(situation.tool_orientations[:, k, None], points * scale) + situation.tool_positions[:, k, None]
                    for k, points in enumerate(self._tool_points)
                ],
                axis=1,
            )
            if bed is not None:
                for points in (organ, tool):
                    points[..., 2] += bed[:, None]
            clipped = (np.minimum(np.maximum(points, -GREATEST_PLACE), GREATEST_PLACE) for points in (organ, tool))
            return dict(zip(("organ", "tool"), (points.astype(np.float32) for points in clipped), strict=True))
        if pictures is None:
            raise ValueError(f"pictures are needed with obs_mode={self._mode!r}")
        result = {"image": pictures["image"]}
        if self.needs_depth:
            result["depth"] = np.minimum(np.maximum(pictures["depth"], 0.0), FARTHEST).astype(np.float32)
        return result

    def _prepare_points(self, setting: Setting) -> None:
        """Select the points of a point cloud."""
        chosen, self._organ_weights = surface_samples(setting.rest_nodes, setting.triangles, self.settings.organ_points)
        self._organ_corners = np.asarray(setting.triangles)[chosen]
        shares = np.diff(np.linspace(0, self.settings.tool_points, len(setting.tools) + 1).round().astype(int))
        self._tool_points = []
        for tool, share in zip(setting.tools, shares.tolist(), strict=True):
            chosen, weights = surface_samples(tool.vertices, tool.triangles, share)
            corners = tool.vertices[np.asarray(tool.triangles)[chosen]]
            self._tool_points.append(np.einsum("pka,pk->pa", corners, weights))

    def _make_space(self) -> spaces.Space[Any]:
        low, high = (self.vectors_of(bound.astype(np.float32)) for bound in (self._low, self._high))
        flat = {name: spaces.Box(low[name], high[name], dtype=np.float32) for name in low}
        named: dict[str, spaces.Space[Any]] = {}
        if self._mode == "state":
            if "" in flat:
                return flat[""]
            named.update(flat)
        elif self._mode == "dict":
            named.update({part.name: part.space for part in self.parts})
        elif self._mode == "pointcloud":
            for name, count in (("organ", self.settings.organ_points), ("tool", self.settings.tool_points)):
                named[name] = spaces.Box(-GREATEST_PLACE, GREATEST_PLACE, (count, 3), dtype=np.float32)
            named.update(flat)
        else:
            size = tuple(self.settings.image_size)
            named["image"] = spaces.Box(0, 255, (*size, 3), dtype=np.uint8)
            if self.needs_depth:
                named["depth"] = spaces.Box(0.0, FARTHEST, (*size, 1), dtype=np.float32)
            named.update(flat)
        if self._goal_interface:
            named["achieved_goal"] = self._goal_space
            named["desired_goal"] = self._goal_space
        return spaces.Dict(named)

    def _stacked(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """Extend a space to the number of frames that are shown."""
        history = self.settings.history
        if history == 1:
            return space
        if isinstance(space, spaces.Dict):
            return spaces.Dict(
                {name: one if name in GOAL_ENTRIES else self._stacked(one) for name, one in space.spaces.items()}
            )
        assert isinstance(space, spaces.Box)
        low, high = (np.repeat(bound[None], history, axis=0) for bound in (space.low, space.high))
        return spaces.Box(low, high, dtype=space.dtype.type)


GOAL_ENTRIES = ("achieved_goal", "desired_goal")
"""Entries that are neither delayed nor stacked."""


class FrameMemory:
    """Stores the last frames of W worlds, to delay and stack observations.

    Attributes:
        delay: Delay in frames.
    """

    def __init__(self, delay: int, history: int) -> None:
        """Start without frames.

        Args:
            delay: Delay in frames.
            history: Number of frames that are stacked.
        """
        self.delay = delay
        self._depth = delay + history
        self._history = history
        self._frames: dict[str, NDArray[Any]] = {}

    def push(self, frames: dict[str, NDArray[Any]], worlds: NDArray[np.int64], count: int, *, first: bool) -> None:
        """Add a frame.

        Args:
            frames: (n, ...) entries by name.
            worlds: (n,) indices of the worlds.
            count: Number of worlds, W.
            first: Whether these frames begin episodes, so that no earlier ones count.
        """
        for name, values in frames.items():
            if name not in self._frames:
                self._frames[name] = np.zeros((count, self._depth, *values.shape[1:]), dtype=values.dtype)
            kept = self._frames[name]
            if first:
                kept[worlds] = values[:, None]
            else:
                kept[worlds, :-1] = kept[worlds, 1:]
                kept[worlds, -1] = values

    def save(self, worlds: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """Copy the stored frames of some worlds (n,): (n, depth, ...) by name."""
        return {name: kept[worlds] for name, kept in self._frames.items()}

    def restore(self, frames: Mapping[str, NDArray[Any]], worlds: NDArray[np.int64], count: int) -> None:
        """Restore in some worlds (n,) of `count` what `save` returned."""
        for name, values in frames.items():
            if name not in self._frames:
                self._frames[name] = np.zeros((count, *values.shape[1:]), dtype=values.dtype)
            self._frames[name][worlds] = values

    def show(self, worlds: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """Delayed frames of some worlds (n,): (n, ...) by name, or (n, history, ...), oldest first, in new arrays."""
        shown = {}
        for name, kept in self._frames.items():
            if name in GOAL_ENTRIES:
                shown[name] = kept[worlds, -1]
            elif self._history == 1:
                shown[name] = kept[worlds, 0]
            else:
                shown[name] = kept[worlds, : self._history]
        return shown


def _deviation(part: PartSpec) -> FloatArray:
    """(size,) standard deviations of a part's numbers."""
    if part.name in EXACT_PARTS:
        return np.zeros(part.size)
    if part.unit in NOISE:
        return np.full(part.size, NOISE[part.unit])
    # For units without an entry, and for parts of several units: 1/200 of the range.
    return np.asarray(0.005 * (part.high.astype(np.float64) - part.low))


def first_of(batch: Observation) -> Observation:
    """The observation of the first world in a batch."""
    if isinstance(batch, dict):
        return {name: values[0] for name, values in batch.items()}
    return np.asarray(batch[0])
