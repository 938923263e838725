"""Data structures of the contact kernels: tool shapes, the memory of a tool and an organ, constraints and workspace.

They are Numba structures that hold named tuples of arrays. Passing a structure to a kernel takes a third of a
microsecond however many arrays it holds, and the structure shares its arrays with the Python objects that made them.
But taking an array out of a structure counts a reference. Therefore a kernel takes the tuples out once, and passes them
to helpers that count no references (`array_kernel`). Structures are made by compiled functions, so that making one
triggers no compilation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numba import types
from numba.experimental import structref
from numba.typed import List

from spatula_env._kernels import ARRAYS, array_kernel, inline_kernel, kernel
from spatula_env.contact.columns import RayColumns
from spatula_env.contact.skin import NEAR, SKIN

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.geometry.tools import Tool

STATES = 7
"""Number of boolean fields of `NodeMemory`, which come first."""

NO_HIT = -1
"""Value of a triangle's index where there is none."""

SAME_DIRECTION = 1e-9
"""Normals belong to one face if the cosine of the angle between them differs from one by no more than this."""

ON_PLANE = 1e-9
"""A corner no farther than this from a plane, relative to the tool's size, lies on it."""


class ToolGeometry(NamedTuple):
    """A convex tool and its contact nodes, in the tool's frame.

    Attributes:
        nodes: (n, 3) positions of the contact nodes [u].
        normals: (n, 3) outward normals of their faces.
        opposite: (n,) index of each node's opposite node.
        areas: (n,) each node's share of its face's area [u2].
        face: (n,) index of each node's face. Faces with nodes come first among the planes, in the tool's order.
        plane_normals: (P, 3) outward normals of all faces, with and without nodes.
        plane_offsets: (P,) normal . x on each face [u].
        corners: (K, 3) [u].
        ridges: (P, P, 2) the two corners of the edge between two faces; -1 where they share none.
        extent: (8,) lower corner of the bounding box, upper corner, bounding radius, thickness [u].
    """

    nodes: np.ndarray
    normals: np.ndarray
    opposite: np.ndarray
    areas: np.ndarray
    face: np.ndarray
    plane_normals: np.ndarray
    plane_offsets: np.ndarray
    corners: np.ndarray
    ridges: np.ndarray
    extent: np.ndarray


class RayLines(NamedTuple):
    """The lines on which a tool's contact nodes cast their rays: see `columns.RayColumns`, attribute by attribute."""

    frames: np.ndarray
    bounds: np.ndarray
    group_rows: np.ndarray
    row_u: np.ndarray
    row_columns: np.ndarray
    column_v: np.ndarray
    column_nodes: np.ndarray
    node_height: np.ndarray


class NodeMemory(NamedTuple):
    """Memory of a tool's n contact nodes and an organ, and results of a query for them.

    Attributes:
        flags: (n,) whether the node is in feasible contact.
        unfeasible: (n,) whether the first step has refused it.
        leading: (n,) whether its face leads; used within one query, as are the next three.
        remembered: (n,) its flag before the query.
        decided: (n,) whether it has been visited.
        came_through: (n,) whether the surface came through its face.
        outside: (n,) whether the last query found it outside of the organ.
        triangle: (n,) triangle that its inward ray leaves through, `NO_HIT` where it is not flagged.
        record: (n, 10) weights of that triangle's corners, depth, normal, point; see `flags.Contacts`.
        hits: (n, 2, 2) see `raycast.cast_columns`.
        distances: (n, 2) see `raycast.cast_columns` [u].
    """

    flags: np.ndarray
    unfeasible: np.ndarray
    leading: np.ndarray
    remembered: np.ndarray
    decided: np.ndarray
    came_through: np.ndarray
    outside: np.ndarray
    triangle: np.ndarray
    record: np.ndarray
    hits: np.ndarray
    distances: np.ndarray


class LocalOrgan(NamedTuple):
    """An organ of V vertices and T triangles in a tool's frame.

    Attributes:
        local: (3, V) present positions of the vertices [u].
        last_local: (3, V) their positions at the last query [u].
        codes: (V,) workspace: bits for the sides of a box that each vertex is beyond.
        candidates: (T,) triangles near the tool.
        ray_local: (3, V) workspace: the vertices in the frame of one group of rays.
    """

    local: np.ndarray
    last_local: np.ndarray
    codes: np.ndarray
    candidates: np.ndarray
    ray_local: np.ndarray


