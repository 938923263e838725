"""The clamp task on an organ of one's own, which says where the crest of its ridge is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spatula_env.arrays import FloatArray, IntArray
from spatula_env.geometry.prepared import RIDGE, PreparedOrgan
from spatula_env.tasks.base import Evaluation, Memory, PartSpec
from spatula_env.tasks.clamp import ClampConfig, ClampTask
from spatula_env.tasks.places import MARGIN
from spatula_env.tasks.ridges import DEPTHS, ROOM, STEP, Profile, jaws_fit, profile_of
from spatula_env.tasks.situation import Setting, Situation

LEAST_WIDTH = 0.006
"""Least width of a ridge: thinner ones are folded by the jaws rather than gripped [m]."""

STEEPEST = 0.1
"""Greatest lean of a flank per height: on one that leans more, jaws touch with their lower edges alone, and slip."""

STRETCH = 0.1
"""Greatest lift, as a part of the distance of the jaws from what is held: a ridge that is stretched more slips out."""

CREST = 0.003
"""Greatest depth of nodes of the crest below its lowest point between the jaws [m]."""

ASIDE = 0.001
"""How far beside the profile nodes may be that belong to the ridge [m]."""

LEAST_NODES = 3
"""Least number of nodes of the crest, and of either flank."""

STOP = 0.004
"""How far below the lowest place of the jaws they are stopped [m]."""

GREATEST_SHAPE = 0.1
"""Greatest width and heights of a ridge that are reported [m]."""


class ClampAnywhereTask(ClampTask):
    """Evaluates how a ridge is gripped and lifted on an organ of any shape.

    It is `ClampTask`, but for this: the organ's line "ridge" says where the crest is, and the ridge is what is between
    the jaws around the line's middle, down to where they get beside it, 18 mm below the crest at most. The jaws start
    above all of the organ. Observations tell the ridge's width, and how high above the middle of its flanks the jaws
    grip and are free.
    """

    def __init__(self, config: ClampConfig, setting: Setting) -> None:
        """Judge the ridge; see `ClampTask`.

        Raises:
            ValueError: If the task cannot be set on it; the message says why, in numbers.
        """
        super().__init__(config, setting)
        limits = np.full(3, GREATEST_SHAPE)
        self.extra_parts += (PartSpec("ridge_shape", "m", -limits, limits, sensed=True),)

    def evaluate(self, situation: Situation, goal: FloatArray, memory: Memory) -> Evaluation:
        """See `ClampTask`.

        Returns:
            The evaluation; its part "ridge_shape" has the ridge's width where it is gripped, and the heights above the
            middle of its flanks where the jaws grip, and where they are free of the organ at rest [m].
        """
        evaluation = super().evaluate(situation, goal, memory)
        shape = np.broadcast_to(self._shape, (len(goal), 3))
        return replace(evaluation, parts={**evaluation.parts, "ridge_shape": shape})

    def _top(self, setting: Setting) -> float:
        return float(setting.rest_nodes[:, 2].max())

    def _read_ridge(self) -> tuple[IntArray, IntArray]:
        """See `ClampTask`: measures the ridge, and judges it."""
        setting, organ = self.setting, self.setting.organ
        if not isinstance(organ, PreparedOrgan):
            raise ValueError(f"organ must be a PreparedOrgan, got {organ!r}")
        organ.line(RIDGE)
        nodes = setting.rest_nodes
        half_length = 0.5 * float(np.ptp(setting.tools[0].corners_about_grip[:, 0]))
        line = nodes[list(organ.lines[RIDGE])]
        length = float(abs(line[-1, 0] - line[0, 0]))
        if length < half_length:
            raise self._unfit(f"it is {1e3 * length:.1f} mm long, {1e3 * half_length:.1f} mm are needed")
        profile = profile_of(setting, line, min(half_length, 0.5 * length))
        middle = 0.5 * (line[0, 0] + line[-1, 0])
        depth, low, high = self._deepest(profile, middle)
        jaw = float(setting.tool_high[2] - setting.tool_low[2])
        grip = np.array([middle, 0.5 * (low + high), profile.top - depth - setting.tool_low[2]])
        self._check_grip(grip, high - low)
        self._check_held(grip)
        near = np.abs(nodes[:, 0] - middle) <= half_length
        near &= (nodes[:, 1] >= low - ASIDE) & (nodes[:, 1] <= high + ASIDE)
        crest = np.flatnonzero(near & (nodes[:, 2] >= profile.top - CREST))
        flank = near & (nodes[:, 2] < profile.top - CREST) & (nodes[:, 2] >= profile.top - depth)
        flanks = [np.flatnonzero(flank & (side * (nodes[:, 1] - grip[1]) > 0.0)) for side in (-1.0, 1.0)]
        counts = [len(some) for some in (crest, *flanks)]
        if min(counts) < LEAST_NODES:
            raise self._unfit(
                f"its crest and its two flanks have {counts[0]}, {counts[1]} and {counts[2]} nodes between the jaws, "
                f"{LEAST_NODES} each are needed: prepare it with more --nodes"
            )
        both = np.concatenate(flanks)
        center = float(nodes[both, 2].mean())
        free = self._top(setting) + 0.25 * jaw - float(setting.tool_low[2]) - center
        self._shape = np.array([high - low, grip[2] - center, free])
        self.stop_height = max(0.0, profile.top - depth - STOP - setting.ground_height)
        return crest, both

    def _deepest(self, profile: Profile, middle: float) -> tuple[float, float, float]:
        """How deep the jaws get beside the ridge, and y of its sides there [m]."""
        # Why they do not get to each of the depths, and the same in words.
        faults: dict[str, list[str]] = {}
        for depth in np.arange(DEPTHS[1], DEPTHS[0] - 0.5 * STEP, -STEP).tolist():
            low, high = profile.sides(depth)
            fault, told = self._fault_at(profile, depth, middle, low, high)
            if not fault:
                return depth, low, high
            faults.setdefault(fault, []).append(f"{1e3 * depth:.0f} mm below its crest {told}")
        raise self._unfit(max(faults.values(), key=len)[-1])

    def _fault_at(self, profile: Profile, depth: float, middle: float, low: float, high: float) -> tuple[str, str]:
        """Why the jaws cannot grip that deep, in a word and in numbers; "" twice if they can."""
        width, widest = high - low, self.config.start_opening_range[1]
        if not np.isfinite(width):
            return "ends", "it has not two flanks all along the jaws"
        if not LEAST_WIDTH <= width <= widest - 2.0 * ROOM:
            allowed = f"{1e3 * LEAST_WIDTH:.0f} to {1e3 * (widest - 2.0 * ROOM):.0f} mm"
            return "width", f"it is {1e3 * width:.1f} mm wide, {allowed} are allowed"
        lean = profile.lean(depth)
        if lean > STEEPEST:
            return "lean", f"its flanks lean by {lean:.2f} mm per mm of height, {STEEPEST:g} are allowed"
        grip = np.array([middle, 0.5 * (low + high), profile.top - depth - self.setting.tool_low[2]])
        if not jaws_fit(self.setting, grip, width + 2.0 * ROOM, self._top(self.setting)):
            return "room", "there is no room for the jaws beside it"
        return "", ""

    def _check_grip(self, grip: FloatArray, width: float) -> None:
        """Check that the jaws' middle may be where they grip."""
        low, high = self.setting.workspace_low + MARGIN, self.setting.workspace_high - MARGIN
        if (grip < low).any() or (grip > high).any():
            raise self._unfit(
                f"jaws would grip it, {1e3 * width:.1f} mm wide, at {np.round(1e3 * grip, 1).tolist()} mm, the "
                f"workspace reaches from {np.round(1e3 * low, 1).tolist()} to {np.round(1e3 * high, 1).tolist()} mm"
            )

    def _check_held(self, grip: FloatArray) -> None:
        """Check that what is held is far enough away, so that the ridge can be lifted."""
        held = self.setting.rest_nodes[list(self.setting.organ.held)]
        if not len(held):
            return
        lowest = grip + np.array([0.0, 0.0, self.setting.tool_low[2]])
        distance = float(np.sqrt(((held - lowest) ** 2).sum(axis=1).min()))
        lift = self.config.lift_range[1]
        if STRETCH * distance < lift:
            raise self._unfit(
                f"nodes that are held are {1e3 * distance:.1f} mm from the jaws' lower edges, so that it can be lifted "
                f"by {1e3 * STRETCH * distance:.1f} mm, lift_range goes to {1e3 * lift:.1f} mm: let the organ lie free"
            )

    def _unfit(self, why: str) -> ValueError:
        return ValueError(f"the ridge of organ {self.setting.organ.name!r} cannot be gripped: {why}")
