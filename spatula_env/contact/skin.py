"""The surfaces of all organs of a scene as one triangle mesh in patches, for contact of organs with themselves."""

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
    """The triangle mesh of all organs' surfaces, for kernels; vertices are numbered over all organs.

    Every vertex and every edge belongs to one patch: that of the first triangle that contains it.

    Fields:
        triangles (T, 3): counter-clockwise from outside.
        edges (E, 2).
        faces (E, 2): the triangles beside each edge; -1 where there is none.
        triangle_starts (P + 1,), triangle_order (T,): the triangles sorted by patch, and where each patch's begin.
        edge_starts (P + 1,), edge_order (E,): the same for edges.
        vertex_starts (P + 1,), vertex_order (V,): the same for vertices.
        neighbour_starts (P + 1,), neighbours: patches that share a vertex with each one, itself included, ascending.
        around_starts (V + 1,), around: patches with a triangle at each vertex.
        organs (V,): index of each vertex's organ.
        left_out: sorted names, without a side, of pairs that touch at rest and are excluded from contact.
    """


class Near(structref.StructRefProxy):
    """Pairs of features of one world's organs that are near each other, and what crosses, for kernels.

    Fields:
        vertex_pairs (., 3): a vertex, a triangle, and the side of it that the vertex was held on in the last step:
            1 outside, -1 inside, 0 if it was not held.
        edge_pairs (., 3): two edges, and likewise the side on which they were held.
        cross_pairs (., 2): an edge and a triangle; found only when crossings are looked for.
        vertex_distances, edge_distances, cross_distances (.,): distance of each pair when it was found; for cross pairs
            a lower bound [u].
        patch_pairs (.,): pairs of patches that may meet, as first x P + second, ascending.
        ends (., 3): for each pair of patches, the index after its last vertex pair, edge pair and cross pair.
        cones (P, 4): a cone around the normals of each patch: axis, and half the opening [rad].
        calm (P,): the greatest shift of its vertices at which no triangle of a patch can have turned far [u].
        stirred (P,): whether a vertex of a patch had shifted farther than that when last checked.
        steep (P,): a triangle of a patch has turned far if the cosine of its angle to the cone's axis is below this.
        folded (P,): whether a patch is not flat with all of its neighbours, itself included.
        boxes (P, 6): lower and upper corner of a box around each patch and the reach of its vertices [u].
        counts (7,): numbers of vertex pairs, edge pairs and cross pairs; whether the first two are known, or
            `TOO_MANY`; whether the cross pairs are known, or `ASKED_FOR`; the number of pairs of patches; whether
            `held` is known.
        found_at (3, V): positions of the vertices when the pairs were found [u].
        placed (3, V): those positions, moved by the rigid motion of the organs since [u].
        rotation (3, 3), motion (3,): that motion takes a point x to rotation x + motion [u].
        reach (V,): how far a vertex may get from `placed` before the pairs are to be found anew [u].
        shift (V,): how far each vertex was from `placed` when last measured [u].
        held (V,): squared distance from `placed` to where each vertex comes from [u2].
        spans (4,): the greatest of these shifts; the least of the vertex distances and of the edge distances; the least
            of `calm` [u]. Most of the time comparing these shows at once that nothing has come near and nothing has
            turned.
        vertex_gaps, edge_gaps (.,): distances of pairs at the positions that vertices come from [u]; -1 where they
            have not been measured.
        order (P,): patches sorted by the lower x of their boxes.
        crossing (2,): for how long organs have crossed themselves or each other [s]; in how many places.
        tangled (V,): whether a vertex belongs to features that cross.
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
"""Value of `counts[IS_KNOWN]`: an organ is so crumpled that there are too many pairs, and none are kept."""

ASKED_FOR = 2
"""Value of `counts[CROSS_IS_KNOWN]`: the cross pairs are known, and have been used since the near pairs were found."""

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
    """Make a `Near` for a `Skin`, with no pairs known yet."""
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
    """Forget the near pairs, so that they are found anew, and that anything crossed."""
    near.counts[:] = 0
    near.crossing[:] = 0.0
    near.tangled[:] = False


@kernel(types.Tuple((ARRAYS["f8_2"], ARRAYS["f8"], ARRAYS["f8_2"], ARRAYS["i8"], types.boolean))(NEAR))
def copy_near(near: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, bool]:
    """Copy the arguments with which `near.find_as_before` finds the same pairs again; and whether pairs are known."""
    known = near.counts[IS_KNOWN] == 1
    return near.found_at.copy(), near.reach.copy(), near.cones.copy(), near.patch_pairs.copy(), known


@kernel(types.float64(NEAR))
def crossed_for(near: Any) -> float:
    """For how long organs have crossed [s]."""
    duration: float = near.crossing[CROSSED_FOR]
    return duration


@kernel(types.void(NEAR, types.float64))
def set_crossed_for(near: Any, duration: float) -> None:
    """Set for how long organs have crossed [s]."""
    near.crossing[CROSSED_FOR] = duration


def make_skin(surfaces: Sequence[IntArray], vertex_counts: Sequence[int]) -> Any:
    """Make a `Skin` of some organs' surfaces.

    Args:
        surfaces: Triangles (T, 3) of each organ, with indices into its own vertices.
        vertex_counts: Number of vertices of each organ.
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
            # Where the surface is not a manifold, further triangles beside an edge are ignored.
            place = 0 if faces[edge, 0] < 0 else 1
            if faces[edge, place] < 0:
                faces[edge, place] = triangle
    return np.ascontiguousarray(edges, dtype=np.int32), faces, edges_of


def _patches(triangles: IntArray, faces: IntArray, edges_of: NDArray[np.int64]) -> NDArray[np.int64]:
    """The patch of each triangle (T,): neighbouring triangles, added breadth first so that patches are roundish."""
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
    """Where each patch's members begin (P + 1,), and members sorted by patch; those without a patch are left out."""
    order = np.argsort(patch_of, kind="stable")
    order = order[np.searchsorted(patch_of[order], 0) :]
    starts = np.searchsorted(patch_of[order], np.arange(count + 1))
    return starts.astype(np.int32), order.astype(np.int32)
