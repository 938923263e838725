"""The flags method: which contact nodes of a tool are in feasible contact with an organ, remembered between steps.

After Fukuhara et al., "Proposition and evaluation of a collision detection method for real time surgery simulation of
opening a brain fissure", ROBOMECH Journal 1:6 (2014), doi 10.1186/s40648-014-0006-7, in the form in which it was put
into Bullet. docs/contact-model.md has the algorithm and every decision left open by its sources.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from spatula_env._kernels import inline_kernel, kernel
from spatula_env.contact.columns import RayColumns
from spatula_env.contact.raycast import NO_HIT, cast_columns
from spatula_env.contact.rigid import opposes_best, turn, turn_back
from spatula_env.geometry.transforms import as_quaternion, as_vector3, rotation_matrix

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from spatula_env.geometry.tools import Tool

FirstStep = Literal["inside", "any_hit", "off"]
"""What makes a contact unfeasible in the first step: see `FlaggedDetector`."""

_FIRST_STEP_CODES: dict[str, int] = {"off": 0, "any_hit": 1, "inside": 2}

_VERTEX_NOT_FINITE, _TRIANGLE_OUT_OF_RANGE, _MOTION_NOT_VALID = 1, 2, 3
CROSSING_SLACK = 0.02
"""How far behind a triangle's plane a node may have been and still count as having crossed it since [u]."""

_UNIT_TOLERANCE = 1.0000001e-6
"""Allowed difference of a quaternion's length from one; a rounding error more than `as_quaternion` allows."""


class Contacts:
    """What a detector found in one query. Arrays are copies; they do not change with the next query.

    Attributes:
        flags: (n,) bool, the node is in feasible contact.
        unfeasible: (n,) bool, the first step refused the node.
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


@inline_kernel
def _fill_rotation(quaternion: np.ndarray, scale: float, rotation: np.ndarray) -> None:
    """Write the rotation matrix of a quaternion (xyzw) that `scale` brings to unit length, row by row."""
    x, y, z, w = scale * quaternion[0], scale * quaternion[1], scale * quaternion[2], scale * quaternion[3]
    rotation[0], rotation[1], rotation[2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    rotation[3], rotation[4], rotation[5] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    rotation[6], rotation[7], rotation[8] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)


@inline_kernel
def _fill_triangle_normal(vertices: np.ndarray, corners: np.ndarray, normal: np.ndarray) -> None:
    """Write the unit outward normal of a triangle."""
    a, b, c = corners[0], corners[1], corners[2]
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


@inline_kernel
def _fill_weights(record: np.ndarray, vertices: np.ndarray, corners: np.ndarray) -> None:
    """Write the barycentric weights of the contact point of one record into its first three entries."""
    normal, point = record[4:7], record[7:10]
    a, b, c = vertices[corners[0]], vertices[corners[1]], vertices[corners[2]]
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
    record[0], record[1] = max(area_a * scale, 0.0), max(area_b * scale, 0.0)
    record[2] = max(1.0 - record[0] - record[1], 0.0)


@inline_kernel
def _height_above(
    position: np.ndarray, rotation: np.ndarray, node: np.ndarray, vertices: np.ndarray, corners: np.ndarray
) -> float:
    """How far a contact node is on the outer side of a triangle's plane [u]."""
    normal = np.empty(3)
    _fill_triangle_normal(vertices, corners, normal)
    x, y, z = turn(rotation, node)
    a = corners[0]
    height: float = (
        (position[0] + x - vertices[a, 0]) * normal[0]
        + (position[1] + y - vertices[a, 1]) * normal[1]
        + (position[2] + z - vertices[a, 2]) * normal[2]
    )
    return height


