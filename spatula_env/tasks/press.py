"""The press task: push the organ's surface to a depth at a place, and hold it there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from spatula_env.arrays import BoolArray, FloatArray, IntArray
from spatula_env.geometry.checks import as_pair
from spatula_env.geometry.rotations import turn
from spatula_env.pressure_limits import COST_PRESSURE
from spatula_env.tasks.base import Evaluation, Memory, Task, as_seen, closeness, sample_disc
from spatula_env.tasks.configuration import TaskConfig, Weights
from spatula_env.tasks.criteria import Criterion
from spatula_env.tasks.marks import Mark, Path, Ring
from spatula_env.tasks.pose import moved_as_a_whole
from spatula_env.tasks.situation import Setting, Situation, Start

LEAST_DEPTH, GREATEST_DEPTH = -0.03, 0.06
"""Limits of a measured depth [m]: a surface that bulges, and one that has slipped from under the tool."""

UPWARDS = (0.0, 0.0, 1.0)
"""Direction in the spatula's frame in which the organ pushes on its lower face."""

LEAST_NORMAL_SHARE = 0.5
"""Least part of the force on the spatula that is along the normal of its lower face if that face presses."""

RING_RATIO = 1.64
"""Radius of the rings that show a goal, relative to half the spatula's width: they reach around it."""


@dataclass(frozen=True)
class PressWeights(Weights):
    """Weights of the reward terms of `PressTask`.

    Attributes:
        reach: Weight of the closeness of the spatula's underside to its target position, 0..1.
        depth: Weight of the closeness of depth and place to the goal's, 0..1.
        force: Weight of the contact force [1/N].
    """

    reach: float = 0.25
    depth: float = 0.25
    hold: float = 0.5
    force: float = -0.002
    action: float = -0.01


@dataclass(frozen=True)
class PressConfig(TaskConfig):
    """Configuration of the press task.

    Attributes:
        center: Middle of the region of goals and starts, seen from above, relative to the organ's axis (x, y) [m]. A
            ring has no surface at its axis.
        place_radius: Goals lie within this distance of the center [m].
        depth_range: Least and greatest depth asked for [m].
        place_tolerance: Allowed horizontal distance between spatula and place [m].
        depth_tolerance: Allowed difference of the depth from the goal's [m].
        least_force: The depth counts only while the spatula's lower face presses on the organ with at least this force
            [N].
        hold_time: Time for which place and depth must be held without interruption [s].
        start_radius: The spatula starts within this distance of the center [m].
        start_height_range: Least and greatest height of its underside above the organ's top at the start [m].
        pressure_per_depth: Additional pressure that deeper goals require beyond what tissue bears, with care: the rim
            of a flat spatula presses harder the deeper it is [Pa/m].
        reach_scale: Distance at which the reward term "reach" is 0.24 [m].
        depth_scale: Error of depth or of place at which the corresponding closeness in the term "depth" is 0.24 [m].
        loading_limit: Rate at which the force on a tool may grow without causing a cost [N/s].
        cost_budget: Greatest cost of an episode with which success counts as safe [s].
    """

    center: tuple[float, float] = (0.0, 0.0)
    place_radius: float = 0.015
    depth_range: tuple[float, float] = (0.005, 0.018)
    place_tolerance: float = 0.002
    depth_tolerance: float = 0.001
    least_force: float = 0.02
    hold_time: float = 0.5
    start_radius: float = 0.02
    start_height_range: tuple[float, float] = (0.01, 0.03)
    pressure_per_depth: float = 4.5e5
    reach_scale: float = 0.02
    depth_scale: float = 0.003
    loading_limit: float = 2.6
    cost_budget: float = 0.02
    weights: PressWeights = field(default_factory=PressWeights)

    def __post_init__(self) -> None:
        """Check the values; convert lists and mappings from a file."""
        self._read_center()
        self._check_not_negative("place_radius", "start_radius", "pressure_per_depth")
        self._check_positive(
            "place_tolerance", "depth_tolerance", "least_force", "hold_time", "reach_scale", "depth_scale"
        )
        self._read_ranges("depth_range")
        self._read_ranges("start_height_range", not_negative=True)
        if self.depth_range[0] <= self.depth_tolerance:
            raise ValueError(
                f"depth_range must begin above depth_tolerance, {self.depth_tolerance}, or the organ at rest "
                f"would fulfil the goal; got {self.depth_range}"
            )
        self._check_positive("loading_limit")
        self._check_not_negative("cost_budget")
        self._read_weights(PressWeights)

    def _read_center(self) -> None:
        object.__setattr__(self, "center", as_pair(self.center, "center", "(x, y)"))


