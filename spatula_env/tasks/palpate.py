"""The palpation task: slide along a path on the organ, with a normal force in a band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from spatula_env.arrays import BoolArray, FloatArray, IntArray
from spatula_env.geometry.rotations import turn
from spatula_env.tasks.base import Evaluation, Memory, PartSpec, Task, closeness, sample_disc
from spatula_env.tasks.configuration import TaskConfig, Weights
from spatula_env.tasks.criteria import Criterion
from spatula_env.tasks.marks import Mark, Path, Ring
from spatula_env.tasks.pressure_centre import centre_of_pressure
from spatula_env.tasks.situation import Setting, Situation, Start
from spatula_env.tasks.surface import points_on_top

PIECES = 40
"""Number of pieces of equal length into which a path is divided; each counts as felt or not."""

TENTHS = 10
"""Number of parts of the path for which it is observed how much has been felt."""

AHEAD = (0.0, 0.125, 0.25, 0.375, 0.5)
"""Observed points of the path: distances ahead of the spatula's progress, as shares of the path's length."""

GREATEST_OFFSET = 0.09
"""Greatest component of the vector from the spatula to points of the path that is observed [m]."""

GREATEST_NORMAL_FORCE = 1.0
"""Greatest magnitude of a normal force that is reported [N]."""

LEAST_FORCE = 0.01
"""Normal force below which the spatula counts as touching nothing [N]."""

MARK_HEIGHT = 0.001
"""Height above the organ at rest at which the path is drawn [m]."""


@dataclass(frozen=True)
class PalpateWeights(Weights):
    """Weights of the reward terms of `PalpateTask`.

    Attributes:
        reach: Weight of the closeness of the spatula's underside to the point of the path that it has reached, 0..1.
        force: Weight of the closeness of the normal force to the middle of the band, while on the path, 0..1.
        felt: Weight of the share of the path that has been felt, relative to the share asked for, 0..1.
    """

    reach: float = 0.1
    force: float = 0.1
    felt: float = 0.3
    hold: float = 0.5
    action: float = -0.01


@dataclass(frozen=True)
class PalpateConfig(TaskConfig):
    """Configuration of the palpation task.

    Attributes:
        middle_radius: Greatest distance of the midpoint between the path's ends from the organ's axis [m].
        length_range: Least and greatest distance of the path's ends, seen from above [m].
        bend_limit: Greatest distance of the path from the straight line at its middle, to either side [m].
        force_range: Least and greatest middle of the force band [N].
        force_tolerance: Half the width of the band [N].
        share_range: Least and greatest share of the path that has to be felt.
        path_tolerance: Allowed horizontal distance of the centre of pressure from the path [m].
        end_tolerance: Allowed horizontal distance of the centre of pressure from the path's end, at the end [m].
        hold_time: Time for which it must stay there, with a force in the band, without interruption [s].
        start_radius: The spatula starts within this horizontal distance of the path's beginning [m].
        start_height_range: Least and greatest height of its underside above the organ's top at the start [m].
        reach_scale: Distance at which the reward term "reach" is 0.24 [m].
        force_scale: Error of the force at which the term "force" is 0.24 [N].
        loading_limit: Rate at which the force on a tool may grow without causing a cost [N/s].
        cost_budget: Greatest cost of an episode with which success counts as safe [s].
    """

    middle_radius: float = 0.004
    length_range: tuple[float, float] = (0.03, 0.04)
    bend_limit: float = 0.004
    force_range: tuple[float, float] = (0.1, 0.18)
    force_tolerance: float = 0.03
    share_range: tuple[float, float] = (0.8, 0.9)
    path_tolerance: float = 0.003
    end_tolerance: float = 0.002
    hold_time: float = 0.5
    start_radius: float = 0.01
    start_height_range: tuple[float, float] = (0.005, 0.015)
    reach_scale: float = 0.02
    force_scale: float = 0.1
    loading_limit: float = 1.8
    cost_budget: float = 0.02
    weights: PalpateWeights = field(default_factory=PalpateWeights)

    def __post_init__(self) -> None:
        """Check the values; convert lists and mappings from a file."""
        self._check_not_negative("middle_radius", "bend_limit", "start_radius")
        self._check_positive(
            "force_tolerance", "path_tolerance", "end_tolerance", "hold_time", "reach_scale", "force_scale"
        )
        self._read_ranges("length_range", "force_range", "share_range")
        self._read_ranges("start_height_range", not_negative=True)
        if self.length_range[0] <= 2.0 * self.end_tolerance:
            raise ValueError(
                f"length_range must begin above twice end_tolerance, {self.end_tolerance}, or a path could begin where "
                f"it ends; got {self.length_range}"
            )
        if self.bend_limit > 0.25 * self.length_range[0]:
            raise ValueError(
                f"bend_limit must be a quarter of the shortest path, {self.length_range[0]}, at most; "
                f"got {self.bend_limit!r}"
            )
        if self.force_range[0] <= self.force_tolerance or self.force_range[1] > GREATEST_NORMAL_FORCE:
            raise ValueError(
                f"force_range must begin above force_tolerance, {self.force_tolerance}, or touching nothing would be "
                f"in the band, and end at {GREATEST_NORMAL_FORCE} at most; got {self.force_range}"
            )
        if not (0.0 < self.share_range[0] and self.share_range[1] <= 1.0):
            raise ValueError(f"share_range must be above 0 and 1 at most, got {self.share_range}")
        self._check_positive("loading_limit")
        self._check_not_negative("cost_budget")
        self._read_weights(PalpateWeights)


class PalpateTask(Task):
    """Evaluates a palpation.

    A goal is (share, x, y, force): the share of the path to be felt, the position of the path's end, and the middle of
    the band of the normal force. A piece of the path is felt once the centre of pressure has passed over it, no farther
    to the side than the tolerance, with a normal force in the band in this control step and, if it comes from another
    piece, in the previous one. Order and number of passes do not matter. The normal force is the component of the
    contact force perpendicular to the spatula's faces, and the centre of pressure is the point where it acts. The path
    is on the organ, and moves with it.

    What is achieved is the share felt so far, the centre of pressure (the middle of the lower face if it touches
    nothing) relative to the present position of the path's end, and the normal force. The share was felt along the
    episode's path, in the episode's band, so it is unknown for the other goals of hindsight replay.

    Attributes:
        config: Configuration of the task.
    """

    description = (
        "Slide the spatula along the path with a normal force in the given band until the given "
        "share of it is felt, and stay at its end."
    )
    goal_names = ("share", "x", "y", "force")
    goal_units = ("1", "m", "m", "N")
    hindsight = False
    definition = 2

    def __init__(self, config: PalpateConfig, setting: Setting) -> None:
        """Prepare the task for a setting.

        Args:
            config: Configuration of the task.
            setting: Setting of the task.

        Raises:
            ValueError: If a path or a start is out of the tool's reach.
        """
        low, high = setting.workspace_low, setting.workspace_high
        super().__init__(
            config,
            setting,
            [0.0, low[0], low[1], -GREATEST_NORMAL_FORCE],
            [1.0, high[0], high[1], GREATEST_NORMAL_FORCE],
        )
        self.config = config
        plate = setting.tools[0].vertices
        self._plate = (plate.min(axis=0), plate.max(axis=0))
        count = 3 * len(AHEAD)
        self.extra_parts = (
            PartSpec("path_ahead", "m", np.full(count, -GREATEST_OFFSET), np.full(count, GREATEST_OFFSET)),
            PartSpec("progress", "1", np.zeros(1), np.ones(1)),
            PartSpec("felt", "1", np.zeros(TENTHS), np.ones(TENTHS)),
            PartSpec(
                "normal_force", "N", np.full(1, -GREATEST_NORMAL_FORCE), np.full(1, GREATEST_NORMAL_FORCE), sensed=True
            ),
        )
        self._check_reach()

    def sample(self, generator: np.random.Generator, count: int, setting: Setting) -> Start:
        """Draw the beginnings of episodes: places uniform in discs, directions on the circle, the rest in their ranges.

        Returns:
            Goals (W, 4) and tool positions (W, 3) [m]; drawn (W, 3) holds the vector from the path's end to its
            beginning [m], and the distance by which the path bends to the left of that [m].
        """
        config = self.config
        share = generator.uniform(*config.share_range, size=count)
        force = generator.uniform(*config.force_range, size=count)
        length = generator.uniform(*config.length_range, size=count)
        angle = generator.uniform(0.0, 2.0 * np.pi, size=count)
        bend = generator.uniform(-config.bend_limit, config.bend_limit, size=count)
        middle = setting.organ_position[:2] + sample_disc(generator, config.middle_radius, count)
        aside = sample_disc(generator, config.start_radius, count)
        height = generator.uniform(*config.start_height_range, size=count)
        way = length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        underside = setting.rest_nodes[:, 2].max() + height
        return Start(
            goal=np.column_stack([share, middle - 0.5 * way, force]),
            tool_position=np.column_stack([middle + 0.5 * way + aside, underside - setting.tool_low[2]]),
            drawn=np.column_stack([way, bend]),
        )

    def check_goal(self, goal: FloatArray) -> None:
        """Check a goal (4,) that was not drawn by `sample`.

        Raises:
            ValueError: If it is out of the configured ranges.
        """
        self._check_share_and_force(goal)
        config = self.config
        farthest = config.middle_radius + 0.5 * config.length_range[1]
        distance = float(np.hypot(*(goal[1:3] - self.setting.organ_position[:2])))
        if distance > farthest + 1e-9:
            raise ValueError(
                f"goal must end the path {farthest:.4f} m from the organ's axis at most, got {distance:.4f}"
            )

    def new_memory(self, count: int) -> Memory:
        """Allocate the memory of paths and of what has been felt.

        Returns:
            "path" (W, P + 1, 3) corners of the path's P pieces, on the organ at rest [m]; "nodes" (W, P + 1, 3) nodes
            of the triangles that they lie on, and "shares" (W, P + 1, 3) their weights; "felt" (W, P) whether each
            piece has been felt; "progress" (W,) the farthest place on the path that has been felt, in pieces; "last"
            (W,) the place in the previous step, in pieces, and "was_feeling" (W,) whether the path was felt then.
        """
        return {
            "path": np.zeros((count, PIECES + 1, 3)),
            "nodes": np.zeros((count, PIECES + 1, 3), dtype=np.int64),
            "shares": np.zeros((count, PIECES + 1, 3)),
            "felt": np.zeros((count, PIECES), dtype=np.bool_),
            "progress": np.zeros(count),
            "last": np.zeros(count),
            "was_feeling": np.zeros(count, dtype=np.bool_),
        }

    def begin_memory(self, memory: Memory, rows: IntArray, start: Start, settings: Sequence[Setting]) -> None:
        """See `Task`: lays the paths on the organ at rest."""
        assert start.drawn is not None
        for row, goal, drawn, setting in zip(rows, start.goal, start.drawn, settings, strict=True):
            path = memory["path"][row] = self._path(goal[1:3], self._way(goal, drawn, setting), drawn[2], setting)
            memory["nodes"][row], memory["shares"][row] = points_on_top(setting.rest_nodes, setting.triangles, path)
        memory["felt"][rows] = False
        memory["progress"][rows], memory["last"][rows], memory["was_feeling"][rows] = 0.0, 0.0, False

    def evaluate(self, situation: Situation, goal: FloatArray, memory: Memory) -> Evaluation:
        """Evaluate a situation, and remember what has been felt.

        Returns:
            Reward terms "reach", "force", "felt", "hold" and "action"; what was achieved; the measures "share",
            "progress", "normal_force" and "force_error" [N], "path_distance" of the centre of pressure [m] and
            "end_distance" [m]; the parts "path_ahead" [m], "progress", "felt" and "normal_force" [N].
        """
        config = self.config
        centre, force, touching = centre_of_pressure(situation, *self._plate, LEAST_FORCE)
        force_error = np.abs(goal[:, 3] - force)
        path = _present_path(memory, situation)
        along, aside = _project(path[:, :, :2], centre[:, :2])
        self._feel(memory, along, aside, force_error)
        share = memory["felt"].mean(axis=1)

        # Subtract the displacement of the organ's surface at the path's end, as if it were where it was at rest.
        place = centre[:, :2] - (path[:, -1, :2] - memory["path"][:, -1, :2])
        measured = np.column_stack([share, place, force])
        achieved, error, within = self.compare(measured, goal)

        below = np.outer(situation.tool_scale * self._plate[0][2], [0.0, 0.0, 1.0])
        underside = situation.tool_position + turn(situation.tool_orientation, below)
        ahead = np.minimum(memory["progress"][:, None] + PIECES * np.array(AHEAD), PIECES)
        offsets = points_at(path, ahead) - underside[:, None]
        distance = np.sqrt((offsets[:, 0] ** 2).sum(axis=1))
        return Evaluation(
            terms={
                "reach": closeness(distance, config.reach_scale),
                "force": closeness(force_error, config.force_scale) * closeness(aside, config.path_tolerance),
                "felt": np.minimum(share / np.maximum(goal[:, 0], 1e-9), 1.0),
                "hold": within.astype(np.float64),
                "action": situation.effort,
            },
            achieved=achieved,
            error=error,
            within_tolerance=within,
            measures={
                "share": share,
                "progress": memory["progress"] / PIECES,
                "normal_force": force,
                "force_error": force_error,
                "path_distance": np.where(touching, aside, np.hypot(offsets[:, 0, 0], offsets[:, 0, 1])),
                "end_distance": np.hypot(error[:, 1], error[:, 2]),
            },
            parts={
                "path_ahead": offsets.reshape(len(goal), -1),
                "progress": memory["progress"][:, None] / PIECES,
                "felt": memory["felt"].reshape(len(goal), TENTHS, -1).mean(axis=2),
                "normal_force": force[:, None],
            },
        )

    def fulfils(self, achieved: FloatArray, desired: FloatArray) -> BoolArray:
        """Whether enough has been felt, the spatula is at the end, and the force is in the band, (..., 4) each."""
        error = desired - achieved
        return np.asarray(
            (error[..., 0] <= 0.0)
            & (np.hypot(error[..., 1], error[..., 2]) <= self.config.end_tolerance)
            & (np.abs(error[..., 3]) <= self.config.force_tolerance)
        )

    def criteria(self, achieved: FloatArray, goal: FloatArray) -> tuple[Criterion, ...]:
        """See `Task`."""
        end = float(np.hypot(*(goal[1:3] - achieved[1:3])))
        return (
            Criterion.at_least("path felt", "1", float(achieved[0]), float(goal[0])),
            Criterion.near("force", "N", float(achieved[3]), float(goal[3]), self.config.force_tolerance),
            Criterion.at_most("distance to end", "m", end, self.config.end_tolerance),
        )

    def marks(
        self, goal: FloatArray, situation: Situation | None = None, memory: Memory | None = None
    ) -> tuple[Mark, ...]:
        """The path, and a ring around its end; only the ring if the path is unknown."""
        if memory is None:
            height = self.setting.surface_heights(self.setting.rest_nodes[None], goal[None, 1:3])[0]
            return (Ring(np.array([*goal[1:3], height + MARK_HEIGHT]), self.config.end_tolerance),)
        path = memory["path"][0] if situation is None else _present_path(memory, situation)[0]
        path = path + np.array([0.0, 0.0, MARK_HEIGHT])
        return Path(path), Ring(path[-1], self.config.end_tolerance)

    def patches(self, goals: FloatArray, situation: Situation, memory: Memory) -> dict[str, BoolArray]:
        """None: nothing of the organ is dyed."""
        return {}

    def _check_share_and_force(self, goal: FloatArray) -> None:
        """Raise ValueError if the share or the force of a goal (4,) is out of its range."""
        for value, (least, greatest), what in (
            (goal[0], (0.0, 1.0), "a share"),
            (goal[3], self.config.force_range, "a force"),
        ):
            if not least <= value <= greatest:
                raise ValueError(f"goal must have {what} from {least} to {greatest}, got {value}")

    def _feel(self, memory: Memory, along: FloatArray, aside: FloatArray, force_error: FloatArray) -> None:
        """Record the pieces felt by pressing at places on paths (W,), at a distance (W,), with a force error (W,)."""
        feeling = (aside <= self.config.path_tolerance) & (force_error <= self.config.force_tolerance)
        last = np.where(memory["was_feeling"], memory["last"], along)
        first_piece = np.floor(np.minimum(last, along))[:, None]
        last_piece = np.floor(np.maximum(last, along))[:, None]
        piece = np.arange(PIECES)
        # At the very end of the path, the last piece counts.
        passed = (piece >= np.minimum(first_piece, PIECES - 1)) & (piece <= last_piece)
        memory["felt"] |= passed & feeling[:, None]
        memory["progress"][:] = np.where(feeling, np.maximum(memory["progress"], along), memory["progress"])
        memory["last"][:], memory["was_feeling"][:] = along, feeling

    def _way(self, goal: FloatArray, drawn: FloatArray, setting: Setting) -> FloatArray:
        """Vector (2,) from a path's end to its beginning [m].

        If a chosen end does not fit the direction that was drawn, the path approaches it over the organ's axis.
        """
        inwards, way = setting.organ_position[:2] - goal[1:3], drawn[:2]
        distance = float(np.hypot(*inwards))
        if np.hypot(*(0.5 * way - inwards)) > self.config.middle_radius + 1e-9 and distance > 0.0:
            return float(np.hypot(*way)) / distance * inwards
        return way

    def _path(self, end: FloatArray, way: FloatArray, bend: float, setting: Setting) -> FloatArray:
        """(P + 1, 3) corners of a path's pieces, which are of equal length as seen from above [m]."""
        part = np.linspace(0.0, 1.0, 4 * PIECES + 1)
        left = np.array([-way[1], way[0]]) / np.hypot(*way)
        places = end + (1.0 - part)[:, None] * way + (4.0 * bend * part * (1.0 - part))[:, None] * left
        length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
        wanted = np.linspace(0.0, length[-1], PIECES + 1)
        even = np.column_stack([np.interp(wanted, length, places[:, axis]) for axis in range(2)])
        return np.column_stack([even, self.setting.surface_heights(setting.rest_nodes[None], even)])

    def _check_reach(self) -> None:
        config = self.config
        widest = config.middle_radius + 0.5 * config.length_range[1] + config.start_radius
        end = self.setting.room_around((0.0, 0.0))
        if widest > end:
            raise ValueError(
                f"middle_radius, half of length_range and start_radius must not be more than {end:.4f} m together, "
                f"where the workspace ends; got {config.middle_radius}, {config.length_range} and "
                f"{config.start_radius}"
            )


