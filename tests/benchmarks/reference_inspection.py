"""A brute-force reference of the inspection: every triangle against every point, vertex and edge, for one world.

Points, columns and faces of a tool are those of `benchmarks.probes`, with the same definitions. There is no broad
phase, and only the paths of vertices are kept between inspections. Beyond these, only plain geometry is shared with the
inspection.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.crossings import Crossings, count_crossings
from benchmarks.depths import (
    GRAZE,
    _deepest,
    _doubled_area,
    _solid_angles,
    _squared_distance_to_triangle,
)
from benchmarks.inspection import APART, Inspection, WorldInspection
from benchmarks.passages import PARALLEL
from benchmarks.probes import RIM, make_probe
from spatula_env._kernels import kernel
from spatula_env.geometry.transforms import quaternion_conjugate, rotate

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from spatula_env.geometry import Tool
    from spatula_env.scenes import Scene

    FloatArray = NDArray[np.float64]


@kernel("void(f8[:,::1], f8[:,::1], i4[:,::1], b1[::1], f8[::1])")
def locate_points(
    points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, inside: np.ndarray, depths: np.ndarray
) -> None:
    """Find the points that a closed surface encloses, and how deep they are.

    The winding number of a point is the number of times that a ray from it leaves the surface, less the number of times
    that it enters it. Where the ray passes too near an edge to tell, the solid angles decide.

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
        # The triangle nearest to the last point is likely near this one too, so that most others are rejected.
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


@kernel("f8(f8[:,::1], i4[:,::1], f8[:,::1], f8[::1])")
def depth_of_surface(vertices: np.ndarray, triangles: np.ndarray, normals: np.ndarray, offsets: np.ndarray) -> float:
    """Greatest depth of any point of a surface in a convex body: its distance from the nearest of the body's faces.

    Args:
        vertices: (V, 3) of the surface, in the body's frame [u].
        triangles: (T, 3).
        normals: (F, 3) outward unit normals of the body's faces.
        offsets: (F,) of the faces' planes [u].

    Returns:
        The depth, 0 if the surface does not meet the body [u].
    """
    count, faces = vertices.shape[0], normals.shape[0]
    under = np.empty((count, faces))
    greatest = 0.0
    for v in range(count):
        depth = np.inf
        for f in range(faces):
            under[v, f] = offsets[f]
            for k in range(3):
                under[v, f] -= normals[f, k] * vertices[v, k]
            depth = min(depth, under[v, f])
        greatest = max(greatest, depth)
    heights, polygons = np.empty((faces, 3)), np.empty((3, 2 * faces + 4, 3))
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        apart = False
        for f in range(faces):
            if max(under[a, f], under[b, f], under[c, f]) <= greatest:
                apart = True
                break
        if apart:
            continue
        for f in range(faces):
            heights[f, 0], heights[f, 1], heights[f, 2] = under[a, f], under[b, f], under[c, f]
        greatest = _deepest(heights, greatest, polygons)
    return greatest


def find_passages(
    before: FloatArray,
    after: FloatArray,
    normals: FloatArray,
    offsets: FloatArray,
    rim: float,
    entries: NDArray[np.int32],
    ways: NDArray[np.int32],
) -> None:
    """Find the vertices that have gone right through a convex body, on straight paths in its frame.

    Args:
        before: (V, 3) where they were, in the body's frame [u].
        after: (V, 3) where they are [u].
        normals: (F, 3) outward unit normals of the body's faces.
        offsets: (F,) of the faces' planes [u].
        rim: Least distance of a path, where it crosses the two faces, from all faces that are not parallel to them [u].
        entries: (V,) face by which each vertex inside the body came in, -1 for other vertices and where unknown; kept
            from call to call.
        ways: (V,) output: face by which each vertex came in that left by the opposite one, -1 for other vertices.
    """
    ways[:] = -1
    was, now = _heights(before, normals, offsets), _heights(after, normals, offsets)
    for v in range(len(before)):
        comes_in, goes_out = (was[v] >= 0.0) & (now[v] < 0.0), (was[v] < 0.0) & (now[v] >= 0.0)
        # Where, on the way, the vertex crosses the faces' planes.
        places = np.divide(was[v], was[v] - now[v], out=np.zeros(len(normals)), where=comes_in | goes_out)
        first, last = places[comes_in].max(initial=0.0), places[goes_out].min(initial=1.0)
        entry = _last_index(comes_in & (places == first), entries[v])
        way_out = _last_index(goes_out & (places == last), -1)
        entries[v] = -1
        if ((was[v] >= 0.0) & (now[v] >= 0.0)).any() or first > last:
            continue
        if way_out < 0:
            entries[v] = entry
            continue
        if entry < 0 or normals[entry] @ normals[way_out] > -1.0 + PARALLEL:
            continue
        ends = before[v] + np.array([[first], [last]]) * (after[v] - before[v])
        beside = np.abs(normals @ normals[entry]) < 1.0 - PARALLEL
        if (-_heights(ends, normals, offsets)[:, beside] >= rim).all():
            ways[v] = entry


