"""The retraction task: move a marked patch of the organ's surface aside, and hold it there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from spatula_env.arrays import BoolArray, FloatArray, IntArray
from spatula_env.geometry.blocks import RidgedBlock
from spatula_env.geometry.checks import as_pair
from spatula_env.tasks.base import Evaluation, Memory, PartSpec, Task, closeness
from spatula_env.tasks.configuration import TaskConfig, Weights
from spatula_env.tasks.criteria import Criterion
from spatula_env.tasks.marks import Mark, Patch, Path, Points
from spatula_env.tasks.organs import organ_with_parts
from spatula_env.tasks.situation import Setting, Situation, Start

GREATEST_SHIFT = 0.03
"""Greatest component of the patch's displacement that is reported [m]."""

GREATEST_PLACE = 0.06
"""Greatest component of the patch's position that is reported [m]."""


@dataclass(frozen=True)
class RetractWeights(Weights):
    """Weights of the reward terms of `RetractTask`.

    Attributes:
        reach: Weight of the closeness of the blade to its contact position at the patch, 0..1.
        shift: Weight of the closeness of the patch's displacement to the goal, 0..1.
        force: Weight of the contact force [1/N].
    """

    reach: float = 0.25
    shift: float = 0.25
    hold: float = 0.5
    force: float = -0.02
    action: float = -0.01


@dataclass(frozen=True)
class RetractConfig(TaskConfig):
    """Configuration of the retraction task.

    Attributes:
        place_limit: The patch's middle lies within this distance of the fold's middle, along the fold [m].
        height_range: Least and greatest height of the patch's middle, 0 at the lowest nodes of the fold's flanks and 1
            at its crest.
        patch_radius: Radius of the patch; nodes near its middle have more weight [m].
        shift_range: Least and greatest displacement asked for [m].
        angle_limit: Greatest angle between the displacement asked for and the direction across the fold [rad].
        tolerance: Allowed horizontal distance between displacement and goal [m].
        least_push: The displacement counts only while the blade pushes against the flank with at least this force, and
            with at least twice the force with which it presses down [N].
        least_overlap: It also counts only while the blade's lower edge is at least this far below the patch's middle
            [m].
        hold_time: Time for which it must be held without interruption [s].
        start_offset: The blade starts within these distances of the fold's middle, across the fold and along it [m].
        start_height_range: Least and greatest height of its lower edge above the organ's top at the start [m].
        edge_depth: Depth below the patch's middle at which the term "reach" wants the blade's lower edge [m].
        reach_scale: Distance from there at which the reward term "reach" is 0.24 [m].
        shift_scale: Error of the displacement at which the term "shift" is 0.24 [m].
        loading_limit: Rate at which the force on a tool may grow without causing a cost [N/s].
        cost_budget: Greatest cost of an episode with which success counts as safe [s].
    """

    place_limit: float = 0.008
    height_range: tuple[float, float] = (0.05, 0.45)
    patch_radius: float = 0.009
    shift_range: tuple[float, float] = (0.004, 0.01)
    angle_limit: float = 0.12
    tolerance: float = 0.001
    least_push: float = 0.01
    least_overlap: float = 0.002
    hold_time: float = 0.5
    start_offset: tuple[float, float] = (0.02, 0.01)
    start_height_range: tuple[float, float] = (0.006, 0.02)
    edge_depth: float = 0.008
    reach_scale: float = 0.02
    shift_scale: float = 0.003
    loading_limit: float = 0.4
    cost_budget: float = 0.02
    weights: RetractWeights = field(default_factory=RetractWeights)

    def __post_init__(self) -> None:
        """Check the values; convert lists and mappings from a file."""
        self._check_not_negative("place_limit", "angle_limit", "edge_depth", "least_overlap")
        self._check_positive("patch_radius", "tolerance", "least_push", "hold_time", "reach_scale", "shift_scale")
        self._read_ranges("height_range", "shift_range")
        self._read_ranges("start_height_range", not_negative=True)
        object.__setattr__(self, "start_offset", _check_pair(self.start_offset, "start_offset"))
        if not (0.0 <= self.height_range[0] and self.height_range[1] <= 1.0):
            raise ValueError(f"height_range must lie in 0 to 1, got {self.height_range}")
        if self.angle_limit >= 0.5 * np.pi:
            raise ValueError(f"angle_limit must be less than pi/2, got {self.angle_limit!r}")
        if self.shift_range[0] <= self.tolerance or self.shift_range[1] > GREATEST_SHIFT:
            raise ValueError(
                f"shift_range must begin above tolerance, {self.tolerance}, or the organ at rest would fulfil the "
                f"goal, and end at {GREATEST_SHIFT} at most; got {self.shift_range}"
            )
        self._check_positive("loading_limit")
        self._check_not_negative("cost_budget")
        self._read_weights(RetractWeights)