@dataclass(frozen=True, eq=False)
class PressView:
    """What a press is measured by, in frames in which it goes straight down.

    Attributes:
        nodes: (W, V, 3) nodes of the organ [m].
        untouched: (W, V, 3) where they would be if nothing pressed on the organ, or (1, V, 3) [m].
        place: (W, 2) horizontal position of the spatula's middle [m].
        force: (W, 3) force of the organ on the spatula [N].
        face: (W, 3) unit vector in which the organ pushes on the spatula's lower face.
        lowest: (W,) height of the spatula's lowest corner [m].
        target: (W,) height of the surface at the goal's place and depth [m].
    """

    nodes: FloatArray
    untouched: FloatArray
    place: FloatArray
    force: FloatArray
    face: FloatArray
    lowest: FloatArray
    target: FloatArray


class PressTask(Task):
    """Evaluates a press.

    A goal is (x, y, depth): a place in the horizontal plane, and the depth of the organ's surface below its height at
    rest. What is achieved is measured at the spatula: the place is that of its centre, and the depth is the height that
    the organ's surface would have there if nothing pressed on it, minus its present height. Since it is measured on the
    organ, a spatula that has sunk into the organ without moving it has achieved nothing, and neither has one that does
    not touch it or has pushed it aside: the depth counts only under a lower face that presses on the organ, and is
    otherwise zero, and the reference surface lies where the organ lies now.

    Attributes:
        config: Configuration of the task.
    """

    description = "Press the organ with the spatula to the given depth at the given place, and hold it there."
    goal_names = ("x", "y", "depth")
    goal_units = ("m", "m", "m")
    definition = 2

    def __init__(self, config: PressConfig, setting: Setting) -> None:
        """Prepare the task for a setting.

        Args:
            config: Configuration of the task.
            setting: Setting of the task.

        Raises:
            ValueError: If the organ has no surface at the goals, or the deepest goal or a start is out of the tool's
                reach.
        """
        low, high = setting.workspace_low, setting.workspace_high
        super().__init__(config, setting, [low[0], low[1], LEAST_DEPTH], [high[0], high[1], GREATEST_DEPTH])
        self.config = config
        self._check_reach()

    def sample(self, generator: np.random.Generator, count: int, setting: Setting) -> Start:
        """Draw the beginnings of episodes: places uniform in discs, depths and heights uniform in their ranges.

        Returns:
            Goals (W, 3) and tool positions (W, 3) [m].
        """
        config = self.config
        depth = generator.uniform(*config.depth_range, size=count)
        place = sample_disc(generator, config.place_radius, count)
        start = sample_disc(generator, config.start_radius, count)
        height = generator.uniform(*config.start_height_range, size=count)
        middle = setting.organ_position[:2] + config.center
        underside = setting.rest_nodes[:, 2].max() + height
        return Start(
            goal=np.column_stack([middle + place, depth]),
            tool_position=np.column_stack([middle + start, underside - setting.tool_low[2]]),
        )

    def check_goal(self, goal: FloatArray) -> None:
        """Check a goal (3,) that was not drawn by `sample`.

        Raises:
            ValueError: If its place is outside the workspace, or its depth is outside the configured range.
        """
        least, greatest = self.config.depth_range
        low, high = self.goal_low[:2], self.goal_high[:2]
        if (goal[:2] < low).any() or (goal[:2] > high).any():
            raise ValueError(f"goal must be at a place from {low} to {high} m, got {goal[:2]}")
        if not least <= goal[2] <= greatest:
            raise ValueError(f"goal must have a depth from {least} to {greatest} m, got {goal[2]}")
        there = self.setting.surface_heights(self.setting.rest_nodes[None], goal[None, :2])[0]
        if there - self.setting.ground_height <= goal[2]:
            raise ValueError(
                f"goal must be at a place where the organ is higher than the goal's depth of {goal[2]:g} m, got "
                f"{goal[:2]}, where it is {there - self.setting.ground_height:.4g} m high"
            )

    def pressure_limit(self, goal: FloatArray) -> FloatArray:
        """See `Task`: the pressure grows with the depth."""
        return np.asarray(COST_PRESSURE + self.config.pressure_per_depth * goal[:, 2])

    def new_memory(self, count: int) -> Memory:
        """Allocate the memory: the target height of the surface at the place, "target_height" (W,) [m]."""
        return {"target_height": np.zeros(count)}

    def begin_memory(self, memory: Memory, rows: IntArray, start: Start, settings: Sequence[Setting]) -> None:
        """See `Task`: evaluates the surface at rest once per episode."""
        rest = np.stack([setting.rest_nodes for setting in settings])
        memory["target_height"][rows] = self.setting.surface_heights(rest, start.goal[:, :2]) - start.goal[:, 2]

    def evaluate(self, situation: Situation, goal: FloatArray, memory: Memory) -> Evaluation:
        """See `Task`.

        Returns:
            Reward terms "reach", "depth", "hold", "force" and "action"; what was achieved; the measures
            "depth", "depth_error" and "place_error" [m].
        """
        config = self.config
        view = self._view(situation, memory)
        depth = self._heights(view.untouched, view.place) - self._heights(view.nodes, view.place)
        pressing = (view.force * view.face).sum(axis=1)
        # An edge or a corner that is pushed in is pushed back across the normal of the lower face; friction alone, with
        # a coefficient up to 1.7, leaves at least half of a force on a face along its normal.
        whole = np.sqrt((view.force**2).sum(axis=1))
        depth = np.where(pressing >= np.maximum(config.least_force, LEAST_NORMAL_SHARE * whole), depth, 0.0)
        measured = np.column_stack([self._place_of(view, goal), depth])
        achieved, error, within = self.compare(as_seen(measured), goal)
        place_error, depth_error = np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])
        distance = np.hypot(place_error, view.lowest - view.target)
        return Evaluation(
            terms={
                "reach": closeness(distance, config.reach_scale),
                "depth": closeness(depth_error, config.depth_scale) * closeness(place_error, config.depth_scale),
                "hold": within.astype(np.float64),
                "force": situation.force,
                "action": situation.effort,
            },
            achieved=achieved,
            error=error,
            within_tolerance=within,
            measures={"depth": achieved[:, 2], "depth_error": depth_error, "place_error": place_error},
            parts=self._parts(memory),
        )

    def fulfils(self, achieved: FloatArray, desired: FloatArray) -> BoolArray:
        """Whether the place and the depth are within tolerance of what is desired, (..., 3) each [m]."""
        error = desired - achieved
        return np.asarray(
            (np.hypot(error[..., 0], error[..., 1]) <= self.config.place_tolerance)
            & (np.abs(error[..., 2]) <= self.config.depth_tolerance)
        )

    def criteria(self, achieved: FloatArray, goal: FloatArray) -> tuple[Criterion, ...]:
        """See `Task`."""
        place = float(np.hypot(*(goal[:2] - achieved[:2])))
        return (
            Criterion.near("depth", "m", float(achieved[2]), float(goal[2]), self.config.depth_tolerance),
            Criterion.at_most("off the place", "m", place, self.config.place_tolerance),
        )

    def marks(
        self, goal: FloatArray, situation: Situation | None = None, memory: Memory | None = None
    ) -> tuple[Mark, ...]:
        """Rings at the place on the surface at rest and at the target depth, and a line from one to the other."""
        rest = self.setting.rest_nodes[None] if situation is None else situation.rest_nodes
        height = self.setting.surface_heights(rest, goal[None, :2])[0]
        points = np.array([[*goal[:2], height], [*goal[:2], height - goal[2]]])
        radius = RING_RATIO * float(self.setting.tool_high[0])
        return Ring(points[0], radius), Ring(points[1], radius), Path(points)

    def patches(self, goals: FloatArray, situation: Situation, memory: Memory) -> dict[str, BoolArray]:
        """None: nothing of the organ is dyed."""
        return {}

    def _view(self, situation: Situation, memory: Memory) -> PressView:
        """What is measured, in frames in which presses go straight down."""
        return PressView(
            nodes=situation.nodes,
            untouched=moved_as_a_whole(situation.nodes, situation.rest_nodes),
            place=situation.tool_position[:, :2],
            force=situation.contact_forces[:, 0],
            face=turn(situation.tool_orientation, UPWARDS),
            lowest=situation.lowest_corner(self.setting.tools[0]),
            target=memory["target_height"],
        )

    def _heights(self, nodes: FloatArray, places: FloatArray) -> FloatArray:
        """Heights (W,) of surfaces with nodes (W, V, 3) at places (W, 2), in the frames of views [m]."""
        return self.setting.surface_heights(nodes, places)

    def _place_of(self, view: PressView, goal: FloatArray) -> FloatArray:
        """Places (W, 2) of the spatula, as goals (W, 3) tell them [m]."""
        return view.place

    def _parts(self, memory: Memory) -> dict[str, FloatArray]:
        """The task's own pieces of the observation."""
        return {}

    def _check_reach(self) -> None:
        config, setting = self.config, self.setting
        middle = setting.organ_position[:2] + config.center
        for name in ("place_radius", "start_radius"):
            self.check_room(name, getattr(config, name), middle)
        angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
        rim = config.place_radius * np.column_stack([np.cos(angle), np.sin(angle)])
        heights = setting.surface_heights(setting.rest_nodes[None], middle + np.concatenate([np.zeros((1, 2)), rim]))
        missed = heights <= setting.ground_height
        if missed.any():
            where = "at " if missed[0] else f"within place_radius ({config.place_radius} m) of "
            raise ValueError(
                f"the organ has no surface {where}center {config.center} m from its axis, as in the hole of a ring: "
                'choose another one, task={"center": (x, y)}, or a smaller place_radius'
            )
        lowest = heights.min()
        deepest = lowest - (setting.workspace_low[2] + setting.tool_low[2])
        if config.depth_range[1] > deepest:
            raise ValueError(
                f"depth_range must end at {deepest:.4f} m at most, where the workspace ends; got {config.depth_range}"
            )
