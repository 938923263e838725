"""The contact model of a scene: every tool against every organ, and the organs against the ground."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.contact import step
from spatula_env.contact.flags import FIRST_STEP_CODES, FlaggedDetector
from spatula_env.contact.multipliers import MOST_PASSED
from spatula_env.contact.pressure import contact_table
from spatula_env.contact.response import LEDGER_LENGTH
from spatula_env.contact.structures import (
    copy_constraints,
    make_constraints,
    memory_list,
    restore_constraints,
    surface_list,
    tool_list,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.contact.flags import FirstStep
    from spatula_env.scenes import Scene

    FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Motions:
    """How the N tools move in one step.

    Attributes:
        start_positions: (N, 3) [u].
        start_orientations: (N, 4).
        positions: (N, 3) at the end of the step [u].
        orientations: (N, 4).
        linear_velocities: (N, 3) [u/s].
        angular_velocities: (N, 3) world frame [rad/s].
    """

    start_positions: FloatArray
    start_orientations: FloatArray
    positions: FloatArray
    orientations: FloatArray
    linear_velocities: FloatArray
    angular_velocities: FloatArray


@dataclass(frozen=True)
class ContactMemory:
    """What a contact model remembers from one step to the next.

    Attributes:
        flags: Of each tool (outer) and organ (inner).
        multipliers: From which the position and the velocity solve start: names, features and rows of constraints.
        ledger: (O, 4) of the energy that the tools put into each organ; see `response`.
    """

    flags: tuple[tuple[NDArray[np.bool_], ...], ...]
    multipliers: tuple[tuple[NDArray[Any], NDArray[Any], NDArray[Any]], ...]
    ledger: FloatArray


@dataclass
class Resolved:
    """Nodes after contact.

    Attributes:
        nodes: (V, 3) positions [u].
        velocities: (V, 3) [u/s].
        displacements: (V, 3) what contact added to the positions [u].
        velocity_changes: (V, 3) what it added to the velocities [u/s].
    """

    nodes: FloatArray
    velocities: FloatArray
    displacements: FloatArray
    velocity_changes: FloatArray


class ContactModel:
    """Detects and resolves the contacts of a scene, step after step.

    Attributes:
        detectors: One for each tool (outer) and organ (inner): flags are remembered per pair.
        penetration: Greatest depth of a contact node in the last step, before correction [u].
        residual: How far the tools are still in the organs after correction [u].
        queries: How many times each detector was asked in the last step.
        nodal_impulses: (V, 3) what the tools gave the organs' nodes in the last step [kg u/s].
        wrenches: (N, 6) force and torque on each tool, averaged over the last step [kg u/s2, kg u2/s2].
        ground_force: (3,) what the ground does to the organs, averaged over the last step [kg u/s2].
    """

    def __init__(self, scene: Scene, inverse_masses: FloatArray, first_step: FirstStep = "inside") -> None:
        """Prepare for a scene.

        Args:
            scene: Its tools, organs and ground.
            inverse_masses: (V,) of the organs' nodes [1/kg].
            first_step: Of the detectors. With "off" nothing but flagged nodes makes contact, as in the published
                method's second step.
        """
        self.detectors = [[FlaggedDetector(placed.tool, first_step) for _ in scene.organs] for placed in scene.tools]
        for row in self.detectors:
            for detector, placed_organ in zip(row, scene.organs, strict=True):
                organ = placed_organ.organ
                detector.memory.resize(len(organ.vertices), len(organ.triangles))
        starts = np.cumsum([0, *(len(placed.organ.vertices) for placed in scene.organs)])
        self._parts = [slice(int(a), int(b)) for a, b in pairwise(starts)]
        self._triangles = [np.array(placed.organ.triangles) for placed in scene.organs]
        self._tools = tool_list([row[0].shape for row in self.detectors])
        self._no_tools = tool_list([])
        self._memories = memory_list([detector.memory.structure for row in self.detectors for detector in row])
        self._surfaces = surface_list(self._triangles)
        self._constraints = make_constraints(256)
        self._earlier = make_constraints(MOST_PASSED)
        self._warm = make_constraints(256), make_constraints(256)
        self._warm_counts = np.zeros(2, dtype=np.int64)
        self._first_vertices = starts[:-1].astype(np.int64)
        self._friction = np.array([placed.friction for placed in scene.tools])
        self._mode = step.SECOND_STEP if first_step == "off" else step.FLAGS
        self._first_step_code = FIRST_STEP_CODES[first_step]
        self._settings = np.zeros(step.SETTINGS_LENGTH)
        self._settings[step.DT] = scene.dt
        self._settings[step.MEAN_EDGE] = min(float(placed.organ.edge_lengths.mean()) for placed in scene.organs)
        self._settings[step.GRAVITY] = scene.gravity
        self._ledger = np.zeros((len(scene.organs), LEDGER_LENGTH))
        free = inverse_masses[inverse_masses > 0.0]
        self._settings[step.MEAN_INVERSE_MASS] = float(free.mean()) if len(free) else 0.0
        if scene.ground is not None:
            self._settings[step.HAS_GROUND] = 1.0
            self._settings[step.GROUND_HEIGHT] = scene.ground.height
            self._settings[step.GROUND_FRICTION] = scene.ground.friction
        self._inverse_masses = inverse_masses
        self._dt = scene.dt
        count = len(scene.tools)
        self._nothing = Motions(*(np.zeros((0, width)) for width in (3, 4, 3, 4, 3, 3)))
        self._impulses = np.zeros((count + 1, 6))
        self._result = np.zeros(step.RESULT_LENGTH)
        self._contact_count = 0
        self.penetration = 0.0
        self.residual = 0.0
        self.queries = 0
        self.nodal_impulses: FloatArray = np.zeros((int(starts[-1]), 3))
        self.wrenches: FloatArray = np.zeros((count, 6))
        self.ground_force: FloatArray = np.zeros(3)

    def reset(self) -> None:
        """Forget all contacts."""
        for index in range(len(self.detectors)):
            self.forget(index)
        self.nodal_impulses = np.zeros_like(self.nodal_impulses)
        self.wrenches = np.zeros_like(self.wrenches)
        self.ground_force = np.zeros(3)
        self.penetration = self.residual = 0.0
        self._warm_counts[:] = 0
        self._ledger[:] = 0.0

    def forget(self, tool: int) -> None:
        """Clear the flags of one tool."""
        for detector in self.detectors[tool]:
            detector.reset()

    def save(self) -> ContactMemory:
        """Everything that is remembered, as arrays of its own."""
        return ContactMemory(
            flags=tuple(tuple(detector.flags for detector in row) for row in self.detectors),
            multipliers=tuple(
                copy_constraints(warm, count)
                for warm, count in zip(self._warm, self._warm_counts.tolist(), strict=True)
            ),
            ledger=self._ledger.copy(),
        )

    def restore(self, memory: ContactMemory) -> None:
        """Go back to what was remembered, here or by another model of the same scene."""
        for row, saved in zip(self.detectors, memory.flags, strict=True):
            for detector, flags in zip(row, saved, strict=True):
                detector.flags = flags
        for index, (warm, parts) in enumerate(zip(self._warm, memory.multipliers, strict=True)):
            restore_constraints(warm, *(part.copy() for part in parts))
            self._warm_counts[index] = len(parts[0])
        self._ledger[:] = memory.ledger

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
        self.residual = self.penetration = deepest

    def resolve(
        self, start: FloatArray, free_nodes: FloatArray, free_velocities: FloatArray, motions: Motions | None
    ) -> Resolved:
        """Resolve all contacts at the end of a step; what it comes to is in this object's attributes as well.

        Args:
            start: (V, 3) nodes at the start of the step [u].
            free_nodes: (V, 3) nodes at its end, without contact [u].
            free_velocities: (V, 3) of the nodes, without contact [u/s].
            motions: What the tools did meanwhile; None if only the ground counts.

        Returns:
            Where the nodes are and how fast; arrays of their own.
        """
        result = self._result
        tools = self._tools
        if motions is None:
            motions, tools = self._nothing, self._no_tools
        resolved, self.nodal_impulses = Resolved(*(room := np.empty((5, *start.shape)))[:4]), room[4]
        status = step.resolve_step(
            tools,
            self._memories,
            self._surfaces,
            self._constraints,
            self._earlier,
            *self._warm,
            self._warm_counts,
            self._first_vertices,
            motions.start_positions,
            motions.start_orientations,
            motions.positions,
            motions.orientations,
            motions.linear_velocities,
            motions.angular_velocities,
            self._friction,
            self._mode,
            self._first_step_code,
            True,
            self._settings,
            self._inverse_masses,
            self._ledger,
            start,
            free_nodes,
            free_velocities,
            resolved.nodes,
            resolved.velocities,
            resolved.displacements,
            resolved.velocity_changes,
            self.nodal_impulses,
            self._impulses,
            result,
        )
        if status != 0:
            raise FloatingPointError("the nodes' or the tools' positions are not finite")
        self._contact_count = int(result[step.CONTACT_COUNT])
        self.penetration = float(result[step.PENETRATION])
        self.residual = float(result[step.RESIDUAL])
        self.queries = int(result[step.QUERIES])
        impulses = self._impulses / self._dt
        self.ground_force = -impulses[len(motions.positions), :3]
        if tools is self._tools:
            self.wrenches = impulses[:-1]
        return resolved

    def contact_table(self) -> FloatArray:
        """(C, 8) where something pushed in the last step; see `pressure.contact_table`."""
        table: FloatArray = contact_table(self._constraints, self._contact_count)
        return table
