"""The fissure task: enter it edge-on, open it, and hold it open until a target on its floor is visible."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from spatula_env.arrays import BoolArray, FloatArray
from spatula_env.geometry.blocks import FissuredBlock
from spatula_env.geometry.checks import check_count, check_positive
from spatula_env.geometry.rotations import conjugate, from_rotation_vector, multiply, to_rotation_vector, turn
from spatula_env.tasks.base import Evaluation, Memory, PartSpec, Task, closeness
from spatula_env.tasks.configuration import TaskConfig, Weights
from spatula_env.tasks.criteria import Criterion
from spatula_env.tasks.exposure import visible_points
from spatula_env.tasks.marks import Mark, Path
from spatula_env.tasks.organs import organ_with_parts
from spatula_env.tasks.situation import Setting, Situation, Start

GREATEST_VIEW = 0.6
"""Greatest tilt of the blade and of the line of sight that is reported [rad]."""

GREATEST_OFFSET = 0.1
"""Greatest component of the vector from the blade's edge to the target that is reported [m]."""

SIGHT_LENGTH = 0.06
"""Length of the line of sight in pictures [m]."""


MOST_ASKED = 1000
"""Greatest number of the target's points along either side."""


@dataclass(frozen=True)
class FissureWeights(Weights):
    """Weights of the reward terms of `FissureTask`.

    Attributes:
        reach: Weight of the closeness of the blade's edge to the target, 0..1.
        align: Weight of "reach" times the closeness of the blade's tilt to the line of sight, 0..1.
        exposure: Weight of the visible share of the target, relative to the share asked for, 0..1.
        force: Weight of the contact force [1/N].
    """

    reach: float = 0.15
    align: float = 0.15
    exposure: float = 0.2
    hold: float = 0.5
    force: float = -0.1
    action: float = -0.01


@dataclass(frozen=True)
class FissureConfig(TaskConfig):
    """Configuration of the fissure task.

    Attributes:
        place_limit: The target's middle lies within this distance of the fissure's, along it [m].
        view_range: Least and greatest angle between the line of sight and the vertical, to either side [rad].
        exposure_range: Least and greatest share of the target that has to be visible.
        target_size: Length of the target along the fissure, and its width across [m].
        target_height: Height of the target, a flat patch, above the lowest line of the floor [m].
        target_grid: Number of its points that are tested for visibility, along it and across.
        place_tolerance: Allowed distance of the blade's middle from the target's, along the fissure [m].
        view_tolerance: Allowed angle between blade and line of sight [rad].
        edge_height: Visibility counts only while the blade's lower edge is at most this far above the target: inside
            the fissure down to its floor, and not between its lips [m].
        hold_time: Time for which the target must be visible without interruption [s].
        start_offset: The blade starts within this distance of the fissure's middle, along each horizontal axis [m].
        start_height_range: Least and greatest height of its lower edge above the organ's top at the start [m].
        start_tilt: Greatest tilt of the blade at the start, to either side [rad].
        reach_height: Height above the target's middle at which the reward term "reach" wants the blade's edge [m].
        reach_aside: Distance beside it, on the side to which the line of sight leans [m].
        reach_scale: Distance from there at which the term is 0.24 [m].
        align_scale: Angle at which the closeness of tilt and line of sight is 0.24 [rad].
        loading_limit: Rate at which the force on a tool may grow without causing a cost [N/s].
        cost_budget: Greatest cost of an episode with which success counts as safe [s].
    """

    place_limit: float = 0.01
    view_range: tuple[float, float] = (0.18, 0.3)
    exposure_range: tuple[float, float] = (0.8, 0.9)
    target_size: tuple[float, float] = (0.012, 0.002)
    target_height: float = 0.002
    target_grid: tuple[int, int] = (5, 21)
    place_tolerance: float = 0.008
    view_tolerance: float = 0.1
    edge_height: float = 0.008
    hold_time: float = 0.5
    start_offset: float = 0.01
    start_height_range: tuple[float, float] = (0.004, 0.015)
    start_tilt: float = 0.1
    reach_height: float = 0.003
    reach_aside: float = 0.002
    reach_scale: float = 0.015
    align_scale: float = 0.15
    loading_limit: float = 0.8
    cost_budget: float = 0.02
    weights: FissureWeights = field(default_factory=FissureWeights)

    def __post_init__(self) -> None:
        """Check the values; convert lists and mappings from a file."""
        self._check_not_negative("place_limit", "start_offset", "start_tilt", "reach_height", "reach_aside")
        self._check_positive(
            "target_height",
            "place_tolerance",
            "view_tolerance",
            "edge_height",
            "hold_time",
            "reach_scale",
            "align_scale",
        )
        self._read_ranges("view_range", "exposure_range")
        self._read_ranges("start_height_range", not_negative=True)
        if not 0.0 <= self.view_range[0] <= self.view_range[1] <= GREATEST_VIEW:
            raise ValueError(f"view_range must lie in 0 to {GREATEST_VIEW}, got {self.view_range}")
        if not 0.0 < self.exposure_range[0] <= self.exposure_range[1] <= 1.0:
            raise ValueError(f"exposure_range must lie above 0 and end at 1 at most, got {self.exposure_range}")
        if self.start_tilt > GREATEST_VIEW:
            raise ValueError(f"start_tilt must be {GREATEST_VIEW} at most, got {self.start_tilt}")
        size, grid = self._pair("target_size"), self._pair("target_grid")
        for value in size:
            check_positive(value, "target_size")
        for count in grid:
            check_count(count, "target_grid", 2, MOST_ASKED)
        object.__setattr__(self, "target_size", (float(size[0]), float(size[1])))
        object.__setattr__(self, "target_grid", (int(grid[0]), int(grid[1])))
        self._check_positive("loading_limit")
        self._check_not_negative("cost_budget")
        self._read_weights(FissureWeights)

    def _pair(self, name: str) -> tuple[Any, Any]:
        value = getattr(self, name)
        try:
            along, across = value
        except (TypeError, ValueError) as error:
            raise ValueError(f"{name} must be two numbers (along, across), got {value!r}") from error
        return along, across


