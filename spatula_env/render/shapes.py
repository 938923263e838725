"""Ready-made meshes: spheres, boxes, arrows, rings and tubes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spatula_env.geometry.checks import check_positive
from spatula_env.geometry.meshes import Organ, icosphere
from spatula_env.geometry.transforms import as_quaternion, as_vector3, rotation_matrix
from spatula_env.render.palette import FORCE, GOAL, STEEL, Color
from spatula_env.render.primitives import BRUSHED_STEEL, Material, Mesh, perpendicular_axes

if TYPE_CHECKING:
    from typing_extensions import Unpack


class Look(TypedDict, total=False):
    """How a mesh looks; omitted entries have the default of the kind of mesh.

    Attributes:
        color: of the surface.
        opacity: 0..1.
        material: of the surface.
        casts_shadow: onto the ground and other meshes.
    """

    color: Color
    opacity: float
    material: Material
    casts_shadow: bool


def sphere_mesh(
    centers: ArrayLike,
    radius: float,
    *,
    colors: ArrayLike | None = None,
    subdivisions: int = 2,
    **look: Unpack[Look],
) -> Mesh:
    """One sphere or many equal ones, such as markers of contact nodes.

    Args:
        centers: u (3,) or (N, 3).
        radius: u, above zero.
        colors: (N, 3), one for each sphere, instead of one colour for all.
        subdivisions: 0..4 splits of an icosahedron, 20 * 4**subdivisions triangles each.
        **look: see `Look`.

    Returns:
        One mesh.

    Raises:
        ValueError: if an argument is out of its range.
    """
    check_positive(radius, "radius")
    if not 0 <= subdivisions <= 4:
        raise ValueError(f"subdivisions must be in 0..4, got {subdivisions}")
    middles = np.atleast_2d(np.asarray(centers, dtype=np.float64))
    if middles.shape[-1:] != (3,) or middles.ndim != 2:
        raise ValueError(f"centers must have the shape (3,) or (N, 3), got {np.shape(centers)}")
    sphere = _unit_sphere(subdivisions)
    unit, faces = sphere.vertices, sphere.triangles
    vertices = (middles[:, None, :] + radius * unit).reshape(-1, 3)
    triangles = (faces + len(unit) * np.arange(len(middles))[:, None, None]).reshape(-1, 3)
    vertex_colors = None
    if colors is not None:
        shades = np.asarray(colors, dtype=np.float64)
        if shades.shape != middles.shape:
            raise ValueError(f"colors must have the shape {middles.shape}, got {shades.shape}")
        vertex_colors = np.repeat(shades, len(unit), axis=0)
    seen: Look = {"color": GOAL, **look}
    return Mesh(vertices, triangles.astype(np.int32), vertex_colors=vertex_colors, **seen)


def box_mesh(
    size: ArrayLike,
    position: ArrayLike = (0.0, 0.0, 0.0),
    orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
    *,
    bevel: float = 0.0,
    **look: Unpack[Look],
) -> Mesh:
    """A box, such as the spatula.

    Args:
        size: edge lengths, u (3,), above zero.
        position: of its centre, u (3,).
        orientation: unit quaternion (x, y, z, w).
        bevel: width by which edges and corners are cut at 45 degrees, u; at most half the shortest edge.
        **look: see `Look`; brush marks run along the box's x axis.

    Returns:
        A flat-shaded mesh of 12 triangles, or of 44 with a bevel.

    Raises:
        ValueError: if an argument is out of its range.
    """
    half = 0.5 * as_vector3(size, "size")
    if not bool(np.all(half > 0.0)):
        raise ValueError(f"size must be above zero, got {size!r}")
    if not 0.0 <= bevel <= float(half.min()):
        raise ValueError(f"bevel must be in 0..{half.min()} (half the shortest edge), got {bevel}")
    if bevel > 0.0:
        corners, triangles = _bevelled_box()
        # A corner's vertex on the face of axis k keeps its whole length along k and loses the bevel elsewhere.
        on_face = np.tile(np.eye(3), (8, 1))
        local = corners * (half - bevel * (1.0 - on_face))
    else:
        corners, triangles = _plain_box()
        local = corners * half
    vertices = as_vector3(position, "position") + local @ quaternion_matrix(orientation).T
    seen: Look = {"color": STEEL, "material": BRUSHED_STEEL, **look}
    return Mesh(vertices, triangles, smooth=False, texture=local, **seen)


def arrow_mesh(
    start: ArrayLike,
    vector: ArrayLike,
    *,
    width: float = 0.12,
    sides: int = 24,
    **look: Unpack[Look],
) -> Mesh:
    """An arrow, such as a force.

    Args:
        start: of the shaft, u (3,).
        vector: from the start to the tip, u (3,). A zero vector gives a mesh without triangles.
        width: of the shaft, u, above zero. The head is 2.4 times as wide; a short arrow is all head.
        sides: around the shaft, 3 or more.
        **look: see `Look`.

    Returns:
        A closed mesh.

    Raises:
        ValueError: if an argument is out of its range.
    """
    check_positive(width, "width")
    _check_sides(sides)
    foot = as_vector3(start, "start")
    along = as_vector3(vector, "vector")
    length = float(np.linalg.norm(along))
    seen: Look = {"color": FORCE, **look}
    if length < 1e-9:
        return Mesh(foot[None], np.zeros((0, 3), dtype=np.int32), **seen)
    head = 1.2 * width
    tip = min(3.2 * width, length)
    # A head that does not fit is made smaller as a whole, so that a small force is a small arrow.
    scale = tip / (3.2 * width)
    shaft, head = 0.5 * width * scale, head * scale
    profile = [(0.0, 0.0), (shaft, 0.0), (shaft, length - tip), (head, length - tip), (0.0, length)]
    vertices, triangles = _revolve(profile, sides)
    return Mesh(foot + vertices @ np.stack(perpendicular_axes(along)), triangles, **seen)


def ring_mesh(
    center: ArrayLike,
    radius: float,
    normal: ArrayLike = (0.0, 0.0, 1.0),
    *,
    width: float = 0.08,
    sides: int = 48,
    **look: Unpack[Look],
) -> Mesh:
    """A torus, such as the ring around a goal.

    Args:
        center: u (3,).
        radius: of the tube's middle line, u, above zero.
        normal: of its plane (3,), any length but zero.
        width: of the tube, u, above zero and below twice the radius.
        sides: around the ring, 3 or more.
        **look: see `Look`.

    Returns:
        A closed mesh.

    Raises:
        ValueError: if an argument is out of its range.
    """
    check_positive(radius, "radius")
    _check_sides(sides)
    if not 0.0 < width < 2.0 * radius:
        raise ValueError(f"width must be above zero and below twice the radius, got {width}")
    around = 10
    turn = 2.0 * np.pi * np.arange(sides)[:, None] / sides
    roll = 2.0 * np.pi * np.arange(around)[None, :] / around
    reach = radius + 0.5 * width * np.cos(roll)
    vertices = np.stack(
        [reach * np.cos(turn), reach * np.sin(turn), 0.5 * width * np.sin(roll) + 0.0 * turn], axis=-1
    ).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(sides), np.arange(around), indexing="ij")
    i_next, j_next = (i + 1) % sides, (j + 1) % around
    a, b = i * around + j, i_next * around + j
    c, d = i_next * around + j_next, i * around + j_next
    vertices = as_vector3(center, "center") + vertices @ np.stack(perpendicular_axes(normal))
    seen: Look = {"color": GOAL, **look}
    return Mesh(vertices, _split(a, b, c, d), **seen)


def tube_mesh(
    points: ArrayLike,
    *,
    width: float = 0.05,
    sides: int = 8,
    **look: Unpack[Look],
) -> Mesh:
    """A tube from point to point, such as a path. Its ends are open, and usually it casts no shadow.

    Args:
        points: u (P, 3); equal neighbours are taken for one point. Fewer than two give a mesh without triangles.
        width: of the tube, u, above zero.
        sides: around it, 3 or more.
        **look: see `Look`.

    Returns:
        An open mesh.

    Raises:
        ValueError: if an argument is out of its range.
    """
    check_positive(width, "width")
    _check_sides(sides)
    line = np.asarray(points, dtype=np.float64)
    if line.ndim != 2 or line.shape[1] != 3:
        raise ValueError(f"points must have the shape (P, 3), got {line.shape}")
    steps = np.diff(line, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    line = line[np.concatenate([[True], lengths > 1e-9])] if len(line) else line
    seen: Look = {"color": GOAL, "casts_shadow": False, **look}
    if len(line) < 2:
        return Mesh(np.zeros((1, 3)), np.zeros((0, 3), dtype=np.int32), **seen)
    directions = (steps / np.maximum(lengths, 1e-300)[:, None])[lengths > 1e-9]
    along = np.concatenate([directions[:1], directions[1:] + directions[:-1], directions[-1:]])
    # The axis along which the tube runs least.
    helper = np.eye(3)[int(np.argmin(np.abs(directions).max(axis=0)))]
    first = np.cross(helper, along) + 1e-9 * np.roll(helper, 1)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(along, first)
    second /= np.maximum(np.linalg.norm(second, axis=1, keepdims=True), 1e-300)
    turn = 2.0 * np.pi * np.arange(sides)[None, :, None] / sides
    rings = line[:, None] + 0.5 * width * (np.cos(turn) * first[:, None] + np.sin(turn) * second[:, None])
    i, j = np.meshgrid(np.arange(len(line) - 1), np.arange(sides), indexing="ij")
    a, b = i * sides + j, i * sides + (j + 1) % sides
    c, d = b + sides, a + sides
    return Mesh(rings.reshape(-1, 3), _split(a, b, c, d), **seen)


def quaternion_matrix(orientation: ArrayLike) -> NDArray[np.float64]:
    """The rotation matrix (3, 3) of a unit quaternion (x, y, z, w)."""
    return rotation_matrix(as_quaternion(orientation, "orientation"))


@cache
def _unit_sphere(subdivisions: int) -> Organ:
    """An icosphere of radius 1."""
    return icosphere(1.0, subdivisions)


@cache
def _plain_box() -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Corner signs (8, 3) and outward triangles (12, 3) of a box."""
    corners = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    return corners, _wind_outwards(corners, _box_faces(corners))


