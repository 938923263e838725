"""Even triangles: a surface with a wanted number of nodes, by splits, collapses, flips and smoothing.

The steps are those of M. Botsch and L. Kobbelt, A remeshing approach to multiresolution modeling, Symposium on Geometry
Processing, 2004, with flips that raise the least angle, and with a count of nodes that is met exactly. A collapse that
would make the surface no longer a manifold is not done, so a closed surface stays closed, of the same genus.
"""

from __future__ import annotations

import heapq
import math
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.anatomy.libraries import load
from spatula_env.anatomy.topology import Surface
from spatula_env.geometry.surface import triangle_areas, triangle_normals

if TYPE_CHECKING:
    from collections.abc import Callable

    from spatula_env.arrays import FloatArray, IntArray

ROUNDS = 8
"""Rounds of splits, collapses, flips and smoothing."""

SHORT, LONG = 0.8, 4.0 / 3.0
"""Edges are collapsed below, and split above, these parts of the wanted length."""

TURN = math.cos(math.radians(50.0))
"""Least cosine between the normal of a triangle and that of what replaces it."""

NEIGHBOURS = 24
"""Triangles among which the nearest point of the reference surface is looked for."""

Point = tuple[float, float, float]


class EditableMesh:
    """A closed triangle mesh that can be changed edge by edge.

    Attributes:
        points: Position of each vertex.
        triangles: Corners of each triangle by its number.
        around: Numbers of the triangles around each vertex; without any, a vertex is gone.
    """

    def __init__(self, vertices: FloatArray, triangles: IntArray) -> None:
        """Copy a mesh.

        Args:
            vertices: (V, 3) positions.
            triangles: (T, 3) vertex indices.
        """
        self.points: list[Point] = [tuple(point) for point in vertices.tolist()]
        self.triangles: dict[int, tuple[int, int, int]] = {}
        self.around: list[set[int]] = [set() for _ in self.points]
        self._next = 0
        for a, b, c in triangles.tolist():
            self._add((a, b, c))

    @property
    def node_count(self) -> int:
        """Number of vertices that are there."""
        return sum(map(bool, self.around))

    def arrays(self) -> tuple[FloatArray, IntArray]:
        """Positions (V, 3) and triangles (T, 3) without gaps; the vertices of the mesh are then numbered the same."""
        used = [vertex for vertex, around in enumerate(self.around) if around]
        number = {vertex: index for index, vertex in enumerate(used)}
        triangles = [[number[corner] for corner in corners] for corners in self.triangles.values()]
        return np.array([self.points[vertex] for vertex in used]), np.array(triangles, dtype=np.int64)

    def edges(self) -> list[tuple[int, int]]:
        """The edges, each once, smaller vertex first."""
        return [(a, b) for corners in self.triangles.values() for a, b in _sides(corners) if a < b]

    def length(self, a: int, b: int) -> float:
        """Length of an edge."""
        return math.dist(self.points[a], self.points[b])

    def neighbours(self, vertex: int) -> set[int]:
        """Vertices that share an edge with one."""
        found = {corner for number in self.around[vertex] for corner in self.triangles[number]}
        found.discard(vertex)
        return found

    def wings(self, a: int, b: int) -> tuple[list[int], list[int]]:
        """The triangles at an edge, and their vertices opposite it."""
        numbers = sorted(self.around[a] & self.around[b])
        return numbers, [next(v for v in self.triangles[n] if v not in (a, b)) for n in numbers]

    def split(self, a: int, b: int) -> int:
        """Put a vertex into the middle of an edge; its index."""
        numbers, _ = self.wings(a, b)
        middle = len(self.points)
        self.points.append(_middle(self.points[a], self.points[b]))
        self.around.append(set())
        for number in numbers:
            corners = self.triangles[number]
            self._remove(number)
            for gone in (a, b):
                self._add(_replaced(corners, gone, middle))
        return middle

    def collapse(self, a: int, b: int, longest: float) -> bool:
        """Make one vertex of the two of an edge, if nothing folds and no edge becomes longer than `longest`."""
        shared = self.neighbours(a) & self.neighbours(b)
        numbers, opposite = self.wings(a, b)
        if len(numbers) != 2 or shared != set(opposite) or any(len(self.around[v]) <= 3 for v in opposite):
            return False
        place = _middle(self.points[a], self.points[b])
        others = (self.neighbours(a) | self.neighbours(b)) - {a, b}
        if len(others) < 3 or any(math.dist(place, self.points[v]) > longest for v in others):
            return False
        kept = [(n, self.triangles[n]) for n in (self.around[a] | self.around[b]) - set(numbers)]
        for _, corners in kept:
            old = [self.points[v] for v in corners]
            new = [place if v in (a, b) else self.points[v] for v in corners]
            if not _same_side(_normal(*old), _normal(*new), 0.3):
                return False
        for number in numbers:
            self._remove(number)
        for number in list(self.around[b]):
            corners = self.triangles[number]
            self._remove(number)
            self._add(_replaced(corners, b, a))
        self.points[a] = place
        return True

    def flip(self, a: int, b: int) -> bool:
        """Turn the edge between two triangles, if that raises their least angle and bends the surface little."""
        numbers, opposite = self.wings(a, b)
        if len(numbers) != 2 or self.around[opposite[0]] & self.around[opposite[1]]:
            return False
        if len(self.around[a]) <= 3 or len(self.around[b]) <= 3:
            return False
        first = self.triangles[numbers[0]]
        c, d = opposite
        if first[(first.index(a) + 1) % 3] != b:
            a, b = b, a
        # The first triangle is now (a, b, c), the second (b, a, d).
        p, q, r, s = (self.points[v] for v in (a, b, c, d))
        if (
            min(_least_angle(p, s, r), _least_angle(s, q, r))
            <= min(_least_angle(p, q, r), _least_angle(q, p, s)) + 1e-6
        ):
            return False
        old, new = (_normal(p, q, r), _normal(q, p, s)), (_normal(p, s, r), _normal(s, q, r))
        if not all(_same_side(one, other, TURN) for one in old for other in new):
            return False
        for number in numbers:
            self._remove(number)
        self._add((a, d, c))
        self._add((d, b, c))
        return True

    def _add(self, corners: tuple[int, int, int]) -> None:
        self.triangles[self._next] = corners
        for vertex in corners:
            self.around[vertex].add(self._next)
        self._next += 1

    def _remove(self, number: int) -> None:
        for vertex in self.triangles.pop(number):
            self.around[vertex].discard(number)