def _heights(points: FloatArray, normals: FloatArray, offsets: FloatArray) -> FloatArray:
    """(n, F) heights of points (n, 3) above planes [u]."""
    heights: FloatArray = -offsets
    for axis in range(3):
        heights = heights + normals[:, axis] * points[:, axis, None]
    return heights


def _last_index(mask: NDArray[np.bool_], otherwise: int) -> int:
    found = np.flatnonzero(mask)
    return int(found[-1]) if len(found) else int(otherwise)


class Inspector:
    """Inspects one tool and one organ, step after step.

    Args:
        tool: The tool.
        triangles: (T, 3) of the organ's closed surface, counter-clockwise from outside; or of several organs.
    """

    def __init__(self, tool: Tool, triangles: ArrayLike) -> None:
        self._triangles = np.array(triangles, dtype=np.int32, order="C")
        probe = make_probe(tool)
        self._planes = probe.normals, probe.offsets
        self._points: FloatArray = probe.points.places
        self._ends = probe.ends
        self._radius = probe.radius
        self._columns = probe.columns
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
        """Inspect the present state.

        Args:
            position: (3,) of the tool [u].
            orientation: (4,) of the tool, unit quaternion xyzw.
            vertices: (V, 3) of the organ, world frame [u], finite.

        Returns:
            The inspection.
        """
        local = np.ascontiguousarray(rotate(quaternion_conjugate(orientation), vertices - np.asarray(position)))
        locate_points(self._points, local, self._triangles, self._inside, self._depths)
        passages, turned = self._count_passages(local)
        self._before = local
        inside = self._inside
        nodes, corners, edges = (part.max(initial=0.0) for part in np.split(self._depths, self._ends[:3])[:3])
        return Inspection(
            node_depth=float(nodes),
            corner_depth=float(corners),
            edge_depth=float(edges),
            surface_depth=depth_of_surface(local, self._triangles, *self._planes),
            centre_inside=bool(inside[-1]),
            enclosed=int(inside[self._columns].all(axis=1).sum()),
            passages=passages,
            turned=turned,
        )

    def is_apart(self, position: FloatArray, low: FloatArray, high: FloatArray) -> bool:
        """Whether a ball around the tool is outside the bounding box of all organs.

        Args:
            position: (3,) of the tool [u].
            low: (3,) lower corner of the box [u].
            high: (3,) upper corner of the box [u].
        """
        return bool((position + self._radius < low).any() or (position - self._radius > high).any())

    def _count_passages(self, local: FloatArray) -> tuple[int, int]:
        """Count vertices that have gone through since the last inspection, with the outside and the inside ahead."""
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


def _vertex_normals(vertices: FloatArray, triangles: NDArray[np.int32]) -> FloatArray:
    """Outward normals at the vertices (V, 3): sums of the area vectors of the triangles around each."""
    a, b, c = vertices[triangles[:, 0]], vertices[triangles[:, 1]], vertices[triangles[:, 2]]
    normals = np.zeros_like(vertices)
    np.add.at(normals, triangles.ravel(), np.repeat(np.cross(b - a, c - a), 3, axis=0))
    return normals


class ReferenceInspector:
    """Inspects all tools and organs of one world, step after step, as `benchmarks.inspection.WorldInspector`.

    Args:
        scene: Scene of the world.
    """

    def __init__(self, scene: Scene) -> None:
        sizes = [len(placed.organ.vertices) for placed in scene.organs]
        starts = np.cumsum([0, *sizes[:-1]])
        self._triangles = np.concatenate(
            [placed.organ.triangles + start for placed, start in zip(scene.organs, starts, strict=True)]
        ).astype(np.int32)
        self._organs = np.repeat(np.arange(len(sizes)), sizes).astype(np.int32)
        self._tools = [Inspector(placed.tool, self._triangles) for placed in scene.tools]

    def reset(self) -> None:
        """Forget where the organs were."""
        for inspector in self._tools:
            inspector.reset()

    def inspect(self, positions: FloatArray, orientations: FloatArray, vertices: FloatArray) -> WorldInspection:
        """Inspect the present state; see `benchmarks.inspection.WorldInspector`."""
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        tools = []
        for inspector, position, orientation in zip(self._tools, positions, orientations, strict=True):
            if inspector.is_apart(position, low, high):
                inspector.reset()
                tools.append(APART)
            else:
                tools.append(inspector.inspect(position, orientation, vertices))
        # With all triangles in one patch, every pair is tested.
        starts = np.array([0, len(self._triangles)])
        crossings = count_crossings(np.ascontiguousarray(vertices), self._triangles, starts, self._organs)
        return WorldInspection(tuple(tools), Crossings(*crossings))
