"""The flags method: which contact nodes of a tool are in feasible contact with an organ, remembered between steps.

After Fukuhara et al., "Proposition and evaluation of a collision detection method for real time surgery simulation of
opening a brain fissure", ROBOMECH Journal 1:6 (2014), doi 10.1186/s40648-014-0006-7, in the form in which it was put
into Bullet. docs/contact-model.md has the algorithm and every decision left open by its sources.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numba import types

from spatula_env._kernels import ARRAYS, array_kernel, kernel
from spatula_env.contact.path import ON_PLANE, entry_plane
from spatula_env.contact.raycast import cast_columns
from spatula_env.contact.rigid import opposes_best, turn
from spatula_env.contact.structures import MEMORY, NO_HIT, TOOL, Memory, tool_shape
from spatula_env.geometry.transforms import as_quaternion, as_vector3

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from spatula_env.geometry.tools import Tool

FirstStep = Literal["inside", "any_hit", "off"]
"""What makes a contact unfeasible in the first step: see `FlaggedDetector`."""

FIRST_STEP_CODES: dict[str, int] = {"off": 0, "any_hit": 1, "inside": 2}
"""Codes of the variants of the first step in kernels."""

F8, F8_2, I4_2 = ARRAYS["f8"], ARRAYS["f8_2"], ARRAYS["i4_2"]

_VERTEX_NOT_FINITE, _TRIANGLE_OUT_OF_RANGE, _MOTION_NOT_VALID, WRONG_SHAPE = 1, 2, 3, 4

_ONLY_ARRAYS = {np.ndarray}
_FLOAT, _INTEGER = np.dtype(np.float64), np.dtype(np.int32)

STILL = (0.0, 0.0, 0.0)
"""Default linear and angular velocity of a tool [u/s], [rad/s]."""

_UNIT_TOLERANCE = 1.0000001e-6
"""Allowed difference of a quaternion's length from one; by a rounding error more than `as_quaternion` allows."""


class Contacts:
    """Contacts that a detector found in one query. Arrays are copies, which do not change with the next query.

    Attributes:
        flags: (n,) bool, whether the node is in feasible contact.
        unfeasible: (n,) bool, whether the first step refused the node.
        triangle: (n,) int32, the organ's triangle that the node's inward ray leaves through; -1 where not flagged.
        barycentric: (n, 3) weights of the triangle's corners at that point; zero where not flagged.
        depth: (n,) distance from the node to that point [u]; zero where not flagged.
        normal: (n, 3) the triangle's outward normal N, world frame; zero where not flagged.
        points: (n, 3) that point on the organ, world frame [u]; the node's own position where not flagged.
    """

    __slots__ = ("_record", "flags", "triangle", "unfeasible")

    def __init__(self, states: NDArray[np.bool_], triangle: NDArray[np.int32], record: NDArray[np.float64]) -> None:
        """Copy a detector's buffers: states (2, n), triangle (n,), record (n, 10)."""
        states = states.copy()
        self.flags: NDArray[np.bool_] = states[0]
        self.unfeasible: NDArray[np.bool_] = states[1]
        self.triangle: NDArray[np.int32] = triangle.copy()
        self._record = record.copy()

    @property
    def barycentric(self) -> NDArray[np.float64]:
        """(n, 3) weights of the triangle's corners at the contact point."""
        return self._record[:, 0:3]

    @property
    def depth(self) -> NDArray[np.float64]:
        """(n,) distance from the contact node to the contact point [u]."""
        return self._record[:, 3]

    @property
    def normal(self) -> NDArray[np.float64]:
        """(n, 3) outward normal of the organ at the contact point, world frame."""
        return self._record[:, 4:7]

    @property
    def points(self) -> NDArray[np.float64]:
        """(n, 3) the contact points on the organ, world frame [u]."""
        return self._record[:, 7:10]


@array_kernel
def fill_rotation(quaternion: np.ndarray, scale: float, rotation: np.ndarray) -> None:
    """Write the rotation matrix (9,), row by row, of a quaternion (xyzw); `scale` brings it to unit length."""
    x, y, z, w = scale * quaternion[0], scale * quaternion[1], scale * quaternion[2], scale * quaternion[3]
    rotation[0], rotation[1], rotation[2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    rotation[3], rotation[4], rotation[5] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    rotation[6], rotation[7], rotation[8] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)


