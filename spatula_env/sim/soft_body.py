"""Bullet's model of an organ: masses of its nodes, and links between them.

In Bullet's classic soft body, links pull nodes towards the links' rest lengths. This module derives masses and links
from the organ's surface as PyBullet's `loadSoftBody(useMassSpring=1, useBendingSprings=1)` does, in the order in which
Bullet processes the links: the outcome of a Gauss–Seidel sweep depends on it. Facts about PyBullet 3.2.7, found by
comparing with it:

- The node masses come from the vertices as read from a file, in single precision. The rest lengths do not: Bullet
  takes them from the nodes' positions at the beginning of the first step, in double precision.
- There is a link along every edge, of stiffness 1, and one between any two nodes at graph distance two, of half that.

An organ of several parts, which PyBullet does not load, is a soft body for each of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry.checks import check_positive
from spatula_env.geometry.parts import organ_parts
from spatula_env.geometry.surface import vertex_areas

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.geometry.meshes import Organ
    from spatula_env.scenes import PlacedOrgan

    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.int32]

EDGE_STIFFNESS = 1.0
"""Fraction of its stretch that a link along an edge removes in each sweep."""

BENDING_STIFFNESS = 0.5
"""Fraction of its stretch that a link between nodes at graph distance two removes in each sweep."""

SWEEPS = 20
"""Sweeps over all links in a step, as in PyBullet: a pull travels about as many edges."""

SHUFFLE_SEED, SHUFFLE_FACTOR, SHUFFLE_SUMMAND, SHUFFLE_MODULUS = 243703, 1664525, 1013904223, 2**32
"""Constants of Bullet's linear congruential generator."""

SHORTEST_SQUARED = float(np.finfo(np.float64).eps)
"""Bullet leaves links alone whose squared rest length and squared length are less than this together [u2]."""


@dataclass(frozen=True, eq=False)
class SoftBody:
    """Nodes and links of one or more organs.

    Attributes:
        vertices: (V, 3) positions at rest [u].
        masses: (V,) of the nodes, including those that are held fixed [kg].
        inverse_masses: (V,) zero for a node that is held fixed [1/kg].
        links: (L, 2) the nodes that each link connects, int32, in the order of a sweep.
        squared_rest_lengths: (L,) [u2].
        stiffness: (L,) fraction of its stretch that a link removes in each sweep.
    """

    vertices: FloatArray
    masses: FloatArray
    inverse_masses: FloatArray
    links: IntArray
    squared_rest_lengths: FloatArray
    stiffness: FloatArray

    def shares(self) -> FloatArray:
        """(L, 2) fraction of its stretch by which a link moves each of its ends.

        With Bullet's constant c0 = (1/m_a + 1/m_b) / stiffness these are 1 / (m_a c0) and 1 / (m_b c0): only ratios of
        masses matter. Zero where both ends are fixed.
        """
        ends = self.inverse_masses[self.links]
        total = ends.sum(axis=1, keepdims=True)
        shares: FloatArray = np.divide(ends * self.stiffness[:, None], total, out=np.zeros_like(ends), where=total > 0)
        return shares


def soft_body(placed: PlacedOrgan) -> SoftBody:
    """The nodes and links of an organ in a scene.

    Args:
        placed: The organ, with its mass, its pose and the nodes that are held fixed.

    Returns:
        The soft body, at rest in its initial shape.

    Raises:
        ValueError: If two nodes to be linked are too close to each other.
    """
    organ, vertices = placed.organ, placed.vertices
    masses = node_masses(organ, placed.mass)
    inverse_masses = 1.0 / masses
    inverse_masses[np.asarray(placed.fixed_nodes, dtype=np.int64)] = 0.0
    parts = organ_parts(organ)
    ordered = [ordered_links(part.triangles) for part in parts]
    links = np.concatenate([part.nodes[links] for part, (links, _) in zip(parts, ordered, strict=True)])
    links = links.astype(np.int32)
    stiffness = np.concatenate([stiffness for _, stiffness in ordered])
    squared_lengths = ((vertices[links[:, 1]] - vertices[links[:, 0]]) ** 2).sum(axis=1)
    if squared_lengths.min() < SHORTEST_SQUARED:
        a, b = links[np.argmin(squared_lengths)].tolist()
        raise ValueError(f"organ {organ.name!r} must not have nodes as close to each other as nodes {a} and {b}")
    return SoftBody(vertices, masses, inverse_masses, links, squared_lengths, stiffness)