def remesh(
    surface: Surface, reference: Surface, node_count: int, progress: Callable[[float], None] = lambda _: None
) -> Surface:
    """Even the triangles of a closed surface, and give it a number of nodes.

    Args:
        surface: A closed manifold, wound consistently.
        reference: Surface on which the nodes lie afterwards.
        node_count: How many; met exactly unless the surface's holes need more.
        progress: Called with the share of the work that is done.

    Returns:
        The surface; whether it crosses itself is not checked.
    """
    length = math.sqrt(2.0 * reference.area / (math.sqrt(3.0) * node_count))
    target = NearestSurface(reference, length)
    mesh = EditableMesh(surface.vertices, surface.triangles)
    for index in range(ROUNDS):
        _split_long(mesh, LONG * length)
        _collapse_short(mesh, SHORT * length, LONG * length)
        if index >= ROUNDS // 2:
            _meet_count(mesh, node_count)
        mesh = _smoothed(mesh, target)
        progress((index + 1) / ROUNDS)
    for _ in range(2):
        mesh = _smoothed(mesh, target)
    _flip_all(mesh)
    return Surface(*mesh.arrays())


def _split_long(mesh: EditableMesh, longest: float, most: int | None = None) -> None:
    """Split edges, the longest first: all that are longer than `longest`, or up to `most` of all."""
    heap = [(-mesh.length(a, b), a, b) for a, b in mesh.edges()]
    heapq.heapify(heap)
    done = 0
    while heap and (most is None or done < most):
        minus, a, b = heapq.heappop(heap)
        if -minus <= longest:
            return
        if len(mesh.around[a] & mesh.around[b]) != 2 or mesh.length(a, b) != -minus:
            continue
        middle = mesh.split(a, b)
        done += 1
        for other in mesh.neighbours(middle):
            heapq.heappush(heap, (-mesh.length(middle, other), min(middle, other), max(middle, other)))


def _collapse_short(mesh: EditableMesh, shortest: float, longest: float, most: int | None = None) -> int:
    """Collapse edges, the shortest first: those below `shortest`, or `most` of all; how many."""
    heap = [(mesh.length(a, b), a, b) for a, b in mesh.edges()]
    heapq.heapify(heap)
    done = 0
    while heap and (most is None or done < most):
        length, a, b = heapq.heappop(heap)
        if length >= shortest:
            break
        if not mesh.around[a] & mesh.around[b] or mesh.length(a, b) != length:
            continue
        if mesh.collapse(a, b, longest):
            done += 1
            for other in mesh.neighbours(a):
                heapq.heappush(heap, (mesh.length(a, other), min(a, other), max(a, other)))
    return done


def _meet_count(mesh: EditableMesh, node_count: int) -> None:
    """Split or collapse until the mesh has a number of nodes, or nothing more can be collapsed."""
    surplus = mesh.node_count - node_count
    if surplus > 0:
        _collapse_short(mesh, math.inf, math.inf, surplus)
    elif surplus < 0:
        _split_long(mesh, 0.0, -surplus)


def _flip_all(mesh: EditableMesh) -> None:
    for _ in range(4):
        if not sum(mesh.flip(a, b) for a, b in mesh.edges()):
            return


def _smoothed(mesh: EditableMesh, target: NearestSurface) -> EditableMesh:
    """Flip, move each node towards the middle of the triangles around it, and put it back onto the surface."""
    _flip_all(mesh)
    vertices, triangles = mesh.arrays()
    for _ in range(3):
        areas = triangle_areas(vertices, triangles)
        weighted = areas[:, None] * vertices[triangles].mean(axis=1)
        normals = triangle_normals(vertices, triangles) * areas[:, None]
        sums, weights, normal = np.zeros_like(vertices), np.zeros(len(vertices)), np.zeros_like(vertices)
        for k in range(3):
            np.add.at(sums, triangles[:, k], weighted)
            np.add.at(weights, triangles[:, k], areas)
            np.add.at(normal, triangles[:, k], normals)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        move = sums / np.maximum(weights, 1e-300)[:, None] - vertices
        move -= (move * normal).sum(axis=1, keepdims=True) * normal
        vertices = target.nearest(vertices + move, normal)
    return EditableMesh(vertices, triangles)


