"""What is wrong with a triangle surface, and what can be put right without moving it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.anatomy.libraries import load
from spatula_env.geometry.surface import (
    connected_components,
    edges,
    shared_edges,
    triangle_areas,
    winding_numbers,
)

if TYPE_CHECKING:
    from spatula_env.arrays import BoolArray, FloatArray, IndexArray, IntArray

WELD = 1e-7
"""Vertices are one if they are no farther apart than this part of the bounding box's diagonal: the rounding of single
precision, in which most files are written."""

MOST_TESTED = 200
"""Most components of which it is determined whether they are inside another one; the smallest are not."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle surface that may have any defect.

    Attributes:
        vertices: (V, 3) positions [m].
        triangles: (T, 3) vertex indices, int64.
    """

    vertices: FloatArray
    triangles: IntArray

    @property
    def diagonal(self) -> float:
        """Diagonal of the bounding box [m]."""
        return float(np.linalg.norm(np.ptp(self.vertices, axis=0)))

    @property
    def volumes(self) -> FloatArray:
        """(T,) signed volumes of the tetrahedra from the middle to the triangles [m3]."""
        centred = self.vertices - self.vertices.mean(axis=0)
        a, b, c = (centred[self.triangles[:, corner]] for corner in range(3))
        shares: FloatArray = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
        return shares

    @property
    def area(self) -> float:
        """Area [m2]."""
        return float(triangle_areas(self.vertices, self.triangles).sum())

    def kept(self, chosen: BoolArray) -> Surface:
        """The surface of some of the triangles alone, without the vertices that none of them has."""
        used, corners = np.unique(self.triangles[chosen], return_inverse=True)
        return Surface(self.vertices[used], corners.reshape(-1, 3).astype(np.int64))


def weld(surface: Surface) -> tuple[Surface, int]:
    """Make one vertex of vertices at the same place, up to rounding, and drop vertices of no triangle.

    Returns:
        The surface, and how many vertices went.
    """
    spatial = load("scipy.spatial")
    places, corners = np.unique(surface.vertices, axis=0, return_inverse=True)
    triangles = corners.reshape(-1)[surface.triangles]
    pairs = spatial.cKDTree(places).query_pairs(WELD * surface.diagonal, output_type="ndarray")
    if len(pairs):
        labels = _labels(len(places), pairs[:, 0], pairs[:, 1])
        triangles, places = labels[triangles], places[np.unique(labels, return_index=True)[1]]
    welded = Surface(places, triangles.astype(np.int64)).kept(np.ones(len(triangles), dtype=np.bool_))
    return welded, len(surface.vertices) - len(welded.vertices)


def drop_degenerate(surface: Surface) -> tuple[Surface, int]:
    """Drop triangles that repeat a vertex, and all but one of those with the same three vertices.

    Returns:
        The surface, and how many triangles went.
    """
    corners = np.sort(surface.triangles, axis=1)
    proper = (np.diff(corners, axis=1) > 0).all(axis=1)
    _, first = np.unique(corners, axis=0, return_index=True)
    chosen = np.zeros(len(corners), dtype=np.bool_)
    chosen[first] = True
    chosen &= proper
    return surface.kept(chosen), int((~chosen).sum())


def count_edges(triangles: IndexArray) -> tuple[IntArray, IntArray]:
    """The edges (E, 2) and the number of triangles at each (E,)."""
    pairs = np.sort(np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1).astype(np.int64)
    unique, uses = np.unique(pairs[:, 0] * (int(pairs.max(initial=0)) + 1) + pairs[:, 1], return_counts=True)
    return np.column_stack(np.divmod(unique, int(pairs.max(initial=0)) + 1)), uses


def orient(surface: Surface) -> tuple[Surface, int, bool]:
    """Wind neighbouring triangles alike, and each component so that it encloses a positive volume.

    Returns:
        The surface, how many triangles were turned, and whether all could be wound alike: a Moebius strip cannot.
    """
    count = len(surface.triangles)
    left, right = shared_edges(surface.triangles)
    # Twins: each triangle as it is, and turned. Neighbours that run along their edge in opposite directions agree.
    starts = surface.triangles.ravel()
    turned = starts[left] == starts[right]
    one, other = left // 3, right // 3
    label = _labels(
        2 * count,
        np.concatenate([one, one + count]),
        np.concatenate([other + count * turned, other + count * ~turned]),
    )
    upright, mirrored = label[:count], label[count:]
    component = connected_components(surface.triangles)
    first = np.unique(component, return_index=True)[1]
    flip = upright != upright[first][component]
    wound = np.where(flip[:, None], surface.triangles[:, ::-1], surface.triangles)
    volumes = np.bincount(component, weights=Surface(surface.vertices, wound).volumes)
    inward = (volumes < 0.0)[component]
    result = Surface(surface.vertices, np.where(inward[:, None], wound[:, ::-1], wound))
    return result, int((flip != inward).sum()), not (upright == mirrored).any()


def buried(surface: Surface, component: IndexArray) -> tuple[BoolArray, IntArray]:
    """Which components lie inside others.

    Args:
        surface: All components wound outwards.
        component: (T,) the component of each triangle.

    Returns:
        For each component, whether an odd number of others enclose it, and which were not tested as they are among the
        smallest of very many.
    """
    volumes = np.bincount(component, weights=surface.volumes)
    order = np.argsort(-volumes, kind="stable")
    inside = np.zeros(len(volumes), dtype=np.bool_)
    for label in order[1:MOST_TESTED]:
        own = component == label
        corner = surface.vertices[surface.triangles[np.argmax(own)]].mean(axis=0)
        turns = winding_numbers(corner[None], surface.vertices, surface.triangles[~own])
        inside[label] = round(float(turns[0])) % 2 == 1
    return inside, order[MOST_TESTED:]


def boundary_loops(surface: Surface) -> list[IntArray]:
    """The borders of the surface's holes, each as vertices in the order in which a triangle there would have them."""
    directed = np.concatenate([surface.triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    base = len(surface.vertices)
    keys, back = directed[:, 0] * base + directed[:, 1], directed[:, 1] * base + directed[:, 0]
    border = directed[~np.isin(keys, back)]
    # A hole's own triangles run along its border the other way.
    following = dict(zip(border[:, 1].tolist(), border[:, 0].tolist(), strict=True))
    loops = []
    while following:
        start, vertex = next(iter(following.items()))
        loop = [start]
        del following[start]
        while vertex != start and vertex in following:
            loop.append(vertex)
            vertex = following.pop(vertex)
        loops.append(np.array(loop))
    return loops


def is_manifold(surface: Surface) -> bool:
    """Whether every edge is in two triangles, and the triangles around every vertex form one fan."""
    if not (count_edges(surface.triangles)[1] == 2).all():
        return False
    left, right = shared_edges(surface.triangles)
    corners = surface.triangles.ravel()
    # The two corners of each triangle at the edge; those at the same vertex belong to the same fan.
    next_left, next_right = (3 * (edge // 3) + (edge % 3 + 1) % 3 for edge in (left, right))
    alike = corners[left] == corners[right]
    label = _labels(
        len(corners),
        np.concatenate([left, next_left]),
        np.concatenate([np.where(alike, right, next_right), np.where(alike, next_right, right)]),
    )
    return int(label.max()) + 1 == len(np.unique(corners))


def angles(vertices: FloatArray, triangles: IndexArray) -> FloatArray:
    """(T, 3) angles at the corners of triangles [deg]."""
    corners = vertices[triangles]
    result = np.empty((len(triangles), 3))
    for k in range(3):
        first, second = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        across = np.linalg.norm(np.cross(first, second), axis=1)
        result[:, k] = np.degrees(np.arctan2(across, np.einsum("ij,ij->i", first, second)))
    return result


def edge_lengths(vertices: FloatArray, triangles: IndexArray) -> FloatArray:
    """(E,) lengths of the edges, in the unit of the vertices."""
    pairs = edges(triangles)
    lengths: FloatArray = np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1)
    return lengths


def _labels(count: int, left: IndexArray, right: IndexArray) -> IntArray:
    """(count,) the connected component of each member, from the pairs that are connected."""
    sparse = load("scipy.sparse")
    links = sparse.coo_matrix((np.ones(len(left), dtype=np.int8), (left, right)), shape=(count, count))
    return np.asarray(load("scipy.sparse.csgraph").connected_components(links, directed=False)[1], dtype=np.int64)
