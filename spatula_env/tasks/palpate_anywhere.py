"""The palpation task on an organ of one's own: along paths on all of its surface that the spatula reaches."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from spatula_env.arrays import BoolArray, FloatArray, IntArray
from spatula_env.tasks.base import Evaluation, Memory, PartSpec, sample_disc
from spatula_env.tasks.palpate import AHEAD, PIECES, PalpateConfig, PalpateTask, points_at
from spatula_env.tasks.places import COMPRESSION, FEWEST_PLACES, Spots, judge_candidates, place_on
from spatula_env.tasks.situation import Setting, Situation, Start
from spatula_env.tasks.surface import points_on_top

STEEPEST_PATH = 0.5
"""Greatest angle between the surface along a path and the horizontal, so that the spatula's tilt, which is limited to
0.6, keeps some room [rad]."""

LEAST_THICKNESS = 0.015
"""Least thickness of the organ under a path [m]: palpation presses about a quarter as deep."""

DIRECTIONS = 8
"""Number of directions in which paths through each place are tried."""

NEAREST_END = 0.003
"""Greatest distance of a chosen goal from the end of a path that can be felt [m]."""

STEPS = 9
"""Number of points of a path that are looked at."""


class PalpateAnywhereTask(PalpateTask):
    """Evaluates a palpation on an organ of any shape.

    It is `PalpateTask`, but for this: paths are drawn from all of the organ that the spatula reaches from above, where
    the surface is no steeper than it can be tilted, thick enough and smooth enough to lie against. The normals along
    the path are observed.

    Attributes:
        ends: The K ends of the paths from which those of episodes are drawn.
        beginnings: Their beginnings.
        bends: (K,) how far they bend to the left of the way from the end to the beginning [m].
    """

    ends: Spots
    beginnings: Spots
    bends: FloatArray

    def __init__(self, config: PalpateConfig, setting: Setting) -> None:
        """Find the paths; see `PalpateTask`.

        Raises:
            ValueError: If there are too few; the message says why.
        """
        super().__init__(config, setting)
        count = 3 * len(AHEAD)
        self.extra_parts += (PartSpec("path_normals", "1", -np.ones(count), np.ones(count)),)

    def sample(self, generator: np.random.Generator, count: int, setting: Setting) -> Start:
        """Draw the beginnings of episodes; see `PalpateTask`.

        Returns:
            Goals (W, 4) and tool positions (W, 3), which `arrange` replaces [m]; drawn (W, 6) holds the vector from the
            path's end to its beginning, the distance by which it bends, the offset of the spatula from the beginning
            and its height [m].
        """
        config = self.config
        share = generator.uniform(*config.share_range, size=count)
        force = generator.uniform(*config.force_range, size=count)
        chosen = generator.integers(len(self.bends), size=count)
        aside = sample_disc(generator, config.start_radius, count)
        height = generator.uniform(*config.start_height_range, size=count)
        ends, beginnings = (spots.some(chosen).on(setting.rest_nodes)[:, :2] for spots in (self.ends, self.beginnings))
        return Start(
            goal=np.column_stack([share, ends, force]),
            tool_position=np.zeros((count, 3)),
            drawn=np.column_stack([beginnings - ends, self.bends[chosen], aside, height]),
        )

    def arrange(self, start: Start, settings: Sequence[Setting], chosen: Collection[str]) -> Start:
        """See `Task`: a chosen end gets the path that ends nearest to it; the spatula starts above the beginning."""
        assert start.drawn is not None
        drawn, positions = np.array(start.drawn), np.array(start.tool_position)
        for row, (goal, setting) in enumerate(zip(start.goal, settings, strict=True)):
            if "goal" in chosen:
                ends, beginnings = (spots.on(setting.rest_nodes)[:, :2] for spots in (self.ends, self.beginnings))
                path = int(((ends - goal[1:3]) ** 2).sum(axis=1).argmin())
                drawn[row, :2], drawn[row, 2] = (beginnings - ends)[path], self.bends[path]
            if "tool_position" not in chosen:
                place = goal[1:3] + drawn[row, :2] + drawn[row, 3:5]
                positions[row] = (*place, self._top_around(place, setting) + drawn[row, 5] - setting.tool_low[2])
        low, high = self.setting.workspace_low, self.setting.workspace_high
        return replace(start, tool_position=np.clip(positions, low, high), drawn=drawn)

    def check_goal(self, goal: FloatArray) -> None:
        """See `PalpateTask`.

        Raises:
            ValueError: If a number is out of its range, or no path can be felt that ends there.
        """
        self._check_share_and_force(goal)
        ends = self.ends.on(self.setting.rest_nodes)[:, :2]
        away = np.sqrt(((ends - goal[1:3]) ** 2).sum(axis=1))
        if away.min() > NEAREST_END:
            raise ValueError(
                f"goal must be at most {NEAREST_END} m from the end of a path that can be felt, got {goal[1:3]}; the "
                f"nearest ends at {ends[away.argmin()]}"
            )

    def new_memory(self, count: int) -> Memory:
        """Allocate the memory; see `PalpateTask`. "normals" (W, P + 1, 3) are those of the surface along the paths."""
        return {**super().new_memory(count), "normals": np.zeros((count, PIECES + 1, 3))}

    def begin_memory(self, memory: Memory, rows: IntArray, start: Start, settings: Sequence[Setting]) -> None:
        """See `PalpateTask`."""
        super().begin_memory(memory, rows, start, settings)
        for row, setting in zip(rows, settings, strict=True):
            _, normals = place_on(setting, memory["path"][row, :, :2], self._half_width)
            memory["normals"][row] = np.where(np.isfinite(normals), normals, [0.0, 0.0, 1.0])

    def evaluate(self, situation: Situation, goal: FloatArray, memory: Memory) -> Evaluation:
        """See `PalpateTask`; "path_normals" are those of the surface at rest at the points of "path_ahead"."""
        evaluation = super().evaluate(situation, goal, memory)
        ahead = np.minimum(memory["progress"][:, None] + PIECES * np.array(AHEAD), PIECES)
        normals = points_at(memory["normals"], ahead)
        return replace(evaluation, parts={**evaluation.parts, "path_normals": normals.reshape(len(normals), -1)})

    @property
    def _half_width(self) -> float:
        return float(self._plate[1][0])

    def _way(self, goal: FloatArray, drawn: FloatArray, setting: Setting) -> FloatArray:
        """See `PalpateTask`: any direction is a path's, wherever it ends."""
        return drawn[:2]

    def _top_around(self, place: FloatArray, setting: Setting) -> float:
        """Height of the highest point under a level spatula, however it is turned [m]."""
        away = np.sqrt(((setting.rest_nodes[:, :2] - place) ** 2).sum(axis=1))
        under = away <= np.sqrt(2.0) * self._half_width
        there = float(setting.surface_heights(setting.rest_nodes[None], place[None])[0])
        return max(there, float(setting.rest_nodes[under, 2].max())) if under.any() else there

    def _check_reach(self) -> None:
        config, setting = self.config, self.setting
        heights = (0.003, config.start_height_range[1])
        judged = judge_candidates(setting, COMPRESSION * LEAST_THICKNESS, heights, STEEPEST_PATH)
        ends, beginnings, bends = _paths(judged.spots.on(setting.rest_nodes)[:, :2], judged.good, config)
        if len(bends) < FEWEST_PLACES:
            raise ValueError(
                f"{judged.told(setting.organ)}; on those are {len(bends)} paths of {config.length_range} m, "
                f"{FEWEST_PLACES} are needed"
            )
        self.ends, self.beginnings = (
            Spots(*points_on_top(setting.rest_nodes, setting.triangles, places)) for places in (ends, beginnings)
        )
        self.bends = bends


