"""The clamp task: grip a ridge between two jaws, lift it, and hold it up without letting it slip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from spatula_env.arrays import BoolArray, FloatArray, IntArray
from spatula_env.geometry.blocks import RidgedBlock
from spatula_env.geometry.rotations import conjugate, turn
from spatula_env.tasks.base import Evaluation, Memory, PartSpec, Task, closeness
from spatula_env.tasks.configuration import TaskConfig, Weights
from spatula_env.tasks.criteria import Criterion
from spatula_env.tasks.marks import Mark, Patch, Path
from spatula_env.tasks.organs import organ_with_parts
from spatula_env.tasks.situation import Setting, Situation, Start

LEAST_LIFT, GREATEST_LIFT = -0.03, 0.08
"""Limits of a measured lift [m]: a ridge that is pushed down, and one at the top of the workspace."""

GREATEST_SLIP = 0.02
"""Greatest slip that is reported [m]; also reported while nothing is gripped."""

GREATEST_OFFSET = 0.12
"""Greatest component of the vector from the grip to the ridge that is reported [m]."""


@dataclass(frozen=True)
class ClampWeights(Weights):
    """Weights of the reward terms of `ClampTask`.

    Attributes:
        reach: Weight of the closeness of the grip to the ridge's middle, 0..1.
        grip: Weight of both jaws touching the ridge, 0 or 1.
        lift: Weight of "grip" times the closeness of the lift to the goal's, 0..1.
        slip: Weight of the slip of what is gripped [1/m].
        force: Weight of the sum of the magnitudes of the two jaws' contact forces [1/N].
    """

    reach: float = 0.15
    grip: float = 0.1
    lift: float = 0.25
    hold: float = 0.5
    slip: float = -10.0
    force: float = -0.1
    action: float = -0.01


@dataclass(frozen=True)
class ClampConfig(TaskConfig):
    """Configuration of the clamp task.

    Attributes:
        lift_range: Least and greatest lift of the ridge that is asked for [m].
        slip_range: Least and greatest slip that a goal allows [m].
        lift_tolerance: Allowed difference of the lift from the goal's [m].
        grip_force_range: Least and greatest force with which each jaw may press on the ridge [N].
        hold_time: Time for which the ridge must be held there without interruption [s].
        start_offset: The grip starts within this distance of the ridge's middle, along each horizontal axis [m].
        start_height_range: Least and greatest height of the jaws' lower edges above the ridge's crest at the start [m].
        start_opening_range: Least and greatest free width between the jaws at the start [m].
        reach_scale: Distance to the ridge's middle at which the reward term "reach" is 0.24 [m].
        lift_scale: Error of the lift at which its closeness is 0.24 [m].
        loading_limit: Rate at which the force on a tool may grow without causing a cost [N/s].
        cost_budget: Greatest cost of an episode with which success counts as safe [s].
    """

    lift_range: tuple[float, float] = (0.004, 0.012)
    slip_range: tuple[float, float] = (0.001, 0.002)
    lift_tolerance: float = 0.001
    grip_force_range: tuple[float, float] = (0.08, 0.25)
    hold_time: float = 0.5
    start_offset: float = 0.008
    start_height_range: tuple[float, float] = (0.002, 0.012)
    start_opening_range: tuple[float, float] = (0.02, 0.03)
    reach_scale: float = 0.015
    lift_scale: float = 0.005
    loading_limit: float = 1.2
    cost_budget: float = 0.02
    weights: ClampWeights = field(default_factory=ClampWeights)

    def __post_init__(self) -> None:
        """Check the values; convert lists and mappings from a file."""
        self._check_not_negative("start_offset")
        self._check_positive("lift_tolerance", "hold_time", "reach_scale", "lift_scale")
        self._read_ranges("lift_range", "slip_range")
        self._read_ranges("start_height_range", "start_opening_range", "grip_force_range", not_negative=True)
        if self.lift_range[0] <= self.lift_tolerance:
            raise ValueError(
                f"lift_range must begin above lift_tolerance, {self.lift_tolerance}, or the organ at rest would be "
                f"high enough; got {self.lift_range}"
            )
        if self.lift_range[1] > GREATEST_LIFT:
            raise ValueError(f"lift_range must end at {GREATEST_LIFT} m at most, got {self.lift_range}")
        if not 0.0 <= self.slip_range[0] <= self.slip_range[1] < GREATEST_SLIP:
            raise ValueError(f"slip_range must lie from 0 to below {GREATEST_SLIP} m, got {self.slip_range}")
        self._check_positive("loading_limit")
        self._check_not_negative("cost_budget")
        self._read_weights(ClampWeights)


class ClampTask(Task):
    """Evaluates how the ridge is gripped and lifted.

    A goal is (lift, slip): the lift of the ridge, and the greatest slip allowed. The lift is measured on the organ: it
    is the mean height of the nodes of the ridge's crest above their height at rest.

    A grip begins when both jaws touch the organ with the faces that they turn to each other, and ends when neither
    does. Its slip is the distance that the part of the ridge that was between the jaws when the grip began has since
    moved along their faces, in the frame of the first jaw. While not both jaws touch, or the force of a jaw is outside
    the range of grip forces, the slip counts as the greatest possible: neither a loose nor a crushing grip holds. The
    goal is fulfilled if the lift is right within a tolerance and the slip is no greater than allowed.
    """

    description = (
        "Grip the ridge between the jaws, lift it by the given height without letting it slip, and hold it there."
    )
    goal_names = ("lift", "slip")
    goal_units = ("m", "m")
    definition = 2

    def __init__(self, config: ClampConfig, setting: Setting) -> None:
        """Prepare the task for a setting.

        Args:
            config: Configuration of the task.
            setting: Setting with an organ that is a `RidgedBlock`, and two tools that face each other.

        Raises:
            ValueError: If the organ has no ridge, there are not two tools, or a goal or a start is out of reach.
        """
        if len(setting.tools) != 2:
            raise ValueError(f"setting.tools must be two jaws, got {len(setting.tools)}")
        super().__init__(config, setting, [LEAST_LIFT, 0.0], [GREATEST_LIFT, GREATEST_SLIP])
        self.config = config
        self.extra_parts = (PartSpec("ridge_offset", "m", np.full(3, -GREATEST_OFFSET), np.full(3, GREATEST_OFFSET)),)
        first, second = setting.tools
        away = second.offset - first.offset
        away = away / np.linalg.norm(away)
        self._inner = (first.face_towards(away), int(first.face.max()) + 1 + second.face_towards(-away))
        self._away = turn(conjugate(first.orientation), away)
        self._plane = _across(self._away)
        along = first.vertices @ self._plane.T
        self._middle, self._half = 0.5 * (along.max(axis=0) + along.min(axis=0)), 0.5 * np.ptp(along, axis=0)
        self._crest, self._flanks = self._read_ridge()
        middle = setting.rest_nodes[self._flanks, :2].mean(axis=0)
        self.check_room("start_offset", config.start_offset, middle)

    def sample(self, generator: np.random.Generator, count: int, setting: Setting) -> Start:
        """Draw the beginnings of episodes: everything is uniform in its range.

        Returns:
            Goals (W, 2), positions of the grip (W, 3) and widths between the jaws (W, 1) [m].
        """
        config = self.config
        lift = generator.uniform(*config.lift_range, size=count)
        slip = generator.uniform(*config.slip_range, size=count)
        offset = generator.uniform(-config.start_offset, config.start_offset, size=(count, 2))
        height = generator.uniform(*config.start_height_range, size=count)
        opening = generator.uniform(*config.start_opening_range, size=count)
        middle = setting.rest_nodes[self._flanks, :2].mean(axis=0)
        grip = np.column_stack([middle + offset, self._top(setting) + height - setting.tool_low[2]])
        return Start(goal=np.column_stack([lift, slip]), tool_position=grip, control=opening[:, None])

    def check_goal(self, goal: FloatArray) -> None:
        """Check a goal (2,) that was not drawn by `sample`.

        Raises:
            ValueError: If its lift or its slip is not allowed.
        """
        least, greatest = self.config.lift_range
        if not least <= goal[0] <= greatest:
            raise ValueError(f"goal must have a lift from {least} to {greatest} m, got {goal[0]}")
        if not 0.0 <= goal[1] < GREATEST_SLIP:
            raise ValueError(f"goal must have a slip from 0 to below {GREATEST_SLIP} m, got {goal[1]}")

    def new_memory(self, count: int) -> Memory:
        """Allocate the memory of a grip.

        Returns:
            "gripped" (W,) whether a grip has begun; "between" (W, n) which of the ridge's n nodes were between the jaws
            when it began, and "reference" (W, 2) their mean position at that time in the plane of the jaws' faces [m].
        """
        return {
            "gripped": np.zeros(count, dtype=np.bool_),
            "between": np.zeros((count, len(self._flanks)), dtype=np.bool_),
            "reference": np.zeros((count, 2)),
        }

    def begin_memory(self, memory: Memory, rows: IntArray, start: Start, settings: Sequence[Setting]) -> None:
        """See `Task`: nothing is gripped."""
        memory["gripped"][rows] = False

    def evaluate(self, situation: Situation, goal: FloatArray, memory: Memory) -> Evaluation:
        """See `Task`.

        Returns:
            Reward terms "reach", "grip", "lift", "hold", "slip", "force" and "action"; what was achieved; the measures
            "lift", "lift_error" and "slip" [m], "gripped", 0 or 1, and "grip_force", that of the jaw that presses less
            [N]; and the part "ridge_offset", from the grip to the middle of the ridge's flanks [m].
        """
        config = self.config
        nodes, rest = situation.nodes, situation.rest_nodes
        lift = (nodes[:, self._crest, 2] - rest[:, self._crest, 2]).mean(axis=1)
        slip, gripped = self._slip(situation, memory)
        least, greatest = self._grip_forces(situation)
        allowed = (least >= config.grip_force_range[0]) & (greatest <= config.grip_force_range[1])
        held = np.where(allowed, slip, GREATEST_SLIP)
        achieved, error, within = self.compare(np.column_stack([lift, held]), goal)

        offset = nodes[:, self._flanks].mean(axis=1) - situation.tool_position
        lift_error = np.abs(error[:, 0])
        forces = np.sqrt((situation.contact_forces**2).sum(axis=2)).sum(axis=1)
        return Evaluation(
            terms={
                "reach": closeness(np.sqrt((offset**2).sum(axis=1)), config.reach_scale),
                "grip": gripped,
                "lift": gripped * closeness(lift_error, config.lift_scale),
                "hold": within.astype(np.float64),
                "slip": gripped * slip,
                "force": forces,
                "action": situation.effort,
            },
            achieved=achieved,
            error=error,
            within_tolerance=within,
            measures={
                "lift": achieved[:, 0],
                "lift_error": lift_error,
                "slip": slip,
                "gripped": gripped,
                "grip_force": least,
            },
            parts={"ridge_offset": offset},
        )

    def fulfils(self, achieved: FloatArray, desired: FloatArray) -> BoolArray:
        """Whether the lift is right and the slip is no greater than desired, (..., 2) each [m]."""
        error = desired - achieved
        return np.asarray((np.abs(error[..., 0]) <= self.config.lift_tolerance) & (error[..., 1] >= 0.0))

    def criteria(self, achieved: FloatArray, goal: FloatArray) -> tuple[Criterion, ...]:
        """See `Task`."""
        slip = float(achieved[1])
        note = "no grip" if slip >= float(self.goal_high[1]) else ""
        return (
            Criterion.near("lift", "m", float(achieved[0]), float(goal[0]), self.config.lift_tolerance),
            Criterion.at_most("slip", "m", slip, float(goal[1]), note),
        )

    def marks(
        self, goal: FloatArray, situation: Situation | None = None, memory: Memory | None = None
    ) -> tuple[Mark, ...]:
        """The ridge's crest, and a line along the ridge at the height that its top is to have."""
        rest = (self.setting.rest_nodes[None] if situation is None else situation.rest_nodes)[0, self._crest]
        ends = np.array([rest[np.argmin(rest[:, 0])], rest[np.argmax(rest[:, 0])]])
        ends[:, 2] = rest[:, 2].max() + goal[0]
        return Patch(self._crest), Path(ends)

    def patches(self, goals: FloatArray, situation: Situation, memory: Memory) -> dict[str, BoolArray]:
        """The ridge's crest."""
        dyed = np.zeros(situation.nodes.shape[:2], dtype=np.bool_)
        dyed[:, self._crest] = True
        return {"target": dyed}

    def _read_ridge(self) -> tuple[IntArray, IntArray]:
        """Nodes of the ridge's crest, and those of its flanks.

        Raises:
            ValueError: If the organ is no `RidgedBlock`.
        """
        organ = organ_with_parts(self.setting, RidgedBlock, "flanks", "crest")
        return organ.crest.astype(np.int64), np.concatenate(organ.flanks).astype(np.int64)

    def _top(self, setting: Setting) -> float:
        """Height above which the jaws start on the organ of a setting [m]."""
        return float(setting.rest_nodes[self._crest, 2].max())

    def _grip_forces(self, situation: Situation) -> tuple[FloatArray, FloatArray]:
        """Forces with which the jaws press on the ridge: the smaller one (W,) and the greater one (W,) [N]."""
        away = turn(situation.tool_orientation, self._away)
        # The organ pushes the two jaws away from each other.
        first, second = situation.contact_forces[:, 0], situation.contact_forces[:, 1]
        forces = np.stack([-(first * away).sum(axis=1), (second * away).sum(axis=1)])
        return forces.min(axis=0), forces.max(axis=0)

    def _slip(self, situation: Situation, memory: Memory) -> tuple[FloatArray, FloatArray]:
        """Slip of what is gripped (W,) [m], and whether anything is gripped (W,), 0 or 1."""
        first, second = (situation.contact_share[:, face] > 0.0 for face in self._inner)
        gripped = first & second
        # Coordinates of the ridge's nodes in the plane of the jaws' faces, relative to the grip, in the first jaw's
        # frame.
        away = situation.nodes[:, self._flanks] - situation.tool_position[:, None]
        seen = turn(conjugate(situation.tool_orientation)[:, None], away) @ self._plane.T
        half = situation.tool_scale[:, None, None] * self._half
        between = (np.abs(seen - self._middle) <= half).all(axis=2)
        # Jaws that touch the ridge only with their rims have none of its nodes between them: then count all nodes.
        between |= ~between.any(axis=1, keepdims=True)
        beginning = gripped & ~memory["gripped"]
        memory["between"][beginning] = between[beginning]
        # A jaw that loses contact for a moment must not reset the slip.
        memory["gripped"][:] = gripped | (memory["gripped"] & (first | second))
        weights = memory["between"] / np.maximum(memory["between"].sum(axis=1, keepdims=True), 1)
        place = (weights[:, :, None] * seen).sum(axis=1)
        memory["reference"][beginning] = place[beginning]
        slip = np.sqrt(((place - memory["reference"]) ** 2).sum(axis=1))
        return np.where(gripped, np.minimum(slip, GREATEST_SLIP), GREATEST_SLIP), gripped.astype(np.float64)


def _across(direction: FloatArray) -> FloatArray:
    """(2, 3) two unit vectors perpendicular to a direction (3,) and to each other."""
    axis = np.zeros(3)
    axis[np.argmin(np.abs(direction))] = 1.0
    first = np.cross(direction, axis)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])