class RetractTask(Task):
    """Evaluates a retraction.

    A goal is (x, y): the horizontal displacement of the patch. The patch is on the flank of the fold from which the
    goal points into the fold. What is achieved is the weighted mean displacement of the patch's nodes while the blade
    pushes against that flank, beside the patch; otherwise it is zero. A fold that is dragged along by its crest does
    not count as retracted.

    Attributes:
        config: Configuration of the task.
    """

    description = "Push the marked patch of the fold aside by the given displacement with the blade, and hold it there."
    goal_names = ("shift_x", "shift_y")
    goal_units = ("m", "m")
    definition = 2

    def __init__(self, config: RetractConfig, setting: Setting) -> None:
        """Prepare the task for a setting.

        Args:
            config: Configuration of the task.
            setting: Setting whose organ is a `RidgedBlock`.

        Raises:
            ValueError: If the organ is of another kind, or a start is out of the tool's reach.
        """
        super().__init__(config, setting, np.full(2, -GREATEST_SHIFT), np.full(2, GREATEST_SHIFT))
        self.config = config
        self._read_organ()
        self._half_thickness = 0.5 * float(setting.tool_high[0] - setting.tool_low[0])
        self.extra_parts = (
            PartSpec("patch_position", "m", np.full(3, -GREATEST_PLACE), np.full(3, GREATEST_PLACE)),
            PartSpec("patch_shift", "m", np.full(3, -GREATEST_SHIFT), np.full(3, GREATEST_SHIFT)),
        )
        self._check_reach()

    def sample(self, generator: np.random.Generator, count: int, setting: Setting) -> Start:
        """Draw the beginnings of episodes: either flank with equal probability, the rest uniform in their ranges.

        Returns:
            Goals (W, 2) and tool positions (W, 3) [m]; drawn (W, 2) holds the patch's position along the fold [m] and
            its height relative to the fold's.
        """
        config = self.config
        middle, across, along = self._fold(setting.rest_nodes)
        side = generator.choice([-1.0, 1.0], size=count)
        size = generator.uniform(*config.shift_range, size=count)
        angle = generator.uniform(-config.angle_limit, config.angle_limit, size=count)
        place = generator.uniform(-config.place_limit, config.place_limit, size=count)
        height = generator.uniform(*config.height_range, size=count)
        offset = generator.uniform(-1.0, 1.0, size=(count, 2)) * config.start_offset
        clearance = generator.uniform(*config.start_height_range, size=count)
        start = middle + offset[:, :1] * across + offset[:, 1:] * along
        top = float(setting.rest_nodes[:, 2].max())
        return Start(
            goal=(side * size * np.cos(angle))[:, None] * across + (size * np.sin(angle))[:, None] * along,
            tool_position=np.column_stack([start, top + clearance - setting.tool_low[2]]),
            drawn=np.column_stack([place, height]),
        )

    def check_goal(self, goal: FloatArray) -> None:
        """Check a goal (2,) that was not drawn by `sample`.

        Raises:
            ValueError: If its size or its direction is outside the configured range.
        """
        least, greatest = self.config.shift_range
        _, across, _ = self._fold(self.setting.rest_nodes)
        size = float(np.hypot(*goal))
        if not least <= size <= greatest:
            raise ValueError(f"goal must be a displacement of {least} to {greatest} m, got {goal}")
        if abs(float(goal @ across)) < size * np.cos(self.config.angle_limit) - 1e-12:
            raise ValueError(
                f"goal must lead across the fold, along {across} or against it, or be turned away from that by "
                f"{self.config.angle_limit} rad at most; got {goal}"
            )

    def new_memory(self, count: int) -> Memory:
        """Allocate the memory of the patch, which is determined on the organ at rest.

        Returns:
            "weights" (W, V) weight of each node in the patch, "rest" (W, 3) the patch's middle [m], and "inwards" (W,
            2) the direction across the fold in which the patch's flank is pushed.
        """
        return {
            "weights": np.zeros((count, len(self.setting.rest_nodes))),
            "rest": np.zeros((count, 3)),
            "inwards": np.zeros((count, 2)),
        }

    def begin_memory(self, memory: Memory, rows: IntArray, start: Start, settings: Sequence[Setting]) -> None:
        """See `Task`: determines the patch on the organ at rest."""
        assert start.drawn is not None
        for row, goal, (place, height), setting in zip(rows, start.goal, start.drawn, settings, strict=True):
            nodes, weights = self._patch(setting.rest_nodes, goal, place, height)
            memory["weights"][row] = 0.0
            memory["weights"][row, nodes] = weights
            memory["rest"][row] = weights @ setting.rest_nodes[nodes]
            _, across, _ = self._fold(setting.rest_nodes)
            memory["inwards"][row] = np.sign(goal @ across) * across

    def evaluate(self, situation: Situation, goal: FloatArray, memory: Memory) -> Evaluation:
        """See `Task`.

        Returns:
            Reward terms "reach", "shift", "hold", "force" and "action"; what was achieved; the measures "shift", the
            horizontal distance of the patch from its position at rest [m], "shift_error" [m], and "pushing", whether
            the displacement counts, 0 or 1; the parts "patch_position" and "patch_shift" [m].
        """
        config = self.config
        # A matrix product per world, which is faster than einsum.
        patch = (memory["weights"][:, None, :] @ situation.nodes)[:, 0]
        shift = patch - memory["rest"]
        pushing = self._pushes(situation, patch, memory["inwards"])
        achieved, error, within = self.compare(np.where(pushing[:, None], shift[:, :2], 0.0), goal)
        shift_error = np.hypot(error[:, 0], error[:, 1])

        scale = situation.tool_scale
        direction = goal / np.maximum(np.hypot(goal[:, 0], goal[:, 1]), 1e-9)[:, None]
        wanted = patch.copy()
        wanted[:, :2] -= (scale * self._half_thickness)[:, None] * direction
        wanted[:, 2] -= config.edge_depth + (
            situation.lowest_corner(self.setting.tools[0]) - situation.tool_position[:, 2]
        )
        distance = np.sqrt(((situation.tool_position - wanted) ** 2).sum(axis=1))
        return Evaluation(
            terms={
                "reach": closeness(distance, config.reach_scale),
                "shift": closeness(shift_error, config.shift_scale),
                "hold": within.astype(np.float64),
                "force": situation.force,
                "action": situation.effort,
            },
            achieved=achieved,
            error=error,
            within_tolerance=within,
            measures={
                "shift": np.hypot(shift[:, 0], shift[:, 1]),
                "shift_error": shift_error,
                "pushing": pushing.astype(np.float64),
            },
            parts={"patch_position": patch, "patch_shift": shift},
        )

    def fulfils(self, achieved: FloatArray, desired: FloatArray) -> BoolArray:
        """Whether displacements (..., 2) are within tolerance of the desired ones (..., 2) [m]."""
        error = desired - achieved
        return np.asarray(np.hypot(error[..., 0], error[..., 1]) <= self.config.tolerance)

    def criteria(self, achieved: FloatArray, goal: FloatArray) -> tuple[Criterion, ...]:
        """See `Task`."""
        distance = float(np.hypot(*(goal - achieved)))
        return (Criterion.at_most("patch to its goal", "m", distance, self.config.tolerance),)

    def marks(
        self, goal: FloatArray, situation: Situation | None = None, memory: Memory | None = None
    ) -> tuple[Mark, ...]:
        """The patch, and the path of its middle from rest to the goal; nothing if the patch is unknown."""
        if memory is None:
            return ()
        weights, rest = memory["weights"][0], memory["rest"][0]
        end = rest + np.array([goal[0], goal[1], 0.0])
        return (
            Patch(np.flatnonzero(weights > 0.0), "target"),
            Path(np.array([rest, end])),
            Points(end[None]),
        )

    def patches(self, goals: FloatArray, situation: Situation, memory: Memory) -> dict[str, BoolArray]:
        """The patch of each world."""
        return {"target": memory["weights"] > 0.0}

    def _pushes(self, situation: Situation, patch: FloatArray, inwards: FloatArray) -> BoolArray:
        """(W,) whether blades push against the flanks beside patches with middles (W, 3).

        A blade that drags the fold along from above is pushed up about as much as it is pushed back, or more, however
        deep it is; a blade beside the fold is hardly pushed up.
        """
        push = -(situation.contact_force[:, :2] * inwards).sum(axis=1)
        edge = situation.lowest_corner(self.setting.tools[0])
        return np.asarray(
            (push >= np.maximum(self.config.least_push, 2.0 * situation.contact_force[:, 2]))
            & (patch[:, 2] - edge >= self.config.least_overlap),
            dtype=np.bool_,
        )

    def _read_organ(self) -> None:
        """Read the parts of the organ that the task needs.

        Raises:
            ValueError: If the organ is no `RidgedBlock`.
        """
        organ, nodes = organ_with_parts(self.setting, RidgedBlock, "flanks", "crest"), self.setting.rest_nodes
        first, second = (np.array(flank, dtype=np.int64) for flank in organ.flanks)
        self._flanks: tuple[IntArray, IntArray] = (first, second)
        middle, across, _ = self._fold(nodes)
        crest = np.array(organ.crest, dtype=np.int64)
        place = (nodes[crest, :2] - middle) @ across
        # Nodes where patches can be: a flank, and its half of the crest.
        self._sides = (np.union1d(first, crest[place > 0.0]), np.union1d(second, crest[place < 0.0]))

    def _fold(self, nodes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """For an organ (V, 3): the fold's middle (2,) [m], and the directions (2,) across it and along it."""
        first, second = (nodes[flank].mean(axis=0)[:2] for flank in self._flanks)
        across = (first - second) / np.linalg.norm(first - second)
        return 0.5 * (first + second), across, np.array([-across[1], across[0]])

    def _patch(self, nodes: FloatArray, goal: FloatArray, place: float, height: float) -> tuple[IntArray, FloatArray]:
        """Nodes (K,) of a patch and their weights (K,), which sum to one."""
        middle, across, along = self._fold(nodes)
        # A push from the second flank towards the first touches the second flank.
        side = self._sides[1] if goal @ across > 0.0 else self._sides[0]
        points = nodes[side]
        sideways = (points[:, :2] - middle) @ along - place
        low, high = nodes[self._flanks[0], 2].min(), points[:, 2].max()
        upwards = points[:, 2] - (low + height * (high - low))
        distance = np.hypot(sideways, upwards)
        radius = max(self.config.patch_radius, 1.2 * float(distance.min()))
        weights = np.maximum(1.0 - (distance / radius) ** 2, 0.0) ** 2
        kept = weights > 0.0
        return side[kept], weights[kept] / weights.sum()

    def _check_reach(self) -> None:
        config, setting = self.config, self.setting
        middle, across, along = self._fold(setting.rest_nodes)
        corners = [
            middle + x * config.start_offset[0] * across + y * config.start_offset[1] * along
            for x in (-1.0, 1.0)
            for y in (-1.0, 1.0)
        ]
        if (corners < setting.workspace_low[:2]).any() or (corners > setting.workspace_high[:2]).any():
            raise ValueError(
                f"start_offset must keep the blade in the workspace, {setting.workspace_low[:2]} to "
                f"{setting.workspace_high[:2]} m; got {config.start_offset}"
            )


def _check_pair(value: Any, name: str) -> tuple[float, float]:
    """Convert to two finite non-negative numbers, as a tuple of floats."""
    first, second = as_pair(value, name, "(across, along)")
    if first < 0.0 or second < 0.0:
        raise ValueError(f"{name} must be two finite numbers of zero or more, got {value!r}")
    return first, second