def _paths(points: FloatArray, good: BoolArray, config: PalpateConfig) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Find paths along which the nearest of the points tried (K, 2) are all good (K,), seen from above.

    Lengths and bends vary from path to path as the fractional parts of the multiples of two irrational numbers, which
    are spread evenly.

    Returns:
        Ends (P, 2) and beginnings (P, 2) [m], and how far paths bend to the left (P,) [m].
    """
    part = np.linspace(0.0, 1.0, STEPS)[:, None]
    found = []
    for number, (middle, turn) in enumerate(itertools.product(points[good], range(DIRECTIONS)), start=1):
        share, other = (0.6180339887 * number) % 1.0, (0.4142135624 * number) % 1.0
        length = config.length_range[0] + share * (config.length_range[1] - config.length_range[0])
        bend = (2.0 * other - 1.0) * config.bend_limit
        angle = 2.0 * np.pi * turn / DIRECTIONS
        along = np.array([np.cos(angle), np.sin(angle)])
        left = np.array([-along[1], along[0]])
        places = middle + (part - 0.5) * length * along + 4.0 * bend * part * (1.0 - part) * left
        nearest = ((points[:, None] - places) ** 2).sum(axis=2).argmin(axis=0)
        if good[nearest].all():
            found.append((*places[0], *places[-1], bend))
    paths = np.array(found).reshape(-1, 5)
    return paths[:, :2], paths[:, 2:4], paths[:, 4]
