"""Looks at where a tool and an organ are, and says how far one is inside the other.

It shares nothing with the contact detector that it judges: points are inside an organ by the winding number of its
surface, depths are Euclidean distances to the nearest triangle, and whether the organ has slipped past the tool is
decided from the paths of its vertices. Everything is computed in the tool's frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spatula_env._kernels import inline_kernel, kernel
from spatula_env.geometry.transforms import quaternion_conjugate, rotate

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from spatula_env.geometry import Tool

    FloatArray = NDArray[np.float64]

RIM = 0.1
"""So near to the rim of a face [u] a surface may slip round it between two inspections: what it does there is a matter
of depth and not of sides."""

PARALLEL = 1e-6
"""Normals are opposite when their dot product is less than this above -1."""

GRAZE = 1e-12
"""A line passes so near an edge that the side is in doubt, if the triangle of edge and line has no more area [u2]."""


@dataclass(frozen=True)
class Inspection:
    """How a tool and an organ overlap at one instant.

    Attributes:
        node_depth: Greatest depth of one of the tool's contact nodes inside the organ [u].
        corner_depth: Greatest depth of one of the tool's corners inside the organ [u].
        vertex_depth: Greatest depth of a vertex of the organ inside the tool [u].
        centre_inside: Whether the tool's origin is inside the organ.
        enclosed: How many of the tool's columns are inside the organ with both ends. A column runs from a contact node
            to its opposite; those within `RIM` of another face do not count.
        passages: How many vertices of the organ have gone right through the tool since the inspection before, in by one
            face and out by the opposite one, the outside of the organ ahead. Their paths are straight in the tool's
            frame; those that cross one of the two faces within `RIM` of another face do not count.
        turned: How many have done so with the inside of the organ ahead: an organ that resists neither contact with
            itself nor inversion may turn inside out over a tool that is rightly outside it. A vertex that goes back the
            way it came counts neither here nor there.
    """

    node_depth: float
    corner_depth: float
    vertex_depth: float
    centre_inside: bool
    enclosed: int
    passages: int
    turned: int

    @property
    def residual(self) -> float:
        """Greatest of the depths [u]."""
        return max(self.node_depth, self.corner_depth, self.vertex_depth)

    @property
    def wrong_side(self) -> bool:
        """Whether some of the organ's surface is on the far side of the tool."""
        return self.centre_inside or self.enclosed > 0 or self.passages > 0


class Inspector:
    """Inspects one tool and one organ, step after step.

    Args:
        tool: The tool.
        triangles: (T, 3) of the organ's closed surface, counter-clockwise from outside.
    """

    def __init__(self, tool: Tool, triangles: ArrayLike) -> None:
        self._triangles = np.array(triangles, dtype=np.int32, order="C")
        self._points: FloatArray = np.concatenate([tool.nodes, tool.vertices, np.zeros((1, 3))])
        self._node_count = len(tool.nodes)
        self._planes = _distinct_planes(*tool.planes)
        self._columns = _inner_columns(tool, *self._planes)
        self._inside = np.zeros(len(self._points), dtype=np.bool_)
        self._depths = np.zeros(len(self._points))
        self._before: FloatArray | None = None
        self._entries = np.zeros(0, dtype=np.int32)
        self._ways = self._entries
        # Vertices that have gone through, with the normal of the face by which they came in.
        self._strayed: dict[int, FloatArray] = {}

    def reset(self) -> None:
        """Forget where the organ was, so that the next inspection counts no passages."""
        self._before = None
        self._strayed.clear()

    def inspect(self, position: ArrayLike, orientation: FloatArray, vertices: FloatArray) -> Inspection:
        """Look at the present state.

        Args:
            position: (3,) of the tool [u].
            orientation: (4,) of the tool, unit quaternion xyzw.
            vertices: (V, 3) of the organ, world frame [u], finite.

        Returns:
            What was seen.
        """
        local = np.ascontiguousarray(rotate(quaternion_conjugate(orientation), vertices - np.asarray(position)))
        locate_points(self._points, local, self._triangles, self._inside, self._depths)
        normals, offsets = self._planes
        passages, turned = self._count_passages(local)
        self._before = local
        count, inside = self._node_count, self._inside
        return Inspection(
            node_depth=float(self._depths[:count].max(initial=0.0)),
            corner_depth=float(self._depths[count:-1].max(initial=0.0)),
            vertex_depth=depth_of_vertices(local, normals, offsets),
            centre_inside=bool(inside[-1]),
            enclosed=int((inside[self._columns[:, 0]] & inside[self._columns[:, 1]]).sum()),
            passages=passages,
            turned=turned,
        )

    def _count_passages(self, local: FloatArray) -> tuple[int, int]:
        """Count vertices that have come through since the last time, the organ's outside and inside ahead."""
        if self._before is None:
            self._entries = np.full(len(local), -1, dtype=np.int32)
            self._ways = np.empty_like(self._entries)
            return 0, 0
        normals, offsets = self._planes
        find_passages(self._before, local, normals, offsets, RIM, self._entries, self._ways)
        through = np.flatnonzero(self._ways >= 0)
        if not len(through):
            return 0, 0
        outwards = _vertex_normals(self._before, self._triangles)
        passages, turned = 0, 0
        for vertex in through.tolist():
            way = normals[self._ways[vertex]]
            if self._strayed.get(vertex, way) @ way < 0.0:
                del self._strayed[vertex]
                continue
            self._strayed[vertex] = way
            if outwards[vertex] @ way < 0.0:
                passages += 1
            else:
                turned += 1
        return passages, turned


