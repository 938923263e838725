"""The surfaces of all organs of a scene as one net, divided into patches, for contact of organs with themselves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numba import types
from numba.experimental import structref

from spatula_env._kernels import ARRAYS, kernel

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    IntArray = NDArray[np.int32]

PATCH_SIZE = 8
"""Most triangles in a patch."""


@structref.register
class SkinType(types.StructRef):
    """Numba type of `Skin`."""


@structref.register
class NearType(types.StructRef):
    """Numba type of `Near`."""


class Skin(structref.StructRefProxy):
    """The net of all organs' surfaces, for kernels; vertices are counted over all organs.

    Every vertex and every edge belongs to one patch, that of the first triangle which has it.

    Fields:
        triangles (T, 3): counter-clockwise from outside.
        edges (E, 2).
        faces (E, 2): the triangles beside each edge; -1 where there is none.
        triangle_starts (P + 1,), triangle_order (T,): the triangles of patch after patch.
        edge_starts (P + 1,), edge_order (E,): the edges.
        vertex_starts (P + 1,), vertex_order (V,): the vertices.
        neighbour_starts (P + 1,), neighbours: patches that share a vertex with each one, itself included, ascending.
        around_starts (V + 1,), around: patches with a triangle at each vertex.
        organs (V,): index of each vertex's organ.
        left_out: sorted names, without a side, of pairs that touch at rest.
    """


class Near(structref.StructRefProxy):
    """Which features of one world's organs are near each other, and how long organs have crossed, for kernels.

    Fields:
        vertex_pairs (., 3): a vertex, a triangle, and the side of it that the vertex was held on in the last step:
            1 outside, -1 inside, 0 if it was not held.
        edge_pairs (., 3): two edges, and likewise.
        cross_pairs (., 2): an edge and a triangle; found only when it is asked what crosses.
        vertex_distances, edge_distances, cross_distances (.,): how far apart they were at least when they were found
            [u].
        patch_pairs (.,): pairs of patches that may meet, as first x P + second, ascending.
        ends (., 3): of each pair of patches, the place after its last vertex pair, edge pair and cross pair.
        cones (P, 4): around the normals of each patch: axis, and half the opening [rad].
        calm (P,): where vertices have got no farther than this since they were found, no triangle of a patch has turned
            much [u].
        stirred (P,): whether one of them has, as was last looked at.
        steep (P,): cosine of the angle to its cone's axis from which on a triangle of a patch has turned far.
        folded (P,): whether a patch is not flat with all of its neighbours, itself included.
        boxes (P, 6): around what each patch can reach: lower and upper corner [u].
        counts (7,): how many of each; whether they are known, or `TOO_MANY`; whether the third kind is known, or
            `ASKED_FOR`; how many pairs of patches; whether it is known how far vertices are that are held.
        found_at (3, V): where the vertices were when they were found [u].
        placed (3, V): the same, moved on as the organs have rolled and slid since as a whole [u].
        rotation (3, 3), motion (3,): that motion takes a point x to rotation x + motion [u].
        reach (V,): how far a vertex may get from where it is placed before they are to be found anew [u].
        shift (V,): how far it has got, as was last looked at [u].
        held (V,): how far it was where it comes from, squared [u2].
        spans (4,): the greatest of these shifts; the least distance of any vertex pair and of any edge pair; the least
            that leaves a patch calm [u]. Most of the time they tell at once that nothing has come near and nothing has
            turned.
        vertex_gaps, edge_gaps (.,): how far apart pairs were there [u]; -1 where nobody has asked.
        order (P,): patches by where they begin along x.
        crossing (2,): for how long organs have crossed themselves or each other [s]; in how many places.
        tangled (V,): whether a vertex belongs to what crosses.
        room (10, 9): workspace of `self_contact.gather_organs`.
    """


SKIN_FIELDS = [
    ("triangles", ARRAYS["i4_2"]),
    ("edges", ARRAYS["i4_2"]),
    ("faces", ARRAYS["i4_2"]),
    ("triangle_starts", ARRAYS["i4"]),
    ("triangle_order", ARRAYS["i4"]),
    ("edge_starts", ARRAYS["i4"]),
    ("edge_order", ARRAYS["i4"]),
    ("vertex_starts", ARRAYS["i4"]),
    ("vertex_order", ARRAYS["i4"]),
    ("neighbour_starts", ARRAYS["i4"]),
    ("neighbours", ARRAYS["i4"]),
    ("around_starts", ARRAYS["i4"]),
    ("around", ARRAYS["i4"]),
    ("organs", ARRAYS["i4"]),
    ("left_out", ARRAYS["i8"]),
]
NEAR_FIELDS = [
    ("vertex_pairs", ARRAYS["i4_2"]),
    ("edge_pairs", ARRAYS["i4_2"]),
    ("cross_pairs", ARRAYS["i4_2"]),
    ("vertex_distances", ARRAYS["f8"]),
    ("edge_distances", ARRAYS["f8"]),
    ("cross_distances", ARRAYS["f8"]),
    ("patch_pairs", ARRAYS["i8"]),
    ("ends", ARRAYS["i8_2"]),
    ("cones", ARRAYS["f8_2"]),
    ("calm", ARRAYS["f8"]),
    ("stirred", ARRAYS["b1"]),
    ("steep", ARRAYS["f8"]),
    ("folded", ARRAYS["b1"]),
    ("boxes", ARRAYS["f8_2"]),
    ("counts", ARRAYS["i8"]),
    ("found_at", ARRAYS["f8_2"]),
    ("placed", ARRAYS["f8_2"]),
    ("rotation", ARRAYS["f8_2"]),
    ("motion", ARRAYS["f8"]),
    ("reach", ARRAYS["f8"]),
    ("shift", ARRAYS["f8"]),
    ("held", ARRAYS["f8"]),
    ("spans", ARRAYS["f8"]),
    ("vertex_gaps", ARRAYS["f8"]),
    ("edge_gaps", ARRAYS["f8"]),
    ("order", ARRAYS["i4"]),
    ("crossing", ARRAYS["f8"]),
    ("tangled", ARRAYS["b1"]),
    ("room", ARRAYS["f8_2"]),
]
structref.define_proxy(Skin, SkinType, [name for name, _ in SKIN_FIELDS])
structref.define_proxy(Near, NearType, [name for name, _ in NEAR_FIELDS])
SKIN = SkinType(SKIN_FIELDS)
NEAR = NearType(NEAR_FIELDS)

VERTEX_PAIRS, EDGE_PAIRS, CROSS_PAIRS, IS_KNOWN, CROSS_IS_KNOWN, PATCH_PAIRS, HELD_IS_KNOWN = 0, 1, 2, 3, 4, 5, 6
"""Places in `Near.counts`."""

TOO_MANY = 2
"""In the place of whether they are known: an organ is so crumpled that nobody looks."""

ASKED_FOR = 2
"""In the place of whether the third kind is known: it is, and somebody has asked since what is near was found."""

CROSSED_FOR, CROSSINGS = 0, 1
"""Places in `Near.crossing`."""

FARTHEST, VERTEX_SPAN, EDGE_SPAN, CALM_SPAN = 0, 1, 2, 3
"""Places in `Near.spans`."""


@kernel(SKIN(*[kind for _, kind in SKIN_FIELDS]))
def _make_skin(
    triangles: Any, edges: Any, faces: Any, triangle_starts: Any, triangle_order: Any, edge_starts: Any,
    edge_order: Any, vertex_starts: Any, vertex_order: Any, neighbour_starts: Any, neighbours: Any, around_starts: Any,
    around: Any, organs: Any, left_out: Any,
) -> Any:  # fmt: skip
    return Skin(
        triangles, edges, faces, triangle_starts, triangle_order, edge_starts, edge_order, vertex_starts, vertex_order,
        neighbour_starts, neighbours, around_starts, around, organs, left_out,
    )  # fmt: skip


@kernel(NEAR(SKIN))
def make_near(skin: Any) -> Any:
    """A `Near` for a `Skin`, of which nothing is known yet."""
    vertices, patches = skin.organs.shape[0], skin.neighbour_starts.shape[0] - 1
    return Near(
        np.zeros((0, 3), np.int32), np.zeros((0, 3), np.int32), np.zeros((0, 2), np.int32), np.zeros(0), np.zeros(0),
        np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 3), np.int64), np.zeros((patches, 4)), np.zeros(patches),
        np.zeros(patches, np.bool_), np.zeros(patches), np.zeros(patches, np.bool_), np.zeros((patches, 6)),
        np.zeros(7, np.int64),
        np.zeros((3, vertices)), np.zeros((3, vertices)), np.eye(3), np.zeros(3), np.zeros(vertices),
        np.zeros(vertices), np.zeros(vertices), np.zeros(4), np.zeros(0), np.zeros(0),
        np.arange(patches).astype(np.int32),
        np.zeros(2), np.zeros(vertices, np.bool_), np.zeros((10, 9)),
    )  # fmt: skip


@kernel(types.void(NEAR))
def forget_near(near: Any) -> None:
    """Have what is near found anew, and forget that anything crossed."""
    near.counts[:] = 0
    near.crossing[:] = 0.0
    near.tangled[:] = False


@kernel(types.Tuple((ARRAYS["f8_2"], ARRAYS["f8"], ARRAYS["f8_2"], ARRAYS["i8"], types.boolean))(NEAR))
def copy_near(near: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, bool]:
    """What `near.find_as_before` is to be given to find again what is near; and whether it has been found."""
    known = near.counts[IS_KNOWN] == 1
    return near.found_at.copy(), near.reach.copy(), near.cones.copy(), near.patch_pairs.copy(), known


@kernel(types.float64(NEAR))
def crossed_for(near: Any) -> float:
    """For how long organs have crossed [s]."""
    duration: float = near.crossing[CROSSED_FOR]
    return duration


@kernel(types.void(NEAR, types.float64))
def set_crossed_for(near: Any, duration: float) -> None:
    """Have organs have crossed for so long [s]."""
    near.crossing[CROSSED_FOR] = duration


def make_skin(surfaces: Sequence[IntArray], vertex_counts: Sequence[int]) -> Any:
    """A `Skin` of some organs' surfaces.

    Args:
        surfaces: Triangles (T, 3) of each organ, counting its own vertices.
        vertex_counts: How many vertices each organ has.
    """
    starts = np.cumsum([0, *vertex_counts])
    triangles = np.concatenate([part + start for part, start in zip(surfaces, starts, strict=False)]).astype(np.int32)
    organs = np.repeat(np.arange(len(vertex_counts)), vertex_counts).astype(np.int32)
    edges, faces, edges_of = _edges(triangles)
    patch_of = _patches(triangles, faces, edges_of)
    count = int(patch_of.max()) + 1
    edge_patch, vertex_patch = np.full(len(edges), -1), np.full(int(starts[-1]), -1)
    touched: list[set[int]] = [set() for _ in range(int(starts[-1]))]
    for triangle, patch in enumerate(patch_of.tolist()):
        for edge in edges_of[triangle].tolist():
            edge_patch[edge] = patch if edge_patch[edge] < 0 else edge_patch[edge]
        for vertex in triangles[triangle].tolist():
            vertex_patch[vertex] = patch if vertex_patch[vertex] < 0 else vertex_patch[vertex]
            touched[vertex].add(patch)
    neighbours: list[set[int]] = [{patch} for patch in range(count)]
    for patches in touched:
        for patch in patches:
            neighbours[patch] |= patches
    triangle_starts, triangle_order = _by_patch(patch_of, count)
    edge_starts, edge_order = _by_patch(edge_patch, count)
    vertex_starts, vertex_order = _by_patch(vertex_patch, count)
    return _make_skin(
        triangles,
        edges,
        faces,
        triangle_starts,
        triangle_order,
        edge_starts,
        edge_order,
        vertex_starts,
        vertex_order,
        np.cumsum([0, *map(len, neighbours)]).astype(np.int32),
        np.array([other for row in neighbours for other in sorted(row)], dtype=np.int32),
        np.cumsum([0, *map(len, touched)]).astype(np.int32),
        np.array([patch for patches in touched for patch in sorted(patches)], dtype=np.int32),
        organs,
        np.zeros(0, dtype=np.int64),
    )


def _edges(triangles: IntArray) -> tuple[IntArray, IntArray, NDArray[np.int64]]:
    """Edges (E, 2), the triangles beside each (E, 2), and the three edges of each triangle (T, 3)."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, edge_of = np.unique(sides, axis=0, return_inverse=True)
    edges_of = edge_of.reshape(-1, 3).astype(np.int64)
    faces = np.full((len(edges), 2), -1, dtype=np.int32)
    for triangle, three in enumerate(edges_of.tolist()):
        for edge in three:
            # Where a surface is not a manifold, further triangles beside an edge are of no use here.
            place = 0 if faces[edge, 0] < 0 else 1
            if faces[edge, place] < 0:
                faces[edge, place] = triangle
    return np.ascontiguousarray(edges, dtype=np.int32), faces, edges_of


def _patches(triangles: IntArray, faces: IntArray, edges_of: NDArray[np.int64]) -> NDArray[np.int64]:
    """The patch of each triangle (T,): neighbours, as round as can be had by adding what was found first."""
    patch_of = np.full(len(triangles), -1, dtype=np.int64)
    patch = 0
    for seed in range(len(triangles)):
        if patch_of[seed] >= 0:
            continue
        members, place = [seed], 0
        patch_of[seed] = patch
        while place < len(members) and len(members) < PATCH_SIZE:
            for edge in edges_of[members[place]].tolist():
                for other in faces[edge].tolist():
                    if other >= 0 and patch_of[other] < 0 and len(members) < PATCH_SIZE:
                        patch_of[other] = patch
                        members.append(other)
            place += 1
        patch += 1
    return patch_of


def _by_patch(patch_of: NDArray[np.int64], count: int) -> tuple[IntArray, IntArray]:
    """Where each patch's members begin (P + 1,), and the members of patch after patch; what has none is left out."""
    order = np.argsort(patch_of, kind="stable")
    order = order[np.searchsorted(patch_of[order], 0) :]
    starts = np.searchsorted(patch_of[order], np.arange(count + 1))
    return starts.astype(np.int32), order.astype(np.int32)