class ConstraintTable(NamedTuple):
    """Unilateral constraints (see `response`), one in each row; columns are named by the constants below.

    Attributes:
        rows: (C, 24) WEIGHTS of three vertices, summing to one where there is no fourth; NORMAL n, towards the organ;
            POINT p [u]; VELOCITY dp/dt [u/s]; ORIGIN, where the constrained point would be had it moved with the tool
            since the last query [u]; FRICTION, coefficient; INERTIA, effective mass of the constrained point [kg]; GAP
            (s - p) . n [u]; DISPLACEMENT, the multiplier of the position solve [kg u]; IMPULSE, the impulse on the
            organ from the velocity solve [kg u/s].
        features: (C, 6) the three vertices; FOURTH, a vertex whose weight makes the sum of all zero, or `NO_VERTEX`;
            OWNER, index of the tool, `GROUND` or `ORGANS`; PLANE, the tool's face.
        names: (C,) identify the features that touch, in the same way in every query; see `rows.constraint_name`.
    """

    rows: np.ndarray
    features: np.ndarray
    names: np.ndarray


class Placement(NamedTuple):
    """Pose and velocity of a tool that meets an organ.

    Attributes:
        position: (3,) of the tool [u].
        rotation: (9,) its rotation matrix, row by row.
        linear_velocity: (3,) of the tool [u/s].
        angular_velocity: (3,) of the tool [rad/s].
        friction: Coefficient.
        owner: The tool's index.
        first_vertex: Index of the organ's first vertex among those of all organs.
    """

    position: np.ndarray
    rotation: np.ndarray
    linear_velocity: np.ndarray
    angular_velocity: np.ndarray
    friction: float
    owner: int
    first_vertex: int


class Scratch(NamedTuple):
    """Workspace of kernels that make no arrays, for tools of up to P planes and K corners, and organs as `LocalOrgan`.

    Attributes:
        heights: (P, 4) heights of an edge's ends over the planes; see `features.fill_heights`.
        clipping: (P, 4) heights over the planes that may clip the edge; see `features.fill_clipping`.
        under: (P, 3) depths of a triangle's corners under the planes; see `depth.fill_under`.
        polygon: (P + 4, 3) weights of the corners of a clipped triangle; see `depth.clip_triangle`.
        clipped: (P + 4, 3) the same.
        facing: (P,) cosines between the normals of a triangle and of the planes.
        corner_heights: (K,) heights of corners over triangles; see `corners.gather_corners`.
        corner_behind: (K,) whether a corner is behind a triangle.
        contact: (7,) contact of two edges; see `features.ridge_contact`.
        normal: (3,) of a triangle.
        last_normal: (3,) of a triangle at the last query.
        moving: (3, 3) a triangle at a time between two queries.
        nearest: (4,) the nearest point of a surface; see `corners.find_nearest`.
        near: (T,) triangles near a tool.
        around: (T,) triangles around another triangle.
        boxes: (6, T) boxes around triangles near a tool.
        other_boxes: (6, T) boxes around other triangles.
        away: (T,) squared distances of a point from boxes.
        codes: (V,) see `LocalOrgan`.
        turned: (3, V) an organ's vertices in the frame of a ray; see `corners.encloses`.
        axes: (9,) of a group of rays.
        listed: (2,) index of the pair of a tool and an organ, counted tool by tool, whose triangles `near` and `boxes`
            hold, at the positions in its `LocalOrgan.local`, or `NO_PAIR`; and the number of these triangles.
        corner_distances: (K,) distances of corners from that pair's organ, negative inside; infinite where not known
            [u].
    """

    heights: np.ndarray
    clipping: np.ndarray
    under: np.ndarray
    polygon: np.ndarray
    clipped: np.ndarray
    facing: np.ndarray
    corner_heights: np.ndarray
    corner_behind: np.ndarray
    contact: np.ndarray
    normal: np.ndarray
    last_normal: np.ndarray
    moving: np.ndarray
    nearest: np.ndarray
    near: np.ndarray
    around: np.ndarray
    boxes: np.ndarray
    other_boxes: np.ndarray
    away: np.ndarray
    codes: np.ndarray
    turned: np.ndarray
    axes: np.ndarray
    listed: np.ndarray
    corner_distances: np.ndarray


