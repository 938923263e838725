"""Triangle surfaces: their measures, and the checks an organ must pass.

A surface is an array of vertices (V, 3) [u] and an array of triangles (T, 3) of vertex indices. Seen from
outside, the vertices of every triangle run counter-clockwise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spatula_env.arrays import BoolArray, FloatArray, IndexArray, Int32Array

SMALLEST_TRIANGLES = 4
"""A tetrahedron: no closed surface has fewer triangles."""

ZERO_AREA = 1e-12
"""A triangle is degenerate when its area is at most this fraction of the squared bounding-box diagonal."""

ZERO_VOLUME = 1e-12
"""A surface encloses nothing when its volume is at most this fraction of the cubed bounding-box diagonal."""


def check_surface(
    vertices: ArrayLike,
    triangles: ArrayLike,
    name: str = "organ",
    smallest: float = 1e-3,
    largest: float = 1e3,
) -> tuple[FloatArray, Int32Array]:
    """Check that a triangle surface is closed and wound outwards, as rays and soft bodies need it.

    Nothing is repaired. The surface may have several components. Each must be wound outwards, with a positive
    volume, unless it lies inside another one, where it bounds a cavity and must be wound inwards: the surface
    then encloses every point of space once or not at all. Whether it crosses itself is not checked here, but when
    a simulation is made with it; see :func:`~spatula_env.geometry.crossings.self_crossings`.

    Args:
        vertices: Positions, shape (V, 3) [u].
        triangles: Vertex indices, shape (T, 3), counter-clockwise seen from outside.
        name: What to call the surface in error messages.
        smallest: Least diagonal of the bounding box [u].
        largest: Greatest diagonal of the bounding box [u].

    Returns:
        Copies of the vertices as float64 (V, 3) and of the triangles as int32 (T, 3), in the order given.

    Raises:
        ValueError: If the surface has a defect. The message names the first kind of defect found and how
            often it occurs: wrong shape or type, values that are not finite, indices out of range, too few
            triangles, size out of limits, vertices of no triangle, duplicate vertices, degenerate triangles,
            non-manifold edges, boundary edges, inconsistent winding, no volume, or components turned
            inside-out.
    """
    points, faces = _as_surface(vertices, triangles, name)
    diagonal = _check_size(points, name, smallest, largest)
    _check_vertices(points, faces, name)
    _check_areas(points, faces, name, diagonal)
    _check_edges(faces, name)
    _check_winding(points, faces, name, diagonal)
    return points, faces


def triangle_normals(vertices: FloatArray, triangles: IndexArray) -> FloatArray:
    """Unit normals of the triangles, which point outwards if the surface is wound outwards.

    Args:
        vertices: Positions, shape (V, 3) [u].
        triangles: Vertex indices, shape (T, 3).

    Returns:
        Normals of shape (T, 3); zero for a triangle without area.
    """
    twice_area = _area_vectors(vertices, triangles)
    length = np.linalg.norm(twice_area, axis=1, keepdims=True)
    length[length == 0.0] = 1.0
    normals: FloatArray = twice_area / length
    return normals


def triangle_areas(vertices: FloatArray, triangles: IndexArray) -> FloatArray:
    """Areas of the triangles.

    Args:
        vertices: Positions, shape (V, 3) [u].
        triangles: Vertex indices, shape (T, 3).

    Returns:
        Areas of shape (T,) [u2].
    """
    areas: FloatArray = 0.5 * np.linalg.norm(_area_vectors(vertices, triangles), axis=1)
    return areas


def surface_area(vertices: FloatArray, triangles: IndexArray) -> float:
    """Sum of the areas of the triangles [u2].

    Args:
        vertices: Positions, shape (V, 3) [u].
        triangles: Vertex indices, shape (T, 3).

    Returns:
        The area [u2].
    """
    return float(triangle_areas(vertices, triangles).sum())


def signed_volume(vertices: FloatArray, triangles: IndexArray) -> float:
    """Volume a closed surface encloses, positive when it is wound outwards.

    Args:
        vertices: Positions, shape (V, 3) [u].
        triangles: Vertex indices, shape (T, 3), of a closed surface.

    Returns:
        The volume [u3].
    """
    return float(_volume_shares(vertices, triangles).sum())


def vertex_areas(vertices: FloatArray, triangles: IndexArray) -> FloatArray:
    """Sum of the areas of the triangles around each vertex.

    Every triangle counts in full at each of its three vertices, so the result sums to three times the
    surface's area.

    Args:
        vertices: Positions, shape (V, 3) [u].
        triangles: Vertex indices, shape (T, 3).

    Returns:
        Areas of shape (V,) [u2].
    """
    shares = np.repeat(triangle_areas(vertices, triangles), 3)
    sums: FloatArray = np.bincount(triangles.ravel(), weights=shares, minlength=len(vertices)).astype(np.float64)
    return sums


def edges(triangles: IndexArray) -> Int32Array:
    """Edges of the triangles, each once.

    Args:
        triangles: Vertex indices, shape (T, 3).

    Returns:
        Vertex indices of shape (E, 2), int32, the smaller first in each row and the rows in ascending order.
    """
    return _edge_uses(triangles)[0]


def canonical_order(triangles: IndexArray) -> Int32Array:
    """Order triangles in a way that depends on the surface alone, not on how it was made.

    Args:
        triangles: Vertex indices, shape (T, 3).

    Returns:
        The same triangles with the same winding, shape (T, 3), int32: the smallest index first in each row
        and the rows in ascending order.
    """
    first = np.argmin(triangles, axis=1)[:, None]
    rotated = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    ordered: Int32Array = rotated[np.lexsort(rotated.T[::-1])].astype(np.int32)
    return ordered


def connected_components(triangles: IndexArray) -> Int32Array:
    """Label the triangles by connected component; triangles that share an edge are connected.

    Args:
        triangles: Vertex indices, shape (T, 3).

    Returns:
        Labels of shape (T,), int32, from 0 in the order of each component's first triangle.
    """
    left, right = shared_edges(triangles)
    return label_components(len(triangles), left // 3, right // 3)


def shared_edges(triangles: IndexArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of triangles that meet along an edge.

    A triangle's edges are numbered like the elements of ``triangles.ravel()``: edge ``3 t + k`` runs from
    corner k of triangle t to its next corner.

    Args:
        triangles: Vertex indices, shape (T, 3).

    Returns:
        Two arrays of such numbers, of the same length: at each index two edges between the same two vertices.
        On a closed surface every number appears exactly once.
    """
    keys = _edge_keys(triangles)[0]
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(keys[order[1:]] == keys[order[:-1]])
    return order[same], order[same + 1]