class FissureTask(Task):
    """Evaluates how a fissure is held open.

    The target is a flat patch slightly above the lowest line of the fissure's floor. It is viewed from far above, along
    a line of sight tilted towards one of the walls, as through an operating microscope. A point of the target is
    visible if its ray towards the eye meets neither the organ nor the blade. At rest the wall is in the way.

    A goal is (place, view, exposure): the target's position along the fissure, from the middle of its floor; the tilt
    of the line of sight, a rotation about x like the blade's, where a positive one leans towards the operator; and the
    share of the target that has to be visible. What is achieved is the position of the blade's edge along the fissure,
    the blade's tilt, and the visible share while the edge is near the floor, otherwise zero. The share is that of the
    episode's target along the episode's line of sight, so it is unknown for the other goals of hindsight replay. The
    goal is fulfilled if the blade is at the target and along the line of sight, both within a wide tolerance, and the
    visible share is at least that asked for.
    """

    description = (
        "Enter the fissure with the blade and lean it against the wall until the given share of "
        "the target is seen, and hold it there."
    )
    goal_names = ("place", "view", "exposure")
    goal_units = ("m", "rad", "1")
    hindsight = False
    definition = 2

    def __init__(self, config: FissureConfig, setting: Setting) -> None:
        """Prepare the task for a setting.

        Args:
            config: Configuration of the task.
            setting: Setting with an organ that is a `FissuredBlock`, and one tool.

        Raises:
            ValueError: If the organ has no fissure, there are several tools, or a goal or a start is out of reach.
        """
        if len(setting.tools) != 1:
            raise ValueError(f"setting.tools must be one blade, got {len(setting.tools)} tools")
        low, high = setting.workspace_low, setting.workspace_high
        super().__init__(config, setting, [low[0], -GREATEST_VIEW, 0.0], [high[0], GREATEST_VIEW, 1.0])
        self.config = config
        self.extra_parts = (PartSpec("target_offset", "m", np.full(3, -GREATEST_OFFSET), np.full(3, GREATEST_OFFSET)),)
        self._triangles = np.array(setting.triangles)
        self._ends = self._read_ends()
        blade = setting.tools[0]
        self._corners, self._blade_start = blade.vertices, blade.orientation
        heights = turn(blade.orientation, blade.vertices)[:, 2]
        lowest = heights <= heights.min() + 1e-6 * np.ptp(heights)
        self._edge = blade.vertices[lowest].mean(axis=0)
        steps = [np.linspace(-0.5, 0.5, count) for count in config.target_grid]
        grid = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
        self._grid: FloatArray = grid * config.target_size
        self._check_reach()

    def sample(self, generator: np.random.Generator, count: int, setting: Setting) -> Start:
        """Draw the beginnings of episodes: everything uniform in its range, either side of the sight equally likely.

        Returns:
            Goals (W, 3), positions (W, 3) [m] and orientations (W, 4) of the blade.
        """
        config = self.config
        limit = min(config.place_limit, self._greatest_place())
        place = generator.uniform(-limit, limit, size=count)
        view = generator.uniform(*config.view_range, size=count) * generator.choice([-1.0, 1.0], size=count)
        exposure = generator.uniform(*config.exposure_range, size=count)
        offset = generator.uniform(-config.start_offset, config.start_offset, size=(count, 2))
        height = generator.uniform(*config.start_height_range, size=count)
        tilt = generator.uniform(-config.start_tilt, config.start_tilt, size=count)
        middle, _ = self._floor_line(setting.rest_nodes[None])
        turned = multiply(from_rotation_vector(tilt[:, None] * [1.0, 0.0, 0.0]), self._blade_start)
        below = turn(turned[:, None], setting.tools[0].vertices)[:, :, 2].min(axis=1)
        top = setting.rest_nodes[:, 2].max()
        return Start(
            goal=np.column_stack([place, view, exposure]),
            tool_position=np.column_stack([middle[:, :2] + offset, top + height - below]),
            tool_orientation=turned,
        )

    def check_goal(self, goal: FloatArray) -> None:
        """Check a goal (3,) that was not drawn by `sample`.

        Raises:
            ValueError: If its place, its view or its exposure is not allowed.
        """
        limit, steepest = self._greatest_place(), self.config.view_range[1]
        if not abs(goal[0]) <= limit:
            raise ValueError(f"goal must have a place from {-limit:.4f} to {limit:.4f} m, got {goal[0]}")
        if not abs(goal[1]) <= steepest:
            raise ValueError(f"goal must have a view from {-steepest} to {steepest} rad, got {goal[1]}")
        if not 0.0 < goal[2] <= 1.0:
            raise ValueError(f"goal must have an exposure above 0 and of 1 at most, got {goal[2]}")

    def evaluate(self, situation: Situation, goal: FloatArray, memory: Memory) -> Evaluation:
        """See `Task`.

        Returns:
            Reward terms "reach", "align", "exposure", "hold", "force" and "action"; what was achieved; the measures
            "exposure", wherever the edge is, "target_distance" [m] from the blade's edge to the place that "reach"
            wants, and "view_error" [rad] of the blade's tilt; and the part "target_offset", from the middle of the
            blade's edge to the target's [m].
        """
        config = self.config
        scale = situation.tool_scale
        position, orientation = situation.tool_positions[:, 0], situation.tool_orientations[:, 0]
        middle, along = self._floor_line(situation.nodes)
        target = self._target(situation.nodes, goal[:, 0])
        edge = position + turn(orientation, scale[:, None] * self._edge)
        corners = position[:, None] + turn(orientation[:, None], scale[:, None, None] * self._corners)
        exposure = self._exposure(situation.nodes, corners, target, along, goal[:, 1])
        tilt = to_rotation_vector(multiply(orientation, conjugate(self._blade_start)))[:, 0]
        place = ((edge - middle) * along).sum(axis=1)
        offset = target - edge
        deep = -offset[:, 2] <= config.edge_height
        achieved, error, within = self.compare(np.column_stack([place, tilt, np.where(deep, exposure, 0.0)]), goal)

        aside = -config.reach_aside * np.sign(goal[:, 1:2]) * np.cross([0.0, 0.0, 1.0], along)
        distance = np.sqrt(((offset + aside + [[0.0, 0.0, config.reach_height]]) ** 2).sum(axis=1))
        view_error = np.abs(error[:, 1])
        reach = closeness(distance, config.reach_scale)
        return Evaluation(
            terms={
                "reach": reach,
                "align": reach * closeness(view_error, config.align_scale),
                "exposure": np.minimum(exposure / goal[:, 2], 1.0),
                "hold": within.astype(np.float64),
                "force": situation.force,
                "action": situation.effort,
            },
            achieved=achieved,
            error=error,
            within_tolerance=within,
            measures={"exposure": exposure, "target_distance": distance, "view_error": view_error},
            parts={"target_offset": offset},
        )

    def fulfils(self, achieved: FloatArray, desired: FloatArray) -> BoolArray:
        """Whether the blade is at the place and along the view, and enough is visible, (..., 3) each."""
        error = desired - achieved
        return np.asarray(
            (np.abs(error[..., 0]) <= self.config.place_tolerance)
            & (np.abs(error[..., 1]) <= self.config.view_tolerance)
            & (error[..., 2] <= 0.0)
        )

    def criteria(self, achieved: FloatArray, goal: FloatArray) -> tuple[Criterion, ...]:
        """See `Task`."""
        (place, tilt, seen), (wanted_place, view, share) = (values.tolist() for values in (achieved, goal))
        return (
            Criterion.at_least("target seen", "1", seen, share),
            Criterion.near("tilt of the blade", "rad", tilt, view, self.config.view_tolerance),
            Criterion.near("place along it", "m", place, wanted_place, self.config.place_tolerance),
        )

    def marks(
        self, goal: FloatArray, situation: Situation | None = None, memory: Memory | None = None
    ) -> tuple[Mark, ...]:
        """The target's outline, and the line of sight."""
        nodes = self.setting.rest_nodes[None] if situation is None else situation.nodes
        _, along = self._floor_line(nodes)
        target = self._target(nodes, goal[None, 0])[0]
        length, width = self.config.target_size
        across = np.cross([0.0, 0.0, 1.0], along[0])
        outline = [target + 0.5 * (x * length * along[0] + y * width * across) for x, y in _ROUND]
        return Path(np.array(outline)), Path(np.array([target, target + SIGHT_LENGTH * sight(goal[None, 1])[0]]))

    def patches(self, goals: FloatArray, situation: Situation, memory: Memory) -> dict[str, BoolArray]:
        """None: nothing of the organ is dyed."""
        return {}

    def _read_ends(self) -> tuple[int, int]:
        """The nodes at the two ends of the floor.

        Raises:
            ValueError: If the organ is no `FissuredBlock`.
        """
        floor = organ_with_parts(self.setting, FissuredBlock, "floor").floor
        along = self.setting.rest_nodes[floor, 0]
        return int(floor[np.argmin(along)]), int(floor[np.argmax(along)])

    def _floor_line(self, nodes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """For organs (W, V, 3): middle of the floor's lowest line (W, 3) [m], and its direction (W, 3)."""
        first, last = nodes[:, self._ends[0]], nodes[:, self._ends[1]]
        way = last - first
        return 0.5 * (first + last), way / np.sqrt((way**2).sum(axis=1, keepdims=True))

    def _target(self, nodes: FloatArray, place: FloatArray) -> FloatArray:
        """(W, 3) the targets' middles at places (W,) on organs (W, V, 3) [m]."""
        middle, along = self._floor_line(nodes)
        return np.asarray(middle + place[:, None] * along + [0.0, 0.0, self.config.target_height])

    def _points(self, target: FloatArray, along: FloatArray) -> FloatArray:
        """(W, K, 3) points of targets with middles (W, 3) that are tested for visibility [m]."""
        across = np.cross([0.0, 0.0, 1.0], along)
        return np.asarray(target[:, None] + self._grid[:, :1] * along[:, None] + self._grid[:, 1:] * across[:, None])

    def _exposure(
        self, nodes: FloatArray, corners: FloatArray, target: FloatArray, along: FloatArray, view: FloatArray
    ) -> FloatArray:
        """(W,) visible share of the target."""
        points = self._points(target, along)
        seen = visible_points(
            np.ascontiguousarray(nodes),
            self._triangles,
            np.ascontiguousarray(corners[:, None]),
            np.ascontiguousarray(points),
            sight(view),
        )
        return np.asarray(seen.mean(axis=1))

    def _greatest_place(self) -> float:
        """Greatest distance of a target from the middle of the fissure [m]."""
        first, last = self.setting.rest_nodes[list(self._ends)]
        return float(0.5 * np.linalg.norm(last - first) - 0.5 * self.config.target_size[0])

    def _check_reach(self) -> None:
        config = self.config
        limit = self._greatest_place()
        if config.place_limit > limit:
            raise ValueError(
                f"place_limit must be {limit:.4f} m at most, where the fissure's floor ends; got {config.place_limit!r}"
            )
        middle, _ = self._floor_line(self.setting.rest_nodes[None])
        self.check_room("start_offset", config.start_offset, middle[0, :2])


_ROUND = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0))
"""Corners of a rectangle, once around."""


def sight(view: FloatArray) -> FloatArray:
    """Unit vectors (W, 3) towards the eye for lines of sight rotated about x from the vertical by angles (W,) [rad]."""
    return np.column_stack([np.zeros(len(view)), -np.sin(view), np.cos(view)])
