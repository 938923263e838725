"""What the contact kernels are given: a tool's shape, what is remembered of a tool and an organ, and constraints.

Numba structures: a kernel takes one in a third of a microsecond however many arrays it holds. They share their arrays
with the Python objects that made them. Structures are made by compiled functions, so that making one compiles nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numba import types
from numba.experimental import structref
from numba.typed import List

from spatula_env._kernels import ARRAYS, array_kernel, kernel
from spatula_env.contact.columns import RayColumns
from spatula_env.contact.skin import NEAR, SKIN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.geometry.tools import Tool

NO_HIT = -1
"""In the place of a triangle's index: none."""

SAME_DIRECTION = 1e-9
"""Normals whose cosine differs from one by less than this belong to one face."""

ON_PLANE = 1e-9
"""A corner no farther than this from a plane, relative to the tool's size, lies on it."""


@structref.register
class ToolShapeType(types.StructRef):
    """Numba type of `ToolShape`."""


@structref.register
class PairMemoryType(types.StructRef):
    """Numba type of `PairMemory`."""


@structref.register
class ConstraintsType(types.StructRef):
    """Numba type of `Constraints`."""


@structref.register
class WorldContactsType(types.StructRef):
    """Numba type of `WorldContacts`."""


class ToolShape(structref.StructRefProxy):
    """A tool, for kernels; everything in the tool's frame.

    Fields:
        nodes (n, 3) [u], normals (n, 3), opposite (n,).
        areas (n,): each node's share of its face [u2].
        face (n,): each node's face. Faces with nodes come first among the planes, in the tool's order.
        plane_normals (P, 3), plane_offsets (P,) [u]: of all faces, those with nodes and those without.
        corners (K, 3) [u].
        ridges (P, P, 2): the two corners of the edge between two planes; -1 where there is none.
        extent (8,): lower corner of the bounding box, upper corner, bounding radius, thickness [u].
        frames to node_height: see `columns.RayColumns`.
    """


class PairMemory(structref.StructRefProxy):
    """A detector's memory and workspace for one tool and one organ, for kernels.

    Fields:
        states (7, n): flags, unfeasible; serving one query, leading, remembered, decided, came through; and whether
            the last query found the node outside of the organ.
        triangle (n,): the one that a node's inward ray leaves through, `NO_HIT` where the node is not flagged.
        record (n, 10): weights of its corners, depth, normal, point.
        hits (n, 2, 2), distances (n, 2): see `raycast.cast_columns`.
        ray_local (3, V), codes (V,): workspace of one group of rays.
        local (3, V), last_local (3, V): the organ in the tool's frame, now and at the last query [u].
        candidates (T,): triangles near the tool.
    """


class Constraints(structref.StructRefProxy):
    """Room for unilateral constraints, for kernels: see `response`. A row each; columns by the names below.

    Fields:
        rows (C, 24): WEIGHTS of three vertices, summing to one where there is no fourth; NORMAL n, towards the organ;
            POINT p [u]; VELOCITY dp/dt [u/s]; ORIGIN, where the constrained point would be had it moved with the tool
            since the last query [u]; FRICTION, coefficient; INERTIA of the constrained point [kg]; GAP (s - p) . n
            [u]; DISPLACEMENT, what the position solve applied [kg u]; IMPULSE, what the velocity solve applied to the
            organ [kg u/s].
        features (C, 6): the three vertices; FOURTH, a vertex whose weight makes the sum of all zero, or `NO_VERTEX`;
            OWNER, index of the tool, `GROUND` or `ORGANS`; PLANE, the tool's face.
        names (C,): tells which features touch, the same in the next query.
    """


