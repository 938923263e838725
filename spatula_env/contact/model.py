"""The contact model of a scene: every tool against every organ, and the organs against the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.contact.columns import frame_along
from spatula_env.contact.flags import Contacts, FirstStep, FlaggedDetector
from spatula_env.contact.response import (
    GROUND,
    Constraints,
    add_ground_constraints,
    add_node_constraints,
    add_surface_constraints,
    solve_positions,
    solve_velocities,
)
from spatula_env.geometry.transforms import rotation_matrix, slerp

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from spatula_env.geometry.tools import Tool
    from spatula_env.scenes import Scene

    FloatArray = NDArray[np.float64]

POSITION_TOLERANCE = 1e-6
"""The position solve ends when a sweep moves no constrained point farther than this [u]."""

VELOCITY_TOLERANCE = 1e-6
"""The velocity solve ends when a sweep changes no constrained point's velocity by more than this [u/s]."""

SUBSTEP_LENGTH = 0.5
"""Greatest relative motion of tool and organ between two queries, in thicknesses of the tool."""

LO=0.25
OP=0.35
RS=1.0
COURANT_LIMIT = 0.125
"""Part of an organ's mean edge that a tool may make a node move in a step by giving it velocity. A faster tool moves
the organ by displacement alone: a node cannot carry more speed than its springs can answer within a step."""

POSITION_SWEEPS = 200
VELOCITY_SWEEPS = 200
"""Most sweeps in one solve; a press takes about twenty."""


@dataclass
class Motion:
    """A tool's movement in one step.

    Attributes:
        position: (3,) at the end [u].
        orientation: (4,) at the end.
        start_position: (3,) at the start [u].
        start_orientation: (4,) at the start.
        linear_velocity: (3,) [u/s].
        angular_velocity: (3,) world frame [rad/s].
    """

    position: FloatArray
    orientation: FloatArray
    start_position: FloatArray
    start_orientation: FloatArray
    linear_velocity: FloatArray
    angular_velocity: FloatArray

    def at(self, fraction: float) -> tuple[FloatArray, FloatArray]:
        """Position and orientation after a fraction of the step."""
        if fraction == 1.0:
            return self.position, self.orientation
        return (
            self.start_position + fraction * (self.position - self.start_position),
            slerp(self.start_orientation, self.orientation, fraction),
        )


@dataclass(frozen=True)
class Wrench:
    """What the organs do to one tool, averaged over a step.

    Attributes:
        force: (3,) [kg u/s2].
        torque: (3,) about the tool's origin, world frame [kg u2/s2].
        node_forces: (n, 3) on each contact node [kg u/s2]; what vertices of the organ press on goes to the nearest
            node of the face.
    """

    force: FloatArray
    torque: FloatArray
    node_forces: FloatArray


