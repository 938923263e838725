"""Where organs' surfaces cross themselves or each other: edges that go through triangles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spatula_env._kernels import inline_kernel, kernel

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    FloatArray = NDArray[np.float64]

PATCH = 8
"""Triangles that are near each other are looked at together, so many at most, or `PATCH_SHARE` of the square root of
their number if that is more."""

PATCH_SHARE = 0.25

ROUNDING = 1e-13
"""A height over a plane is in doubt if it is less than this, in the size of what it is computed from."""


@dataclass(frozen=True)
class Crossings:
    """Pairs of an edge and a triangle that it goes through.

    Attributes:
        own: Of one organ.
        between: Of two.
    """

    own: int
    between: int


class CrossingCounter:
    """Counts crossings of surfaces whose vertices move.

    Args:
        vertices: (V, 3) of all surfaces in some state: what is near each other then is looked at together [u].
        triangles: (T, 3) of closed surfaces, counter-clockwise from outside.
        organs: (V,) which organ each vertex belongs to; all to one by default.
    """

    def __init__(self, vertices: FloatArray, triangles: ArrayLike, organs: ArrayLike | None = None) -> None:
        indices = np.array(triangles, dtype=np.int32)
        patches = _patches(vertices[indices].mean(axis=1), np.arange(len(indices)))
        self._triangles = np.ascontiguousarray(indices[np.concatenate(patches)])
        self._starts = np.cumsum([0, *(len(patch) for patch in patches)])
        self._organs = np.zeros(len(vertices), dtype=np.int32) if organs is None else np.array(organs, dtype=np.int32)

    def count(self, vertices: FloatArray) -> Crossings:
        """Count them.

        Args:
            vertices: (V, 3) finite [u].

        Returns:
            How many there are. An edge does not go through a triangle that it only touches, or shares a vertex with.
        """
        found = count_crossings(np.ascontiguousarray(vertices), self._triangles, self._starts, self._organs)
        return Crossings(*found)


def _patches(middles: FloatArray, members: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Divide triangles (n,), of which all middles (T, 3) are given, into patches by halving the longest axis."""
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
    """Whether the edge from p to q goes through the inner of a triangle."""
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
    """How many edges of triangle s go through triangle t, of those that it is the first of two triangles to have."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    count = 0
    for side in range(3):
        p, q = triangles[s, side], triangles[s, (side + 1) % 3]
        # The two triangles of an edge have it in opposite directions.
        if p < q and _goes_through(vertices, p, q, a, b, c):
            count += 1
    return count


@inline_kernel
def _is_beside(vertices: np.ndarray, corners: np.ndarray, plane: np.ndarray, others: np.ndarray) -> bool:
    """Whether a triangle is on one side of another's plane (4,), normal and offset, or touches it.

    Corners that both have are on the plane.
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
    """Write a triangle's normal, not of unit length, its offset, and how much rounding may change a height by."""
    a, b, c = corners[0], corners[1], corners[2]
    ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    bx, by, bz = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
    cx, cy, cz = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
    plane[0], plane[1], plane[2] = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    plane[3] = plane[0] * ax + plane[1] * ay + plane[2] * az
    plane[4] = ROUNDING * (abs(plane[0]) + abs(plane[1]) + abs(plane[2])) * (1.0 + abs(ax) + abs(ay) + abs(az))


@inline_kernel
def _are_apart(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether two boxes (6,), lower corner and upper one, have nothing in common."""
    return (
        (first[0] > second[3]) | (first[3] < second[0])
        | (first[1] > second[4]) | (first[4] < second[1])
        | (first[2] > second[5]) | (first[5] < second[2])
    )  # fmt: skip


@kernel("UniTuple(i8, 2)(f8[:,::1], i4[:,::1], i8[::1], i4[::1])")
def count_crossings(
    vertices: np.ndarray, triangles: np.ndarray, starts: np.ndarray, organs: np.ndarray
) -> tuple[int, int]:
    """Count the pairs of an edge and a triangle that it goes through.

    Args:
        vertices: (V, 3) [u].
        triangles: (T, 3) of closed surfaces, patch after patch.
        starts: (P + 1,) where each patch begins, and the end.
        organs: (V,) which organ each vertex belongs to.

    Returns:
        How many pairs are of one organ, and how many of two.
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
                    # Triangles that meet reach across each other's planes.
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