@kernel(
    "i4(f8[::1], f8[::1], f8[::1], f8[::1], f8[:,::1], i4[:,::1], f8[::1], f8[::1], f8[:,::1], f8[:,::1], f8[:,::1],"
    " i4[::1], i4, b1, f8[:,::1], b1, b1,"
    " f8[:,:,::1], f8[:,::1], i4[::1], f8[::1], i4[::1], f8[::1], i4[:,::1], f8[::1],"
    " f8[:,::1], u1[::1], i4[:,:,::1], f8[:,::1], b1[:,::1], i4[::1], f8[:,::1])"
)
def detect_contacts(
    position: np.ndarray,
    orientation: np.ndarray,
    linear_velocity: np.ndarray,
    angular_velocity: np.ndarray,
    vertices: np.ndarray,
    triangles: np.ndarray,
    last_position: np.ndarray,
    last_orientation: np.ndarray,
    last_vertices: np.ndarray,
    nodes: np.ndarray,
    normals: np.ndarray,
    opposite: np.ndarray,
    first_step: int,
    exclusive: bool,
    face_normals: np.ndarray,
    has_last: bool,
    selective: bool,
    frames: np.ndarray,
    bounds: np.ndarray,
    group_rows: np.ndarray,
    row_u: np.ndarray,
    row_columns: np.ndarray,
    column_v: np.ndarray,
    column_nodes: np.ndarray,
    node_height: np.ndarray,
    local: np.ndarray,
    codes: np.ndarray,
    hits: np.ndarray,
    distances: np.ndarray,
    states: np.ndarray,
    triangle: np.ndarray,
    record: np.ndarray,
) -> int:
    """One query of the flags method; `FlaggedDetector` says what the arguments and results mean."""
    length_squared, finite = 0.0, True
    for k in range(4):
        length_squared += orientation[k] * orientation[k]
    for k in range(3):
        finite = finite and abs(position[k]) < np.inf
        finite = finite and abs(linear_velocity[k]) < np.inf and abs(angular_velocity[k]) < np.inf
    if not (finite and abs(np.sqrt(length_squared) - 1.0) <= _UNIT_TOLERANCE):
        return _MOTION_NOT_VALID
    rotation = np.empty(9)
    _fill_rotation(orientation, 1.0 / np.sqrt(length_squared), rotation)
    status: int = cast_columns(
        position, rotation, vertices, triangles, frames, bounds, group_rows, row_u, row_columns, column_v,
        column_nodes, node_height, local, codes, hits, distances,
    )  # fmt: skip
    if status != 0:
        return status
    node_count = nodes.shape[0]
    flags, unfeasible, leading, remembered, decided, left_inside = (
        states[0], states[1], states[2], states[3], states[4], states[5],
    )  # fmt: skip
    for i in range(node_count):
        unfeasible[i] = False
        rx, ry, rz = turn(rotation, nodes[i])
        nx, ny, nz = turn(rotation, normals[i])
        vx = linear_velocity[0] + angular_velocity[1] * rz - angular_velocity[2] * ry
        vy = linear_velocity[1] + angular_velocity[2] * rx - angular_velocity[0] * rz
        vz = linear_velocity[2] + angular_velocity[0] * ry - angular_velocity[1] * rx
        leading[i] = vx * nx + vy * ny + vz * nz > 0.0
        for k in range(10):
            record[i, k] = 0.0
        record[i, 7], record[i, 8], record[i, 9] = position[0] + rx, position[1] + ry, position[2] + rz
    normal = record[:, 4:7]
    last_rotation, local_normal = np.empty(9), np.empty(3)
    if has_last:
        _fill_rotation(last_orientation, 1.0, last_rotation)
    for i in range(node_count):
        remembered[i] = flags[i]
        if has_last and hits[i, 0, 1] > 0:
            # Which way the node has moved since the last query, relative to the surface that it would be in contact
            # with: an organ does not move as one.
            corners = triangles[hits[i, 0, 0]]
            nx, ny, nz = turn(rotation, normals[i])
            lx, ly, lz = turn(last_rotation, nodes[i])
            x, y, z = (
                record[i, 7] - last_position[0] - lx,
                record[i, 8] - last_position[1] - ly,
                record[i, 9] - last_position[2] - lz,
            )
            _fill_triangle_normal(vertices, corners, normal[i])
            record[i, 7] -= nx * distances[i, 0]
            record[i, 8] -= ny * distances[i, 0]
            record[i, 9] -= nz * distances[i, 0]
            _fill_weights(record[i], vertices, corners)
            for k in range(3):
                x -= record[i, k] * (vertices[corners[k], 0] - last_vertices[corners[k], 0])
                y -= record[i, k] * (vertices[corners[k], 1] - last_vertices[corners[k], 1])
                z -= record[i, k] * (vertices[corners[k], 2] - last_vertices[corners[k], 2])
                record[i, k] = 0.0
            leading[i] = x * nx + y * ny + z * nz > 0.0
            record[i, 7] += nx * distances[i, 0]
            record[i, 8] += ny * distances[i, 0]
            record[i, 9] += nz * distances[i, 0]
    for attempt in range(3 if selective else 1):
        refused, accepted = False, False
        for i in range(node_count):
            flags[i], decided[i] = remembered[i], False
        for visit_leading in (True, False):
            for i in range(node_count):
                if leading[i] != visit_leading:
                    continue
                decided[i] = True
                unfeasible[i] = False
                other = opposite[i]
                if first_step != 0 and flags[other]:
                    # The opposite node owns a contact. If it is inside the organ, this node's would be unfeasible.
                    # Where the organ overlaps itself rays may contradict that; if asked to, the first then keeps it.
                    outward = hits[other, 1, 1]
                    if (
                        outward > 0
                        or (first_step == 1 and outward != 0)
                        or (exclusive and decided[other] and hits[i, 0, 1] > 0)
                    ):
                        flags[i] = False
                        unfeasible[i] = True
                        continue
                flags[i] = hits[i, 0, 1] > 0
                if not flags[i]:
                    continue
                _fill_triangle_normal(vertices, triangles[hits[i, 0, 0]], normal[i])
                if selective and attempt < 2:
                    last_height = _height_above(
                        last_position, last_rotation, nodes[i], last_vertices, triangles[hits[i, 0, 0]]
                    )
                    turn_back(rotation, normal[i], local_normal)
                    came_through = attempt == 1 or left_inside[i] or last_height >= -CROSSING_SLACK
                    if not (came_through and opposes_best(local_normal, normals[i], face_normals)):
                        flags[i] = False
                        refused = True
                accepted = accepted or flags[i]
        if accepted or not refused:
            break
    for i in range(node_count):
        triangle[i] = NO_HIT
        if not flags[i]:
            normal[i, 0], normal[i, 1], normal[i, 2] = 0.0, 0.0, 0.0
            continue
        triangle[i] = hits[i, 0, 0]
        nx, ny, nz = turn(rotation, normals[i])
        record[i, 3] = distances[i, 0]
        record[i, 7] -= nx * distances[i, 0]
        record[i, 8] -= ny * distances[i, 0]
        record[i, 9] -= nz * distances[i, 0]
        _fill_weights(record[i], vertices, triangles[triangle[i]])
    return 0