def label_components(count: int, left: IndexArray, right: IndexArray) -> Int32Array:
    """Label the members of a set by which of them are connected, directly or through others.

    Args:
        count: Number of members n.
        left: One member of each connection, shape (m,).
        right: The other member, shape (m,).

    Returns:
        Labels of shape (n,), int32, from 0 in the order of each component's first member.
    """
    label = np.arange(count)
    while True:
        # Connected members take the smaller label; following labels to their end then spreads it over whole
        # chains at once.
        lower = np.minimum(label[left], label[right])
        spread = label.copy()
        for side in (left, right):
            np.minimum.at(spread, label[side], lower)
        while not np.array_equal(spread[spread], spread):
            spread = spread[spread]
        spread = spread[label]
        if np.array_equal(spread, label):
            break
        label = spread
    components: Int32Array = np.unique(label, return_inverse=True)[1].astype(np.int32)
    return components


def winding_numbers(points: FloatArray, vertices: FloatArray, triangles: IndexArray) -> FloatArray:
    """How often a closed surface encloses points: 1 inside, 0 outside, to rounding.

    The solid angles of the triangles are summed (A. van Oosterom and J. Strackee, The solid angle of a plane
    triangle, IEEE Transactions on Biomedical Engineering 30(2), 1983).

    Args:
        points: The points, shape (m, 3) [u]; for a point on the surface itself the result is meaningless.
        vertices: Positions, shape (V, 3) [u].
        triangles: Vertex indices, shape (T, 3), of a closed surface.

    Returns:
        Winding numbers of shape (m,); negative inside a surface that is wound inwards.
    """
    result = np.empty(len(points))
    for index, point in enumerate(points):  # one point at a time bounds the memory at O(T)
        corner = (vertices - point)[triangles]
        a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
        length_a, length_b, length_c = np.linalg.norm(corner, axis=2).T
        numerator = _row_dot(a, np.cross(b, c))
        denominator = (
            length_a * length_b * length_c
            + _row_dot(a, b) * length_c
            + _row_dot(b, c) * length_a
            + _row_dot(c, a) * length_b
        )
        result[index] = 2.0 * np.arctan2(numerator, denominator).sum()
    return result / (4.0 * np.pi)