class ContactModel:
    """Detects and resolves the contacts of a scene, step after step.

    Attributes:
        detectors: One for each tool (outer) and organ (inner): flags are remembered per pair.
        penetration: Greatest depth of a contact node in the last step, before correction [u].
        residual: Greatest violation of a contact constraint after correction [u].
        path_parts: Into how many parts the tools' paths were divided in the last step.
        nodal_impulses: (V, 3) what the tools gave the organs' nodes in the last step [kg u/s].
        ground_force: (3,) what the ground does to the organs, averaged over the last step [kg u/s2].
    """

    def __init__(self, scene: Scene, inverse_masses: FloatArray, first_step: FirstStep = "inside") -> None:
        """Prepare for a scene.

        Args:
            scene: Its tools, organs and ground.
            inverse_masses: (V,) of the organs' nodes [1/kg].
            first_step: Of the detectors.
        """
        self.detectors = [
            [FlaggedDetector(placed.tool, first_step=first_step, least_opposition=LO) for _ in scene.organs] for placed in scene.tools
        ]
        self._dt = scene.dt
        self._ground = scene.ground
        self._tools = [placed.tool for placed in scene.tools]
        self._friction = [placed.friction for placed in scene.tools]
        counts = [len(placed.organ.vertices) for placed in scene.organs]
        starts = np.cumsum([0, *counts])
        self._parts = [slice(int(a), int(b)) for a, b in zip(starts[:-1], starts[1:], strict=True)]
        self._triangles = [np.array(placed.organ.triangles) for placed in scene.organs]
        # Kernels take writeable arrays; a tool's are read-only.
        self._nodes = [(np.array(tool.nodes), np.array(tool.normals)) for tool in self._tools]
        self._faces = [_face_arrays(tool) for tool in self._tools]
        self._longest_edge = max(float(placed.organ.edge_lengths.max()) for placed in scene.organs)
        mean_edge = min(float(placed.organ.edge_lengths.mean()) for placed in scene.organs)
        self._greatest_speed = COURANT_LIMIT * mean_edge / scene.dt
        self._inverse_masses = inverse_masses
        nodes = sum(len(tool.nodes) for tool in self._tools) * len(scene.organs)
        self._constraints = Constraints(2 * nodes + int(starts[-1]))
        self.penetration = 0.0
        self.residual = 0.0
        self.path_parts = 1
        self.nodal_impulses: FloatArray = np.zeros((int(starts[-1]), 3))
        self.ground_force: FloatArray = np.zeros(3)

    def reset(self) -> None:
        """Forget all contacts."""
        for index in range(len(self.detectors)):
            self.forget(index)
        self.nodal_impulses[:] = 0.0
        self.ground_force[:] = 0.0
        self.penetration = self.residual = 0.0

    def forget(self, tool: int) -> None:
        """Clear the flags of one tool."""
        for detector in self.detectors[tool]:
            detector.reset()

    def contacts(self, tool: int, organ: int) -> Contacts:
        """What the last query of a pair found."""
        return self.detectors[tool][organ].contacts

    def observe(self, start: FloatArray, vertices: FloatArray, motions: Sequence[Motion]) -> None:
        """Detect the tools' contacts without resolving them."""
        self._detect(start, vertices, motions, 0.0, 1.0)
        self.residual = self.penetration = self._deepest()

    def resolve(
        self, start: FloatArray, vertices: FloatArray, velocities: FloatArray, motions: Sequence[Motion]
    ) -> list[Wrench]:
        """Resolve all contacts at the end of a step.

        Args:
            start: (V, 3) nodes at the start of the step [u].
            vertices: (V, 3) nodes at its end; corrected in place [u].
            velocities: (V, 3) of the nodes; changed in place by the contacts' impulses [u/s].
            motions: What each tool did meanwhile; empty if only the ground counts.

        Returns:
            The wrench on each tool.
        """
        constraints = self._constraints
        parts = self.path_parts = self._count_parts(start, vertices, motions)
        self.penetration = 0.0
        # With a divided path the organs' own motion is resolved first, against the tools where they were.
        shift = vertices - start
        near = 0.0
        if motions: near=float(np.sqrt((shift**2).sum(axis=1).max()))
        op = max(1, math.ceil(near / OP)) if motions else 1
        schedule = [(k/op, 0.0, 0.0) for k in range(1, op)]
        schedule += [(1.0, 0.0, 1.0)] if parts == 1 else [(1.0, 0.0, 0.0)] + [(1.0, k / parts, (k+1)/parts) for k in range(parts)]
        if op > 1: vertices[:] = start
        done=0.0
        reference = start
        for n_,(organ, begin, end) in enumerate(schedule):
            if op > 1 and organ>done: vertices += (organ-done)*shift; done=organ
            self._detect(reference, vertices, motions, begin, end)
            self.penetration = max(self.penetration, self._deepest())
            self._constrain(vertices, motions, begin, end)
            self.residual = solve_positions(
                constraints.count,
                constraints.corners,
                constraints.weights,
                constraints.normal,
                constraints.point,
                constraints.carry,
                constraints.friction,
                self._inverse_masses,
                reference,
                vertices,
                constraints.displacement,
                constraints.gap,
                POSITION_SWEEPS,
                POSITION_TOLERANCE,
            )
            if n_+1<len(schedule):
                reference = vertices.copy()
        solve_velocities(
            constraints.count,
            constraints.corners,
            constraints.weights,
            constraints.normal,
            constraints.velocity,
            constraints.friction,
            constraints.gap,
            self._inverse_masses,
            velocities,
            constraints.impulse,
            self._dt,
            VELOCITY_SWEEPS,
            VELOCITY_TOLERANCE,
        )
        return self._account(vertices, motions)

    def _count_parts(self, start: FloatArray, vertices: FloatArray, motions: Sequence[Motion]) -> int:
        """Into how many parts the tools' paths must be divided so that nothing is jumped over."""
        parts = 1
        low = np.minimum(start.min(axis=0), vertices.min(axis=0))
        high = np.maximum(start.max(axis=0), vertices.max(axis=0))
        for tool, motion in zip(self._tools, motions, strict=False):
            radius = tool.bounding_radius
            if (np.minimum(motion.position, motion.start_position) - radius > high).any():
                continue
            if (np.maximum(motion.position, motion.start_position) + radius < low).any():
                continue
            travel = float(np.linalg.norm(motion.position - motion.start_position))
            travel += float(np.linalg.norm(motion.angular_velocity)) * self._dt * radius
            parts = max(parts, math.ceil(travel / (SUBSTEP_LENGTH * tool.thickness)))
        return parts

    def _detect(self, reference: FloatArray, vertices: FloatArray, motions: Sequence[Motion], begin: float, end: float) -> None:
        """Query all pairs at the poses at fraction `end` of the step."""
        for tool, motion, row in zip(self._tools, motions, self.detectors, strict=False):
            position, orientation = motion.at(end)
            for part, triangles, detector in zip(self._parts, self._triangles, row, strict=True):
                organ_velocity = _local_shift(
                    vertices[part] - reference[part],
                    vertices[part],
                    position,
                    tool.bounding_radius + self._longest_edge,
                ) / self._dt
                detector.update(
                    position,
                    orientation,
                    vertices[part],
                    triangles,
                    motion.linear_velocity - organ_velocity,
                    motion.angular_velocity,
                    RS*((end-begin)*(np.linalg.norm(motion.position-motion.start_position)+np.linalg.norm(motion.angular_velocity)*self._dt*tool.bounding_radius)+np.sqrt(((vertices[part] - reference[part])**2).sum(1).max())+.01),
                )

    def _deepest(self) -> float:
        return max((detector.deepest for row in self.detectors for detector in row), default=0.0)

    def _constrain(self, vertices: FloatArray, motions: Sequence[Motion], begin: float, end: float) -> None:
        """Write the constraints of the contacts just detected, between the poses at two fractions of the step."""
        while not self._try_to_constrain(vertices, motions, begin, end):
            self._constraints = Constraints(2 * self._constraints.capacity)

    def _try_to_constrain(
        self, vertices: FloatArray, motions: Sequence[Motion], begin: float, end: float
    ) -> bool:
        """As `_constrain`; False if the constraints are too many for their arrays."""
        constraints = self._constraints
        into = (
            constraints.corners,
            constraints.weights,
            constraints.normal,
            constraints.point,
            constraints.carry,
            constraints.velocity,
            constraints.friction,
            constraints.owner,
            constraints.node,
        )
        count = 0
        for index, (tool, motion, row) in enumerate(zip(self._tools, motions, self.detectors, strict=False)):
            position, orientation = motion.at(end)
            start_position, start_orientation = motion.at(begin)
            speed = float(np.linalg.norm(motion.linear_velocity))
            speed += float(np.linalg.norm(motion.angular_velocity)) * tool.bounding_radius
            limit = min(1.0, self._greatest_speed / speed) if speed > 0.0 else 1.0
            pose = (
                position,
                rotation_matrix(orientation).ravel(),
                start_position,
                rotation_matrix(start_orientation).ravel(),
                limit * motion.linear_velocity,
                limit * motion.angular_velocity,
                self._friction[index],
                index,
            )
            for part, triangles, detector in zip(self._parts, self._triangles, row, strict=True):
                count = add_node_constraints(
                    count, *detector.buffers, *self._nodes[index], triangles, part.start, *pose, *into
                )
                states, _, record = detector.buffers
                count = add_surface_constraints(
                    count, states, record, *self._faces[index], triangles, vertices, part.start, *pose,
                    *detector.workspace, *into,
                )  # fmt: skip
                if count < 0:
                    return False
        if self._ground is not None:
            count = add_ground_constraints(
                count, vertices, self._inverse_masses, self._ground.height, self._ground.friction, *into
            )
        constraints.count = count
        return count >= 0

    def _account(self, vertices: FloatArray, motions: Sequence[Motion]) -> list[Wrench]:
        """Sum the impulses of the last solve, per node and per tool."""
        c, n = self._constraints, self._constraints.count
        impulse, owner, node, corners = c.impulse[:n], c.owner[:n], c.node[:n], c.corners[:n]
        by_tool = owner != GROUND
        self.nodal_impulses[:] = 0.0
        np.add.at(self.nodal_impulses, corners[by_tool], (c.weights[:n, :, None] * impulse[:, None, :])[by_tool])
        self.ground_force = impulse[~by_tool].sum(axis=0) / self._dt
        points = np.einsum("ck,ckx->cx", c.weights[:n], vertices[corners])
        wrenches = []
        for index, (tool, motion) in enumerate(zip(self._tools, motions, strict=False)):
            mine = owner == index
            forces = -impulse[mine] / self._dt
            torque = np.cross(points[mine] - motion.position, forces).sum(axis=0)
            node_forces = np.zeros((len(tool.nodes), 3))
            on_node = node[mine] >= 0
            np.add.at(node_forces, node[mine][on_node], forces[on_node])
            wrenches.append(Wrench(forces.sum(axis=0), torque, node_forces))
        return wrenches