class FlaggedDetector:
    """Tells which contact nodes of a tool are in feasible contact with an organ, and remembers it.

    Nodes are visited one by one: those whose face leads (their normal has a positive component along their velocity)
    before those whose face trails, by index among equals. For each node:

    1. First step. If the opposite node's flag is set at this moment, the opposite node casts a ray outwards, along
       its own normal. If that ray finds the organ, this node's contact is unfeasible: its flag is cleared.
    2. Second step. Otherwise the node casts a ray inwards, against its normal N_r. If the first triangle it meets has
       an outward normal N with N . N_r < 0, the node is inside the organ: its flag is set. Otherwise it is cleared.

    Rays have no end: a node of a tool that is wholly inside needs one longer than the tool is thick.

    Attributes:
        tool: The tool whose nodes are watched.
        first_step: What the outward ray must find. "inside": a triangle that it leaves the organ through, so that the
            opposite wall of a fissure does not make a good contact unfeasible. "any_hit": any triangle, which is the
            published method to the letter. "off": no first step.
        exclusive: Whether a node is also refused a contact that its opposite owns since earlier in the same query. On
            a closed surface that changes nothing. On one that overlaps itself rays can say of both nodes of a pair
            that they are inside, and of neither that its outward ray leaves the organ; the published method then flags
            both.
    """

    def __init__(
        self,
        tool: Tool,
        first_step: FirstStep = "inside",
        exclusive: bool = True,
    ) -> None:
        """Make a detector with all flags clear.

        Args:
            tool: The tool whose nodes are watched.
            first_step: "inside", "any_hit" or "off"; see the class.
            exclusive: See the class.

        Raises:
            ValueError: If `first_step` is not one of those.
        """
        if first_step not in _FIRST_STEP_CODES:
            raise ValueError(f"first_step must be one of {list(get_args(FirstStep))}, got {first_step!r}")
        self.tool = tool
        self.first_step: FirstStep = first_step
        self.exclusive = bool(exclusive)
        self._face_normals = np.array(tool.face_normals)
        count = len(tool.nodes)
        columns = RayColumns(tool)
        self._first_step_code = _FIRST_STEP_CODES[first_step]
        self._tool_arrays = (
            np.array(tool.nodes),
            np.array(tool.normals),
            np.array(tool.opposite),
        )
        self._columns = (
            columns.frames,
            columns.bounds,
            columns.group_rows,
            columns.row_u,
            columns.row_columns,
            columns.column_v,
            columns.column_nodes,
            columns.node_height,
        )
        # Rows: flags, unfeasible; and leading, remembered and decided, which serve one query; left inside.
        self._states = np.zeros((6, count), dtype=np.bool_)
        self._triangle = np.full(count, NO_HIT, dtype=np.int32)
        # Columns: barycentric 0-2, depth 3, normal 4-6, point 7-9.
        self._record = np.zeros((count, 10))
        self._hits = np.zeros((count, 2, 2), dtype=np.int32)
        self._distances = np.zeros((count, 2))
        self._local = np.zeros((3, 0))
        self._codes = np.zeros(0, dtype=np.uint8)

    @property
    def flags(self) -> NDArray[np.bool_]:
        """(n,) bool, the remembered flags (a copy)."""
        flags: NDArray[np.bool_] = self._states[0].copy()
        return flags

    @flags.setter
    def flags(self, value: ArrayLike) -> None:
        flags = np.asarray(value)
        if flags.shape != self._states[0].shape or flags.dtype != np.bool_:
            raise ValueError(
                f"flags must be a bool array of shape {self._states[0].shape}, got {flags.dtype} {flags.shape}"
            )
        self._states[0] = flags

    def reset(self) -> None:
        """Clear all flags."""
        self._states[:] = False

    def detect(
        self,
        position: ArrayLike,
        orientation: ArrayLike,
        vertices: ArrayLike,
        triangles: ArrayLike,
        linear_velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
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
            The contacts; arrays of their own.

        Raises:
            ValueError: If an argument has the wrong shape, is not finite, is not a unit quaternion, or names a vertex
                that does not exist. The remembered flags are then as they were.
        """
        self.update(
            _float_array(position, "position", (3,)),
            _float_array(orientation, "orientation", (4,)),
            _float_array(vertices, "vertices", (None, 3)),
            _index_array(triangles),
            _float_array(linear_velocity, "linear_velocity", (3,)),
            _float_array(angular_velocity, "angular_velocity", (3,)),
        )
        return Contacts(self._states, self._triangle, self._record)

    def update(
        self,
        position: NDArray[np.float64],
        orientation: NDArray[np.float64],
        vertices: NDArray[np.float64],
        triangles: NDArray[np.int32],
        linear_velocity: NDArray[np.float64],
        angular_velocity: NDArray[np.float64],
        last: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None = None,
        selective: bool = False,
    ) -> None:
        """As `detect`, for arrays of the right type and shape, leaving the result in the detector's buffers.

        Args:
            position: As in `detect`, as the next five.
            orientation: See there.
            vertices: See there.
            triangles: See there.
            linear_velocity: See there.
            angular_velocity: See there.
            last: Position, orientation and vertices at the last query. If given, whether a node leads is decided by
                its motion since then relative to the surface that it would be in contact with, and the velocities
                do not matter.
            selective: Needs `last`. A node's contact with a triangle is refused if another face of the tool opposes
                the triangle clearly better, or if the node was already behind the triangle's plane at the last query
                and so has not come in through it, unless `look_again` found that it was inside. If nothing at all
                would be in contact then, nothing is refused.
        """
        if self._codes.shape[0] != vertices.shape[0]:
            self._local = np.zeros((3, vertices.shape[0]))
            self._codes = np.zeros(vertices.shape[0], dtype=np.uint8)
        status = detect_contacts(
            position,
            orientation,
            linear_velocity,
            angular_velocity,
            vertices,
            triangles,
            *(last or (position, orientation, vertices)),
            *self._tool_arrays,
            self._first_step_code,
            self.exclusive,
            self._face_normals,
            last is not None,
            selective,
            *self._columns,
            self._local,
            self._codes,
            self._hits,
            self._distances,
            self._states,
            self._triangle,
            self._record,
        )
        if status != 0:
            _raise_for_status(status, position, orientation, vertices, triangles, linear_velocity, angular_velocity)

    def look_again(
        self,
        position: NDArray[np.float64],
        orientation: NDArray[np.float64],
        vertices: NDArray[np.float64],
        triangles: NDArray[np.int32],
    ) -> None:
        """Note which nodes the response has left inside, for an `update` that is told the last query.

        Args:
            position: (3,) of the last query.
            orientation: (4,) of the last query.
            vertices: (V, 3) after the response [u].
            triangles: (T, 3).
        """
        cast_columns(
            position, rotation_matrix(orientation).ravel(), vertices, triangles, *self._columns, self._local,
            self._codes, self._hits, self._distances,
        )  # fmt: skip
        np.greater(self._hits[:, 0, 1], 0, out=self._states[5])

    @property
    def buffers(self) -> tuple[NDArray[np.bool_], NDArray[np.int32], NDArray[np.float64]]:
        """The last query's states (3, n), triangles (n,) and records (n, 10), which the next query overwrites."""
        return self._states, self._triangle, self._record

    @property
    def workspace(self) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Arrays (3, V) and (V,) that hold nothing between queries."""
        return self._local, self._codes

    @property
    def deepest(self) -> float:
        """Greatest depth of the last query [u]; zero without contact."""
        return float(self._record[:, 3].max())

    @property
    def contacts(self) -> Contacts:
        """The result of the last query; arrays of their own."""
        return Contacts(self._states, self._triangle, self._record)


def _float_array(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """The argument as a C-contiguous float64 array of the shape asked for; no copy if it is one."""
    # Kernels take writeable arrays, though they do not write to these.
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
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    linear_velocity: NDArray[np.float64],
    angular_velocity: NDArray[np.float64],
) -> None:
    """Say which argument a kernel refused."""
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