@array_kernel
def _fill_triangle_normal(vertices: np.ndarray, a: int, b: int, c: int, normal: np.ndarray) -> None:
    """Write the unit outward normal of a triangle."""
    ux, uy, uz = (
        vertices[b, 0] - vertices[a, 0],
        vertices[b, 1] - vertices[a, 1],
        vertices[b, 2] - vertices[a, 2],
    )
    vx, vy, vz = (
        vertices[c, 0] - vertices[a, 0],
        vertices[c, 1] - vertices[a, 1],
        vertices[c, 2] - vertices[a, 2],
    )
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    scale = 1.0 / np.sqrt(x * x + y * y + z * z)
    normal[0], normal[1], normal[2] = x * scale, y * scale, z * scale


@array_kernel
def fill_local_normal(local: np.ndarray, corners: np.ndarray, normal: np.ndarray) -> None:
    """Write the unit outward normal of a triangle whose vertices are in local (3, V)."""
    a, b, c = corners[0], corners[1], corners[2]
    ux, uy, uz = local[0, b] - local[0, a], local[1, b] - local[1, a], local[2, b] - local[2, a]
    vx, vy, vz = local[0, c] - local[0, a], local[1, c] - local[1, a], local[2, c] - local[2, a]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    scale = 1.0 / np.sqrt(x * x + y * y + z * z)
    normal[0], normal[1], normal[2] = x * scale, y * scale, z * scale


