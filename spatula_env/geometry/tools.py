"""Rigid tools: their contact nodes, and their surface.

A tool senses an organ through *contact nodes* spread over its flat faces. They come in pairs of *opposites*:
the ray that starts at one of them and runs inwards, along minus its face's normal, leaves the tool at the other.
On parallel faces that holds both ways. All coordinates are in the tool's own frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spatula_env.arrays import BoolArray, FloatArray, Int32Array
from spatula_env.geometry.arrays import read_only
from spatula_env.geometry.checks import check_count, check_positive
from spatula_env.geometry.hull import convex_hull
from spatula_env.geometry.polyhedra import COPLANAR, Face, cell_count, polyhedron_faces
from spatula_env.geometry.surface import canonical_order, check_surface, triangle_normals
from spatula_env.geometry.transforms import as_vector3

BOX_FACES = ("largest", "all")
"""Which faces of a box may carry contact nodes."""

PARALLEL = 1e-4
"""Two faces are parallel, and sampled as a pair, when their normals are opposite within this angle [rad]."""

MOST_NODES = 100_000
"""Greatest number of nodes: more are refused, as the unit of length is then probably mistaken."""

SMALLEST_SIZE = 1e-6
LARGEST_SIZE = 1e6
"""Limits of the diagonal of a tool's bounding box [u], wide enough for any sensible unit."""