class StepRoom(NamedTuple):
    """Workspace of a step, for up to N tools, M pairs of a tool and an organ, and V vertices of all organs.

    Attributes:
        points: (4, V, 3) expected, thrown, held and kept positions of the vertices; see `step` and
            `query.QueryPoints`.
        vectors: (4, N, 3) both positions and both velocities of `query.QueryTools`.
        rotations: (2, N, 9) both rotations of `query.QueryTools`.
        passes: (N,) `passes` of `query.QueryTools`.
        pairs: (2, M) `quiet` and `looked_at` of `query.QueryTools`.
        islands: (3, N + 2) starts, parents and sizes of `islands.IslandRoom`.
        holders: (V,) `holders` of `islands.IslandRoom`, all -1 between two steps.
        orientation: (4,) of one tool.
    """

    points: np.ndarray
    vectors: np.ndarray
    rotations: np.ndarray
    passes: np.ndarray
    pairs: np.ndarray
    islands: np.ndarray
    holders: np.ndarray
    orientation: np.ndarray


class SpreadRoom(NamedTuple):
    """Workspace of `pressure.tool_pressures`, for a tool of up to n contact nodes.

    Attributes:
        touching: (n,) whether each node is in contact with any organ.
        shares: (n,) the nodes' shares of a push.
        rotation: (9,) of the tool.
        point: (3,) where a push acts, tool frame [u].
        impulse: (3,) of a push, tool frame [kg u/s].
    """

    touching: np.ndarray
    shares: np.ndarray
    rotation: np.ndarray
    point: np.ndarray
    impulse: np.ndarray


def _arrays(kind: Any, *elements: str) -> Any:
    """Numba's type of a NamedTuple of arrays, by the names in `ARRAYS`."""
    return types.NamedTuple([ARRAYS[element] for element in elements], kind)


TOOL_GEOMETRY = _arrays(ToolGeometry, "f8_2", "f8_2", "i4", "f8", "i4", "f8_2", "f8", "f8_2", "i4_3", "f8")
RAY_LINES = _arrays(RayLines, "f8_3", "f8_2", "i4", "f8", "i4", "f8", "i4_2", "f8")
NODE_MEMORY = _arrays(NodeMemory, *["b1"] * 7, "i4", "f8_2", "i4_3", "f8_2")
LOCAL_ORGAN = _arrays(LocalOrgan, "f8_2", "f8_2", "u1", "i4", "f8_2")
CONSTRAINT_TABLE = _arrays(ConstraintTable, "f8_2", "i4_2", "i8")


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
class ScratchRoomType(types.StructRef):
    """Numba type of `ScratchRoom`."""


@structref.register
class WorldContactsType(types.StructRef):
    """Numba type of `WorldContacts`."""


class ToolShape(structref.StructRefProxy):
    """A tool, for kernels.

    Fields:
        geometry: `ToolGeometry`.
        rays: `RayLines`.
    """


class PairMemory(structref.StructRefProxy):
    """A detector's memory and workspace for one tool and one organ, for kernels.

    Fields:
        nodes: `NodeMemory`.
        organ: `LocalOrgan`.
    """


class Constraints(structref.StructRefProxy):
    """A growable table of constraints, for kernels.

    Fields:
        table: `ConstraintTable`.
    """


class ScratchRoom(structref.StructRefProxy):
    """The workspace of kernels, which worlds that are queried one after the other share.

    To allocate its arrays anew in every step would take longer than much of the work that is done in them.

    Fields:
        scratch: `Scratch`.
        step: `StepRoom`.
        spread: `SpreadRoom`.
    """


class WorldContacts(structref.StructRefProxy):
    """The contact state of one world, for kernels: its tools and organs, the memory of contacts, and workspace.

    Fields:
        tools: `ToolShape` of the N tools.
        memories: `PairMemory` of each tool (outer) and organ (inner).
        surfaces: Triangles (T, 3) of each organ, counting its own vertices.
        constraints: `Constraints`, workspace: those of a query.
        earlier: `Constraints`, workspace: those of the step's earlier queries that pushed.
        trial: `Constraints`, workspace: those that pushed in the last position solve, to warm-start the next pass.
        warm: `Constraints` that pushed in the last step, to warm-start solves.
        warm_count (1,): number of these.
        first_vertices (O,): index of each organ's first vertex among those of all organs.
        friction (N,): coefficients.
        settings: See `settings`.
        inverse_mass (V,): of the organs' nodes [1/kg].
        skin: `Skin` of all organs.
        near: `Near`, the pairs of features of organs that are near each other.
        ledger (O, 5): of the energy that the tools put into each organ; see `energy`.
        pace (1,): fraction of their motion that the tools carry out in the next step; less than 1 after a stop.
        room: `ScratchRoom`, large enough for all tools and organs.
    """


