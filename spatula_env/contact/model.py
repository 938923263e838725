"""The contact model of a scene: every tool against every organ, and the organs against the ground."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.contact import settings, step
from spatula_env.contact.flags import FIRST_STEP_CODES, FlaggedDetector
from spatula_env.contact.motion import Motions, OrganMotion, StepOutcome
from spatula_env.contact.pressure import contact_table, tool_pressures
from spatula_env.contact.structures import surface_list
from spatula_env.contact.world import Workspace, World, scene_skin

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.arrays import FloatArray
    from spatula_env.contact.flags import FirstStep
    from spatula_env.contact.world import Multipliers, NearMemory
    from spatula_env.scenes import Scene


@dataclass(frozen=True)
class Pressures:
    """How tools are pressed in a step.

    Attributes:
        peak: Greatest on a contact node of any tool [kg/(u s2)].
        faces: (F,) mean on each face with nodes, of one tool after the other [kg/(u s2)].
        nodes: (n,) for each tool, on its contact nodes [kg/(u s2)].
    """

    peak: float
    faces: FloatArray
    nodes: tuple[FloatArray, ...]


@dataclass(frozen=True)
class ContactMemory:
    """What a contact model remembers from one step to the next.

    Attributes:
        flags: Of each tool (outer) and organ (inner).
        multipliers: From which the position and the velocity solve start: names, features and rows of constraints.
        ledger: (O, 5) of the energy that the tools put into each organ; see `response`.
        wrenches: (N, 6) force and torque on each tool, averaged over the last step [kg u/s2, kg u2/s2].
        near: Of organs that are near themselves or each other.
    """

    flags: tuple[tuple[NDArray[np.bool_], ...], ...]
    multipliers: Multipliers
    ledger: FloatArray
    wrenches: FloatArray
    near: NearMemory


class ContactModel:
    """Detects and resolves the contacts of a scene, step after step.

    Attributes:
        detectors: One for each tool (outer) and organ (inner): flags are remembered per pair.
        penetration: Greatest depth of a contact node in the last step, before correction [u].
        residual: Greatest depth that is left after correction: of any point of an organ's surface in a tool, and of a
            tool's corners in an organ; see `contact.depth` [u].
        queries: How many times each detector was asked in the last step.
        crossings: In how many places organs cross themselves or each other after it.
        crossed_for: For how long they have [s].
        nodal_impulses: (V, 3) what the tools gave the organs' nodes in the last step [kg u/s].
        wrenches: (N, 6) force and torque on each tool, averaged over the last step [kg u/s2, kg u2/s2].
        ground_force: (3,) what the ground does to the organs, averaged over the last step [kg u/s2].
        reach: How far a push is spread over a tool's contact nodes, the mean edge of the organ with the smallest [u].
    """

    def __init__(
        self, scene: Scene, inverse_masses: FloatArray, first_step: FirstStep = "inside", *, keeps_apart: bool = True
    ) -> None:
        """Prepare for a scene.

        Args:
            scene: Its tools, organs and ground.
            inverse_masses: (V,) of the organs' nodes [1/kg].
            first_step: Of the detectors. With "off" nothing but flagged nodes makes contact, as in the published
                method's second step.
            keeps_apart: Whether organs are kept apart from themselves and each other.
        """
        self.detectors = [[FlaggedDetector(placed.tool, first_step) for _ in scene.organs] for placed in scene.tools]
        for row in self.detectors:
            for detector, placed_organ in zip(row, scene.organs, strict=True):
                organ = placed_organ.organ
                detector.memory.resize(len(organ.vertices), len(organ.triangles))
        starts = np.cumsum([0, *(len(placed.organ.vertices) for placed in scene.organs)])
        self._parts = [slice(int(a), int(b)) for a, b in pairwise(starts)]
        self._triangles = [np.array(placed.organ.triangles) for placed in scene.organs]
        self._world = World(
            scene,
            [row[0].shape for row in self.detectors],
            [detector.memory for row in self.detectors for detector in row],
            surface_list(self._triangles),
            scene_skin(scene),
            inverse_masses,
            Workspace(),
            keeps_apart,
        )
        self._first_step_code = FIRST_STEP_CODES[first_step]
        self._dt = scene.dt
        count = len(scene.tools)
        self._nothing = Motions(*(np.zeros((0, width)) for width in (3, 4, 3, 4, 3, 3)))
        self._impulses = np.zeros((count + 1, 6))
        tools = [placed.tool for placed in scene.tools]
        self._pressures = [np.zeros(len(tool.nodes)) for tool in tools]
        self._face_pressures = [np.zeros(len(tool.face_normals)) for tool in tools]
        self.reach = float(self._world.settings[settings.MEAN_EDGE])
        self._result = np.zeros(settings.RESULT_LENGTH)
        self._contact_count = 0
        self.penetration = 0.0
        self.residual = 0.0
        self.queries = 0
        self.crossings = 0
        self.crossed_for = 0.0
        self.nodal_impulses: FloatArray = np.zeros((int(starts[-1]), 3))
        self.wrenches: FloatArray = np.zeros((count, 6))
        self.ground_force: FloatArray = np.zeros(3)

    def reset(self) -> None:
        """Forget all contacts."""
        for index in range(len(self.detectors)):
            self.forget(index)
        self.nodal_impulses = np.zeros_like(self.nodal_impulses)
        self.ground_force = np.zeros(3)
        self.penetration = self.residual = 0.0
        self.crossings, self.crossed_for = 0, 0.0
        self._contact_count = 0
        self._world.forget_solves()

    def forget(self, tool: int) -> None:
        """Clear the flags of one tool, and what it felt."""
        for detector in self.detectors[tool]:
            detector.reset()
        # Reports keep the old one.
        self.wrenches = self.wrenches.copy()
        self.wrenches[tool] = 0.0

    def save(self) -> ContactMemory:
        """Everything that is remembered, as arrays of its own."""
        return ContactMemory(
            flags=tuple(tuple(detector.flags for detector in row) for row in self.detectors),
            multipliers=self._world.copy_multipliers(),
            ledger=self._world.ledger.copy(),
            wrenches=self.wrenches.copy(),
            near=self._world.copy_near(),
        )

    def restore(self, memory: ContactMemory, nodes: FloatArray, velocities: FloatArray) -> None:
        """Go back to what was remembered, here or by another model of the same scene.

        Args:
            memory: What was remembered.
            nodes: (V, 3) where the organs' nodes are put [u].
            velocities: (V, 3) how fast they are [u/s]. What energy they have more than when `memory` was saved, they
                were given by hand.
        """
        for row, saved in zip(self.detectors, memory.flags, strict=True):
            for detector, flags in zip(row, saved, strict=True):
                detector.flags = flags
        self._world.restore_multipliers(memory.multipliers)
        self._world.restore_near(memory.near, nodes)
        self._world.ledger[:] = memory.ledger
        self._world.admit_energy(nodes, velocities)
        self.wrenches = memory.wrenches.copy()

    def observe(self, vertices: FloatArray, motions: Motions) -> None:
        """Detect the tools' contacts at the end of a step without resolving them."""
        deepest = 0.0
        for index, row in enumerate(self.detectors):
            for part, triangles, detector in zip(self._parts, self._triangles, row, strict=True):
                found = detector.detect(
                    motions.positions[index],
                    motions.orientations[index],
                    vertices[part],
                    triangles,
                    motions.linear_velocities[index],
                    motions.angular_velocities[index],
                )
                deepest = max(deepest, float(found.depth.max()))
        self.queries = 1
        self.penetration = deepest
        self.residual = float(
            step.measure_depth(self._world.structure, motions.positions, motions.orientations, vertices)
        )
        self._contact_count = 0

    def resolve(
        self, start: FloatArray, free_nodes: FloatArray, free_velocities: FloatArray, motions: Motions | None
    ) -> tuple[FloatArray, FloatArray]:
        """Resolve all contacts at the end of a step; what it comes to is in this object's attributes as well.

        Args:
            start: (V, 3) nodes at the start of the step [u].
            free_nodes: (V, 3) nodes at its end, without contact [u].
            free_velocities: (V, 3) of the nodes, without contact [u/s].
            motions: What the tools did meanwhile; None if only the ground counts.

        Returns:
            Positions (V, 3) [u] and velocities (V, 3) [u/s] of the nodes after contact; arrays of their own.
        """
        result, with_tools = self._result, motions is not None
        motions = self._nothing if motions is None else motions
        nodes, velocities, self.nodal_impulses = np.empty((3, *start.shape))
        status = step.resolve_step(
            self._world.structure,
            self._first_step_code,
            motions,
            OrganMotion(start, free_nodes, free_velocities, nodes, velocities),
            StepOutcome(self.nodal_impulses, self._impulses, result),
        )
        if status != 0:
            raise FloatingPointError("the nodes' or the tools' positions are not finite")
        self._contact_count = int(result[settings.CONTACT_COUNT])
        self.penetration = float(result[settings.PENETRATION])
        self.residual = float(result[settings.RESIDUAL])
        self.queries = int(result[settings.QUERIES])
        self.crossings, self.crossed_for = int(result[settings.CROSSINGS]), float(result[settings.CROSSED_FOR])
        impulses = self._impulses / self._dt
        self.ground_force = -impulses[len(motions.positions), :3]
        if with_tools:
            self.wrenches = impulses[:-1]
        return nodes, velocities

    def contact_table(self) -> FloatArray:
        """(C, 8) where something pushed in the last step; see `pressure.contact_table`."""
        table: FloatArray = contact_table(self._world.workspace.constraints, self._contact_count)
        return table

    def pressures(self, motions: Motions) -> Pressures:
        """The contact pressures of the last step, in which the tools did what they are said to have done."""
        peak = 0.0
        for index, (nodes, faces) in enumerate(zip(self._pressures, self._face_pressures, strict=True)):
            faces[:] = 0.0
            if self.wrenches[index].any():
                on_tool = tool_pressures(
                    self._world.structure,
                    index,
                    self._contact_count,
                    motions.positions[index],
                    motions.orientations[index],
                    nodes,
                    faces,
                )
                peak = max(peak, on_tool)
            else:
                nodes[:] = 0.0
        return Pressures(peak, np.concatenate(self._face_pressures), tuple(nodes.copy() for nodes in self._pressures))
