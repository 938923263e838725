"""The press task on an organ of one's own: along the normal of its surface, at any place that the spatula reaches."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from spatula_env.arrays import FloatArray, IntArray
from spatula_env.geometry.overlap import overlaps
from spatula_env.geometry.rotations import conjugate, turn
from spatula_env.tasks.base import Memory, PartSpec, sample_disc
from spatula_env.tasks.marks import Mark, Path, Ring
from spatula_env.tasks.places import (
    FEWEST_PLACES,
    Spots,
    judge_candidates,
    judge_places,
    local_heights,
    place_on,
    turned_to,
    upright,
)
from spatula_env.tasks.pose import moved_as_a_whole
from spatula_env.tasks.press import RING_RATIO, UPWARDS, PressConfig, PressTask, PressView
from spatula_env.tasks.situation import Setting, Situation, Start

UNDER_SPATULA = 0.5 * np.array([[x, y] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
"""Points under the spatula at which its depth is measured, of half its width."""

NEAREST_START = 0.003
"""Height above the surface at which the spatula has to be free, so that it can come down [m]."""


class PressAnywhereTask(PressTask):
    """Evaluates a press on an organ of any shape.

    It is `PressTask`, but for this: places are drawn from all of the organ that the spatula reaches from above, and at
    each of them it is pressed along the surface's normal, with the spatula turned to it. The depth is measured along
    the normal. What is achieved tells how far aside of the goal's place the spatula is by the distance within the
    plane across the normal, turned into the horizontal. Where the organ is thin, or held below, depths are smaller.

    The normal belongs to the goal's place, so that hindsight replay, which exchanges goals, does not apply.

    Attributes:
        places: The K places from which those of episodes are drawn.
        depths: (K,) greatest depths of presses there [m].
    """

    places: Spots
    depths: FloatArray

    hindsight = False

    def __init__(self, config: PressConfig, setting: Setting) -> None:
        """Find the places; see `PressTask`.

        Raises:
            ValueError: If there are too few; the message says why.
        """
        super().__init__(config, setting)
        low, high = setting.workspace_low, setting.workspace_high
        self.extra_parts = (
            PartSpec("place_position", "m", low, high, sensed=True),
            PartSpec("place_normal", "1", -np.ones(3), np.ones(3), sensed=True),
        )

    def sample(self, generator: np.random.Generator, count: int, setting: Setting) -> Start:
        """Draw the beginnings of episodes.

        Returns:
            Goals (W, 3) and tool positions (W, 3), which `arrange` replaces [m]; drawn (W, 3) holds the height of the
            spatula above the surface and its offset within the plane across the normal [m].
        """
        config = self.config
        chosen = generator.integers(len(self.depths), size=count)
        least, greatest = config.depth_range
        share = generator.uniform(size=count)
        depth = least + share * (np.minimum(greatest, self.depths[chosen]) - least)
        height = generator.uniform(*config.start_height_range, size=count)
        aside = sample_disc(generator, config.start_radius, count)
        return Start(
            goal=np.column_stack([self.places.some(chosen).on(setting.rest_nodes)[:, :2], depth]),
            tool_position=np.zeros((count, 3)),
            drawn=np.column_stack([height, aside]),
        )

    def arrange(self, start: Start, settings: Sequence[Setting], chosen: Collection[str]) -> Start:
        """See `Task`: the spatula is turned to the goal's place, and starts beside it where that is free.

        Returns:
            The start; drawn (W, 6) holds the goals' places on the surface at rest [m], and its normals there.
        """
        assert start.drawn is not None
        positions = np.array(start.tool_position)
        points, normals = np.empty((2, len(positions), 3))
        for row, (goal, drawn, setting) in enumerate(zip(start.goal, start.drawn, settings, strict=True)):
            points[row : row + 1], normals[row : row + 1] = place_on(setting, goal[None, :2], self._half_width)
            if not np.isfinite(normals[row]).all():
                # A chosen place may be beside an organ that was shifted at random.
                points[row], normals[row] = (*goal[:2], setting.ground_height), UPWARDS
            if "tool_position" not in chosen:
                positions[row] = self._free_start(points[row], normals[row], drawn, setting)
        return replace(
            start,
            tool_position=positions,
            tool_orientation=turned_to(normals, self.setting.tools[0].orientation),
            drawn=np.column_stack([points, normals]),
        )

    def check_goal(self, goal: FloatArray) -> None:
        """See `PressTask`; the place must be one that can be pressed that deep.

        Raises:
            ValueError: If it is not; the message says why.
        """
        super().check_goal(goal)
        depths, reasons = judge_places(self.setting, goal[None, :2], self.config.depth_range[0], self._heights_above)
        if reasons[0]:
            raise ValueError(f"goal must be at a place that can be pressed, got {goal[:2]}, where places {reasons[0]}")
        if goal[2] > depths[0]:
            raise ValueError(f"goal must have a depth of {depths[0]:.4f} m at most at {goal[:2]}, got {goal[2]}")

    def new_memory(self, count: int) -> Memory:
        """Allocate the memory: "point" (W, 3) of the goals' places [m], and "normal" (W, 3) of the surface there."""
        return {"point": np.zeros((count, 3)), "normal": np.tile(UPWARDS, (count, 1)), "depth": np.zeros(count)}

    def begin_memory(self, memory: Memory, rows: IntArray, start: Start, settings: Sequence[Setting]) -> None:
        """See `Task`."""
        assert start.drawn is not None
        memory["point"][rows], memory["normal"][rows] = start.drawn[:, :3], start.drawn[:, 3:]
        memory["depth"][rows] = start.goal[:, 2]

    def marks(
        self, goal: FloatArray, situation: Situation | None = None, memory: Memory | None = None
    ) -> tuple[Mark, ...]:
        """See `PressTask`; rings lie across the normal."""
        if memory is None:
            points, normals = place_on(self.setting, goal[None, :2], self._half_width)
        else:
            points, normals = memory["point"], memory["normal"]
        normal = normals[0] if np.isfinite(normals).all() else np.array(UPWARDS)
        ends = np.where(np.isfinite(points[0]), points[0], 0.0) - np.outer([0.0, goal[2]], normal)
        radius = RING_RATIO * self._half_width
        return Ring(ends[0], radius, normal), Ring(ends[1], radius, normal), Path(ends)

    @property
    def _half_width(self) -> float:
        """Half of the spatula's width [m]."""
        return float(np.abs(self.setting.tools[0].vertices[:, :2]).max())

    @property
    def _heights_above(self) -> tuple[float, ...]:
        """Heights above the surface at which the spatula has to be free [m]."""
        return (NEAREST_START, *np.linspace(*self.config.start_height_range, 3).tolist())

    def _free_start(self, point: FloatArray, normal: FloatArray, drawn: FloatArray, setting: Setting) -> FloatArray:
        """(3,) where the spatula begins: beside the place as drawn, or nearer to above it if it is not free there."""
        tool, back = setting.tools[0], conjugate(upright(normal))
        corners = turn(turned_to(normal, tool.orientation), tool.vertices)
        low, high = self.setting.workspace_low, self.setting.workspace_high
        for part in (1.0, 0.5, 0.0):
            offset = np.array([part * drawn[1], part * drawn[2], drawn[0] - tool.vertices[:, 2].min()])
            position = np.clip(point + turn(back, offset), low, high)
            if not overlaps(setting.rest_nodes, setting.triangles, corners + position, tool.triangles):
                break
        return np.asarray(position)

    def _view(self, situation: Situation, memory: Memory) -> PressView:
        point, rotation = memory["point"], upright(memory["normal"])
        rest, held = situation.rest_nodes, getattr(self.setting.organ, "held", ())
        untouched = rest if held else moved_as_a_whole(situation.nodes, rest)
        corners = situation.corners(self.setting.tools[0])
        lowest = turn(rotation[:, None], corners - point[:, None])[..., 2].min(axis=1)
        return PressView(
            nodes=turn(rotation[:, None], situation.nodes - point[:, None]),
            untouched=turn(rotation[:, None], untouched - point[:, None]),
            place=turn(rotation, situation.tool_position - point)[:, :2],
            force=turn(rotation, situation.contact_forces[:, 0]),
            face=turn(rotation, turn(situation.tool_orientation, UPWARDS)),
            lowest=lowest,
            target=-memory["depth"],
        )

    def _heights(self, nodes: FloatArray, places: FloatArray) -> FloatArray:
        """Mean heights under the spatula; a furrow under its middle alone tells little about a press."""
        spots = self._half_width * UNDER_SPATULA
        heights = [local_heights(nodes, self.setting.triangles, places + spot) for spot in spots]
        return np.asarray(np.mean(heights, axis=0))

    def _place_of(self, view: PressView, goal: FloatArray) -> FloatArray:
        return np.asarray(goal[:, :2] + view.place)

    def _parts(self, memory: Memory) -> dict[str, FloatArray]:
        return {"place_position": memory["point"], "place_normal": memory["normal"]}

    def _check_reach(self) -> None:
        judged = judge_candidates(self.setting, self.config.depth_range[0], self._heights_above)
        if judged.good.sum() < FEWEST_PLACES:
            raise ValueError(f"{judged.told(self.setting.organ)}; {FEWEST_PLACES} are needed")
        self.places, self.depths = judged.spots.some(judged.good), judged.depths[judged.good]