WEIGHTS, NORMAL, POINT, VELOCITY, ORIGIN = 0, 3, 6, 9, 12
FRICTION, INERTIA, GAP, DISPLACEMENT, IMPULSE = 15, 16, 17, 18, 21
ROW_LENGTH = 24
FOURTH, OWNER, PLANE, FEATURE_LENGTH = 3, 4, 5, 6

NO_PAIR = -1
"""Value of a pair's index in `Scratch.listed` where there is none."""

NO_VERTEX = -1
"""Value of the fourth vertex where there is none: the constraint then keeps a point of the organ from a plane."""

ORGANS, GROUND = -2, -1
"""Owners of constraints that belong to no tool: of organs with themselves and each other, and with the ground."""

structref.define_proxy(ToolShape, ToolShapeType, ["geometry", "rays"])
structref.define_proxy(PairMemory, PairMemoryType, ["nodes", "organ"])
structref.define_proxy(Constraints, ConstraintsType, ["table"])
TOOL = ToolShapeType([("geometry", TOOL_GEOMETRY), ("rays", RAY_LINES)])
MEMORY = PairMemoryType([("nodes", NODE_MEMORY), ("organ", LOCAL_ORGAN)])
CONSTRAINTS = ConstraintsType([("table", CONSTRAINT_TABLE)])
structref.define_proxy(ScratchRoom, ScratchRoomType, ["scratch", "step", "spread"])
SCRATCH = _arrays(
    Scratch,
    *("f8_2", "f8_2", "f8_2", "f8_2", "f8_2", "f8", "f8", "b1", "f8", "f8", "f8", "f8_2", "f8", "i4", "i4"),
    *("f8_2", "f8_2", "f8", "u1", "f8_2", "f8", "i8", "f8"),
)
STEP_ROOM = _arrays(StepRoom, "f8_3", "f8_3", "f8_3", "b1", "b1_2", "i8_2", "i8", "f8")
SPREAD_ROOM = _arrays(SpreadRoom, "b1", "f8", "f8", "f8", "f8")
ROOM = ScratchRoomType([("scratch", SCRATCH), ("step", STEP_ROOM), ("spread", SPREAD_ROOM)])
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
    ("pace", ARRAYS["f8"]),
    ("room", ROOM),
]
structref.define_proxy(WorldContacts, WorldContactsType, [name for name, _ in WORLD_FIELDS])
WORLD_CONTACTS = WorldContactsType(WORLD_FIELDS)
WORLDS = types.ListType(WORLD_CONTACTS)


@kernel(TOOL(TOOL_GEOMETRY, RAY_LINES))
def _make_tool(geometry: Any, rays: Any) -> Any:
    return ToolShape(geometry, rays)


@kernel(MEMORY(NODE_MEMORY, LOCAL_ORGAN))
def _make_memory(nodes: Any, organ: Any) -> Any:
    return PairMemory(nodes, organ)


@kernel(WORLD_CONTACTS(*[kind for _, kind in WORLD_FIELDS]))
def make_world_contacts(
    tools: Any, memories: Any, surfaces: Any, constraints: Any, earlier: Any, trial: Any, warm: Any,
    warm_count: Any, first_vertices: Any, friction: Any, settings: Any, inverse_mass: Any, skin: Any,
    near: Any, ledger: Any, pace: Any, room: Any,
) -> Any:  # fmt: skip
    """Make a `WorldContacts` of these fields."""
    return WorldContacts(
        tools, memories, surfaces, constraints, earlier, trial, warm, warm_count, first_vertices, friction,
        settings, inverse_mass, skin, near, ledger, pace, room,
    )  # fmt: skip


@kernel(CONSTRAINTS(types.int64))
def make_constraints(capacity: int) -> Any:
    """Make `Constraints` with room for `capacity` constraints."""
    rows, features = np.zeros((capacity, ROW_LENGTH)), np.zeros((capacity, FEATURE_LENGTH), np.int32)
    return Constraints(ConstraintTable(rows, features, np.zeros(capacity, np.int64)))


