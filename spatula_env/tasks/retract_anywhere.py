"""The retraction task on an organ of one's own: any wall that a blade gets beside is pushed along its normal."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from spatula_env.arrays import FloatArray, IntArray
from spatula_env.geometry.surface import vertex_areas
from spatula_env.tasks.base import Evaluation, Memory, PartSpec
from spatula_env.tasks.places import FEWEST_PLACES
from spatula_env.tasks.retract import RetractConfig, RetractTask
from spatula_env.tasks.situation import Setting, Situation, Start
from spatula_env.tasks.surface import average_normals
from spatula_env.tasks.walls import find_walls, upright_blade

GREATEST_OWN_SHIFT = 0.006
"""Greatest displacement asked for [m]: a thick wall resists more than a fold."""

LEAST_PATCH = 4
"""Least number of nodes of a patch."""


class RetractAnywhereTask(RetractTask):
    """Evaluates a retraction on an organ of any shape.

    It is `RetractTask`, but for this: patches are drawn from all walls that the blade gets beside, straight down from
    above the organ, and each is pushed along the horizontal part of its normal, with the blade turned to it. The goal's
    direction is turned away from that by the angle limit at most. Displacements reach 6 mm at most.

    The patch belongs to the episode and not to the goal, so that hindsight replay is true for every goal that leads
    into the wall.

    Attributes:
        walls: The walls from which those of episodes are drawn.
    """

    def __init__(self, config: RetractConfig, setting: Setting) -> None:
        """Find the walls; see `RetractTask`.

        Raises:
            ValueError: If there are too few; the message says why.
        """
        super().__init__(config, setting)
        self.extra_parts += (
            PartSpec("patch_outwards", "1", -np.ones(2), np.ones(2)),
            PartSpec("patch_room", "m", np.zeros(1), np.full(1, 0.01)),
        )

    def sample(self, generator: np.random.Generator, count: int, setting: Setting) -> Start:
        """Draw the beginnings of episodes: walls with equal probability, the rest uniform in their ranges.

        Returns:
            Goals (W, 2) and tool positions (W, 3), which `arrange` replaces [m]; drawn (W, 4) holds the wall's number,
            the offset of the blade across the wall and along it, and its height above the organ [m].
        """
        config = self.config
        wall = generator.integers(len(self.walls.rooms), size=count)
        least, greatest = config.shift_range
        size = generator.uniform(least, max(least, min(greatest, GREATEST_OWN_SHIFT)), size=count)
        angle = generator.uniform(-config.angle_limit, config.angle_limit, size=count)
        offset = generator.uniform(-1.0, 1.0, size=(count, 2)) * config.start_offset
        clearance = generator.uniform(*config.start_height_range, size=count)
        inwards = -np.stack([self._wall(setting, one)[1] for one in wall.tolist()])
        along = np.column_stack([-inwards[:, 1], inwards[:, 0]])
        return Start(
            goal=(size * np.cos(angle))[:, None] * inwards + (size * np.sin(angle))[:, None] * along,
            tool_position=np.zeros((count, 3)),
            drawn=np.column_stack([wall, offset, clearance]),
        )

    def arrange(self, start: Start, settings: Sequence[Setting], chosen: Collection[str]) -> Start:
        """See `Task`: a chosen goal gets a wall that it leads into, and the blade is turned to the wall.

        Returns:
            The start; drawn (W, 4) is as before, with the numbers of these walls.
        """
        assert start.drawn is not None
        drawn, positions = np.array(start.drawn), np.array(start.tool_position)
        outwards = np.empty((len(positions), 2))
        for row, (goal, setting) in enumerate(zip(start.goal, settings, strict=True)):
            if "goal" in chosen:
                fits = self._allow(goal)
                # The drawn wall, or the next that the goal leads into.
                order = (np.arange(len(fits)) + int(drawn[row, 0])) % len(fits)
                drawn[row, 0] = order[fits[order].argmax()]
            point, outwards[row] = self._wall(setting, int(drawn[row, 0]))
            if "tool_position" not in chosen:
                along = np.array([-outwards[row, 1], outwards[row, 0]])
                place = point[:2] + drawn[row, 1] * outwards[row] + drawn[row, 2] * along
                top = float(setting.rest_nodes[:, 2].max())
                positions[row] = (*place, top + drawn[row, 3] - setting.tool_low[2])
        return replace(
            start,
            tool_position=np.clip(positions, self.setting.workspace_low, self.setting.workspace_high),
            tool_orientation=upright_blade(outwards, self.setting.tools[0].orientation),
            drawn=drawn,
        )

    def check_goal(self, goal: FloatArray) -> None:
        """Check a goal (2,) that was not drawn by `sample`.

        Raises:
            ValueError: If its size is out of range, or it leads into none of the walls.
        """
        least, greatest = self.config.shift_range
        size = float(np.hypot(*goal))
        if not least <= size <= greatest:
            raise ValueError(f"goal must be a displacement of {least} to {greatest} m, got {goal}")
        if not self._allow(goal).any():
            raise ValueError(
                f"goal must lead into one of the {len(self.walls.rooms)} walls of the organ, turned away from its "
                f"normal by {self.config.angle_limit} rad at most; got {goal}"
            )

    def new_memory(self, count: int) -> Memory:
        """Allocate the memory of the patch; see `RetractTask`. "room" (W,) is that beside the wall [m]."""
        return {**super().new_memory(count), "room": np.zeros(count)}

    def begin_memory(self, memory: Memory, rows: IntArray, start: Start, settings: Sequence[Setting]) -> None:
        """See `RetractTask`."""
        assert start.drawn is not None
        for row, drawn, setting in zip(rows, start.drawn, settings, strict=True):
            wall = int(drawn[0])
            point, outwards = self._wall(setting, wall)
            nodes, weights = self._around(setting.rest_nodes, point)
            memory["weights"][row] = 0.0
            memory["weights"][row, nodes] = weights
            memory["rest"][row] = weights @ setting.rest_nodes[nodes]
            memory["inwards"][row], memory["room"][row] = -outwards, self.walls.rooms[wall]

    def evaluate(self, situation: Situation, goal: FloatArray, memory: Memory) -> Evaluation:
        """See `RetractTask`; the parts "patch_outwards" and "patch_room" [m] are those of the wall at rest."""
        evaluation = super().evaluate(situation, goal, memory)
        own = {"patch_outwards": -memory["inwards"], "patch_room": memory["room"][:, None]}
        return replace(evaluation, parts={**evaluation.parts, **own})

    def _wall(self, setting: Setting, wall: int) -> tuple[FloatArray, FloatArray]:
        """Point (3,) of a wall on the organ of a setting [m], and its horizontal normal (2,)."""
        point = self.walls.spots.some(np.array([wall])).on(setting.rest_nodes)
        normal = average_normals(setting.rest_nodes, setting.triangles, point, self.config.patch_radius)[0, :2]
        return point[0], normal / np.sqrt(normal @ normal)

    def _allow(self, goal: FloatArray) -> FloatArray:
        """(K,) whether a goal (2,) leads into each of the walls."""
        inwards = -(self.walls.outwards @ goal) / np.hypot(*goal)
        return np.asarray(inwards >= np.cos(self.config.angle_limit) - 1e-9)

    def _around(self, nodes: FloatArray, point: FloatArray) -> tuple[IntArray, FloatArray]:
        """Nodes (K,) of the patch around a point of a wall and their weights (K,), which sum to one."""
        distance = np.sqrt(((nodes - point) ** 2).sum(axis=1))
        normal = average_normals(nodes, self.setting.triangles, point[None], self.config.patch_radius)[0]
        # What lies across a thin fold or a groove is not of the patch.
        through = np.abs((nodes - point) @ normal)
        radius = max(self.config.patch_radius, 1.2 * float(np.sort(distance)[LEAST_PATCH - 1]))
        weights = np.maximum(1.0 - (distance / radius) ** 2, 0.0) ** 2 * (through <= 0.5 * radius)
        weights = weights * vertex_areas(nodes, self.setting.triangles)
        kept = np.flatnonzero(weights > 0.0)
        return kept, weights[kept] / weights.sum()

    def _read_organ(self) -> None:
        """See `RetractTask`: the organ has no parts with names."""

    def _check_reach(self) -> None:
        self.walls, told = find_walls(self.setting, self.config.patch_radius, self.config.edge_depth)
        if len(self.walls.rooms) < FEWEST_PLACES:
            raise ValueError(f"{told}; {FEWEST_PLACES} are needed")