class NearestSurface:
    """A surface on which the points nearest to others are looked for.

    Attributes:
        middles: (n, 3) points on the surface, no farther apart than a length [m].
    """

    def __init__(self, surface: Surface, length: float) -> None:
        """Divide the triangles of a surface until no side is longer than a length [m]."""
        corners = surface.vertices[surface.triangles]
        # Divided until none is long: the nearest centroids then belong to the nearest triangles.
        while True:
            sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
            long = sides.max(axis=1) > length
            if not long.any():
                break
            corners = np.concatenate([corners[~long], _halved(corners[long], sides[long].argmax(axis=1))])
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        sizes = np.linalg.norm(normals, axis=1)
        there = sizes > 0.0
        self._corners, self._normals = corners[there], normals[there] / sizes[there, None]
        self.middles = self._corners.mean(axis=1)
        self._tree = load("scipy.spatial").cKDTree(self.middles)

    def nearest(self, points: FloatArray, normals: FloatArray | None = None) -> FloatArray:
        """(n, 3) the nearest points to (n, 3); with normals (n, 3), of what faces the same way.

        Where there is nothing, they are the points themselves.
        """
        count = min(NEIGHBOURS, len(self._corners))
        found = self._tree.query(points, k=count)[1].reshape(len(points), count)
        near = _nearest_on_triangles(np.repeat(points[:, None], count, axis=1), self._corners[found])
        distance = np.linalg.norm(near - points[:, None], axis=2)
        if normals is not None:
            distance[(self._normals[found] * normals[:, None]).sum(axis=2) <= 0.0] = np.inf
        best = distance.argmin(axis=1)
        chosen = near[np.arange(len(points)), best]
        return np.where(np.isfinite(distance.min(axis=1))[:, None], chosen, points)


def _halved(corners: FloatArray, longest: IntArray) -> FloatArray:
    """(2 n, 3, 3) two triangles for each of n, divided in the middle of the side that begins at a corner."""
    rows = np.arange(len(corners))
    a, b, c = (corners[rows, (longest + k) % 3] for k in range(3))
    middle = 0.5 * (a + b)
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])


def _nearest_on_triangles(points: FloatArray, corners: FloatArray) -> FloatArray:
    """(..., 3) the points of triangles (..., 3, 3) that are nearest to points (..., 3)."""
    a, b, c = (corners[..., k, :] for k in range(3))
    u, v, w = b - a, c - a, points - a
    uu, uv, vv = (u * u).sum(-1), (u * v).sum(-1), (v * v).sum(-1)
    wu, wv = (w * u).sum(-1), (w * v).sum(-1)
    scale = np.maximum(uu * vv - uv * uv, 1e-300)
    s, t = (vv * wu - uv * wv) / scale, (uu * wv - uv * wu) / scale
    best: FloatArray = a + s[..., None] * u + t[..., None] * v
    inside = (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)
    distance = np.where(inside, ((best - points) ** 2).sum(-1), np.inf)
    for start, side in ((a, u), (a, v), (b, c - b)):
        part = np.clip(((points - start) * side).sum(-1) / np.maximum((side * side).sum(-1), 1e-300), 0.0, 1.0)
        near = start + part[..., None] * side
        closer = ((near - points) ** 2).sum(-1)
        better = closer < distance
        best = np.where(better[..., None], near, best)
        distance = np.where(better, closer, distance)
    return best


def _sides(corners: tuple[int, int, int]) -> tuple[tuple[int, int], ...]:
    a, b, c = corners
    return (a, b), (b, c), (c, a)


def _replaced(corners: tuple[int, int, int], gone: int, new: int) -> tuple[int, int, int]:
    a, b, c = (new if vertex == gone else vertex for vertex in corners)
    return a, b, c


def _middle(p: Point, q: Point) -> Point:
    return 0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1]), 0.5 * (p[2] + q[2])


def _normal(p: Point, q: Point, r: Point) -> Point:
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


def _same_side(one: Point, other: Point, least: float) -> bool:
    """Whether the cosine between two vectors is greater than `least`; the first may have no length."""
    first, second = math.hypot(*one), math.hypot(*other)
    if second == 0.0:
        return False
    return first == 0.0 or sum(a * b for a, b in zip(one, other, strict=True)) > least * first * second


def _least_angle(p: Point, q: Point, r: Point) -> float:
    """Least angle of a triangle [rad]."""
    a, b, c = math.dist(q, r), math.dist(r, p), math.dist(p, q)
    least = min(a, b, c)
    if least == 0.0:
        return 0.0
    area = 0.5 * math.hypot(*_normal(p, q, r))
    return math.asin(min(1.0, 2.0 * area * least / (a * b * c)))