class WorldContacts(structref.StructRefProxy):
    """All that is known of contact in one world, for kernels: its tools and organs, and what is remembered.

    Fields:
        tools: `ToolShape` of the N tools.
        memories: `PairMemory` of each tool (outer) and organ (inner).
        surfaces: Triangles (T, 3) of each organ, counting its own vertices.
        constraints: Workspace of a query.
        earlier: Workspace: constraints of queries before the last one.
        trial: Workspace: displacements of the last position solve's constraints, with which it is tried again.
        warm: Displacements of the last step's constraints, from which solves start.
        warm_count (1,): how many.
        first_vertices (O,): index of each organ's first vertex among all.
        friction (N,): coefficients.
        settings: See `step`.
        inverse_mass (V,): of the organs' nodes [1/kg].
        skin: `Skin` of all organs.
        near: `Near`: which features of organs are near each other.
        ledger (O, 5): of the energy that the tools put into each organ; see `response`.
    """


WEIGHTS, NORMAL, POINT, VELOCITY, ORIGIN = 0, 3, 6, 9, 12
FRICTION, INERTIA, GAP, DISPLACEMENT, IMPULSE = 15, 16, 17, 18, 21
ROW_LENGTH = 24
FOURTH, OWNER, PLANE, FEATURE_LENGTH = 3, 4, 5, 6

NO_VERTEX = -1
"""In the place of a fourth vertex: none. The constrained point is one of the organ and kept from a plane."""

ORGANS, GROUND = -2, -1
"""Owners of constraints that are not a tool's: of organs with themselves and each other, and with the ground."""

TOOL_FIELDS = [
    ("nodes", ARRAYS["f8_2"]),
    ("normals", ARRAYS["f8_2"]),
    ("opposite", ARRAYS["i4"]),
    ("areas", ARRAYS["f8"]),
    ("face", ARRAYS["i4"]),
    ("plane_normals", ARRAYS["f8_2"]),
    ("plane_offsets", ARRAYS["f8"]),
    ("corners", ARRAYS["f8_2"]),
    ("ridges", ARRAYS["i4_3"]),
    ("extent", ARRAYS["f8"]),
    ("frames", ARRAYS["f8_3"]),
    ("bounds", ARRAYS["f8_2"]),
    ("group_rows", ARRAYS["i4"]),
    ("row_u", ARRAYS["f8"]),
    ("row_columns", ARRAYS["i4"]),
    ("column_v", ARRAYS["f8"]),
    ("column_nodes", ARRAYS["i4_2"]),
    ("node_height", ARRAYS["f8"]),
]
MEMORY_FIELDS = [
    ("states", ARRAYS["b1_2"]),
    ("triangle", ARRAYS["i4"]),
    ("record", ARRAYS["f8_2"]),
    ("hits", ARRAYS["i4_3"]),
    ("distances", ARRAYS["f8_2"]),
    ("ray_local", ARRAYS["f8_2"]),
    ("codes", ARRAYS["u1"]),
    ("local", ARRAYS["f8_2"]),
    ("last_local", ARRAYS["f8_2"]),
    ("candidates", ARRAYS["i4"]),
]
CONSTRAINT_FIELDS = [("rows", ARRAYS["f8_2"]), ("features", ARRAYS["i4_2"]), ("names", ARRAYS["i8"])]
structref.define_proxy(ToolShape, ToolShapeType, [name for name, _ in TOOL_FIELDS])
structref.define_proxy(PairMemory, PairMemoryType, [name for name, _ in MEMORY_FIELDS])
structref.define_proxy(Constraints, ConstraintsType, [name for name, _ in CONSTRAINT_FIELDS])
TOOL = ToolShapeType(TOOL_FIELDS)
MEMORY = PairMemoryType(MEMORY_FIELDS)
CONSTRAINTS = ConstraintsType(CONSTRAINT_FIELDS)
TOOLS = types.ListType(TOOL)
MEMORIES = types.ListType(MEMORY)
SURFACE = ARRAYS["i4_2"]
SURFACES = types.ListType(SURFACE)