@array_kernel
def _fill_weights(record: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    """Write the weights of a triangle's corners (3,) at the contact point of a record, into its first three entries."""
    normal, point = record[4:7], record[7:10]
    # Areas projected along the largest component of the normal; the plane's other two axes keep their order.
    largest = 0
    if abs(normal[1]) > abs(normal[largest]):
        largest = 1
    if abs(normal[2]) > abs(normal[largest]):
        largest = 2
    u, v = (largest + 1) % 3, (largest + 2) % 3
    area_a = (b[u] - point[u]) * (c[v] - point[v]) - (b[v] - point[v]) * (c[u] - point[u])
    area_b = (c[u] - point[u]) * (a[v] - point[v]) - (c[v] - point[v]) * (a[u] - point[u])
    area_c = (a[u] - point[u]) * (b[v] - point[v]) - (a[v] - point[v]) * (b[u] - point[u])
    scale = 1.0 / (area_a + area_b + area_c)
    record[0] = min(max(area_a * scale, 0.0), 1.0)
    record[1] = min(max(area_b * scale, 0.0), 1.0 - record[0])
    record[2] = 1.0 - record[0] - record[1]


@array_kernel
def fill_local(
    position: np.ndarray, rotation: np.ndarray, vertices: np.ndarray, first_vertex: int, local: np.ndarray
) -> None:
    """Write an organ's vertices, in the tool's frame, into local (3, V)."""
    own = vertices[first_vertex : first_vertex + local.shape[1]]
    along_x, along_y, along_z = local[0], local[1], local[2]
    # The loop is vectorised because these scalars, unlike array elements, cannot change while the organ is written.
    left, back, down = position[0], position[1], position[2]
    xx, xy, xz = rotation[0], rotation[3], rotation[6]
    yx, yy, yz = rotation[1], rotation[4], rotation[7]
    zx, zy, zz = rotation[2], rotation[5], rotation[8]
    for i in range(own.shape[0]):
        x, y, z = own[i, 0] - left, own[i, 1] - back, own[i, 2] - down
        along_x[i] = xx * x + xy * y + xz * z
        along_y[i] = yx * x + yy * y + yz * z
        along_z[i] = zx * x + zy * y + zz * z


@array_kernel
def triangle_weights(
    local: np.ndarray, a: int, b: int, c: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Barycentric weights of the projection of a point onto a triangle, vertices in local (3, V)."""
    ux, uy, uz = local[0, b] - local[0, a], local[1, b] - local[1, a], local[2, b] - local[2, a]
    vx, vy, vz = local[0, c] - local[0, a], local[1, c] - local[1, a], local[2, c] - local[2, a]
    px, py, pz = x - local[0, a], y - local[1, a], z - local[2, a]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    scale = 1.0 / (nx * nx + ny * ny + nz * nz)
    second = scale * (nx * (py * vz - pz * vy) + ny * (pz * vx - px * vz) + nz * (px * vy - py * vx))
    third = scale * (nx * (uy * pz - uz * py) + ny * (uz * px - ux * pz) + nz * (ux * py - uy * px))
    return 1.0 - second - third, second, third


@array_kernel
def lead_by_velocity(
    tool: Any, leading: np.ndarray, rotation: np.ndarray, linear_velocity: np.ndarray, angular_velocity: np.ndarray
) -> None:
    """Mark the nodes whose face leads, N_r . v > 0, in leading (n,)."""
    nodes, normals = tool.nodes, tool.normals
    for i in range(nodes.shape[0]):
        rx, ry, rz = turn(rotation, nodes[i])
        nx, ny, nz = turn(rotation, normals[i])
        vx = linear_velocity[0] + angular_velocity[1] * rz - angular_velocity[2] * ry
        vy = linear_velocity[1] + angular_velocity[2] * rx - angular_velocity[0] * rz
        vz = linear_velocity[2] + angular_velocity[0] * ry - angular_velocity[1] * rx
        leading[i] = vx * nx + vy * ny + vz * nz > 0.0


@array_kernel
def lead_by_motion(tool: Any, memory: Any, organ: Any, triangles: np.ndarray) -> None:
    """Mark the nodes whose face leads relative to the surface, and the nodes through whose face the surface came.

    As an organ does not move as a whole, this uses the motion, since the last query and in the tool's frame, of the
    point of the surface that the node would push.

    Args:
        tool: `ToolGeometry`.
        memory: `NodeMemory`, written.
        organ: `LocalOrgan`.
        triangles: (T, 3).
    """
    nodes, normals, face, hits, distances = tool.nodes, tool.normals, tool.face, memory.hits, memory.distances
    plane_normals, plane_offsets = tool.plane_normals, tool.plane_offsets
    leading, came_through, record = memory.leading, memory.came_through, memory.record
    local, last = organ.local, organ.last_local
    for i in range(nodes.shape[0]):
        # What was true at an earlier query must not count: a restored state does not know it.
        leading[i] = came_through[i] = False
        if hits[i, 0, 1] <= 0:
            continue
        t = hits[i, 0, 0]
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        x = nodes[i, 0] - distances[i, 0] * normals[i, 0]
        y = nodes[i, 1] - distances[i, 0] * normals[i, 1]
        z = nodes[i, 2] - distances[i, 0] * normals[i, 2]
        wa, wb, wc = triangle_weights(local, a, b, c, x, y, z)
        # The weights of a triangle seen edge-on may be far off because of rounding.
        wa = min(max(wa, 0.0), 1.0)
        wb = min(max(wb, 0.0), 1.0 - wa)
        wc = 1.0 - wa - wb
        record[i, 0], record[i, 1], record[i, 2] = wa, wb, wc
        last_x = wa * last[0, a] + wb * last[0, b] + wc * last[0, c]
        last_y = wa * last[1, a] + wb * last[1, b] + wc * last[1, c]
        last_z = wa * last[2, a] + wb * last[2, b] + wc * last[2, c]
        leading[i] = (last_x - x) * normals[i, 0] + (last_y - y) * normals[i, 1] + (last_z - z) * normals[i, 2] > 0.0
        plane = entry_plane(last_x, last_y, last_z, x, y, z, plane_normals, plane_offsets, -ON_PLANE)
        came_through[i] = plane == face[i]


@array_kernel
def remember_flags(memory: Any) -> None:
    """Store the flags of a `NodeMemory` in `remembered`, before they are decided anew."""
    for i in range(memory.flags.shape[0]):
        memory.remembered[i] = memory.flags[i]


@array_kernel
def decide_flags(
    tool: Any,
    memory: Any,
    local: np.ndarray,
    triangles: np.ndarray,
    first_step: int,
    exclusive: bool,
    grade: int,
    normal: np.ndarray,
) -> tuple[int, int]:
    """Carry out the two steps of the flags method, node by node, after rays have been cast.

    Args:
        tool: `ToolGeometry`.
        memory: `NodeMemory`; flags and unfeasible are written, remembered and leading read.
        local: (3, V) the organ in the tool's frame [u].
        triangles: (T, 3).
        first_step: Code of what the outward ray must find; 0 for no first step.
        exclusive: See `FlaggedDetector`.
        grade: Further condition on a contact. 0: none; 1: no other face opposes the triangle clearly better; 2: the
            surface came through the node's face.
        normal: (3,) workspace.

    Returns:
        The number of flagged nodes, and the number of nodes inside the organ that the condition of `grade` refused.
    """
    flags, unfeasible, leading, remembered, decided, came_through = (
        memory.flags, memory.unfeasible, memory.leading, memory.remembered, memory.decided, memory.came_through,
    )  # fmt: skip
    hits, opposite = memory.hits, tool.opposite
    accepted, refused = 0, 0
    for i in range(opposite.shape[0]):
        flags[i], unfeasible[i], decided[i] = remembered[i], False, False
    for visit_leading in (True, False):
        for i in range(opposite.shape[0]):
            if leading[i] != visit_leading:
                continue
            decided[i] = True
            other = opposite[i]
            inside = hits[i, 0, 1] > 0
            if first_step != 0 and flags[other]:
                # The opposite node owns a contact. If its outward ray leaves the organ, too, this node's contact is
                # unfeasible. Where the organ overlaps itself, rays may contradict each other; if `exclusive`, the node
                # visited first then keeps its contact.
                outward = hits[other, 1, 1]
                if outward > 0 or (first_step == 1 and outward != 0) or (exclusive and decided[other] and inside):
                    flags[i] = False
                    unfeasible[i] = True
                    continue
            flags[i] = inside
            if inside and grade > 0:
                flags[i] = came_through[i]
                if grade == 1:
                    fill_local_normal(local, triangles[hits[i, 0, 0]], normal)
                    flags[i] = opposes_best(normal, tool.normals[i], tool.plane_normals)
                if not flags[i]:
                    refused += 1
            if flags[i]:
                accepted += 1
    return accepted, refused


@array_kernel
def fill_record(
    tool: Any,
    memory: Any,
    vertices: np.ndarray,
    first_vertex: int,
    triangles: np.ndarray,
    position: np.ndarray,
    rotation: np.ndarray,
    has_weights: bool,
) -> None:
    """Write triangle and record of all nodes, after the flags have been decided.

    With `has_weights`, the weights of flagged nodes are in the record already.
    """
    nodes, normals, flags, hits, distances = tool.nodes, tool.normals, memory.flags, memory.hits, memory.distances
    triangle, record = memory.triangle, memory.record
    for i in range(nodes.shape[0]):
        triangle[i] = NO_HIT
        rx, ry, rz = turn(rotation, nodes[i])
        record[i, 7], record[i, 8], record[i, 9] = position[0] + rx, position[1] + ry, position[2] + rz
        if not flags[i]:
            for k in range(7):
                record[i, k] = 0.0
            continue
        t = hits[i, 0, 0]
        triangle[i] = t
        a, b, c = triangles[t, 0] + first_vertex, triangles[t, 1] + first_vertex, triangles[t, 2] + first_vertex
        _fill_triangle_normal(vertices, a, b, c, record[i, 4:7])
        nx, ny, nz = turn(rotation, normals[i])
        record[i, 3] = distances[i, 0]
        record[i, 7] -= nx * distances[i, 0]
        record[i, 8] -= ny * distances[i, 0]
        record[i, 9] -= nz * distances[i, 0]
        if not has_weights:
            _fill_weights(record[i], vertices[a], vertices[b], vertices[c])


@kernel(types.int32(F8, F8, F8, F8, F8_2, I4_2, TOOL, MEMORY, types.int64, types.boolean))
def detect_contacts(
    position: np.ndarray,
    orientation: np.ndarray,
    linear_velocity: np.ndarray,
    angular_velocity: np.ndarray,
    vertices: np.ndarray,
    triangles: np.ndarray,
    tool: Any,
    memory: Any,
    first_step: int,
    exclusive: bool,
) -> int:
    """Run one query of the flags method by itself; see `FlaggedDetector.detect` for arguments and results."""
    if (
        position.shape[0] != 3 or orientation.shape[0] != 4 or linear_velocity.shape[0] != 3
        or angular_velocity.shape[0] != 3 or vertices.shape[1] != 3 or triangles.shape[1] != 3
        or vertices.shape[0] != memory.organ.codes.shape[0]
    ):  # fmt: skip
        return WRONG_SHAPE
    length_squared, finite = 0.0, True
    for k in range(4):
        length_squared += orientation[k] * orientation[k]
    for k in range(3):
        finite = finite and abs(position[k]) < np.inf
        finite = finite and abs(linear_velocity[k]) < np.inf and abs(angular_velocity[k]) < np.inf
    if not (finite and abs(np.sqrt(length_squared) - 1.0) <= _UNIT_TOLERANCE):
        return _MOTION_NOT_VALID
    geometry, nodes, organ = tool.geometry, memory.nodes, memory.organ
    rotation, axes, normal = np.empty(9), np.empty(9), np.empty(3)
    fill_rotation(orientation, 1.0 / np.sqrt(length_squared), rotation)
    status: int = cast_columns(position, rotation, vertices, triangles, tool.rays, nodes, organ, axes)
    if status != 0:
        return status
    remember_flags(nodes)
    lead_by_velocity(geometry, nodes.leading, rotation, linear_velocity, angular_velocity)
    decide_flags(geometry, nodes, organ.local, triangles, first_step, exclusive, 0, normal)
    fill_record(geometry, nodes, vertices, 0, triangles, position, rotation, False)
    return 0


class FlaggedDetector:
    """Detector of the flags method: it flags a tool's contact nodes in feasible contact and remembers the flags.

    Nodes are visited one by one: those whose face leads (their normal has a positive component along their velocity)
    before those whose face trails, in the order of their indices within each group. For each node:

    1. First step. If the opposite node's flag is set at this moment, the opposite node casts a ray outwards, along
       its own normal. If that ray finds the organ, this node's contact is unfeasible: its flag is cleared.
    2. Second step. Otherwise the node casts a ray inwards, against its normal N_r. If the first triangle it meets has
       an outward normal N with N . N_r < 0, the node is inside the organ: its flag is set. Otherwise it is cleared.

    Rays are infinitely long: a node of a tool that is wholly inside needs a ray longer than the tool is thick.

    Attributes:
        tool: The tool whose contact nodes are checked.
        first_step: What the outward ray must find. "inside": a triangle through which it leaves the organ, so that the
            opposite wall of a fissure does not make a good contact unfeasible. "any_hit": any triangle, which is the
            published method to the letter. "off": no first step.
        exclusive: Whether a node is also refused a contact if its opposite node has been flagged earlier in the same
            query. On a closed surface this changes nothing. On a surface that overlaps itself, the rays may find both
            nodes of a pair inside, and neither outward ray leaving the organ; the published method then flags both.
    """

    def __init__(
        self,
        tool: Tool,
        first_step: FirstStep = "inside",
        exclusive: bool = True,
    ) -> None:
        """Make a detector with all flags clear.

        Args:
            tool: The tool whose contact nodes are checked.
            first_step: "inside", "any_hit" or "off"; see the class.
            exclusive: See the class.

        Raises:
            ValueError: If `first_step` is not one of those.
        """
        if first_step not in FIRST_STEP_CODES:
            raise ValueError(f"first_step must be one of {list(get_args(FirstStep))}, got {first_step!r}")
        self.tool = tool
        self.first_step: FirstStep = first_step
        self.exclusive = bool(exclusive)
        self._first_step_code = FIRST_STEP_CODES[first_step]
        self.shape = tool_shape(tool)
        self.memory = Memory(len(tool.nodes))
        self._still = np.zeros(3)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies and pickles hold the remembered flags; the kernels' structures are made anew."""
        return _remake, (self.tool, self.first_step, self.exclusive, self.flags)

    @property
    def flags(self) -> NDArray[np.bool_]:
        """(n,) bool, the remembered flags (a copy)."""
        flags: NDArray[np.bool_] = self.memory.states[0].copy()
        return flags

    @flags.setter
    def flags(self, value: ArrayLike) -> None:
        flags = np.asarray(value)
        if flags.shape != self.memory.states[0].shape or flags.dtype != np.bool_:
            raise ValueError(
                f"flags must be a bool array of shape {self.memory.states[0].shape}, got {flags.dtype} {flags.shape}"
            )
        self.memory.states[:] = False
        self.memory.states[0] = flags

    def reset(self) -> None:
        """Clear all flags."""
        self.memory.states[:] = False

    def detect(
        self,
        position: ArrayLike,
        orientation: ArrayLike,
        vertices: ArrayLike,
        triangles: ArrayLike,
        linear_velocity: ArrayLike = STILL,
        angular_velocity: ArrayLike = STILL,
    ) -> Contacts:
        """Query the contacts at a pose of the tool, and remember the flags.

        Args:
            position: (3,) of the tool's origin, world frame [u].
            orientation: (4,) unit quaternion xyzw, tool to world.
            vertices: (V, 3) of the organ, world frame [u].
            triangles: (T, 3) vertex indices, counter-clockwise from outside.
            linear_velocity: (3,) of the tool's origin relative to the organ, world frame [u/s].
            angular_velocity: (3,) relative to the organ, world frame [rad/s].

        Returns:
            The contacts, as copies.

        Raises:
            ValueError: If an argument has the wrong shape, is not finite, is not a unit quaternion, or names a vertex
                that does not exist. The remembered flags are then as they were.
        """
        linear = self._still if linear_velocity is STILL else linear_velocity
        angular = self._still if angular_velocity is STILL else angular_velocity
        arguments: tuple[Any, ...] = (position, orientation, linear, angular, vertices, triangles)
        memory, status = self.memory, WRONG_SHAPE
        # Arrays of the right type go straight to the kernel, which checks their shapes.
        if (
            {type(argument) for argument in arguments} == _ONLY_ARRAYS
            and arguments[4].dtype is _FLOAT
            and arguments[5].dtype is _INTEGER
            and arguments[5].flags.writeable
        ):
            try:
                status = detect_contacts(
                    *arguments, self.shape, memory.structure, self._first_step_code, self.exclusive
                )
            except TypeError:
                # Numba raises it for arrays that the kernel was not compiled for.
                pass
        if status == WRONG_SHAPE:
            arguments = (
                _float_array(position, "position", (3,)),
                _float_array(orientation, "orientation", (4,)),
                _float_array(linear, "linear_velocity", (3,)),
                _float_array(angular, "angular_velocity", (3,)),
                _float_array(vertices, "vertices", (None, 3)),
                _index_array(triangles),
            )
            if memory.vertices != arguments[4].shape[0]:
                memory.resize(arguments[4].shape[0], memory.triangles)
            status = detect_contacts(*arguments, self.shape, memory.structure, self._first_step_code, self.exclusive)
        if status != 0:
            _raise_for_status(status, *arguments)
        return self.contacts

    @property
    def contacts(self) -> Contacts:
        """The result of the last query, as copies."""
        return Contacts(self.memory.states, self.memory.triangle, self.memory.record)


def _remake(tool: Tool, first_step: FirstStep, exclusive: bool, flags: NDArray[np.bool_]) -> FlaggedDetector:
    detector = FlaggedDetector(tool, first_step, exclusive)
    detector.flags = flags
    return detector


def _float_array(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """The argument as a C-contiguous float64 array of the shape asked for; no copy if it is one."""
    # Kernels are compiled for writeable arrays, although they do not write to these.
    if type(value) is np.ndarray and value.dtype == np.float64 and value.flags.carray:
        array: NDArray[np.float64] = value
    else:
        try:
            array = np.array(value, dtype=np.float64, order="C")
        except (TypeError, ValueError) as error:
            raise ValueError(f"{name} must be numbers, got {value!r}") from error
    if array.ndim != len(shape) or array.shape[-1] != shape[-1]:
        wanted = str(shape).replace("None", "any")
        raise ValueError(f"{name} must have shape {wanted}, got {array.shape}")
    return array


def _index_array(value: ArrayLike) -> NDArray[np.int32]:
    """The argument `triangles` as a C-contiguous int32 array (T, 3); no copy if it is one."""
    try:
        array = value if type(value) is np.ndarray else np.asarray(value)
    except ValueError as error:
        raise ValueError(f"triangles must be integers of shape (any, 3), got {value!r}") from error
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iu":
        raise ValueError(f"triangles must be integers of shape (any, 3), got {array.dtype} {array.shape}")
    if array.dtype == np.int32 and array.flags.carray:
        return array
    return np.array(np.clip(array, -1, np.iinfo(np.int32).max), dtype=np.int32, order="C")


def _raise_for_status(
    status: int,
    position: NDArray[np.float64],
    orientation: NDArray[np.float64],
    linear_velocity: NDArray[np.float64],
    angular_velocity: NDArray[np.float64],
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
) -> None:
    """Raise a `ValueError` that names the argument which a kernel refused with this status."""
    as_vector3(position, "position")
    as_quaternion(orientation, "orientation")
    as_vector3(linear_velocity, "linear_velocity")
    as_vector3(angular_velocity, "angular_velocity")
    if status == _TRIANGLE_OUT_OF_RANGE:
        bad = int(np.count_nonzero(((triangles < 0) | (triangles >= len(vertices))).any(axis=1)))
        raise ValueError(
            f"triangles must hold indices from 0 to {len(vertices) - 1}; {bad} of {len(triangles)} triangles do not"
        )
    bad = int(np.count_nonzero(~np.isfinite(vertices).all(axis=1)))
    if bad == 0:
        name, largest = max(
            (("position", np.abs(position).max()), ("vertices", np.abs(vertices).max(initial=0.0))),
            key=lambda entry: entry[1],
        )
        raise ValueError(f"{name} must be small enough to compute with, got values up to {largest}")
    raise ValueError(f"vertices must be finite; {bad} of {len(vertices)} are not")
