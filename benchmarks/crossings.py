"""Counts where the surfaces of organs intersect themselves or each other: edges that pierce triangles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from spatula_env._kernels import inline_kernel, kernel

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    FloatArray = NDArray[np.float64]

PATCH = 8
"""Greatest number of neighbouring triangles in a patch, the unit of the broad phase; `PATCH_SHARE` times the square
root of the number of all triangles if that is more."""

PATCH_SHARE = 0.25

REACH = 0.35
"""Pairs of an edge and a triangle nearer to each other than this are kept as candidates, in median edge lengths."""

ROOM = 8
"""Candidate pairs that can be stored, for each edge. If there are more, all patches are searched instead."""

SURE = 1.0 - 1e-6
"""Share of half the reach that a vertex may move before its candidates are found anew; the rest is for rounding."""

FLAT = 1e-9
"""A triangle whose doubled area is at most this, relative to the sum of two squared sides, has no plane."""

TURNS = 2
"""Iterations per call that turn the co-rotating frame of the vertices towards them."""

UNKNOWN = -1
"""Stands for the number of candidate pairs where they have not been found, or are too many to store."""

ROUNDING = 1e-13
"""A height above a plane that is smaller than this has an uncertain sign; relative to the terms it is computed from."""


@dataclass(frozen=True)
class Crossings:
    """Numbers of pairs of an edge and a triangle that it goes through.

    Attributes:
        own: Pairs within one organ.
        between: Pairs of an edge of one organ and a triangle of another.
    """

    own: int
    between: int


class Net(NamedTuple):
    """Topology of surfaces, divided into patches, for kernels.

    Attributes:
        triangles: (T, 3) of closed surfaces, counter-clockwise from outside, sorted by patch.
        triangle_starts: (P + 1,) index of the first triangle of each patch, and the number of all.
        edges: (E, 2) sorted by patch; an edge is in the patch of one of its two triangles.
        edge_starts: (P + 1,) index of the first edge of each patch, and the number of all.
        triangle_patches: (T,) which patch each triangle is in.
        edge_patches: (E,) which patch each edge is in.
        fan_starts: (V + 1,) where the triangles around each vertex begin in `fans`, and the end.
        fans: (3 T,) indices of the triangles around each vertex, sorted by vertex.
        star_starts: (V + 1,) where the edges at each vertex begin in `stars`, and the end.
        stars: (2 E,) indices of the edges at each vertex, sorted by vertex.
        organs: (V,) which organ each vertex belongs to.
        shape: (V, 3) the vertices in a reference state, relative to their mean [u].
    """

    triangles: NDArray[np.int32]
    triangle_starts: NDArray[np.int64]
    edges: NDArray[np.int32]
    edge_starts: NDArray[np.int64]
    triangle_patches: NDArray[np.int64]
    edge_patches: NDArray[np.int64]
    fan_starts: NDArray[np.int64]
    fans: NDArray[np.int64]
    star_starts: NDArray[np.int64]
    stars: NDArray[np.int64]
    organs: NDArray[np.int32]
    shape: FloatArray


class Near(NamedTuple):
    """Candidate pairs of each world: edges and triangles that are near each other, for kernels.

    Attributes:
        counts: (W,) number of candidate pairs, `UNKNOWN` if they have not been found or are too many.
        pairs: (W, n, 2) indices of an edge and a triangle.
        turns: (W, 4) orientation of the co-rotating frame of the vertices, quaternion xyzw; its origin is their mean.
        found_at: (W, V, 3) position of each vertex in that frame when its candidates were last found [u].
        triangle_boxes: (W, T, 6) bounding boxes of the triangles at `found_at`, lower and upper corner, enlarged by
            half of the reach on every side.
        edge_boxes: (W, E, 6) the same for edges.
        patch_boxes: (W, P, 6) bounding boxes of the boxes of each patch's triangles.
    """

    counts: NDArray[np.int64]
    pairs: NDArray[np.int32]
    turns: FloatArray
    found_at: FloatArray
    triangle_boxes: FloatArray
    edge_boxes: FloatArray
    patch_boxes: FloatArray


class CrossingCounter:
    """Counts crossings of surfaces whose vertices move, in one world or in many.

    An edge and a triangle that are farther apart than a given reach cannot cross before a vertex has moved by half of
    it. Only the pairs that were within reach when candidates were last found are tested. When a vertex has moved by
    half of the reach in a frame that follows the organs as a whole, its candidates are found anew.

    Args:
        vertices: (V, 3) of all surfaces in a reference state, from which the patches are made: triangles that are near
            each other in this state share one [u].
        triangles: (T, 3) of closed surfaces, counter-clockwise from outside.
        organs: (V,) which organ each vertex belongs to; by default, all vertices belong to one.
        worlds: Number of worlds.
    """

    def __init__(
        self, vertices: FloatArray, triangles: ArrayLike, organs: ArrayLike | None = None, worlds: int = 1
    ) -> None:
        which = np.zeros(len(vertices), dtype=np.int32) if organs is None else np.array(organs, dtype=np.int32)
        self._net = _make_net(vertices, np.array(triangles, dtype=np.int32), which)
        edges, patches = self._net.edges, len(self._net.triangle_starts) - 1
        lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        self._reach = REACH * float(np.median(lengths))
        self._near = Near(
            counts=np.full(worlds, UNKNOWN),
            pairs=np.empty((worlds, ROOM * len(edges), 2), dtype=np.int32),
            turns=np.tile([0.0, 0.0, 0.0, 1.0], (worlds, 1)),
            found_at=np.zeros((worlds, len(vertices), 3)),
            triangle_boxes=np.zeros((worlds, len(self._net.triangles), 6)),
            edge_boxes=np.zeros((worlds, len(edges), 6)),
            patch_boxes=np.zeros((worlds, patches, 6)),
        )
        self._every = np.ones(worlds, dtype=np.bool_)

    def count(self, vertices: FloatArray) -> Crossings:
        """Count the crossings in the first world.

        Args:
            vertices: (V, 3) finite [u].

        Returns:
            The counts. An edge that only touches a triangle, or shares a vertex with it, does not cross it.
        """
        own, between = self.count_all(vertices[None], self._every)
        return Crossings(int(own[0]), int(between[0]))

    def count_all(self, vertices: FloatArray, active: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Count the crossings in those worlds that are active.

        Args:
            vertices: (W, V, 3) finite in active worlds [u].
            active: (W,) which worlds to test.

        Returns:
            Number of crossings within one organ, and number of crossings between two, (W,) each; 0 in inactive worlds.
        """
        counts = np.zeros((len(vertices), 2), dtype=np.int64)
        count_in_worlds(self._net, np.ascontiguousarray(vertices), active, self._reach, self._near, counts)
        return counts[:, 0], counts[:, 1]