def _present_path(memory: Memory, situation: Situation) -> FloatArray:
    """(W, P + 1, 3) present positions of the paths [m]; a corner that lies on no triangle stays where it is."""
    row = np.arange(len(situation.nodes))[:, None, None]
    rest = situation.rest_nodes[row if len(situation.rest_nodes) > 1 else 0, memory["nodes"]]
    moved = situation.nodes[row, memory["nodes"]] - rest
    return np.asarray(memory["path"] + (memory["shares"][..., None] * moved).sum(axis=2))


def _project(paths: FloatArray, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Project places (W, 2) onto paths (W, P + 1, 2): position along (W,), in pieces, and distance (W,) [m]."""
    start, step = paths[:, :-1], np.diff(paths, axis=1)
    square = np.maximum((step**2).sum(axis=2), 1e-18)
    part = np.clip(((places[:, None] - start) * step).sum(axis=2) / square, 0.0, 1.0)
    distance = np.sqrt(((start + part[:, :, None] * step - places[:, None]) ** 2).sum(axis=2))
    piece = distance.argmin(axis=1)
    row = np.arange(len(paths))
    return piece + part[row, piece], distance[row, piece]


def points_at(paths: FloatArray, along: FloatArray) -> FloatArray:
    """(W, K, 3) points of paths (W, P + 1, 3) at positions along them (W, K), in pieces."""
    piece = np.minimum(along.astype(np.int64), paths.shape[1] - 2)
    row = np.arange(len(paths))[:, None]
    start, end = paths[row, piece], paths[row, piece + 1]
    return np.asarray(start + (along - piece)[:, :, None] * (end - start))