WORLD_FIELDS = [
    ("tools", TOOLS),
    ("memories", MEMORIES),
    ("surfaces", SURFACES),
    ("constraints", CONSTRAINTS),
    ("earlier", CONSTRAINTS),
    ("trial", CONSTRAINTS),
    ("warm", CONSTRAINTS),
    ("warm_count", ARRAYS["i8"]),
    ("first_vertices", ARRAYS["i8"]),
    ("friction", ARRAYS["f8"]),
    ("settings", ARRAYS["f8"]),
    ("inverse_mass", ARRAYS["f8"]),
    ("skin", SKIN),
    ("near", NEAR),
    ("ledger", ARRAYS["f8_2"]),
]
structref.define_proxy(WorldContacts, WorldContactsType, [name for name, _ in WORLD_FIELDS])
WORLD_CONTACTS = WorldContactsType(WORLD_FIELDS)
WORLDS = types.ListType(WORLD_CONTACTS)


@kernel(TOOL(*[kind for _, kind in TOOL_FIELDS]))
def _make_tool(
    nodes: Any, normals: Any, opposite: Any, areas: Any, face: Any, plane_normals: Any, plane_offsets: Any,
    corners: Any, ridges: Any, extent: Any, frames: Any, bounds: Any, group_rows: Any, row_u: Any, row_columns: Any,
    column_v: Any, column_nodes: Any, node_height: Any,
) -> Any:  # fmt: skip
    return ToolShape(
        nodes, normals, opposite, areas, face, plane_normals, plane_offsets, corners, ridges, extent, frames, bounds,
        group_rows, row_u, row_columns, column_v, column_nodes, node_height,
    )  # fmt: skip


@kernel(MEMORY(*[kind for _, kind in MEMORY_FIELDS]))
def _make_memory(
    states: Any, triangle: Any, record: Any, hits: Any, distances: Any, ray_local: Any, codes: Any, local: Any,
    last_local: Any, candidates: Any,
) -> Any:  # fmt: skip
    return PairMemory(
        states, triangle, record, hits, distances, ray_local, codes, local, last_local, candidates
    )  # fmt: skip


@kernel(WORLD_CONTACTS(*[kind for _, kind in WORLD_FIELDS]))
def make_world_contacts(
    tools: Any, memories: Any, surfaces: Any, constraints: Any, earlier: Any, trial: Any, warm: Any,
    warm_count: Any,    first_vertices: Any, friction: Any, settings: Any, inverse_mass: Any, skin: Any,
    near: Any, ledger: Any,
) -> Any:  # fmt: skip
    """A `WorldContacts` of these fields."""
    return WorldContacts(
        tools, memories, surfaces, constraints, earlier, trial, warm, warm_count, first_vertices, friction,
        settings, inverse_mass, skin, near, ledger,
    )  # fmt: skip


@kernel(CONSTRAINTS(types.int64))
def make_constraints(capacity: int) -> Any:
    """Room for so many constraints."""
    return Constraints(
        np.zeros((capacity, ROW_LENGTH)), np.zeros((capacity, FEATURE_LENGTH), np.int32), np.zeros(capacity, np.int64)
    )


@array_kernel
def copy_constraint(
    rows: np.ndarray,
    features: np.ndarray,
    names: np.ndarray,
    index: int,
    into_rows: np.ndarray,
    into_features: np.ndarray,
    into_names: np.ndarray,
    place: int,
) -> None:
    """Copy one constraint of some to a place among others."""
    # Element by element: an assignment of array to array compiles checks of their shapes, for seconds.
    for column in range(ROW_LENGTH):
        into_rows[place, column] = rows[index, column]
    for column in range(FEATURE_LENGTH):
        into_features[place, column] = features[index, column]
    into_names[place] = names[index]


@array_kernel
def copy_first(
    count: int,
    rows: np.ndarray,
    features: np.ndarray,
    names: np.ndarray,
    into_rows: np.ndarray,
    into_features: np.ndarray,
    into_names: np.ndarray,
) -> None:
    """Copy the first `count` constraints of some to the first places among others."""
    for c in range(count):
        copy_constraint(rows, features, names, c, into_rows, into_features, into_names, c)