@dataclass(frozen=True, eq=False)
class Tool:
    """A rigid convex body with contact nodes on its faces; make one with :meth:`box` or :meth:`convex`.

    Construction checks that the parts fit together and copies the arrays, which cannot be written to
    afterwards.

    Attributes:
        nodes: Positions of the contact nodes, shape (n, 3), float64 [u].
        normals: Outward unit normal of each node's face, shape (n, 3), float64.
        opposite: Index of each node's opposite, shape (n,), int32; ``opposite[opposite[i]] == i``.
        face: Index of each node's face, shape (n,), int32.
        face_normals: Outward unit normals of the faces with nodes, shape (F, 3), float64.
        areas: Each node's share of its face's area, shape (n,), float64 [u2].
        vertices: Corners of the tool's surface, shape (K, 3), float64 [u].
        triangles: Triangles of the tool's closed surface, all faces of it, shape (M, 3), int32, wound
            outwards.
        name: What to call the tool.
    """

    nodes: FloatArray = field(repr=False)
    normals: FloatArray = field(repr=False)
    opposite: Int32Array = field(repr=False)
    face: Int32Array = field(repr=False)
    face_normals: FloatArray = field(repr=False)
    areas: FloatArray = field(repr=False)
    vertices: FloatArray = field(repr=False)
    triangles: Int32Array = field(repr=False)
    name: str = "tool"

    def __post_init__(self) -> None:
        """Check the parts and replace the arrays by read-only copies."""
        vertices, triangles = check_surface(
            self.vertices, self.triangles, self.name, smallest=SMALLEST_SIZE, largest=LARGEST_SIZE
        )
        for key in ("nodes", "normals", "face_normals", "areas"):
            object.__setattr__(self, key, read_only(getattr(self, key), np.float64))
        for key in ("opposite", "face"):
            object.__setattr__(self, key, read_only(getattr(self, key), np.int32))
        object.__setattr__(self, "vertices", read_only(vertices, np.float64))
        object.__setattr__(self, "triangles", read_only(triangles, np.int32))
        self._check()

    @classmethod
    def box(
        cls,
        size: ArrayLike = (1.0, 1.0, 0.125),
        nodes_per_edge: int = 6,
        faces: str = "largest",
        *,
        node_spacing: float | None = None,
        name: str = "box",
    ) -> Tool:
        """A box centred at the origin, its edges along the axes: by default the seed's spatula.

        The two largest faces carry the same lattice of nodes, which reaches from rim to rim. A node's share of
        the area follows the trapezoidal rule, so a corner has a quarter of the share of a node in the middle.
        With ``faces="all"`` the other four faces carry nodes too, in the middles of the cells of a grid.

        The nodes are ordered by face. The largest pair of faces comes first, then the others by axis; of each
        pair the face towards the negative axis comes first. Opposite nodes are mirror images of each other.
        Among equally large pairs, z counts as the largest before y, and y before x.

        Args:
            size: Lengths of the edges along x, y and z, shape (3,) [u].
            nodes_per_edge: Nodes along each edge of the largest faces, at least 2.
            faces: ``"largest"`` for nodes on the two largest faces, as in the seed, or ``"all"``.
            node_spacing: If given, nodes along an edge are at most this far apart, and ``nodes_per_edge`` is
                not used [u].
            name: What to call the tool.

        Returns:
            The tool.

        Raises:
            ValueError: If a length or the spacing is not positive and finite, ``nodes_per_edge`` is not an
                integer of at least 2, ``faces`` is unknown, or there would be very many nodes.
        """
        lengths = as_vector3(size, "size")
        for axis, length in enumerate(lengths.tolist()):
            check_positive(length, f"size[{axis}]")
        if faces not in BOX_FACES:
            raise ValueError(f"faces must be one of {', '.join(map(repr, BOX_FACES))}, got {faces!r}")
        if node_spacing is None:
            check_count(nodes_per_edge, "nodes_per_edge", 2)
            cells = np.full(3, nodes_per_edge - 1)
        else:
            check_positive(node_spacing, "node_spacing")
            cells = np.array([cell_count(length, node_spacing) for length in lengths.tolist()])

        # The largest faces are across the shortest edge; of equal edges the last.
        thin = 2 - int(np.argmin(lengths[::-1]))
        u, v = (axis for axis in range(3) if axis != thin)
        _check_node_count(2 * (int(cells[u]) + 1) * (int(cells[v]) + 1))
        pairs = [_box_pair(lengths, thin, _rim_to_rim(lengths, cells, u), _rim_to_rim(lengths, cells, v))]
        if faces == "all":
            for axis, along in ((u, v), (v, u)):
                # Middles of cells in both directions, not rim to rim. A node on the rim of a side face would
                # lie on the rim of a largest face, whose lattice has nodes there already, and its inward ray
                # would run in the plane of the largest face, exactly where the surface of an organ in contact
                # is.
                rows = cells.copy()
                rows[thin] = cell_count(float(lengths[thin]), float(lengths[along] / cells[along]))
                first, second = sorted((along, thin))
                pairs.append(
                    _box_pair(
                        lengths,
                        axis,
                        _cell_middles(lengths, rows, first),
                        _cell_middles(lengths, rows, second),
                    )
                )
        nodes, normals, areas = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
        sizes = [len(pair[0]) // 2 for pair in pairs]
        face = np.repeat(np.arange(2 * len(pairs), dtype=np.int32), np.repeat(sizes, 2))
        start = np.repeat(np.cumsum([0, *sizes[:-1]]) * 2, np.multiply(sizes, 2))
        half = np.repeat(sizes, np.multiply(sizes, 2))
        opposite = start + (np.arange(len(nodes)) - start + half) % (2 * half)
        corners = 0.5 * lengths * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return cls(
            nodes=nodes,
            normals=normals,
            opposite=opposite.astype(np.int32),
            face=face,
            face_normals=normals[np.unique(face, return_index=True)[1]],
            areas=areas,
            vertices=corners,
            triangles=convex_hull(corners),
            name=name,
        )

    @classmethod
    def convex(cls, vertices: ArrayLike, node_spacing: float, name: str = "convex") -> Tool:
        """A convex polyhedron, the hull of some points, with nodes on all of its faces.

        Every face carries a lattice of at least one node. The opposite of a lattice node is an additional node
        on the face where the inward ray leaves the tool. Two parallel faces face each other node by node, as
        on a box, so the region between them is sampled only once: by the lattice of the larger face. The nodes
        on a face share its area equally. Nodes are ordered by face, faces from the largest to the smallest.

        Args:
            vertices: Points, shape (K, 3); those inside the hull of the others are ignored [u].
            node_spacing: Greatest distance between neighbouring nodes of a lattice [u].
            name: What to call the tool.

        Returns:
            The tool; its frame is that of the points.

        Raises:
            ValueError: If there are fewer than four points, or they are not finite, or lie in a plane, or the
                spacing is not positive and finite, or so small that there would be very many nodes.
        """
        check_positive(node_spacing, "node_spacing")
        try:
            used, renamed = np.unique(convex_hull(vertices, COPLANAR), return_inverse=True)
            corners = np.array(vertices, dtype=np.float64)[used]
            triangles = canonical_order(renamed.reshape(-1, 3))
            faces = polyhedron_faces(corners, triangles)
        except ValueError as error:
            raise ValueError(f"vertices of tool {name!r}: {error}") from error
        _check_node_count(sum(entry.area for entry in faces) / node_spacing**2)
        nodes, face, opposite = _convex_nodes(faces, node_spacing)
        face_normals = np.array([entry.normal for entry in faces])
        shares = np.array([entry.area for entry in faces]) / np.bincount(face)
        return cls(
            nodes=nodes,
            normals=face_normals[face],
            opposite=opposite,
            face=face,
            face_normals=face_normals,
            areas=shares[face],
            vertices=corners,
            triangles=triangles,
            name=name,
        )

    def scaled(self, factor: float) -> Tool:
        """The tool with all lengths multiplied by a factor, about its origin; the tool itself if the factor is 1.

        Raises:
            ValueError: If the factor is not positive and finite.
        """
        check_positive(factor, "factor")
        if factor == 1.0:
            return self
        return replace(self, nodes=self.nodes * factor, vertices=self.vertices * factor, areas=self.areas * factor**2)

    def __eq__(self, other: object) -> bool:
        """Whether the other is a tool of the same name, nodes and surface."""
        if not isinstance(other, Tool):
            return NotImplemented
        keys = ("nodes", "normals", "opposite", "face", "face_normals", "areas", "vertices", "triangles")
        return self.name == other.name and all(np.array_equal(getattr(self, key), getattr(other, key)) for key in keys)

    def __hash__(self) -> int:
        """Hash of the name and the nodes."""
        return hash((self.name, self.nodes.tobytes()))

    @cached_property
    def size(self) -> FloatArray:
        """Lengths of the bounding box along the axes, shape (3,) [u]."""
        size: FloatArray = np.ptp(self.vertices, axis=0)
        size.setflags(write=False)
        return size

    @cached_property
    def thickness(self) -> float:
        """Smallest width of the tool along a normal of a face with nodes [u]."""
        return float(np.ptp(self.vertices @ self.face_normals.T, axis=0).min())

    @cached_property
    def bounding_radius(self) -> float:
        """Distance of the farthest corner from the origin of the tool's frame [u]."""
        return float(np.linalg.norm(self.vertices, axis=1).max())

    def face_nodes(self, face: int) -> NDArray[np.int64]:
        """Indices of the nodes on a face.

        Args:
            face: Index of the face, from 0 to F - 1.

        Returns:
            Indices into ``nodes``, ascending.

        Raises:
            ValueError: If there is no such face.
        """
        if not 0 <= face < len(self.face_normals):
            raise ValueError(f"face must be from 0 to {len(self.face_normals) - 1}, got {face}")
        return np.flatnonzero(self.face == face)

    def contains(self, points: ArrayLike) -> BoolArray:
        """Which points are strictly inside the tool.

        Args:
            points: Points in the tool's frame, shape (m, 3) [u].

        Returns:
            Whether each point is inside, shape (m,).
        """
        normals, offsets = self.planes
        inside: BoolArray = np.all(np.asarray(points, dtype=np.float64) @ normals.T < offsets, axis=1)
        return inside

    @cached_property
    def planes(self) -> tuple[FloatArray, FloatArray]:
        """Outward unit normals (M, 3) and offsets (M,) of the planes of the surface's triangles."""
        normals = triangle_normals(self.vertices, self.triangles)
        return normals, np.einsum("ij,ij->i", normals, self.vertices[self.triangles[:, 0]])

    def _check(self) -> None:
        """Raise ValueError if the arrays do not fit together."""
        count, faces = len(self.nodes), len(self.face_normals)
        shapes = {
            "nodes": (count, 3),
            "normals": (count, 3),
            "opposite": (count,),
            "face": (count,),
            "face_normals": (faces, 3),
            "areas": (count,),
        }
        for key, shape in shapes.items():
            array = getattr(self, key)
            if array.shape != shape:
                raise ValueError(f"tool {self.name!r}: {key} must have shape {shape}, got {array.shape}")
            if not np.isfinite(array).all():
                raise ValueError(f"tool {self.name!r}: {key} must be finite")
        index = np.arange(count)
        if count == 0 or not ((self.opposite >= 0) & (self.opposite < count)).all():
            raise ValueError(f"tool {self.name!r}: opposite must name nodes from 0 to {count - 1}")
        lonely = (self.opposite == index) | (self.opposite[self.opposite] != index)
        if lonely.any():
            raise ValueError(
                f"tool {self.name!r}: {lonely.sum()} of {count} nodes are not their opposite's opposite, "
                f"first node {np.argmax(lonely)}"
            )
        if not ((self.face >= 0) & (self.face < faces)).all():
            raise ValueError(f"tool {self.name!r}: face must be from 0 to {faces - 1}")
        if not np.allclose(np.linalg.norm(self.face_normals, axis=1), 1.0, rtol=0.0, atol=1e-9):
            raise ValueError(f"tool {self.name!r}: face_normals must be of unit length")
        if not np.allclose(self.normals, self.face_normals[self.face], rtol=0.0, atol=1e-9):
            raise ValueError(f"tool {self.name!r}: normals must be those of the nodes' faces")
        if not (self.areas > 0.0).all():
            raise ValueError(f"tool {self.name!r}: areas must be positive")


def _check_node_count(count: float) -> None:
    """Raise ValueError if a lattice would have very many nodes."""
    if count > MOST_NODES:
        raise ValueError(f"a tool may have at most {MOST_NODES} nodes, this lattice has about {count:.3g}")


def _rim_to_rim(lengths: FloatArray, cells: NDArray[np.int64], axis: int) -> tuple[FloatArray, FloatArray]:
    """Boundaries of the cells along an axis, and their trapezoidal weights; both of shape (cells + 1,) [u]."""
    count, length = int(cells[axis]), float(lengths[axis])
    weights = np.full(count + 1, length / count)
    weights[[0, -1]] *= 0.5
    return np.linspace(-0.5 * length, 0.5 * length, count + 1), weights


def _cell_middles(lengths: FloatArray, cells: NDArray[np.int64], axis: int) -> tuple[FloatArray, FloatArray]:
    """Middles of the cells along an axis, and the cells' lengths; both of shape (cells,) [u]."""
    count, length = int(cells[axis]), float(lengths[axis])
    return ((np.arange(count) + 0.5) / count - 0.5) * length, np.full(count, length / count)


def _box_pair(
    lengths: FloatArray,
    axis: int,
    first: tuple[FloatArray, FloatArray],
    second: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Nodes (2 k, 3), normals (2 k, 3) and areas (2 k,) of the two faces across an axis, the negative first.

    ``first`` and ``second`` are coordinates and weights along the other two axes, in the order of the axes.
    """
    x, y = np.meshgrid(first[0], second[0], indexing="ij")
    plane = np.delete(np.arange(3), axis)
    nodes = np.empty((2, x.size, 3))
    nodes[:, :, plane] = np.column_stack([x.ravel(), y.ravel()])
    nodes[:, :, axis] = 0.5 * lengths[axis] * np.array([[-1.0], [1.0]])
    normals = np.zeros_like(nodes)
    normals[:, :, axis] = np.array([[-1.0], [1.0]])
    return nodes.reshape(-1, 3), normals.reshape(-1, 3), np.tile(np.outer(first[1], second[1]).ravel(), 2)


def _convex_nodes(faces: list[Face], spacing: float) -> tuple[FloatArray, Int32Array, Int32Array]:
    """Nodes (n, 3), their faces (n,) and their opposites (n,) on a convex polyhedron, ordered by face."""
    normals = np.array([face.normal for face in faces])
    offsets = np.array([face.offset for face in faces])
    nodes: list[FloatArray] = []
    labels: list[NDArray[np.int64]] = []
    for index, face in enumerate(faces):
        start = face.lattice(spacing)
        exit_face, end = _leave(start, face.normal, normals, offsets)
        # The larger of two parallel faces came first, and its rays have sampled this one already.
        antiparallel = np.abs(normals + face.normal).max(axis=1) <= PARALLEL
        fresh = ~(antiparallel[exit_face] & (exit_face < index))
        if not fresh.any() and not any((label == index).any() for label in labels):
            # The rays of the larger face may all have missed a small face, which would then have no node at all.
            start = face.centroid[None, :]
            exit_face, end = _leave(start, face.normal, normals, offsets)
            fresh = np.array([True])
        nodes.append(np.stack([start[fresh], end[fresh]], axis=1).reshape(-1, 3))
        labels.append(np.column_stack([np.full(fresh.sum(), index), exit_face[fresh]]).ravel())
    node, label = np.concatenate(nodes), np.concatenate(labels)
    # So far nodes 2 k and 2 k + 1 are opposite. Order the nodes by face, and renumber their opposites.
    order = np.argsort(label, kind="stable")
    rank = np.empty(len(order), dtype=np.int32)
    rank[order] = np.arange(len(order))
    return node[order], label[order].astype(np.int32), rank[order ^ 1]


def _leave(
    start: FloatArray, normal: FloatArray, normals: FloatArray, offsets: FloatArray
) -> tuple[NDArray[np.int64], FloatArray]:
    """Faces (m,) and points (m, 3) at which rays from points (m, 3) along ``-normal`` leave a polyhedron."""
    slope = -normals @ normal
    ahead = slope > 1e-12
    distance = np.full((len(start), len(normals)), math.inf)
    distance[:, ahead] = (offsets[ahead] - start @ normals[ahead].T) / slope[ahead]
    face = distance.argmin(axis=1)
    return face, start - distance.min(axis=1)[:, None] * normal
