"""The contact model of a scene: every tool against every organ, and the organs against the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.contact.columns import frame_along
from spatula_env.contact.flags import FlaggedDetector
from spatula_env.contact.motion import largest_shift, tool_passes
from spatula_env.contact.response import (
    GROUND,
    Constraints,
    add_ground_constraints,
    add_node_constraints,
    add_surface_constraints,
    solve_positions,
    solve_velocities,
    sum_tool_impulses,
)
from spatula_env.geometry.transforms import rotation_matrix, slerp

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from spatula_env.contact.flags import FirstStep
    from spatula_env.geometry.tools import Tool
    from spatula_env.scenes import Scene

    FloatArray = NDArray[np.float64]

POSITION_TOLERANCE = 1e-5
"""The position solve ends when a sweep moves no constrained point farther than this [u]."""

VELOCITY_TOLERANCE = 1e-4
"""The velocity solve ends when a sweep changes no constrained point's velocity by more than this [u/s]."""

MOST_SWEEPS = 50
"""Most sweeps in one solve. More do not change forces or residuals of a press in the fourth digit."""

PATH_PART = 0.5
"""Greatest motion of a tool between two queries, in its thicknesses."""

ORGAN_PART = 0.5
"""Greatest motion of an organ's node between two queries, in mean edges of the organ."""

