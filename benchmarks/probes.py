"""The points, columns and faces of a tool that the inspection examines, arranged for fast queries."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from benchmarks.passages import PARALLEL

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.geometry import Tool

    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.int64]

RIM = 0.1
"""Within this distance of the rim of a face [u], a surface may slip round the rim between two inspections. There only
depth is judged, not on which side of the tool the surface is."""

EDGE_SPACING = 0.1
"""Greatest distance between the sample points on the tool's edges [u]."""

LINES = np.array([(3.0, -6.0, 2.0), (6.0, 2.0, -3.0), (2.0, 3.0, 6.0)]) / 7.0
"""Orthonormal axes u, v and w, one per row. All test lines run along w, which is parallel to no face and no lattice
line of a box, so that they meet a surface that rests on a face at an angle."""

CELLS_PER_POINT = 1.0
"""Number of cells of the grid over u and v, per point."""


class Points(NamedTuple):
    """Points in a grid over u and v, in which those under a triangle are found quickly, for kernels.

    Attributes:
        places: (m, 3) positions [u].
        seen: (m, 3) coordinates along u, v and w [u].
        grid: (4,) least u and least v [u], and number of cells per unit of length along u and along v.
        cells: Number of cells along u, and along v.
        starts: (cells**2 + 1,) where the points of each cell begin in `order`; consecutive cells are neighbours in v.
        order: (m,) indices of the points, sorted by cell.
    """

    places: FloatArray
    seen: FloatArray
    grid: FloatArray
    cells: int
    starts: IntArray
    order: IntArray


class Probe(NamedTuple):
    """The parts of a tool that the inspection examines, in the tool's frame [u], for kernels.

    Attributes:
        points: Contact nodes, corners, sample points on edges, middles of columns, and the origin, in this order.
        ends: (5,) index in `points` at which each of these groups ends.
        columns: (c, 3) indices of points: two opposite contact nodes, whose connection is at least `RIM` away from all
            faces but theirs, and the middle between them.
        normals: (F, 3) outward unit normals of the faces, each plane once.
        offsets: (F,) offsets of these planes.
        box: (6,) lower and upper corner of the tool's bounding box.
        radius: Radius of a ball about the origin that contains the tool.
    """

    points: Points
    ends: IntArray
    columns: IntArray
    normals: FloatArray
    offsets: FloatArray
    box: FloatArray
    radius: float


def arrange_points(places: FloatArray) -> Points:
    """Arrange points (m, 3), at least one, in a grid."""
    seen = places @ LINES.T
    cells = max(1, round((CELLS_PER_POINT * len(places)) ** 0.5))
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    density = cells / np.maximum(high - low, 1e-9)
    cell = np.minimum(((seen[:, :2] - low) * density).astype(np.int64), cells - 1) @ [cells, 1]
    return Points(
        places=places,
        seen=seen,
        grid=np.concatenate([low, density]),
        cells=cells,
        starts=np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=cells**2))]),
        order=np.argsort(cell, kind="stable"),
    )


def make_probe(tool: Tool) -> Probe:
    """Make the `Probe` of a tool."""
    normals, offsets = _distinct_planes(*tool.planes)
    edges, opposite = _edge_points(tool, normals, offsets), _inner_columns(tool, normals, offsets)
    groups = (tool.nodes, tool.vertices, edges, tool.nodes[opposite].mean(axis=1), np.zeros((1, 3)))
    places, ends = np.concatenate(groups), np.cumsum([len(group) for group in groups])
    return Probe(
        points=arrange_points(places),
        ends=ends,
        columns=np.column_stack([opposite, np.arange(ends[2], ends[3])]),
        normals=normals,
        offsets=offsets,
        box=np.concatenate([places.min(axis=0), places.max(axis=0)]),
        radius=float(tool.bounding_radius),
    )


def _distinct_planes(normals: FloatArray, offsets: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The planes of a tool's faces, each once: normals (F, 3) and offsets (F,)."""
    rows = np.column_stack([normals, offsets])
    first = np.sort(np.unique(rows.round(9), axis=0, return_index=True)[1])
    return np.ascontiguousarray(normals[first]), np.ascontiguousarray(offsets[first])


def _edge_points(tool: Tool, normals: FloatArray, offsets: FloatArray) -> FloatArray:
    """Sample points (m, 3) on a tool's edges, without their ends, no farther apart than `EDGE_SPACING`."""
    corners = tool.vertices
    on_plane = np.abs(corners @ normals.T - offsets) < PARALLEL * tool.bounding_radius
    pairs = np.unique(np.sort(tool.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    points = []
    for first, second in pairs.tolist():
        # A triangle's side inside a face lies on one plane, an edge of the tool on two.
        if (on_plane[first] & on_plane[second]).sum() >= 2:
            parts = int(np.ceil(np.linalg.norm(corners[second] - corners[first]) / EDGE_SPACING))
            points += [corners[first] + k / parts * (corners[second] - corners[first]) for k in range(1, parts)]
    return np.array(points).reshape(-1, 3)


def _inner_columns(tool: Tool, normals: FloatArray, offsets: FloatArray) -> NDArray[np.int64]:
    """Pairs of opposite contact nodes (c, 2) whose connection is at least `RIM` away from all faces but theirs."""
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
