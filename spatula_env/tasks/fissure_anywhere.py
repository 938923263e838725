"""The fissure task on an organ of one's own, which says where the floor of its fissure is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spatula_env.arrays import FloatArray
from spatula_env.geometry.prepared import FISSURE, PreparedOrgan
from spatula_env.geometry.surface import winding_numbers
from spatula_env.tasks.base import Evaluation, Memory, PartSpec
from spatula_env.tasks.fissure import FissureConfig, FissureTask
from spatula_env.tasks.openings import (
    GREATEST_OPENING,
    HELD_ROOM,
    lowest_free_edge,
    opening_needed,
    walls_beside,
)
from spatula_env.tasks.places import MARGIN
from spatula_env.tasks.situation import Setting, Situation

GREATEST_DEPTH = 0.1
"""Greatest height of the organ above the target that is reported [m]."""

MOST_SEEN = 0.5
"""Greatest share of the target that may be seen at rest."""

ABOVE_FLOOR = 0.002
"""Height above the floor at which tools are stopped, as in the preset [m]."""

STEP = 0.0025
"""Distance of the places along the fissure at which the blade is looked at [m]."""

DEGREE = 2
"""Degree of the polynomial that the floor is along its line."""

UNDER_LIPS = 0.002
"""Least length of blade that stands out of the fissure [m]."""


class FissureAnywhereTask(FissureTask):
    """Evaluates how a fissure is held open on an organ of any shape.

    It is `FissureTask`, but for this: the organ's line "fissure" says where the floor is: a parabola through its nodes.
    Places of the target are within the configured limit, and where the blade gets down to the floor upright.
    Observations tell how high the organ is above the target.
    """

    def __init__(self, config: FissureConfig, setting: Setting) -> None:
        """Judge the fissure; see `FissureTask`.

        Raises:
            ValueError: If the task cannot be set on it; the message says why, in numbers.
        """
        super().__init__(config, setting)
        self.extra_parts += (PartSpec("fissure_depth", "m", np.zeros(1), np.full(1, GREATEST_DEPTH), sensed=True),)
        self.stop_height = max(
            0.0, float(setting.rest_nodes[self._line, 2].min()) + ABOVE_FLOOR - setting.ground_height
        )

    def evaluate(self, situation: Situation, goal: FloatArray, memory: Memory) -> Evaluation:
        """See `FissureTask`; the part "fissure_depth" is the height of the organ's top above the target at rest [m]."""
        evaluation = super().evaluate(situation, goal, memory)
        rest = situation.rest_nodes
        depth = rest[:, :, 2].max(axis=1) - self._target(rest, goal[:, 0])[:, 2]
        return replace(evaluation, parts={**evaluation.parts, "fissure_depth": depth[:, None]})

    def _read_ends(self) -> tuple[int, int]:
        """See `FissureTask`: those of the organ's line, from left to right."""
        organ = self.setting.organ
        if not isinstance(organ, PreparedOrgan):
            raise ValueError(f"organ must be a PreparedOrgan, got {organ!r}")
        organ.line(FISSURE)
        line = np.array(organ.lines[FISSURE], dtype=np.int64)
        rest = self.setting.rest_nodes
        self._line = line if rest[line[-1], 0] >= rest[line[0], 0] else line[::-1]
        points = rest[self._line]
        way = points[-1] - points[0]
        lengthwise = (points - 0.5 * (points[0] + points[-1])) @ way / np.sqrt(way @ way)
        # Nodes lie on either side of a floor that is as wide as its edges are long: the least squares are between them.
        degree = min(DEGREE, len(line) - 1)
        self._smooth = np.linalg.pinv(lengthwise[:, None] ** np.arange(degree + 1))
        self._span = (float(lengthwise.min()), float(lengthwise.max()))
        return int(self._line[0]), int(self._line[-1])

    def _floor_line(self, nodes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `FissureTask`: between the ends of a smooth line through the nodes."""
        first, last = (self._on_floor(nodes, np.full(len(nodes), end)) for end in self._span)
        way = last - first
        return 0.5 * (first + last), way / np.sqrt((way**2).sum(axis=1, keepdims=True))

    def _target(self, nodes: FloatArray, place: FloatArray) -> FloatArray:
        """See `FissureTask`; the floor may be bent."""
        first, last = (self._on_floor(nodes, np.full(len(nodes), end)) for end in self._span)
        # An organ may be larger or smaller than that on which the line was measured.
        larger = np.sqrt(((last - first) ** 2).sum(axis=1)) / (self._span[1] - self._span[0])
        on_floor = self._on_floor(nodes, 0.5 * (self._span[0] + self._span[1]) + place / larger)
        return np.asarray(on_floor + np.array([0.0, 0.0, self.config.target_height]))

    def _on_floor(self, nodes: FloatArray, lengthwise: FloatArray) -> FloatArray:
        """(W, 3) points of the smooth line through the nodes at distances (W,) along it, as measured at rest [m]."""
        coefficients = self._smooth @ nodes[:, self._line]
        powers = lengthwise[:, None] ** np.arange(len(self._smooth))
        return np.asarray((powers[:, :, None] * coefficients).sum(axis=1))

    def _greatest_place(self) -> float:
        return self._place_limit

    def _check_reach(self) -> None:
        """Judge the fissure: whether the blade gets in and reaches the floor, what is seen, and what is held."""
        config, setting = self.config, self.setting
        longest = 0.5 * (self._span[1] - self._span[0] - config.target_size[0])
        if longest < 0.0:
            raise self._unfit(
                f"its floor is {1e3 * (2.0 * longest + config.target_size[0]):.1f} mm long, the target is "
                f"{1e3 * config.target_size[0]:.1f} mm long"
            )
        middle, _ = self._floor_line(setting.rest_nodes[None])
        self.check_room("start_offset", config.start_offset, middle[0, :2])
        self._check_height(longest)
        self._place_limit = self._free_places(min(config.place_limit, longest))
        for place in sorted({-self._place_limit, 0.0, self._place_limit}):
            self._check_sight(place)

    def _check_height(self, longest: float) -> None:
        """Check that the grip gets low enough, at either end of what is asked for."""
        limit = min(self.config.place_limit, longest)
        lowest = min(float(self._edge_at(place)[2]) for place in (-limit, limit))
        grip = lowest - float(self.setting.tool_low[2])
        floor = float(self.setting.workspace_low[2]) + MARGIN
        if grip < floor:
            top = float(self.setting.rest_nodes[:, 2].max())
            raise self._unfit(
                f"its floor is {1e3 * (top - lowest):.1f} mm below the organ's top, the blade reaches "
                f"{1e3 * (top - floor - float(self.setting.tool_low[2])):.1f} mm"
            )

    def _free_places(self, limit: float) -> float:
        """Distance from the middle up to which targets can be shown, to either side [m]: where the blade gets down."""
        reached = 0.0
        for place in np.append(np.arange(0.0, limit, STEP), limit):
            faults = [fault for side in (-place, place) if (fault := self._fault_at(float(side)))]
            if faults and place == 0.0:
                raise self._unfit(faults[0])
            if faults:
                break
            reached = float(place)
        return reached

    def _fault_at(self, place: float) -> str:
        """Why a target at a place along the fissure cannot be shown; "" if the blade gets down to it."""
        config, reach = self.config, self.config.reach_height
        free = lowest_free_edge(self.setting, self._edge_at(place))
        if free > 0.0:
            return (
                f"the blade, {self._blade_size()}, gets down to {1e3 * (free + reach):.1f} mm above the target in its "
                f"middle without meeting the organ, it has to get to {1e3 * reach:.1f} mm"
            )
        rest = self.setting.rest_nodes[None]
        points = self._points(self._target(rest, np.array([place])), self._floor_line(rest)[1])[0]
        buried = float((winding_numbers(points, self.setting.rest_nodes, self.setting.triangles) > 0.5).mean())
        if 1.0 - buried >= config.exposure_range[1]:
            return ""
        length, width = (1e3 * size for size in config.target_size)
        return (
            f"{buried:.0%} of the target in its middle, {length:g} x {width:g} mm, is inside the organ, "
            f"{1.0 - config.exposure_range[1]:.0%} are allowed: is the line straight, and the floor as wide?"
        )

    def _check_sight(self, place: float) -> None:
        """Check of a place that its target is hidden at rest, and can be shown."""
        config, setting = self.config, self.setting
        rest = setting.rest_nodes[None]
        along, target = self._floor_line(rest)[1], self._target(rest, np.array([place]))
        where = f"at {1e3 * place:.1f} mm from its middle"
        # No blade.
        nowhere = np.zeros((1, 0, 3))
        thickness = float((setting.tool_high - setting.tool_low)[1])
        held = setting.rest_nodes[list(setting.organ.held)]
        for side in (-1.0, 1.0):
            for angle in config.view_range:
                view = -side * angle
                seen = float(self._exposure(rest, nowhere, target, along, np.array([view]))[0])
                if seen > MOST_SEEN:
                    raise self._unfit(
                        f"{seen:.0%} of the target is seen at rest {where} along a line of sight of {view:.2f} rad, "
                        f"{MOST_SEEN:.0%} are allowed: it is too wide for its depth, or view_range, "
                        f"{list(config.view_range)}, is too small"
                    )
            self._check_wall(target[0], side, thickness, held, where)

    def _check_wall(self, target: FloatArray, side: float, thickness: float, held: FloatArray, where: str) -> None:
        """Check that a wall may be moved as far as the steepest line of sight asks for."""
        walls = walls_beside(self.setting, target, side)
        blade = -float(self.setting.tool_low[2]) + float(self.setting.tool_high[2])
        depth = float(walls[-1, 0]) if len(walls) else 0.0
        if depth + self.config.reach_height > blade - UNDER_LIPS:
            raise self._unfit(
                f"its lips are {1e3 * depth:.1f} mm above the target {where}, "
                f"{1e3 * (blade - UNDER_LIPS - self.config.reach_height):.1f} mm are allowed with a blade "
                f"{1e3 * blade:.1f} mm high"
            )
        needed = opening_needed(walls, self.config.view_range[1], thickness)
        if needed.max(initial=0.0) > GREATEST_OPENING:
            raise self._unfit(
                f"a wall would have to be moved by {1e3 * needed.max():.1f} mm {where} for a line of sight of "
                f"{self.config.view_range[1]:g} rad, {1e3 * GREATEST_OPENING:.1f} mm are allowed"
            )
        if not len(held):
            return
        points = target + np.column_stack([np.zeros(len(walls)), side * walls[:, 1], walls[:, 0]])
        nearest = np.sqrt(((held - points[:, None]) ** 2).sum(axis=2)).min(axis=1)
        if (nearest < HELD_ROOM * needed).any():
            row = int((nearest / np.maximum(needed, 1e-9)).argmin())
            raise self._unfit(
                f"a wall that has to be moved by {1e3 * needed[row]:.1f} mm {where} is {1e3 * nearest[row]:.1f} mm "
                f"from nodes that are held, {1e3 * HELD_ROOM * needed[row]:.1f} mm are needed"
            )

    def _edge_at(self, place: float) -> FloatArray:
        """(3,) where the blade's edge is wanted at a place along the fissure."""
        target = self._target(self.setting.rest_nodes[None], np.array([place]))[0]
        return np.asarray(target + np.array([0.0, 0.0, self.config.reach_height]))

    def _blade_size(self) -> str:
        size = 1e3 * (self.setting.tool_high - self.setting.tool_low)
        return f"{size[0]:.3g} mm wide and {size[1]:.3g} mm thick"

    def _unfit(self, why: str) -> ValueError:
        return ValueError(f"the fissure of organ {self.setting.organ.name!r} cannot be opened: {why}")