def _make_net(vertices: FloatArray, triangles: NDArray[np.int32], organs: NDArray[np.int32]) -> Net:
    """Make the `Net` of triangles (T, 3) with vertices (V, 3) and the organ of each vertex (V,)."""
    patches = _patches(vertices[triangles].mean(axis=1), np.arange(len(triangles)))
    sizes = [len(patch) for patch in patches]
    ordered = np.ascontiguousarray(triangles[np.concatenate(patches)])
    starts = np.cumsum([0, *sizes])
    # The two triangles of an edge list its ends in opposite orders. The edge is assigned to the one that has them in
    # ascending order.
    sides = ordered[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    upwards = sides[:, 0] < sides[:, 1]
    edges = np.ascontiguousarray(sides[upwards])
    edge_starts = np.concatenate([[0], np.cumsum(upwards)])[3 * starts]
    fan_starts, fans = _around(ordered, len(vertices))
    star_starts, stars = _around(edges, len(vertices))
    return Net(
        triangles=ordered,
        triangle_starts=starts,
        edges=edges,
        edge_starts=edge_starts,
        triangle_patches=np.repeat(np.arange(len(sizes)), sizes),
        edge_patches=np.repeat(np.arange(len(sizes)), np.diff(edge_starts)),
        fan_starts=fan_starts,
        fans=fans,
        star_starts=star_starts,
        stars=stars,
        organs=organs,
        shape=vertices - vertices.mean(axis=0),
    )


def _around(members: NDArray[np.int32], vertices: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Edges or triangles (n, k) at each vertex: where the list of each vertex begins, (V + 1,), and their indices."""
    flat = members.ravel()
    starts = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=vertices))])
    return starts, np.argsort(flat, kind="stable") // members.shape[1]


def _patches(middles: FloatArray, members: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Divide triangles (n,) into patches by median splits along the longest axis; `middles` (T, 3) are those of all."""
    if len(members) <= max(PATCH, PATCH_SHARE * len(middles) ** 0.5):
        return [members]
    along = middles[members][:, np.argmax(np.ptp(middles[members], axis=0))]
    halves = np.array_split(members[np.argsort(along, kind="stable")], 2)
    return [patch for half in halves for patch in _patches(middles, half)]


@inline_kernel
def _volume(vertices: np.ndarray, a: int, b: int, c: int, d: int) -> float:
    """Six times the signed volume of a tetrahedron of four vertices."""
    ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    bx, by, bz = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
    cx, cy, cz = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
    dx, dy, dz = vertices[d, 0] - ax, vertices[d, 1] - ay, vertices[d, 2] - az
    volume: float = bx * (cy * dz - cz * dy) + by * (cz * dx - cx * dz) + bz * (cx * dy - cy * dx)
    return volume


@inline_kernel
def _goes_through(vertices: np.ndarray, p: int, q: int, a: int, b: int, c: int) -> bool:
    """Whether the edge from p to q passes through the interior of the triangle a, b, c."""
    if p == a or p == b or p == c or q == a or q == b or q == c:
        return False
    before, after = _volume(vertices, a, b, c, p), _volume(vertices, a, b, c, q)
    if before == 0.0 or after == 0.0 or (before > 0.0) == (after > 0.0):
        return False
    first, second = _volume(vertices, p, q, a, b), _volume(vertices, p, q, b, c)
    third = _volume(vertices, p, q, c, a)
    return (first > 0.0 and second > 0.0 and third > 0.0) or (first < 0.0 and second < 0.0 and third < 0.0)


@inline_kernel
def _pierces(vertices: np.ndarray, triangles: np.ndarray, s: int, t: int) -> int:
    """How many of the edges assigned to triangle s go through triangle t; each edge is assigned to one triangle."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    count = 0
    for side in range(3):
        p, q = triangles[s, side], triangles[s, (side + 1) % 3]
        # The two triangles of an edge list its ends in opposite orders, so that this is true for one of them.
        if p < q and _goes_through(vertices, p, q, a, b, c):
            count += 1
    return count


@inline_kernel
def _is_beside(vertices: np.ndarray, corners: np.ndarray, plane: np.ndarray, others: np.ndarray) -> bool:
    """Whether a triangle lies on one side of another's plane, or only touches it.

    Corners that the two triangles share count as on the plane. The plane (5,) is as `_fill_plane` writes it.
    """
    above, below = False, False
    for k in range(3):
        v = corners[k]
        if v != others[0] and v != others[1] and v != others[2]:
            x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
            height = plane[0] * x + plane[1] * y + plane[2] * z - plane[3]
            above |= height > -plane[4]
            below |= height < plane[4]
    return not (above and below)


@inline_kernel
def _fill_plane(vertices: np.ndarray, corners: np.ndarray, plane: np.ndarray) -> None:
    """Write a triangle's plane (5,): normal, not of unit length, offset, and bound on the rounding error of heights."""
    a, b, c = corners[0], corners[1], corners[2]
    ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    bx, by, bz = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
    cx, cy, cz = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
    plane[0], plane[1], plane[2] = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    plane[3] = plane[0] * ax + plane[1] * ay + plane[2] * az
    plane[4] = ROUNDING * (abs(plane[0]) + abs(plane[1]) + abs(plane[2])) * (1.0 + abs(ax) + abs(ay) + abs(az))


@inline_kernel
def _are_apart(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether two boxes (6,), each a lower and an upper corner, are disjoint."""
    return (
        (first[0] > second[3]) | (first[3] < second[0])
        | (first[1] > second[4]) | (first[4] < second[1])
        | (first[2] > second[5]) | (first[5] < second[2])
    )  # fmt: skip


@kernel()
def count_crossings(
    vertices: np.ndarray, triangles: np.ndarray, starts: np.ndarray, organs: np.ndarray
) -> tuple[int, int]:
    """Count the pairs of an edge and a triangle that it goes through, without candidates from earlier calls.

    Args:
        vertices: (V, 3) [u].
        triangles: (T, 3) of closed surfaces, sorted by patch.
        starts: (P + 1,) index of the first triangle of each patch, and the number of all.
        organs: (V,) which organ each vertex belongs to.

    Returns:
        Number of pairs within one organ, and number of pairs between two.
    """
    count, patches = triangles.shape[0], starts.shape[0] - 1
    boxes, around, planes = np.empty((count, 6)), np.empty((patches, 6)), np.empty((count, 5))
    for patch in range(patches):
        for axis in range(3):
            around[patch, axis], around[patch, 3 + axis] = np.inf, -np.inf
        for t in range(starts[patch], starts[patch + 1]):
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            _fill_plane(vertices, triangles[t], planes[t])
            for axis in range(3):
                x, y, z = vertices[a, axis], vertices[b, axis], vertices[c, axis]
                boxes[t, axis], boxes[t, 3 + axis] = min(x, y, z), max(x, y, z)
                around[patch, axis] = min(around[patch, axis], boxes[t, axis])
                around[patch, 3 + axis] = max(around[patch, 3 + axis], boxes[t, 3 + axis])
    own, between = 0, 0
    near = np.empty(count, np.int64)
    for first in range(patches):
        for second in range(first, patches):
            if _are_apart(around[first], around[second]):
                continue
            found = 0
            for t in range(starts[second], starts[second + 1]):
                if not _are_apart(around[first], boxes[t]):
                    near[found] = t
                    found += 1
            for s in range(starts[first], starts[first + 1]):
                if _are_apart(boxes[s], around[second]):
                    continue
                for k in range(found):
                    t = near[k]
                    if (first == second and t <= s) or _are_apart(boxes[s], boxes[t]):
                        continue
                    # Triangles that intersect straddle each other's planes.
                    if _is_beside(vertices, triangles[s], planes[t], triangles[t]) or _is_beside(
                        vertices, triangles[t], planes[s], triangles[s]
                    ):
                        continue
                    pairs = _pierces(vertices, triangles, s, t) + _pierces(vertices, triangles, t, s)
                    if organs[triangles[s, 0]] == organs[triangles[t, 0]]:
                        own += pairs
                    else:
                        between += pairs
    return own, between


@inline_kernel
def _share(p: int, q: int, a: int, b: int, c: int) -> bool:
    """Whether an edge and a triangle have a vertex in common."""
    return (p == a) | (p == b) | (p == c) | (q == a) | (q == b) | (q == c)


@inline_kernel
def _fill_frame(vertices: np.ndarray, a: int, b: int, c: int, frame: np.ndarray) -> None:
    """Write four planes (4, 4) of a triangle, unit normal and offset: its own, and those of its sides, facing outwards.

    The planes of a degenerate triangle are all zero.
    """
    ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    bx, by, bz = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
    cx, cy, cz = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
    x, y, z = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    area = math.sqrt(x * x + y * y + z * z)
    if area <= FLAT * (bx * bx + by * by + bz * bz + cx * cx + cy * cy + cz * cz):
        frame[:] = 0.0
        return
    x, y, z = x / area, y / area, z / area
    frame[0, 0], frame[0, 1], frame[0, 2] = x, y, z
    frame[0, 3] = x * ax + y * ay + z * az
    _fill_side(vertices, a, b, x, y, z, frame, 1)
    _fill_side(vertices, b, c, x, y, z, frame, 2)
    _fill_side(vertices, c, a, x, y, z, frame, 3)


@inline_kernel
def _fill_side(
    vertices: np.ndarray, start: int, end: int, x: float, y: float, z: float, frame: np.ndarray, k: int
) -> None:
    """Write the plane of a triangle's side, perpendicular to the triangle of normal x, y, z, into row k of `frame`."""
    sx, sy, sz = vertices[start, 0], vertices[start, 1], vertices[start, 2]
    ex, ey, ez = vertices[end, 0] - sx, vertices[end, 1] - sy, vertices[end, 2] - sz
    length = math.sqrt(ex * ex + ey * ey + ez * ez)
    ox, oy, oz = (ey * z - ez * y) / length, (ez * x - ex * z) / length, (ex * y - ey * x) / length
    frame[k, 0], frame[k, 1], frame[k, 2] = ox, oy, oz
    frame[k, 3] = ox * sx + oy * sy + oz * sz


@inline_kernel
def _are_far(vertices: np.ndarray, p: int, q: int, a: int, b: int, c: int, frame: np.ndarray, reach: float) -> bool:
    """Whether a separating axis shows that an edge and a triangle are farther apart than `reach`.

    The axes are the normals of the triangle's four planes and the cross products of the edge with the triangle's sides.
    """
    px, py, pz = vertices[p, 0], vertices[p, 1], vertices[p, 2]
    qx, qy, qz = vertices[q, 0], vertices[q, 1], vertices[q, 2]
    for k in range(4):
        x, y, z, offset = frame[k, 0], frame[k, 1], frame[k, 2], frame[k, 3]
        first, second = x * px + y * py + z * pz - offset, x * qx + y * qy + z * qz - offset
        if min(first, second) > reach or (k == 0 and max(first, second) < -reach):
            return True
    return (
        _are_far_across(vertices, p, q, a, b, c, reach)
        or _are_far_across(vertices, p, q, b, c, a, reach)
        or _are_far_across(vertices, p, q, c, a, b, reach)
    )


@inline_kernel
def _are_far_across(vertices: np.ndarray, p: int, q: int, a: int, b: int, c: int, reach: float) -> bool:
    """Whether an edge and a triangle are more than `reach` apart along the cross product of the edge and side ab."""
    px, py, pz = vertices[p, 0], vertices[p, 1], vertices[p, 2]
    dx, dy, dz = vertices[q, 0] - px, vertices[q, 1] - py, vertices[q, 2] - pz
    ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    sx, sy, sz = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
    x, y, z = dy * sz - dz * sy, dz * sx - dx * sz, dx * sy - dy * sx
    side = x * (ax - px) + y * (ay - py) + z * (az - pz)
    third = x * (vertices[c, 0] - px) + y * (vertices[c, 1] - py) + z * (vertices[c, 2] - pz)
    nearest = max(min(side, third), -max(side, third))
    return nearest > 0.0 and nearest * nearest > reach * reach * (x * x + y * y + z * z)


@inline_kernel
def _fill_box(vertices: np.ndarray, corners: np.ndarray, wider: float, box: np.ndarray) -> None:
    """Write the bounding box (6,) of an edge or a triangle, lower and upper corner, enlarged by `wider` each way."""
    for axis in range(3):
        low, high = vertices[corners[0], axis], vertices[corners[0], axis]
        for k in range(1, corners.shape[0]):
            x = vertices[corners[k], axis]
            low, high = min(low, x), max(high, x)
        box[axis], box[3 + axis] = low - wider, high + wider


@inline_kernel
def _boxes_are_apart(boxes: np.ndarray, i: int, others: np.ndarray, j: int) -> bool:
    """Whether box i of `boxes` (n, 6) and box j of `others` (m, 6) are disjoint."""
    return (
        (boxes[i, 0] > others[j, 3]) | (boxes[i, 3] < others[j, 0])
        | (boxes[i, 1] > others[j, 4]) | (boxes[i, 4] < others[j, 1])
        | (boxes[i, 2] > others[j, 5]) | (boxes[i, 5] < others[j, 2])
    )  # fmt: skip


@inline_kernel
def _list_moved(moved: np.ndarray, starts: np.ndarray, around: np.ndarray, flags: np.ndarray, found: np.ndarray) -> int:
    """Flag and list the edges or triangles at vertices that have moved, and return their number."""
    count = 0
    for v in range(moved.shape[0]):
        if moved[v]:
            for k in range(starts[v], starts[v + 1]):
                if not flags[around[k]]:
                    flags[around[k]] = True
                    found[count] = around[k]
                    count += 1
    return count


@kernel()
def find_pairs(net: Net, near: Near, w: int, moved: np.ndarray, reach: float) -> None:
    """Update the candidate pairs of the edges and triangles at vertices that have moved.

    Args:
        net: The surfaces.
        near: The candidates; updated in place.
        w: Index of the world.
        moved: (V,) which vertices have moved.
        reach: Greatest distance of a candidate pair [u].
    """
    vertices, pairs = near.found_at[w], near.pairs[w]
    boxes, edge_boxes, around = near.triangle_boxes[w], near.edge_boxes[w], near.patch_boxes[w]
    triangles, edges, patches = net.triangles, net.edges, around.shape[0]
    triangle_moved, edge_moved = np.zeros(triangles.shape[0], np.bool_), np.zeros(edges.shape[0], np.bool_)
    patch_moved, some = np.zeros(patches, np.bool_), np.empty(max(triangles.shape[0], edges.shape[0]), np.int64)
    for k in range(_list_moved(moved, net.star_starts, net.stars, edge_moved, some)):
        _fill_box(vertices, edges[some[k]], 0.5 * reach, edge_boxes[some[k]])
    for k in range(_list_moved(moved, net.fan_starts, net.fans, triangle_moved, some)):
        _fill_box(vertices, triangles[some[k]], 0.5 * reach, boxes[some[k]])
        patch_moved[net.triangle_patches[some[k]]] = True
    for patch in range(patches):
        if patch_moved[patch]:
            around[patch, :3], around[patch, 3:] = np.inf, -np.inf
            for t in range(net.triangle_starts[patch], net.triangle_starts[patch + 1]):
                for axis in range(3):
                    around[patch, axis] = min(around[patch, axis], boxes[t, axis])
                    around[patch, 3 + axis] = max(around[patch, 3 + axis], boxes[t, 3 + axis])
    count = 0
    for k in range(max(near.counts[w], 0)):
        if not (edge_moved[pairs[k, 0]] or triangle_moved[pairs[k, 1]]):
            pairs[count, 0], pairs[count, 1] = pairs[k, 0], pairs[k, 1]
            count += 1
    triangle_starts, edge_starts, room = net.triangle_starts, net.edge_starts, pairs.shape[0]
    frame = np.empty((4, 4))
    # If an edge has moved, so has a triangle of its patch: patches without a moved triangle can be skipped.
    for first in range(patches):
        if not patch_moved[first]:
            continue
        found = 0
        for second in range(patches):
            if not _boxes_are_apart(around, first, around, second):
                some[found] = second
                found += 1
        for t in range(triangle_starts[first], triangle_starts[first + 1]):
            if not triangle_moved[t]:
                continue
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            _fill_frame(vertices, a, b, c, frame)
            for k in range(found):
                second = some[k]
                if _boxes_are_apart(boxes, t, around, second):
                    continue
                for e in range(edge_starts[second], edge_starts[second + 1]):
                    if _boxes_are_apart(boxes, t, edge_boxes, e):
                        continue
                    p, q = edges[e, 0], edges[e, 1]
                    if _share(p, q, a, b, c) or _are_far(vertices, p, q, a, b, c, frame, reach):
                        continue
                    if count < room:
                        pairs[count, 0], pairs[count, 1] = e, t
                    count += 1
        for e in range(edge_starts[first], edge_starts[first + 1]):
            if not edge_moved[e]:
                continue
            p, q = edges[e, 0], edges[e, 1]
            for k in range(found):
                second = some[k]
                if _boxes_are_apart(edge_boxes, e, around, second):
                    continue
                for t in range(triangle_starts[second], triangle_starts[second + 1]):
                    if triangle_moved[t] or _boxes_are_apart(edge_boxes, e, boxes, t):
                        continue
                    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
                    if _share(p, q, a, b, c):
                        continue
                    _fill_frame(vertices, a, b, c, frame)
                    if _are_far(vertices, p, q, a, b, c, frame, reach):
                        continue
                    if count < room:
                        pairs[count, 0], pairs[count, 1] = e, t
                    count += 1
    near.counts[w] = count if count <= room else UNKNOWN


@inline_kernel
def _fill_axes(turn: np.ndarray, axes: np.ndarray) -> None:
    """Write the axes of a frame, the columns of `axes` (3, 3), from its orientation (4,), quaternion xyzw."""
    x, y, z, w = turn[0], turn[1], turn[2], turn[3]
    axes[0, 0], axes[0, 1], axes[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
    axes[1, 0], axes[1, 1], axes[1, 2] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)
    axes[2, 0], axes[2, 1], axes[2, 2] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)


@kernel()
def follow_turn(
    shape: np.ndarray, vertices: np.ndarray, turn: np.ndarray, axes: np.ndarray
) -> tuple[float, float, float]:
    """Turn a frame with vertices as they move, so that they move little in it.

    The rotation is extracted from the vertices' moments by `TURNS` iterations, warm-started with the last one.
    M. Müller, J. Bender, N. Chentanez and M. Macklin, A robust method to extract the rotational part of deformations,
    Motion in Games, 2016.

    Args:
        shape: (V, 3) the vertices in the reference state, relative to their mean [u].
        vertices: (V, 3) the vertices now [u].
        turn: (4,) orientation of the frame, quaternion xyzw; updated in place.
        axes: (3, 3) output: the frame's axes in columns.

    Returns:
        Mean of the vertices, the frame's origin [u].
    """
    size = vertices.shape[0]
    mean, moments = np.zeros(3), np.zeros((3, 3))
    for v in range(size):
        for k in range(3):
            mean[k] += vertices[v, k]
            for m in range(3):
                moments[k, m] += vertices[v, k] * shape[v, m]
    for _ in range(TURNS):
        _fill_axes(turn, axes)
        x, y, z, w, along = 0.0, 0.0, 0.0, 1.0, 0.0
        for m in range(3):
            x += axes[1, m] * moments[2, m] - axes[2, m] * moments[1, m]
            y += axes[2, m] * moments[0, m] - axes[0, m] * moments[2, m]
            z += axes[0, m] * moments[1, m] - axes[1, m] * moments[0, m]
            along += axes[0, m] * moments[0, m] + axes[1, m] * moments[1, m] + axes[2, m] * moments[2, m]
        # Half the vector of a small rotation: with a scalar part of 1, to first order its quaternion.
        half = 0.5 / (abs(along) + 1e-300)
        x, y, z = half * x, half * y, half * z
        a, b, c, d = turn[0], turn[1], turn[2], turn[3]
        turn[0] = w * a + x * d + y * c - z * b
        turn[1] = w * b - x * c + y * d + z * a
        turn[2] = w * c + x * b - y * a + z * d
        turn[3] = w * d - x * a - y * b - z * c
        length = math.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2 + turn[3] ** 2)
        for k in range(4):
            turn[k] /= length
    _fill_axes(turn, axes)
    return mean[0] / size, mean[1] / size, mean[2] / size


@inline_kernel
def _find_moved(net: Net, near: Near, w: int, vertices: np.ndarray, half: float, moved: np.ndarray) -> bool:
    """Mark the vertices (V, 3) that have moved farther than `half` in the co-rotating frame, and store where they are.

    Where candidates are `UNKNOWN`, all vertices are marked.

    Returns:
        Whether any vertex is marked.
    """
    axes = np.empty((3, 3))
    x, y, z = follow_turn(net.shape, vertices, near.turns[w], axes)
    xx, xy, xz = axes[0, 0], axes[0, 1], axes[0, 2]
    yx, yy, yz = axes[1, 0], axes[1, 1], axes[1, 2]
    zx, zy, zz = axes[2, 0], axes[2, 1], axes[2, 2]
    at, some, every = near.found_at[w], False, near.counts[w] == UNKNOWN
    for v in range(vertices.shape[0]):
        dx, dy, dz = vertices[v, 0] - x, vertices[v, 1] - y, vertices[v, 2] - z
        a, b, c = xx * dx + yx * dy + zx * dz, xy * dx + yy * dy + zy * dz, xz * dx + yz * dy + zz * dz
        squared = (a - at[v, 0]) ** 2 + (b - at[v, 1]) ** 2 + (c - at[v, 2]) ** 2
        moved[v] = every or squared > half * half
        if moved[v]:
            some = True
            at[v, 0], at[v, 1], at[v, 2] = a, b, c
    return some


@kernel()
def count_in_worlds(
    net: Net, vertices: np.ndarray, active: np.ndarray, reach: float, near: Near, crossings: np.ndarray
) -> None:
    """Count the pairs of an edge and a triangle that it goes through, in the active worlds.

    Args:
        net: The surfaces.
        vertices: (W, V, 3) [u].
        active: (W,) which worlds to test.
        reach: Greatest distance of a candidate pair [u].
        near: The candidates, kept from call to call; updated in place.
        crossings: (W, 2) output, zero beforehand: number of pairs within one organ, and number of pairs between two.
    """
    moved = np.empty(vertices.shape[1], np.bool_)
    for w in range(vertices.shape[0]):
        if not active[w]:
            continue
        if _find_moved(net, near, w, vertices[w], SURE * 0.5 * reach, moved):
            find_pairs(net, near, w, moved, reach)
        if near.counts[w] == UNKNOWN:
            crossings[w] = count_crossings(vertices[w], net.triangles, net.triangle_starts, net.organs)
            continue
        for k in range(near.counts[w]):
            e, t = near.pairs[w, k, 0], near.pairs[w, k, 1]
            p, q = net.edges[e, 0], net.edges[e, 1]
            a, b, c = net.triangles[t, 0], net.triangles[t, 1], net.triangles[t, 2]
            if _goes_through(vertices[w], p, q, a, b, c):
                crossings[w, 0 if net.organs[p] == net.organs[a] else 1] += 1