def join(bodies: Sequence[SoftBody]) -> SoftBody:
    """Join several soft bodies into one, with nodes numbered consecutively.

    Args:
        bodies: At least one.

    Returns:
        The soft body. No link connects one part with another.
    """
    starts = np.cumsum([0, *(len(body.vertices) for body in bodies)])
    return SoftBody(
        np.concatenate([body.vertices for body in bodies]),
        np.concatenate([body.masses for body in bodies]),
        np.concatenate([body.inverse_masses for body in bodies]),
        np.concatenate([body.links + start for body, start in zip(bodies, starts, strict=False)]).astype(np.int32),
        np.concatenate([body.squared_rest_lengths for body in bodies]),
        np.concatenate([body.stiffness for body in bodies]),
    )


def node_masses(organ: Organ, mass: float) -> FloatArray:
    """Spread an organ's mass over its nodes by the area of the triangles around each.

    Args:
        organ: The organ.
        mass: Mass of the whole organ [kg].

    Returns:
        (V,) [kg].

    Raises:
        ValueError: If the mass is not positive and finite, or the organ is so far from the origin of its frame that
            triangles vanish in single precision.
    """
    check_positive(mass, "mass")
    areas = vertex_areas(organ.vertices.astype(np.float32).astype(np.float64), organ.triangles)
    if not areas.all():
        raise ValueError(
            f"organ {organ.name!r} must be closer to the origin of its frame: in single precision the triangles around "
            f"node {int(np.argmin(areas))}, at {organ.vertices[int(np.argmin(areas))].tolist()}, have no area"
        )
    masses: FloatArray = areas * (mass / areas.sum())
    return masses


def ordered_links(triangles: NDArray[np.integer]) -> tuple[IntArray, FloatArray]:
    """The links of a surface, in the order in which Bullet processes them.

    Args:
        triangles: (T, 3) node indices.

    Returns:
        The nodes that each link connects (L, 2), and the links' stiffness (L,).
    """
    edges = _edges_as_named(triangles)
    edges = edges[shuffle(len(edges))]
    bending = _pairs_at_distance_two(edges, int(triangles.max()) + 1)
    links = np.concatenate([edges, bending])
    stiffness = np.repeat([EDGE_STIFFNESS, BENDING_STIFFNESS], [len(edges), len(bending)])
    order = shuffle(len(links))
    return links[order].astype(np.int32), stiffness[order]


def shuffle(count: int) -> NDArray[np.int64]:
    """Bullet's shuffle: each element in turn changes places with one that a random number selects.

    Args:
        count: Number of elements.

    Returns:
        (count,) the element at each place afterwards.
    """
    order = list(range(count))
    number = SHUFFLE_SEED
    for place in range(count):
        number = (SHUFFLE_FACTOR * number + SHUFFLE_SUMMAND) % SHUFFLE_MODULUS
        other = number % count
        order[place], order[other] = order[other], order[place]
    return np.array(order, dtype=np.int64)


def _edges_as_named(triangles: NDArray[np.integer]) -> NDArray[np.int64]:
    """Edges (E, 2) in the order in which the triangles first name them: each its last edge, then the others."""
    corners = triangles.astype(np.int64)
    named = np.stack([np.roll(corners, 1, axis=1), corners], axis=2).reshape(-1, 2)
    _, first = np.unique(np.sort(named, axis=1), axis=0, return_index=True)
    edges: NDArray[np.int64] = named[np.sort(first)]
    return edges


def _pairs_at_distance_two(edges: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Pairs (B, 2) of nodes that share a neighbour and no edge: the greater node first, ordered by the smaller one."""
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    start, end = both.T
    degree = np.bincount(start, minlength=count)
    offset = np.concatenate([[0], np.cumsum(degree)])
    # Extend every directed edge to every neighbour of its end.
    branches = degree[end]
    place = np.arange(branches.sum()) - np.repeat(np.cumsum(branches) - branches, branches)
    near, far = np.repeat(start, branches), end[np.repeat(offset[end], branches) + place]
    pairs = np.unique((near * count + far)[near < far])
    pairs = np.setdiff1d(pairs, start * count + end, assume_unique=True)
    smaller, greater = np.divmod(pairs, count)
    return np.column_stack([greater, smaller])
