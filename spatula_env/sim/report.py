"""The report of a physics step."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.contact.pressure import spread_forces
from spatula_env.geometry.transforms import rotation_matrix

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.contact.flags import Contacts
    from spatula_env.contact.motion import Motions
    from spatula_env.scenes import Scene

    FloatArray = NDArray[np.float64]


LONGEST_CROSSED = 0.1
"""Organs that have crossed for longer than this are tangled [s]."""


@dataclass(frozen=True)
class Wrench:
    """The load of the organs on one tool, averaged over a step.

    Attributes:
        force: (3,) [kg u/s2].
        torque: (3,) about the tool's origin, world frame [kg u2/s2].
        node_forces: (n, 3) the force, distributed over the contact nodes; they sum to `force` [kg u/s2]. NaN with
            contact of the engine's own, "bullet" or "mujoco", which does not report them.
        pressures: (n,) the component of each node's force against its face, divided by the node's share of the face
            [kg/(u s2)].
    """

    force: FloatArray
    torque: FloatArray
    node_forces: FloatArray
    pressures: FloatArray


@dataclass(frozen=True)
class Report:
    """What happened in one step, in scene units.

    Attributes:
        scene: The scene.
        motions: How the tools moved.
        loads: (N, 6) force and torque on each of the N tools, averaged over the step [kg u/s2, kg u2/s2].
        nodal_impulses: (V, 3) impulses of the tools on the organs' nodes [kg u/s]; NaN with contact of the engine's
            own, which does not report them.
        ground_force: (3,) force of the ground on the organs, averaged over the step [kg u/s2].
        all_contacts: What the detector of each tool (outer) and organ (inner) found, before correction.
        table: (C, 8) all points where something pushed; see `contact.pressure`. None with contact of the
            engine's own.
        penetration: Greatest depth of a contact node before correction [u].
        residual: Greatest depth that is left after correction: of any point of an organ's surface in a tool, and of a
            tool's corners and edges in an organ; see `contact.depth` and `contact.edge_depth` [u].
        queries: Number of queries of each detector: more than one where something moved too far at once.
        reach: Distance over which a push is distributed to contact nodes [u].
        crossings: Number of places where organs cross themselves or each other: pairs of an edge and a triangle.
        crossed_for: Time for which organs have been crossing [s].
        stopped: Whether the tools did not move, or only part of their way, because an organ could not give way.
    """

    scene: Scene
    motions: Motions
    loads: FloatArray
    nodal_impulses: FloatArray
    ground_force: FloatArray
    all_contacts: tuple[tuple[Contacts, ...], ...]
    table: FloatArray | None
    penetration: float
    residual: float
    queries: int
    reach: float
    crossings: int
    crossed_for: float
    stopped: bool

    @property
    def tangled(self) -> bool:
        """Whether organs have crossed for longer than `LONGEST_CROSSED`; their motion is meaningless then."""
        return self.crossed_for > LONGEST_CROSSED

    @property
    def force(self) -> FloatArray:
        """(3,) force of the organs on the first tool, averaged over the step [kg u/s2]."""
        return self.loads[0, :3]

    @property
    def torque(self) -> FloatArray:
        """(3,) torque of the organs on the first tool, about its origin, world frame [kg u2/s2]."""
        return self.loads[0, 3:]

    @property
    def contacts(self) -> Contacts:
        """What the detector of the first tool and the first organ found, before correction."""
        return self.all_contacts[0][0]

    @property
    def force_newtons(self) -> FloatArray:
        """(3,) `force` in newtons."""
        return self.force * self.scene.scale.force

    @property
    def torque_newton_metres(self) -> FloatArray:
        """(3,) `torque` in newton-metres."""
        return self.torque * self.scene.scale.torque

    @cached_property
    def wrenches(self) -> tuple[Wrench, ...]:
        """The load of the organs on each tool, and its distribution over the contact nodes."""
        return tuple(self._wrench(index) for index in range(len(self.loads)))

    @cached_property
    def pressures_pascals(self) -> FloatArray:
        """(n,) contact pressure on each node of the first tool [Pa]."""
        return self.wrenches[0].pressures * self.scene.scale.pressure

    @cached_property
    def peak_pressure_pascals(self) -> float:
        """Greatest contact pressure on any node of any tool [Pa]."""
        return max(float(wrench.pressures.max()) for wrench in self.wrenches) * self.scene.scale.pressure

    def _wrench(self, index: int) -> Wrench:
        tool = self.scene.tools[index].tool
        forces = np.full((len(tool.nodes), 3), np.nan)
        rotation = rotation_matrix(self.motions.orientations[index])
        if self.table is not None:
            flags = np.any([contacts.flags for contacts in self.all_contacts[index]], axis=0)
            spread_forces(
                self.table,
                index,
                self.motions.positions[index],
                rotation.ravel(),
                np.array(tool.nodes),
                np.array(tool.face),
                np.array(tool.areas),
                flags,
                self.reach,
                self.scene.dt,
                forces,
            )
        against = -np.einsum("ij,ij->i", forces, tool.normals @ rotation.T)
        return Wrench(
            force=self.loads[index, :3],
            torque=self.loads[index, 3:],
            node_forces=forces,
            pressures=np.maximum(against, 0.0) / tool.areas,
        )


@dataclass(frozen=True)
class Pressures:
    """Contact pressures on the tools in a step.

    Attributes:
        peak: Greatest pressure on a contact node of any tool [kg/(u s2)].
        faces: (F,) mean pressure on each face with nodes, tool after tool [kg/(u s2)].
        nodes: For each tool, (n,) pressures on its contact nodes [kg/(u s2)].
    """

    peak: float
    faces: FloatArray
    nodes: tuple[FloatArray, ...]