@inline_kernel
def _make_scratch(planes: int, corners: int, vertices: int, triangles: int) -> Any:
    return Scratch(
        np.empty((planes, 4)), np.empty((planes, 4)), np.empty((planes, 3)), np.empty((planes + 4, 3)),
        np.empty((planes + 4, 3)), np.empty(planes), np.empty(corners), np.empty(corners, np.bool_), np.empty(7),
        np.empty(3), np.empty(3), np.empty((3, 3)), np.empty(4), np.empty(triangles, np.int32),
        np.empty(triangles, np.int32),
        np.empty((6, triangles)), np.empty((6, triangles)), np.empty(triangles), np.empty(vertices, np.uint8),
        np.empty((3, vertices)), np.empty(9), np.full(2, NO_PAIR), np.empty(corners),
    )  # fmt: skip


@inline_kernel
def _make_step_room(tools: int, pairs: int, vertices: int) -> Any:
    return StepRoom(
        np.empty((4, vertices, 3)), np.empty((4, tools, 3)), np.empty((2, tools, 9)), np.empty(tools, np.bool_),
        np.empty((2, pairs), np.bool_), np.empty((3, tools + 2), np.int64), np.full(vertices, -1), np.empty(4),
    )  # fmt: skip


@inline_kernel
def _make_spread_room(nodes: int) -> Any:
    return SpreadRoom(np.empty(nodes, np.bool_), np.empty(nodes), np.empty(9), np.empty(3), np.empty(3))


@kernel(ROOM())
def make_room() -> Any:
    """Make an empty `ScratchRoom`; see `fit_room`."""
    return ScratchRoom(_make_scratch(0, 0, 0, 0), _make_step_room(0, 0, 0), _make_spread_room(0))


@kernel(types.void(WORLD_CONTACTS))
def fit_room(world: Any) -> None:
    """Enlarge the workspace of a world, if needed, so that it suffices for all of its tools and organs."""
    scratch, vertices = world.room.scratch, world.inverse_mass.shape[0]
    planes, corners, triangles = scratch.under.shape[0], scratch.corner_heights.shape[0], scratch.near.shape[0]
    step, nodes = world.room.step, 0
    tools, pairs = max(len(world.tools), step.passes.shape[0]), max(len(world.memories), step.pairs.shape[1])
    fits = vertices <= scratch.codes.shape[0]
    for k in range(len(world.tools)):
        tool = world.tools[k].geometry
        nodes = max(nodes, tool.nodes.shape[0])
        fits &= tool.plane_offsets.shape[0] <= planes and tool.corners.shape[0] <= corners
        planes, corners = max(planes, tool.plane_offsets.shape[0]), max(corners, tool.corners.shape[0])
    for o in range(len(world.surfaces)):
        fits &= world.surfaces[o].shape[0] <= triangles
        triangles = max(triangles, world.surfaces[o].shape[0])
    if not fits:
        world.room.scratch = _make_scratch(planes, corners, max(vertices, scratch.codes.shape[0]), triangles)
    vertices = max(vertices, step.holders.shape[0])
    if tools > step.passes.shape[0] or pairs > step.pairs.shape[1] or vertices > step.holders.shape[0]:
        world.room.step = _make_step_room(tools, pairs, vertices)
    if nodes > world.room.spread.shares.shape[0]:
        world.room.spread = _make_spread_room(nodes)


@array_kernel
def copy_constraint(table: Any, index: int, into: Any, place: int) -> None:
    """Copy one constraint of a `ConstraintTable` to a place in another."""
    # Element by element: for an assignment of whole arrays Numba compiles checks of their shapes, which takes seconds.
    for column in range(ROW_LENGTH):
        into.rows[place, column] = table.rows[index, column]
    for column in range(FEATURE_LENGTH):
        into.features[place, column] = table.features[index, column]
    into.names[place] = table.names[index]


@array_kernel
def copy_first(count: int, table: Any, into: Any) -> None:
    """Copy the first `count` constraints of a `ConstraintTable` to the first places of another."""
    for c in range(count):
        copy_constraint(table, c, into, c)


@kernel(types.void(CONSTRAINTS, types.int64, types.int64))
def reserve(constraints: Any, count: int, capacity: int) -> None:
    """Make room for at least `capacity` constraints, keeping the first `count`."""
    room = constraints.table.names.shape[0]
    if capacity <= room:
        return
    more = make_constraints(max(capacity, 2 * room)).table
    copy_first(count, constraints.table, more)
    constraints.table = more