COURANT_LIMIT = 0.125
"""Part of an organ's mean edge that a tool may make a node move in a step by giving it velocity. A faster tool moves
the organ by displacement alone: a node cannot carry more speed than its springs can answer within a step."""


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

    def speed(self, radius: float) -> float:
        """Greatest speed of a point of the tool no farther than this from its origin [u/s]."""
        return math.hypot(*self.linear_velocity) + math.hypot(*self.angular_velocity) * radius

    def at(self, fraction: float) -> tuple[FloatArray, FloatArray]:
        """Position and orientation after a fraction of the step."""
        if fraction == 1.0:
            return self.position, self.orientation
        if fraction == 0.0:
            return self.start_position, self.start_orientation
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
        queries: How many times each detector was asked in the last step.
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
        # The published method decides between two opposite faces. With nodes on more faces it must also be decided
        # which pair of faces a surface has come through; the seed's tool is left to the published method.
        self._selective = [first_step != "off" and len(placed.tool.face_normals) > 2 for placed in scene.tools]
        self.detectors = [[FlaggedDetector(placed.tool, first_step) for _ in scene.organs] for placed in scene.tools]
        self._dt = scene.dt
        self._ground = scene.ground
        self._tools = [placed.tool for placed in scene.tools]
        self._friction = [placed.friction for placed in scene.tools]
        starts = np.cumsum([0, *(len(placed.organ.vertices) for placed in scene.organs)])
        self._parts = [slice(int(a), int(b)) for a, b in pairwise(starts)]
        self._triangles = [np.array(placed.organ.triangles) for placed in scene.organs]
        # Kernels take writeable arrays; a tool's are read-only.
        self._nodes = [(np.array(tool.nodes), np.array(tool.normals)) for tool in self._tools]
        self._faces = [_face_arrays(tool) for tool in self._tools]
        edges = [placed.organ.edge_lengths for placed in scene.organs]
        self._mean_edge = min(float(lengths.mean()) for lengths in edges)
        self._inverse_masses = inverse_masses
        nodes = sum(len(tool.nodes) for tool in self._tools) * len(scene.organs)
        self._constraints = Constraints(2 * nodes + int(starts[-1]))
        self.penetration = 0.0
        self.residual = 0.0
        self.queries = 0
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

    def observe(self, start: FloatArray, vertices: FloatArray, motions: Sequence[Motion]) -> None:
        """Detect the tools' contacts without resolving them."""
        self._detect(start, vertices, motions, 0.0, 1.0)
        self.queries = 1
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
        self.penetration = self.residual = 0.0
        schedule = self._schedule(start, vertices, motions)
        self.queries = len(schedule)
        reference = start
        if len(schedule) > 1:
            shift = vertices - start
            vertices[:] = start
            organ_before = 0.0
        for organ, begin, end in schedule:
            if len(schedule) > 1:
                reference = vertices.copy()
                vertices += (organ - organ_before) * shift
                organ_before = organ
            self._detect(reference, vertices, motions, begin, end)
            self.penetration = max(self.penetration, self._deepest())
            # Friction moves the surface along a face, and with it the points where it crosses the rim: a second pass
            # finds them again.
            for _ in range(2):
                constraints = self._constrain(vertices, motions, begin, end)
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
                    MOST_SWEEPS,
                    POSITION_TOLERANCE,
                )
            self._look_again(vertices, motions, end)
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
            MOST_SWEEPS,
            VELOCITY_TOLERANCE,
        )
        return self._account(vertices, motions)

    def _schedule(
        self, start: FloatArray, vertices: FloatArray, motions: Sequence[Motion]
    ) -> list[tuple[float, float, float]]:
        """How a step is divided so that no query moves anything too far for the flags to follow.

        Returns:
            A query each: the fraction of the organs' motion done by then, and the fractions of the tools' paths
            between which the query looks. The organs move first, against the tools where they were.
        """
        parts = 1
        for tool, motion in zip(self._tools, motions, strict=False):
            if tool_passes(motion.start_position, motion.position, tool.bounding_radius, start, vertices):
                travel = motion.speed(tool.bounding_radius) * self._dt
                parts = max(parts, math.ceil(travel / (PATH_PART * tool.thickness)))
        organ_parts = 1
        if motions:
            organ_parts = max(1, math.ceil(largest_shift(start, vertices) / (ORGAN_PART * self._mean_edge) - 1e-9))
        schedule = [(k / organ_parts, 0.0, 0.0) for k in range(1, organ_parts)]
        if parts > 1:
            schedule.append((1.0, 0.0, 0.0))
        return schedule + [(1.0, k / parts, (k + 1) / parts) for k in range(parts)]

    def _detect(
        self, reference: FloatArray, vertices: FloatArray, motions: Sequence[Motion], begin: float, end: float
    ) -> None:
        """Query all pairs at fraction `end` of the tools' paths, the last query having been at `begin`."""
        for index, (motion, row) in enumerate(zip(motions, self.detectors, strict=False)):
            position, orientation = motion.at(end)
            last_position, last_orientation = motion.at(begin)
            for part, triangles, detector in zip(self._parts, self._triangles, row, strict=True):
                detector.update(
                    position,
                    orientation,
                    vertices[part],
                    triangles,
                    motion.linear_velocity,
                    motion.angular_velocity,
                    (last_position, last_orientation, reference[part]),
                    self._selective[index],
                )

    def _look_again(self, vertices: FloatArray, motions: Sequence[Motion], end: float) -> None:
        """Note what the response has left inside of the tools that must tell faces apart."""
        for motion, row, selective in zip(motions, self.detectors, self._selective, strict=False):
            if selective:
                position, orientation = motion.at(end)
                for part, triangles, detector in zip(self._parts, self._triangles, row, strict=True):
                    detector.look_again(position, orientation, vertices[part], triangles)

    def _deepest(self) -> float:
        return max((detector.deepest for row in self.detectors for detector in row), default=0.0)

    def _constrain(self, vertices: FloatArray, motions: Sequence[Motion], begin: float, end: float) -> Constraints:
        """Write the constraints of the contacts just detected, between the poses at two fractions of the step."""
        while not self._try_to_constrain(vertices, motions, begin, end):
            self._constraints = Constraints(2 * self._constraints.capacity)
        return self._constraints

    def _try_to_constrain(self, vertices: FloatArray, motions: Sequence[Motion], begin: float, end: float) -> bool:
        """As `_constrain`; False if the constraints are too many for their arrays."""
        constraints = self._constraints
        into = constraints.planes
        count = 0
        for index, (tool, motion, row) in enumerate(zip(self._tools, motions, self.detectors, strict=False)):
            position, orientation = motion.at(end)
            start_position, start_orientation = motion.at(begin)
            speed = motion.speed(tool.bounding_radius)
            greatest = COURANT_LIMIT * self._mean_edge / self._dt
            limit = greatest / speed if speed > greatest else 1.0
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
                states, triangle, record = detector.buffers
                count = add_node_constraints(
                    count, states, triangle, record, *self._nodes[index], triangles, part.start, *pose, *into
                )
                count = add_surface_constraints(
                    count, states, record, *self._faces[index], self._selective[index], triangles, vertices, part.start,
                    *pose, *detector.workspace, *into,
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
        constraints = self._constraints
        wrenches = []
        self.nodal_impulses[:] = 0.0
        for index, (tool, motion) in enumerate(zip(self._tools, motions, strict=False)):
            impulse, moment, node_impulses = np.zeros(3), np.zeros(3), np.zeros((len(tool.nodes), 3))
            sum_tool_impulses(
                constraints.count,
                constraints.corners,
                constraints.weights,
                constraints.normal,
                constraints.impulse,
                constraints.owner,
                constraints.node,
                vertices,
                index,
                motion.position,
                rotation_matrix(motion.orientation).ravel(),
                *self._nodes[index],
                self.nodal_impulses,
                impulse,
                moment,
                node_impulses,
            )
            wrenches.append(Wrench(impulse / -self._dt, moment / -self._dt, node_impulses / -self._dt))
        on_ground = constraints.owner[: constraints.count] == GROUND
        self.ground_force = constraints.impulse[: constraints.count][on_ground].sum(axis=0) / self._dt
        return wrenches


def _face_arrays(tool: Tool) -> tuple[NDArray[Any], ...]:
    """A tool's faces as `add_surface_constraints` takes them, from `face` to `plane_offsets`.

    A face may be deeper in the organ than its deepest node by the distance of its nodes.
    """
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