def _local_shift(shift: FloatArray, vertices: FloatArray, position: FloatArray, radius: float) -> FloatArray:
    """Mean shift (3,) of the vertices near a tool, or of all if none is [u]."""
    near = ((vertices - position) ** 2).sum(axis=1) < radius**2
    mean: FloatArray = shift[near].mean(axis=0) if near.any() else shift.mean(axis=0)
    return mean


def _face_arrays(tool: Tool) -> tuple[NDArray[Any], ...]:
    """A tool's faces as `add_surface_constraints` takes them, from `face` to `plane_offsets`."""
    frames, bounds, heights, rims, slack = [], [], [], [], []
    for face, normal in enumerate(tool.face_normals):
        frame = frame_along(normal)
        corners = tool.vertices @ frame.T
        height = corners[:, 2].max()
        rim = corners[corners[:, 2] > height - 1e-6 * np.max(tool.size)][:, :2]
        frames.append(frame)
        heights.append(height)
        bounds.append([rim[:, 0].min(), rim[:, 0].max(), rim[:, 1].min(), rim[:, 1].max()])
        rims.append(rim)
        slack.append(float(np.sqrt(tool.areas[tool.face == face].max())))
    normals, offsets = tool.planes
    return (
        np.array(tool.face),
        np.array(frames),
        np.array(bounds),
        np.array(heights),
        np.array(slack),
        np.concatenate(rims),
        np.cumsum([0, *(len(rim) for rim in rims)]).astype(np.int32),
        np.array(normals),
        np.array(offsets),
    )