def _distinct_planes(normals: FloatArray, offsets: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The planes of a tool's faces, each once: normals (F, 3) and offsets (F,)."""
    rows = np.column_stack([normals, offsets])
    first = np.sort(np.unique(rows.round(9), axis=0, return_index=True)[1])
    return np.ascontiguousarray(normals[first]), np.ascontiguousarray(offsets[first])


def _vertex_normals(vertices: FloatArray, triangles: NDArray[np.int32]) -> FloatArray:
    """Outward normals at the vertices (V, 3): sums of the area vectors of the triangles around each."""
    a, b, c = vertices[triangles[:, 0]], vertices[triangles[:, 1]], vertices[triangles[:, 2]]
    normals = np.zeros_like(vertices)
    np.add.at(normals, triangles.ravel(), np.repeat(np.cross(b - a, c - a), 3, axis=0))
    return normals


def _inner_columns(tool: Tool, normals: FloatArray, offsets: FloatArray) -> NDArray[np.int64]:
    """Pairs of opposite contact nodes (c, 2) whose connection keeps `RIM` from all faces but theirs."""
    columns = []
    for node, other in enumerate(tool.opposite.tolist()):
        if node > other:
            continue
        ends = tool.nodes[[node, other]]
        depths = (offsets - ends @ normals.T).min(axis=0)
        across = np.abs(normals @ tool.normals[[node, other]].T).max(axis=1) > 1.0 - PARALLEL
        if (depths[~across] >= RIM).all():
            columns.append((node, other))
    return np.array(columns, dtype=np.int64).reshape(-1, 2)


@inline_kernel
def _doubled_area(au: float, av: float, bu: float, bv: float, cu: float, cv: float) -> float:
    """Twice the signed area of a triangle in the plane."""
    return (bu - au) * (cv - av) - (bv - av) * (cu - au)


@inline_kernel
def _solid_angles(point: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Winding number of a closed surface about a point (3,), from the solid angles of all its triangles.

    A. van Oosterom and J. Strackee, The solid angle of a plane triangle, IEEE Transactions on Biomedical Engineering
    30(2), 1983.
    """
    total = 0.0
    for t in range(triangles.shape[0]):
        ax = vertices[triangles[t, 0], 0] - point[0]
        ay = vertices[triangles[t, 0], 1] - point[1]
        az = vertices[triangles[t, 0], 2] - point[2]
        bx = vertices[triangles[t, 1], 0] - point[0]
        by = vertices[triangles[t, 1], 1] - point[1]
        bz = vertices[triangles[t, 1], 2] - point[2]
        cx = vertices[triangles[t, 2], 0] - point[0]
        cy = vertices[triangles[t, 2], 1] - point[1]
        cz = vertices[triangles[t, 2], 2] - point[2]
        a = math.sqrt(ax * ax + ay * ay + az * az)
        b = math.sqrt(bx * bx + by * by + bz * bz)
        c = math.sqrt(cx * cx + cy * cy + cz * cz)
        volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        rest = (
            a * b * c
            + (ax * bx + ay * by + az * bz) * c
            + (bx * cx + by * cy + bz * cz) * a
            + (cx * ax + cy * ay + cz * az) * b
        )
        total += math.atan2(volume, rest)
    return total / (2.0 * math.pi)


@inline_kernel
def _squared_distance_to_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """Squared distance of a point from a segment, all (3,)."""
    along, length = 0.0, 0.0
    for k in range(3):
        along += (p[k] - a[k]) * (b[k] - a[k])
        length += (b[k] - a[k]) ** 2
    fraction = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
    total = 0.0
    for k in range(3):
        total += (a[k] + fraction * (b[k] - a[k]) - p[k]) ** 2
    return total


@inline_kernel
def _squared_distance_to_triangle(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Squared distance of a point from a triangle, all (3,)."""
    nx = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    ny = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    nz = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    squared = nx * nx + ny * ny + nz * nz
    within = squared > 0.0
    if within:
        corners = (a, b, c)
        for k in range(3):
            start, end = corners[k], corners[(k + 1) % 3]
            ex, ey, ez = end[0] - start[0], end[1] - start[1], end[2] - start[2]
            px, py, pz = p[0] - start[0], p[1] - start[1], p[2] - start[2]
            if nx * (ey * pz - ez * py) + ny * (ez * px - ex * pz) + nz * (ex * py - ey * px) < 0.0:
                within = False
    if within:
        height = nx * (p[0] - a[0]) + ny * (p[1] - a[1]) + nz * (p[2] - a[2])
        result: float = height * height / squared
        return result
    return min(
        _squared_distance_to_segment(p, a, b),
        _squared_distance_to_segment(p, b, c),
        _squared_distance_to_segment(p, c, a),
    )


@kernel("void(f8[:,::1], f8[:,::1], i4[:,::1], b1[::1], f8[::1])")
def locate_points(
    points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, inside: np.ndarray, depths: np.ndarray
) -> None:
    """Say which points a closed surface encloses, and how deep they are.

    A point's winding number is the number of times that a line from it leaves the surface, less the number of times
    that it enters. Where the line passes too near an edge to tell, the solid angles decide.

    Args:
        points: (m, 3) [u].
        vertices: (V, 3) of the surface [u].
        triangles: (T, 3), counter-clockwise from outside.
        inside: (m,) is filled: whether the winding number is positive.
        depths: (m,) is filled: distance of each point inside from the nearest triangle, 0 for the others [u].
    """
    count, size = points.shape[0], triangles.shape[0]
    # All lines run along w of the right-handed frame (3, -6, 2) / 7, (6, 2, -3) / 7, (2, 3, 6) / 7, a direction that no
    # face or lattice of a box lies along: surfaces that rest on a face are met at an angle.
    seen = np.empty((vertices.shape[0], 3))
    for v in range(vertices.shape[0]):
        x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        seen[v, 0] = (3.0 * x - 6.0 * y + 2.0 * z) / 7.0
        seen[v, 1] = (6.0 * x + 2.0 * y - 3.0 * z) / 7.0
        seen[v, 2] = (2.0 * x + 3.0 * y + 6.0 * z) / 7.0
    lines = np.empty((count, 3))
    low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
    for i in range(count):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        lines[i, 0] = (3.0 * x - 6.0 * y + 2.0 * z) / 7.0
        lines[i, 1] = (6.0 * x + 2.0 * y - 3.0 * z) / 7.0
        lines[i, 2] = (2.0 * x + 3.0 * y + 6.0 * z) / 7.0
        low_u, high_u = min(low_u, lines[i, 0]), max(high_u, lines[i, 0])
        low_v, high_v = min(low_v, lines[i, 1]), max(high_v, lines[i, 1])
    near = np.empty(size, dtype=np.int32)
    near_count = 0
    for t in range(size):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if (
            min(seen[a, 0], seen[b, 0], seen[c, 0]) <= high_u
            and max(seen[a, 0], seen[b, 0], seen[c, 0]) >= low_u
            and min(seen[a, 1], seen[b, 1], seen[c, 1]) <= high_v
            and max(seen[a, 1], seen[b, 1], seen[c, 1]) >= low_v
        ):
            near[near_count] = t
            near_count += 1
    found = False
    for i in range(count):
        u, v, w = lines[i, 0], lines[i, 1], lines[i, 2]
        winding = 0
        doubtful = False
        for k in range(near_count):
            a, b, c = triangles[near[k], 0], triangles[near[k], 1], triangles[near[k], 2]
            opposite_a = _doubled_area(u, v, seen[b, 0], seen[b, 1], seen[c, 0], seen[c, 1])
            opposite_b = _doubled_area(u, v, seen[c, 0], seen[c, 1], seen[a, 0], seen[a, 1])
            opposite_c = _doubled_area(u, v, seen[a, 0], seen[a, 1], seen[b, 0], seen[b, 1])
            least = min(opposite_a, opposite_b, opposite_c)
            most = max(opposite_a, opposite_b, opposite_c)
            if least > GRAZE or most < -GRAZE:
                area = opposite_a + opposite_b + opposite_c
                if (opposite_a * seen[a, 2] + opposite_b * seen[b, 2] + opposite_c * seen[c, 2]) / area > w:
                    winding += 1 if area > 0.0 else -1
            elif least >= -GRAZE or most <= GRAZE:
                doubtful = True
                break
        inside[i] = _solid_angles(points[i], vertices, triangles) > 0.5 if doubtful else winding > 0
        depths[i] = 0.0
        found = found or inside[i]
    if not found:
        return
    middles = np.empty((size, 3))
    radii = np.empty(size)
    for t in range(size):
        radius = 0.0
        for k in range(3):
            middles[t, k] = (
                vertices[triangles[t, 0], k] + vertices[triangles[t, 1], k] + vertices[triangles[t, 2], k]
            ) / 3.0
        for corner in range(3):
            squared = 0.0
            for k in range(3):
                squared += (vertices[triangles[t, corner], k] - middles[t, k]) ** 2
            radius = max(radius, squared)
        radii[t] = math.sqrt(radius)
    nearest = 0
    for i in range(count):
        if not inside[i]:
            continue
        # The triangle that was nearest to the point before is near this one too: the others are then mostly too far.
        best = _squared_distance_to_triangle(
            points[i],
            vertices[triangles[nearest, 0]],
            vertices[triangles[nearest, 1]],
            vertices[triangles[nearest, 2]],
        )
        reach = math.sqrt(best)
        for t in range(size):
            squared = 0.0
            for k in range(3):
                squared += (points[i, k] - middles[t, k]) ** 2
            if squared < (reach + radii[t]) ** 2:
                squared = _squared_distance_to_triangle(
                    points[i], vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
                )
                if squared < best:
                    best, nearest, reach = squared, t, math.sqrt(squared)
        depths[i] = reach


@kernel("f8(f8[:,::1], f8[:,::1], f8[::1])")
def depth_of_vertices(vertices: np.ndarray, normals: np.ndarray, offsets: np.ndarray) -> float:
    """Greatest distance of a vertex inside a convex body from the nearest of its faces.

    Args:
        vertices: (V, 3) in the body's frame [u].
        normals: (F, 3) outward unit normals of its faces.
        offsets: (F,) of the faces' planes [u].

    Returns:
        The depth, 0 if all vertices are outside [u].
    """
    greatest = 0.0
    for v in range(vertices.shape[0]):
        depth = np.inf
        for f in range(normals.shape[0]):
            height = offsets[f]
            for k in range(3):
                height -= normals[f, k] * vertices[v, k]
            depth = min(depth, height)
            if depth <= greatest:
                break
        greatest = max(greatest, depth)
    return greatest


@kernel("void(f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8, i4[::1], i4[::1])")
def find_passages(
    before: np.ndarray,
    after: np.ndarray,
    normals: np.ndarray,
    offsets: np.ndarray,
    rim: float,
    entries: np.ndarray,
    ways: np.ndarray,
) -> None:
    """Find the vertices that have gone right through a convex body, on straight paths in its frame.

    Args:
        before: (V, 3) where they were, in the body's frame [u].
        after: (V, 3) where they are [u].
        normals: (F, 3) outward unit normals of the body's faces.
        offsets: (F,) of the faces' planes [u].
        rim: Where a path crosses one of the two faces, it must be this far under the other ones [u].
        entries: (V,) by which face each vertex that is inside came in, -1 for the others and where it is not known;
            kept from call to call.
        ways: (V,) is filled: by which face each vertex came in that came out by the opposite one, -1 for the others.
    """
    faces = normals.shape[0]
    for v in range(before.shape[0]):
        ways[v] = -1
        first, last = 0.0, 1.0
        entry, out = entries[v], -1
        for f in range(faces):
            start, end = -offsets[f], -offsets[f]
            for k in range(3):
                start += normals[f, k] * before[v, k]
                end += normals[f, k] * after[v, k]
            if start >= 0.0 and end >= 0.0:
                first = 2.0
                break
            if start >= 0.0:
                part = start / (start - end)
                if part >= first:
                    first, entry = part, f
            elif end >= 0.0:
                part = start / (start - end)
                if part <= last:
                    last, out = part, f
        if first > last:
            entries[v] = -1
            continue
        if out < 0:
            entries[v] = entry
            continue
        entries[v] = -1
        if entry < 0:
            continue
        across = 0.0
        for k in range(3):
            across += normals[entry, k] * normals[out, k]
        if across > -1.0 + PARALLEL:
            continue
        within = True
        for f in range(faces):
            alignment, depth_in, depth_out = 0.0, offsets[f], offsets[f]
            for k in range(3):
                alignment += normals[f, k] * normals[entry, k]
                depth_in -= normals[f, k] * (before[v, k] + first * (after[v, k] - before[v, k]))
                depth_out -= normals[f, k] * (before[v, k] + last * (after[v, k] - before[v, k]))
            if abs(alignment) < 1.0 - PARALLEL and min(depth_in, depth_out) < rim:
                within = False
        if within:
            ways[v] = entry