@kernel(types.Tuple((ARRAYS["i8"], ARRAYS["i4_2"], ARRAYS["f8_2"]))(CONSTRAINTS, types.int64))
def copy_constraints(constraints: Any, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Copy names, features and rows of the first `count` constraints."""
    copied = make_constraints(count).table
    copy_first(count, constraints.table, copied)
    return copied.names, copied.features, copied.rows


@kernel(types.void(CONSTRAINTS, ARRAYS["i8"], ARRAYS["i4_2"], ARRAYS["f8_2"]))
def restore_constraints(constraints: Any, names: np.ndarray, features: np.ndarray, rows: np.ndarray) -> None:
    """Write back constraints that `copy_constraints` returned."""
    reserve(constraints, 0, names.shape[0])
    copy_first(names.shape[0], ConstraintTable(rows, features, names), constraints.table)


@kernel(TOOLS())
def _no_tools() -> Any:
    return List.empty_list(TOOL)


@kernel(types.void(TOOLS, TOOL))
def _append_tool(tools: Any, tool: Any) -> None:
    tools.append(tool)


@kernel(types.void(WORLD_CONTACTS, types.int64, TOOL))
def replace_tool(world: Any, index: int, tool: Any) -> None:
    """Replace the tool with this index by another one."""
    world.tools[index] = tool
    fit_room(world)


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
    """Make the `ToolShape` of a tool."""
    columns = RayColumns(tool)
    normals, offsets = _planes(tool)
    low, high = tool.vertices.min(axis=0), tool.vertices.max(axis=0)
    # Kernels are compiled for writeable arrays, and a tool's are read-only: copy them.
    geometry = ToolGeometry(
        nodes=np.array(tool.nodes),
        normals=np.array(tool.normals),
        opposite=np.array(tool.opposite),
        areas=np.array(tool.areas, dtype=np.float64),
        face=np.array(tool.face),
        plane_normals=normals,
        plane_offsets=offsets,
        corners=np.array(tool.vertices),
        ridges=ridges_between(tool.vertices, normals, offsets),
        extent=np.array([*low, *high, tool.bounding_radius, tool.thickness]),
    )
    return _make_tool(geometry, RayLines(*(getattr(columns, name) for name in RayLines._fields)))


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
    """The two corners (P, P, 2) of the edge that each two planes share, -1 where they share none."""
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
    """Arrays of a `LocalOrgan`; pairs of a tool and an organ that are queried one after the other can share them."""

    def __init__(self, vertices: int, triangles: int) -> None:
        """Allocate them for an organ with these numbers of vertices and triangles."""
        self.ray_local: NDArray[np.float64] = np.zeros((3, vertices))
        self.codes: NDArray[np.uint8] = np.zeros(vertices, dtype=np.uint8)
        self.local: NDArray[np.float64] = np.zeros((3, vertices))
        self.last_local: NDArray[np.float64] = np.zeros((3, vertices))
        self.candidates: NDArray[np.int32] = np.zeros(triangles, dtype=np.int32)


class Memory:
    """The arrays of a `PairMemory`: the memory of a tool's contact nodes, and workspace for an organ.

    Attributes:
        states: (7, n) the boolean fields of `NodeMemory`, flags first.
        triangle: (n,) see `NodeMemory`.
        record: (n, 10) see `NodeMemory`.
        vertices: Number of vertices of the organ.
        triangles: Number of triangles of the organ.
        structure: The `PairMemory` for kernels.
    """

    def __init__(self, nodes: int, room: OrganRoom | None = None) -> None:
        """Make the arrays for a tool with `nodes` contact nodes, with all flags clear."""
        self.states: NDArray[np.bool_] = np.zeros((STATES, nodes), dtype=np.bool_)
        self.triangle: NDArray[np.int32] = np.full(nodes, NO_HIT, dtype=np.int32)
        self.record: NDArray[np.float64] = np.zeros((nodes, 10))
        self._hits = np.zeros((nodes, 2, 2), dtype=np.int32)
        self._distances = np.zeros((nodes, 2))
        self.use(OrganRoom(0, 0) if room is None else room)

    def use(self, room: OrganRoom) -> None:
        """Use another workspace, for an organ of another size; the memory of the nodes stays."""
        self.vertices, self.triangles = len(room.codes), len(room.candidates)
        nodes: tuple[Any, ...] = (*self.states, self.triangle, self.record, self._hits, self._distances)
        self.structure = _make_memory(
            NodeMemory(*nodes),
            LocalOrgan(room.local, room.last_local, room.codes, room.candidates, room.ray_local),
        )

    def resize(self, vertices: int, triangles: int) -> None:
        """Make new workspace, for an organ of another size."""
        self.use(OrganRoom(vertices, triangles))