def _as_surface(vertices: ArrayLike, triangles: ArrayLike, name: str) -> tuple[FloatArray, Int32Array]:
    """Copy a surface into arrays of the right types; raise ValueError if its arrays are not valid."""
    try:
        points = np.array(vertices, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"surface {name!r}: vertices must be an array of numbers of shape (V, 3)") from error
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"surface {name!r}: vertices must have shape (V, 3), got {points.shape}")
    try:
        faces = np.asarray(triangles)
    except ValueError as error:
        raise ValueError(f"surface {name!r}: triangles must be an array of integers of shape (T, 3)") from error
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"surface {name!r}: triangles must have shape (T, 3), got {faces.shape}")
    if len(faces) < SMALLEST_TRIANGLES:
        raise ValueError(
            f"surface {name!r} must have at least {SMALLEST_TRIANGLES} triangles, got {_count(len(faces), 'triangle')}"
        )
    if faces.dtype.kind not in "iu":
        raise ValueError(f"surface {name!r}: triangles must be integers, got {faces.dtype}")

    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        raise ValueError(
            f"surface {name!r} has {_count(bad.sum(), 'vertex', 'vertices')} of {len(points)} not finite, "
            f"first vertex {first}: {points[first].tolist()}"
        )
    bad = ((faces < 0) | (faces >= len(points))).any(axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        raise ValueError(
            f"surface {name!r} has {_count(bad.sum(), 'triangle')} of {len(faces)} with indices outside "
            f"0..{len(points) - 1}, first triangle {first}: {faces[first].tolist()}"
        )
    return points, faces.astype(np.int32)


def _check_size(points: FloatArray, name: str, smallest: float, largest: float) -> float:
    """Check the diagonal of the bounding box and return it [u]."""
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    if not smallest <= diagonal <= largest:
        raise ValueError(
            f"surface {name!r} must be {smallest:g} to {largest:g} u across, "
            f"its bounding box has a diagonal of {diagonal:g} u; scale it"
        )
    return diagonal


def _check_vertices(points: FloatArray, faces: Int32Array, name: str) -> None:
    """Check that every vertex belongs to a triangle and that no two coincide."""
    unused = np.ones(len(points), dtype=bool)
    unused[faces] = False
    if unused.any():
        raise ValueError(
            f"surface {name!r} has {_count(unused.sum(), 'vertex', 'vertices')} of no triangle, "
            f"first vertex {np.argmax(unused)}"
        )
    _, first, inverse = np.unique(points, axis=0, return_index=True, return_inverse=True)
    original = first[inverse.reshape(-1)]
    duplicate = original != np.arange(len(points))
    if duplicate.any():
        index = int(np.argmax(duplicate))
        raise ValueError(
            f"surface {name!r} has {_count(duplicate.sum(), 'duplicate vertex', 'duplicate vertices')}, "
            f"first vertex {index} at the position of vertex {original[index]}"
        )


def _check_areas(points: FloatArray, faces: Int32Array, name: str, diagonal: float) -> None:
    """Check that no triangle repeats a vertex or has no area."""
    repeated = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    flat = triangle_areas(points, faces) <= ZERO_AREA * diagonal**2
    degenerate = repeated | flat
    if degenerate.any():
        first = int(np.argmax(degenerate))
        reason = "repeats a vertex" if repeated[first] else "has no area"
        raise ValueError(
            f"surface {name!r} has {_count(degenerate.sum(), 'degenerate triangle')}, "
            f"first triangle {first}: {faces[first].tolist()} {reason}"
        )


def _check_edges(faces: Int32Array, name: str) -> None:
    """Check that every edge lies in exactly two triangles, which run along it in opposite directions."""
    pairs, uses, forward = _edge_uses(faces)

    def found(bad: BoolArray, what: str) -> str:
        a, b = pairs[np.argmax(bad)].tolist()
        return f"{_count(bad.sum(), what)}, first between vertices {a} and {b}"

    crowded = uses > 2
    if crowded.any():
        raise ValueError(
            f"surface {name!r} is not a manifold: {found(crowded, 'edge')}, shared by more than two triangles"
        )
    boundary = uses == 1
    if boundary.any():
        raise ValueError(f"surface {name!r} is open: {found(boundary, 'boundary edge')}")
    clashing = forward != 1
    if clashing.any():
        raise ValueError(
            f"surface {name!r} is wound inconsistently: {found(clashing, 'edge')}, "
            "along which both triangles run the same way"
        )


def _check_winding(points: FloatArray, faces: Int32Array, name: str, diagonal: float) -> None:
    """Check that the surface encloses a volume, its components wound outwards and its cavities inwards."""
    component = connected_components(faces)
    count = int(component.max()) + 1
    volumes = np.bincount(component, weights=_volume_shares(points, faces), minlength=count)
    hollow = np.abs(volumes) <= ZERO_VOLUME * diagonal**3
    if hollow.any():
        raise ValueError(
            f"surface {name!r} encloses no volume in {hollow.sum()} of {_count(count, 'component')}, "
            f"first with triangle {np.argmax(component == np.argmax(hollow))}"
        )
    if count == 1:
        if volumes[0] < 0.0:
            raise ValueError(f"surface {name!r} is inside-out: signed volume {volumes[0]:.6g} u3; reverse the winding")
        return
    buried = np.array([_is_inside_others(points, faces, component == label) for label in range(count)])
    wrong = (volumes > 0.0) == buried
    if wrong.any():
        label = int(np.argmax(wrong))
        expected = "bounds a cavity and must be wound inwards" if buried[label] else "must be wound outwards"
        raise ValueError(
            f"surface {name!r} has {wrong.sum()} of {_count(count, 'component')} inside-out, "
            f"first with triangle {np.argmax(component == label)}: it {expected}, "
            f"got signed volume {volumes[label]:.6g} u3; reverse its winding"
        )


def _is_inside_others(points: FloatArray, faces: Int32Array, own: BoolArray) -> bool:
    """Whether the triangles ``own`` (T,) lie in the material that the others enclose."""
    corners = np.unique(faces[own])
    # The winding number is meaningless at a vertex where two components touch; the median over a few vertices
    # ignores it.
    sample = corners[np.linspace(0, len(corners) - 1, min(len(corners), 9)).astype(int)]
    return bool(np.median(winding_numbers(points[sample], points, faces[~own])) > 0.5)


def _area_vectors(vertices: FloatArray, triangles: IndexArray) -> FloatArray:
    """Normals of the triangles with lengths of twice their areas, shape (T, 3) [u2]."""
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


def _volume_shares(vertices: FloatArray, triangles: IndexArray) -> FloatArray:
    """Signed volumes of the tetrahedra from the surface's middle to the triangles, shape (T,) [u3]."""
    # Measured from the middle, so that a surface far from the origin loses no digits.
    centred = vertices - vertices.mean(axis=0)
    return _row_dot(centred[triangles[:, 0]], _area_vectors(centred, triangles)) / 6.0


def _row_dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Dot products of the rows of two arrays of shape (m, 3), shape (m,)."""
    products: FloatArray = np.einsum("ij,ij->i", a, b)
    return products


def _edge_keys(triangles: IndexArray) -> tuple[NDArray[np.int64], BoolArray, int]:
    """Keys (3 T,) of the triangles' edges, whether each runs from a smaller to a larger index (3 T,), and the base."""
    start = triangles.astype(np.int64).ravel()
    end = np.roll(triangles.astype(np.int64), -1, axis=1).ravel()
    base = int(start.max(initial=0)) + 1
    return np.minimum(start, end) * base + np.maximum(start, end), start < end, base


def _edge_uses(triangles: IndexArray) -> tuple[Int32Array, NDArray[np.int64], NDArray[np.int64]]:
    """Edges (E, 2), the number of triangles at each (E,), and how many of these run from its first vertex (E,)."""
    keys, upwards, base = _edge_keys(triangles)
    unique, inverse = np.unique(keys, return_inverse=True)
    uses = np.bincount(inverse, minlength=len(unique))
    forward = np.bincount(inverse[upwards], minlength=len(unique))
    return np.column_stack(np.divmod(unique, base)).astype(np.int32), uses, forward


def _count(number: int, singular: str, plural: str | None = None) -> str:
    """Write a number with its noun, such as "1 edge" or "12 edges"."""
    return f"{number} {singular if number == 1 else plural or singular + 's'}"