@cache
def _bevelled_box() -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Corner signs (24, 3), three vertices per corner, and outward triangles (44, 3) of a bevelled box.

    Vertex 3 c + k is that of corner c on the face across axis k.
    """
    corners, _ = _plain_box()
    signs = np.repeat(corners, 3, axis=0)
    rows = [(3 * c, 3 * c + 1, 3 * c + 2) for c in range(8)]
    # The faces themselves: the triangles of the plain box, with the vertices of each face.
    for a, b, c in _box_faces(corners).tolist():
        same = (corners[a] == corners[b]) & (corners[b] == corners[c])
        k = int(np.argmax(same))
        rows.append((3 * a + k, 3 * b + k, 3 * c + k))
    # One strip along each edge, between its two faces.
    for a in range(8):
        for b in range(a + 1, 8):
            differs = corners[a] != corners[b]
            if differs.sum() == 1:
                k, m = (int(axis) for axis in np.flatnonzero(~differs))
                rows += [(3 * a + k, 3 * b + k, 3 * b + m), (3 * a + k, 3 * b + m, 3 * a + m)]
    # Winding is decided on a box with a real bevel.
    inset = signs * (1.0 - 0.25 * (1.0 - np.tile(np.eye(3), (8, 1))))
    return signs, _wind_outwards(inset, np.array(rows, dtype=np.int32))


def _box_faces(corners: NDArray[np.float64]) -> NDArray[np.int32]:
    rows = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            a, b, c, d = np.flatnonzero(corners[:, axis] == side).tolist()
            # In this order a and d lie opposite each other.
            rows += [(a, b, d), (a, d, c)]
    return np.array(rows, dtype=np.int32)


def _wind_outwards(vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """Orient the triangles of a body that is star-shaped about the origin counter-clockwise from outside."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0.0
    result = triangles.copy()
    result[inwards] = result[inwards][:, ::-1]
    return result