@kernel(types.void(CONSTRAINTS, types.int64, types.int64))
def reserve(constraints: Any, count: int, capacity: int) -> None:
    """Make room for at least so many constraints, keeping the first `count`."""
    if capacity <= constraints.names.shape[0]:
        return
    more = make_constraints(max(capacity, 2 * constraints.names.shape[0]))
    rows, features, names = more.rows, more.features, more.names
    copy_first(count, constraints.rows, constraints.features, constraints.names, rows, features, names)
    constraints.rows, constraints.features, constraints.names = rows, features, names


@kernel(types.Tuple((ARRAYS["i8"], ARRAYS["i4_2"], ARRAYS["f8_2"]))(CONSTRAINTS, types.int64))
def copy_constraints(constraints: Any, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Names, features and rows of the first `count` constraints, copied."""
    copied = make_constraints(count)
    rows, features, names = copied.rows, copied.features, copied.names
    copy_first(count, constraints.rows, constraints.features, constraints.names, rows, features, names)
    return names, features, rows


@kernel(types.void(CONSTRAINTS, ARRAYS["i8"], ARRAYS["i4_2"], ARRAYS["f8_2"]))
def restore_constraints(constraints: Any, names: np.ndarray, features: np.ndarray, rows: np.ndarray) -> None:
    """Write constraints that were copied."""
    reserve(constraints, 0, names.shape[0])
    copy_first(names.shape[0], rows, features, names, constraints.rows, constraints.features, constraints.names)


@kernel(TOOLS())
def _no_tools() -> Any:
    return List.empty_list(TOOL)


@kernel(types.void(TOOLS, TOOL))
def _append_tool(tools: Any, tool: Any) -> None:
    tools.append(tool)


@kernel(types.void(WORLD_CONTACTS, types.int64, TOOL))
def replace_tool(world: Any, index: int, tool: Any) -> None:
    """Put another tool in the place of one."""
    world.tools[index] = tool


@kernel(MEMORIES())
def _no_memories() -> Any:
    return List.empty_list(MEMORY)


@kernel(types.void(MEMORIES, MEMORY))
def _append_memory(memories: Any, memory: Any) -> None:
    memories.append(memory)


@kernel(WORLDS())
def _no_worlds() -> Any:
    return List.empty_list(WORLD_CONTACTS)


@kernel(types.void(WORLDS, WORLD_CONTACTS))
def _append_world(worlds: Any, world: Any) -> None:
    worlds.append(world)


@kernel(SURFACES())
def _no_surfaces() -> Any:
    return List.empty_list(SURFACE)


@kernel(types.void(SURFACES, SURFACE))
def _append_surface(surfaces: Any, triangles: Any) -> None:
    surfaces.append(triangles)


def tool_list(tools: list[Any]) -> Any:
    """A list of `ToolShape` that kernels take."""
    made = _no_tools()
    for tool in tools:
        _append_tool(made, tool)
    return made


def memory_list(memories: list[Any]) -> Any:
    """A list of `PairMemory` that kernels take."""
    made = _no_memories()
    for memory in memories:
        _append_memory(made, memory)
    return made


def surface_list(surfaces: list[NDArray[np.int32]]) -> Any:
    """A list of triangle arrays (T, 3) that kernels take."""
    made = _no_surfaces()
    for triangles in surfaces:
        _append_surface(made, triangles)
    return made


def world_list(worlds: list[Any]) -> Any:
    """A list of `WorldContacts` that kernels take."""
    made = _no_worlds()
    for world in worlds:
        _append_world(made, world)
    return made


def tool_shape(tool: Tool) -> Any:
    """A `ToolShape` of a tool."""
    columns = RayColumns(tool)
    normals, offsets = _planes(tool)
    low, high = tool.vertices.min(axis=0), tool.vertices.max(axis=0)
    # Kernels take writeable arrays; a tool's are read-only.
    return _make_tool(
        np.array(tool.nodes),
        np.array(tool.normals),
        np.array(tool.opposite),
        np.array(tool.areas, dtype=np.float64),
        np.array(tool.face),
        normals,
        offsets,
        np.array(tool.vertices),
        ridges_between(tool.vertices, normals, offsets),
        np.array([*low, *high, tool.bounding_radius, tool.thickness]),
        columns.frames,
        columns.bounds,
        columns.group_rows,
        columns.row_u,
        columns.row_columns,
        columns.column_v,
        columns.column_nodes,
        columns.node_height,
    )


def _planes(tool: Tool) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Normals and offsets of all faces of a convex tool, those with nodes first."""
    normals = list(tool.face_normals)
    for normal in tool.planes[0]:
        if all(normal @ known < 1.0 - SAME_DIRECTION for known in normals):
            normals.append(normal)
    stacked = np.array(normals)
    return stacked, np.ascontiguousarray((tool.vertices @ stacked.T).max(axis=0))


def ridges_between(
    corners: NDArray[np.float64], normals: NDArray[np.float64], offsets: NDArray[np.float64]
) -> NDArray[np.int32]:
    """The two corners that each two planes share, -1 where they share no edge."""
    tolerance = ON_PLANE * float(np.ptp(corners, axis=0).max())
    on_plane = np.abs(corners @ normals.T - offsets) <= tolerance
    ridges = np.full((len(normals), len(normals), 2), -1, dtype=np.int32)
    for first in range(len(normals)):
        for second in range(len(normals)):
            shared = np.flatnonzero(on_plane[:, first] & on_plane[:, second])
            if first != second and len(shared) >= 2:
                along = corners[shared] @ np.cross(normals[first], normals[second])
                ridges[first, second] = shared[np.argmin(along)], shared[np.argmax(along)]
    return ridges


class OrganRoom:
    """Workspace for an organ of so many vertices and triangles; pairs that are queried one by one can share it."""

    def __init__(self, vertices: int, triangles: int) -> None:
        """Make room."""
        self.ray_local: NDArray[np.float64] = np.zeros((3, vertices))
        self.codes: NDArray[np.uint8] = np.zeros(vertices, dtype=np.uint8)
        self.local: NDArray[np.float64] = np.zeros((3, vertices))
        self.last_local: NDArray[np.float64] = np.zeros((3, vertices))
        self.candidates: NDArray[np.int32] = np.zeros(triangles, dtype=np.int32)


class Memory:
    """The arrays of a `PairMemory`: what is remembered of a tool with so many nodes, and workspace for an organ."""

    def __init__(self, nodes: int, room: OrganRoom | None = None) -> None:
        """Make them, with all flags clear."""
        self.states: NDArray[np.bool_] = np.zeros((7, nodes), dtype=np.bool_)
        self.triangle: NDArray[np.int32] = np.full(nodes, NO_HIT, dtype=np.int32)
        self.record: NDArray[np.float64] = np.zeros((nodes, 10))
        self._hits = np.zeros((nodes, 2, 2), dtype=np.int32)
        self._distances = np.zeros((nodes, 2))
        self.use(OrganRoom(0, 0) if room is None else room)

    def use(self, room: OrganRoom) -> None:
        """Change the workspace, for an organ of another size; what is remembered stays."""
        self.vertices, self.triangles = len(room.codes), len(room.candidates)
        self.structure = _make_memory(
            self.states,
            self.triangle,
            self.record,
            self._hits,
            self._distances,
            room.ray_local,
            room.codes,
            room.local,
            room.last_local,
            room.candidates,
        )

    def resize(self, vertices: int, triangles: int) -> None:
        """Make workspace for an organ of another size."""
        self.use(OrganRoom(vertices, triangles))
