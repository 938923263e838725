"""Organ surfaces: the seed's sphere and simple test shapes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from spatula_env.arrays import FloatArray, Int32Array
from spatula_env.geometry.arrays import read_only
from spatula_env.geometry.checks import check_count, check_positive
from spatula_env.geometry.hull import convex_hull
from spatula_env.geometry.polyhedra import cell_count
from spatula_env.geometry.surface import canonical_order, check_surface, edges, signed_volume, surface_area
from spatula_env.geometry.transforms import as_vector3


@dataclass(frozen=True, eq=False)
class Organ:
    """The surface of a soft body, closed and wound outwards.

    Construction checks the surface with :func:`~spatula_env.geometry.surface.check_surface` and copies the
    arrays, which cannot be written to afterwards.

    Attributes:
        vertices: Positions of the nodes at rest, shape (V, 3), float64 [u].
        triangles: Node indices, shape (T, 3), int32, counter-clockwise seen from outside.
        name: What to call the organ.
    """

    vertices: FloatArray = field(repr=False)
    triangles: Int32Array = field(repr=False)
    name: str = "organ"

    def __post_init__(self) -> None:
        """Check the surface and replace the arrays by read-only copies."""
        vertices, triangles = check_surface(self.vertices, self.triangles, self.name)
        object.__setattr__(self, "vertices", read_only(vertices, np.float64))
        object.__setattr__(self, "triangles", read_only(triangles, np.int32))

    def __eq__(self, other: object) -> bool:
        """Whether the other is an organ of the same name, nodes and triangles."""
        if not isinstance(other, Organ):
            return NotImplemented
        return (
            self.name == other.name
            and np.array_equal(self.vertices, other.vertices)
            and np.array_equal(self.triangles, other.triangles)
        )

    def __hash__(self) -> int:
        """Hash of the name and the nodes."""
        return hash((self.name, self.vertices.tobytes()))

    @property
    def area(self) -> float:
        """Area of the surface [u2]."""
        return surface_area(self.vertices, self.triangles)

    @property
    def volume(self) -> float:
        """Volume the surface encloses [u3]."""
        return signed_volume(self.vertices, self.triangles)

    @property
    def bounds(self) -> FloatArray:
        """Lower and upper corner of the bounding box, shape (2, 3) [u]."""
        return np.array([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def edge_lengths(self) -> FloatArray:
        """Lengths of the edges, shape (E,) [u], ordered as :func:`~spatula_env.geometry.surface.edges`."""
        pairs = edges(self.triangles)
        lengths: FloatArray = np.linalg.norm(self.vertices[pairs[:, 0]] - self.vertices[pairs[:, 1]], axis=1)
        return lengths


def seed_sphere(radius: float = 3.0, node_count: int = 328) -> Organ:
    """The seed's organ: Hammersley points on a sphere and their convex hull.

    With the defaults it has 328 nodes and 652 triangles, and is the body that Bullet's own ellipsoid helper
    builds. The points are those of T. T. Wong, W. S. Luk and P. A. Heng, Sampling with Hammersley and Halton
    points, Journal of Graphics Tools 2(2), 1997: point i is at the height 2 t - 1 (times the radius), where t
    is i with its binary digits mirrored at the binary point, and at the angle (2 i + 1) pi / n.

    Args:
        radius: Radius of the sphere [u].
        node_count: Number n of nodes, at least 4.

    Returns:
        The organ, centred at the origin. Node i is Hammersley point i; node 0 is the south pole.

    Raises:
        ValueError: If the radius is not positive and finite, or there are fewer than 4 nodes.
    """
    check_positive(radius, "radius")
    check_count(node_count, "node_count", 4)
    return _seed_sphere(float(radius), int(node_count))


@lru_cache(maxsize=8)
def _seed_sphere(radius: float, node_count: int) -> Organ:
    """Cached `seed_sphere`: its hull takes longer than the rest of making a scene, and scenes are made repeatedly."""
    index = np.arange(node_count)
    mirrored = np.zeros(node_count)
    for bit in range(int(node_count - 1).bit_length()):
        mirrored += ((index >> bit) & 1) * 0.5 ** (bit + 1)
    height = 2.0 * mirrored - 1.0
    angle = (2.0 * index * np.pi + np.pi) / node_count
    distance = np.sqrt(1.0 - height * height)
    vertices = radius * np.column_stack([distance * np.cos(angle), distance * np.sin(angle), height])
    return Organ(vertices, convex_hull(vertices), "sphere")


def icosphere(radius: float = 1.0, subdivisions: int = 2) -> Organ:
    """A sphere of nearly equal triangles: an icosahedron whose triangles are repeatedly divided into four.

    Args:
        radius: Radius of the sphere [u].
        subdivisions: How often to divide; the result has 20 * 4**subdivisions triangles.

    Returns:
        The organ, centred at the origin, all nodes on the sphere.

    Raises:
        ValueError: If the radius is not positive and finite, or subdivisions is negative.
    """
    check_positive(radius, "radius")
    check_count(subdivisions, "subdivisions", 0)
    golden = 0.5 * (1.0 + math.sqrt(5.0))
    corners = [(0.0, s, t * golden) for s in (-1.0, 1.0) for t in (-1.0, 1.0)]
    vertices = np.array([corner[k:] + corner[:k] for k in range(3) for corner in corners])
    triangles = convex_hull(vertices)
    for _ in range(subdivisions):
        vertices, triangles = _split_in_four(vertices, triangles)
    vertices *= radius / np.linalg.norm(vertices, axis=1, keepdims=True)
    return Organ(vertices, canonical_order(triangles), "icosphere")


def box_surface(size: ArrayLike = (1.0, 1.0, 1.0), spacing: float = 0.25) -> Organ:
    """A box whose faces are divided into a grid of rectangles, each of two triangles.

    Args:
        size: Lengths of the edges, shape (3,) [u].
        spacing: Greatest distance between neighbouring nodes along an edge [u].

    Returns:
        The organ, centred at the origin.

    Raises:
        ValueError: If a length or the spacing is not positive and finite.
    """
    lengths = as_vector3(size, "size")
    for length in lengths.tolist():
        check_positive(length, "size")
    check_positive(spacing, "spacing")
    counts = np.array([cell_count(length, spacing) for length in lengths.tolist()])
    quads = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        # The four corners of every rectangle, turning from the first axis to the second.
        corner = np.zeros((counts[first] * counts[second], 4, 3), dtype=np.int64)
        i, j = np.divmod(np.arange(len(corner)), counts[second])
        corner[:, :, first] = i[:, None] + np.array([0, 1, 1, 0])
        corner[:, :, second] = j[:, None] + np.array([0, 0, 1, 1])
        far = corner.copy()
        far[:, :, axis] = counts[axis]
        quads += [corner[:, ::-1], far]
    # Nodes on edges and corners of the box belong to several faces: equal grid coordinates are one node.
    grid, node = np.unique(np.concatenate(quads).reshape(-1, 3), axis=0, return_inverse=True)
    quad = node.reshape(-1, 4)
    triangles = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
    return Organ(lengths * (grid / counts - 0.5), canonical_order(triangles), "box")


def torus(major_radius: float = 2.0, minor_radius: float = 0.5, major_count: int = 32, minor_count: int = 16) -> Organ:
    """A ring about the z axis: a surface that is neither convex nor like a sphere.

    Args:
        major_radius: Radius of the circle in the middle of the tube [u].
        minor_radius: Radius of the tube, less than ``major_radius`` [u].
        major_count: Nodes around the ring, at least 3.
        minor_count: Nodes around the tube, at least 3.

    Returns:
        The organ, centred at the origin, with ``major_count * minor_count`` nodes.

    Raises:
        ValueError: If a radius is not positive and finite, the tube is wider than the ring, or a count is
            below 3.
    """
    check_positive(major_radius, "major_radius")
    check_positive(minor_radius, "minor_radius")
    if minor_radius >= major_radius:
        raise ValueError(f"minor_radius must be less than major_radius ({major_radius}), got {minor_radius}")
    check_count(major_count, "major_count", 3)
    check_count(minor_count, "minor_count", 3)
    i, j = np.divmod(np.arange(major_count * minor_count), minor_count)
    around, across = 2.0 * np.pi * i / major_count, 2.0 * np.pi * j / minor_count
    distance = major_radius + minor_radius * np.cos(across)
    vertices = np.column_stack([distance * np.cos(around), distance * np.sin(around), minor_radius * np.sin(across)])
    next_i, next_j = (i + 1) % major_count * minor_count, (j + 1) % minor_count
    i *= minor_count
    triangles = np.concatenate(
        [
            np.column_stack([i + j, next_i + j, next_i + next_j]),
            np.column_stack([i + j, next_i + next_j, i + next_j]),
        ]
    )
    return Organ(vertices, canonical_order(triangles), "torus")


def _split_in_four(vertices: FloatArray, triangles: Int32Array) -> tuple[FloatArray, Int32Array]:
    """Put a vertex in the middle of every edge and divide every triangle into four."""
    pairs = edges(triangles)
    base = len(vertices)
    keys = pairs[:, 0].astype(np.int64) * base + pairs[:, 1]
    # The edges are in ascending order, so a search finds the middle of the edge opposite every corner.
    start, end = (np.roll(triangles, -k, axis=1).astype(np.int64) for k in (1, 2))
    middle = base + np.searchsorted(keys, np.minimum(start, end) * base + np.maximum(start, end))
    corners = [np.column_stack([triangles[:, k], middle[:, (k + 2) % 3], middle[:, (k + 1) % 3]]) for k in range(3)]
    return np.concatenate([vertices, vertices[pairs].mean(axis=1)]), np.concatenate([*corners, middle])