def _split(a: NDArray[np.int_], b: NDArray[np.int_], c: NDArray[np.int_], d: NDArray[np.int_]) -> NDArray[np.int32]:
    """Two triangles (2 K, 3) for each of K quadrilaterals with these corners, of any shape but all of one."""
    halves = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])
    return halves.reshape(-1, 3).astype(np.int32)


def _revolve(profile: Sequence[tuple[float, float]], sides: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Revolve a profile of (radius, height) about the z axis.

    Each piece has vertices of its own, so its ends stay sharp under smooth shading. For a profile that goes up, the
    outside is away from the axis.
    """
    angle = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    here = np.arange(sides)
    after = (here + 1) % sides
    vertices, triangles, start = [], [], 0
    for (r0, z0), (r1, z1) in pairwise(profile):
        for radius, height in ((r0, z0), (r1, z1)):
            vertices.append(np.column_stack([radius * circle, np.full(sides, height)]))
        low, high = start + here, start + sides + here
        low_next, high_next = start + after, start + sides + after
        # At the axis one of the two triangles of a side has no area.
        if r0 > 0.0:
            triangles.append(np.stack([low, low_next, high_next if r1 > 0.0 else high], axis=1))
        if r1 > 0.0:
            triangles.append(np.stack([low, high_next, high], axis=1))
        start += 2 * sides
    return np.concatenate(vertices), np.concatenate(triangles).astype(np.int32)


def _check_sides(sides: int) -> None:
    if sides < 3:
        raise ValueError(f"sides must be 3 or more, got {sides}")
