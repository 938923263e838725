"""Pieces of an organ with a flat base: one with a fissure to enter and open, one with a ridge to grip and lift.

Both stand on the plane z = 0, centred on the z axis, and their fissure or ridge runs along x. Both are their own mirror
images in the plane y = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from spatula_env.arrays import BoolArray, FloatArray, Int32Array
from spatula_env.geometry.checks import check_positive
from spatula_env.geometry.meshes import Organ
from spatula_env.geometry.rings import Loft, loft
from spatula_env.geometry.transforms import as_vector3

SHOULDER = 2.5
"""Exponent of the superellipse that forms the profile of the top and the sides: a flat top with a round shoulder."""

SAMPLES = 96
"""Points on each part of a profile, except that of top and sides, which has four times as many."""

LEAN_OF_DEPTH, LEAN_OF_LENGTH = 0.25, 0.1
"""From its floor to its lips each end of a fissure leans outwards by the lesser of these parts of its depth and of its
length, so that a fissure ends in a slope, not in a shaft."""

BASE_LINE = 0.25
"""Least length of the line in the middle of the base, to which the rings shrink, as a part of the block's length."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FissuredBlock(Organ):
    """A rounded block with a fissure in its top, as made by :func:`fissured_block`.

    Every node is in at most one of ``base``, ``walls``, ``lips`` and ``floor``; a node in none of them is on the outer
    surface or in the plane y = 0 at an end of the fissure. Indices are in ascending order.

    Attributes:
        base: Nodes of the flat base with its rim, int32.
        walls: Nodes of the two walls between floor and lips, at negative y and at positive y, int32.
        lips: Nodes of the rounded edges between walls and top, at negative y and at positive y, int32.
        floor: Nodes of the rounded floor, int32.
        target: Triangles at the middle of the floor, int32.
        floor_height: z of the lowest line of the floor [u].
    """

    base: Int32Array = field(repr=False)
    walls: tuple[Int32Array, Int32Array] = field(repr=False)
    lips: tuple[Int32Array, Int32Array] = field(repr=False)
    floor: Int32Array = field(repr=False)
    target: Int32Array = field(repr=False)
    floor_height: float


@dataclass(frozen=True, eq=False, kw_only=True)
class RidgedBlock(Organ):
    """A rounded block with a ridge on its top, as made by :func:`ridged_block`.

    Indices are in ascending order.

    Attributes:
        base: Nodes of the flat base with its rim, int32.
        flanks: Nodes of the two sides of the ridge between crest and foot, at negative y and at positive y, int32.
        crest: Nodes of the rounded top of the ridge, int32.
        foot_height: z of the top around the ridge [u].
    """

    base: Int32Array = field(repr=False)
    flanks: tuple[Int32Array, Int32Array] = field(repr=False)
    crest: Int32Array = field(repr=False)
    foot_height: float


def fissured_block(
    size: ArrayLike = (6.0, 5.0, 3.0),
    depth: float = 1.6,
    length: float = 3.0,
    width: float = 0.25,
    edge_length: float = 0.25,
    *,
    lip: float = 0.2,
    base_edge_length: float | None = None,
    target_length: float = 0.6,
    name: str = "fissured block",
) -> FissuredBlock:
    """A piece of an organ with a deep, narrow fissure in its top, as between two folds of a brain.

    Seen from above, block and fissure are rounded rectangles, so that the walls are nearly parallel. The fissure's
    floor is a half circle in cross-section, its ends lean slightly outwards on the way up, and rounded lips lead over
    to the top. The walls may be arbitrarily close: where the floor is narrower than its triangles are long, it becomes
    a line on which both walls stand.

    Args:
        size: Extents of the block along x, y and z, shape (3,) [u].
        depth: Distance of the lowest line of the floor from the top [u].
        length: Length of the fissure along x, below the lips [u].
        width: Distance between the walls at the middle of the fissure [u].
        edge_length: Target length of the triangles' edges [u].
        lip: Radius of the lips [u].
        base_edge_length: If given, edges grow from the lips to this length at the base, where little moves [u].
        target_length: Length of the target on the floor [u].
        name: Name of the organ.

    Returns:
        The organ.

    Raises:
        ValueError: If a length is not positive and finite, the fissure does not fit into the block, the lips and the
            round floor do not fit into the fissure, or there would be very many nodes.
    """
    extent = _as_size(size)
    for key, value in (("depth", depth), ("length", length), ("width", width), ("edge_length", edge_length)):
        check_positive(value, key)
    check_positive(lip, "lip")
    check_positive(target_length, "target_length")
    _check_less(depth, "depth", float(extent[2]), "the height of the block")
    _check_less(length + 2.0 * lip, "length and twice lip", float(extent[0]), "the length of the block")
    _check_less(width + 2.0 * lip, "width and twice lip", float(extent[1]), "the width of the block")
    _check_less(0.5 * width + lip, "half width and lip", depth, "depth")
    _check_less(width, "width", length, "length")
    bottom, radius = float(extent[2]) - depth, 0.5 * width
    wall_bottom, wall_top = bottom + radius, float(extent[2]) - lip
    lean = min(LEAN_OF_DEPTH * depth, LEAN_OF_LENGTH * length)

    quarter = np.linspace(0.0, 0.5 * np.pi, SAMPLES)
    straight = np.linspace(0.0, 1.0, SAMPLES)
    heights = np.concatenate(
        [bottom + radius * (1.0 - np.cos(quarter)), wall_bottom + (wall_top - wall_bottom) * straight[1:]]
    )
    half_widths = np.concatenate([radius * np.sin(quarter), np.full(SAMPLES - 1, radius)])
    # An elliptic slope, upright where it meets the lips.
    rise = (heights - bottom) / (wall_top - bottom)
    half_lengths = 0.5 * length - lean * (1.0 - np.sqrt(1.0 - (1.0 - rise) ** 2))
    inside = np.column_stack([half_lengths, half_widths, heights])
    rounding = lip * np.column_stack([1.0 - np.cos(quarter), 1.0 - np.cos(quarter), np.sin(quarter)])
    inside = np.concatenate([inside, inside[-1] + rounding[1:]])
    surface = _complete(inside, extent, edge_length, base_edge_length)

    vertices, row = surface.vertices, surface.profile_index
    # The floor has the first SAMPLES points of the profile; wall and lip each share a point with the part before.
    floor_end, wall_end, lip_end = SAMPLES - 1, 2 * SAMPLES - 2, 3 * SAMPLES - 3
    floor_row = row <= floor_end
    wall_row, lip_row = ~floor_row & (row < wall_end), (row >= wall_end) & (row <= lip_end)
    sides = [vertices[:, 1] < 0.0, vertices[:, 1] > 0.0]
    # The target's triangles stand on the lowest line, which is the first row.
    on_line = (row == 0.0)[surface.triangles].any(axis=1)
    distance = np.abs(vertices[surface.triangles].mean(axis=1)[:, 0])
    near = on_line & (distance <= max(0.5 * target_length, float(distance[on_line].min())))
    return FissuredBlock(
        vertices=vertices,
        triangles=surface.triangles,
        name=name,
        base=_indices(vertices[:, 2] == 0.0),
        walls=(_indices(wall_row & sides[0]), _indices(wall_row & sides[1])),
        lips=(_indices(lip_row & sides[0]), _indices(lip_row & sides[1])),
        floor=_indices(floor_row),
        target=_indices(near),
        floor_height=bottom,
    )


def ridged_block(
    size: ArrayLike = (4.0, 3.2, 1.2),
    height: float = 1.3,
    length: float = 2.0,
    width: float = 0.8,
    edge_length: float = 0.25,
    *,
    fillet: float = 0.25,
    base_edge_length: float | None = None,
    name: str = "ridged block",
) -> RidgedBlock:
    """A piece of an organ with a ridge on its top that two jaws can grip, like one fold of a brain.

    Seen from above, block and ridge are rounded rectangles, so that the flanks of the ridge are nearly parallel. The
    crest is a half circle in cross-section, and a fillet leads from the foot of the ridge over to the top of the block.

    Args:
        size: Extents of the block along x, y and z, without the ridge, shape (3,) [u].
        height: Height of the ridge above the block [u].
        length: Length of the ridge along x [u].
        width: Width of the ridge along y [u].
        edge_length: Target length of the triangles' edges [u].
        fillet: Radius of the fillet [u].
        base_edge_length: If given, edges grow from the ridge's foot to this length at the base, where little moves [u].
        name: Name of the organ.

    Returns:
        The organ.

    Raises:
        ValueError: If a length is not positive and finite, the ridge does not fit onto the block, its crest and the
            fillet do not fit into its height, or there would be very many nodes.
    """
    extent = _as_size(size)
    for key, value in (("height", height), ("length", length), ("width", width), ("edge_length", edge_length)):
        check_positive(value, key)
    check_positive(fillet, "fillet")
    _check_less(length + 2.0 * fillet, "length and twice fillet", float(extent[0]), "the length of the block")
    _check_less(width + 2.0 * fillet, "width and twice fillet", float(extent[1]), "the width of the block")
    _check_less(0.5 * width + fillet, "half width and fillet", height, "height")
    _check_less(width, "width", length, "length")
    foot, radius = float(extent[2]), 0.5 * width
    start = np.array([0.5 * length - radius, 0.0, foot + height])

    quarter = np.linspace(0.0, 0.5 * np.pi, SAMPLES)
    crest = start + radius * np.column_stack([np.sin(quarter), np.sin(quarter), np.cos(quarter) - 1.0])
    drop = np.linspace(0.0, height - radius - fillet, SAMPLES)
    flank = crest[-1] - drop[:, None] * np.array([0.0, 0.0, 1.0])
    rounding = fillet * np.column_stack([1.0 - np.cos(quarter), 1.0 - np.cos(quarter), -np.sin(quarter)])
    outside = np.concatenate([crest, flank[1:], flank[-1] + rounding[1:]])
    surface = _complete(outside, extent, edge_length, base_edge_length)

    vertices, row = surface.vertices, surface.profile_index
    crest_row = row <= SAMPLES - 1
    flank_row = ~crest_row & (row <= 2 * SAMPLES - 2)
    return RidgedBlock(
        vertices=vertices,
        triangles=surface.triangles,
        name=name,
        base=_indices(vertices[:, 2] == 0.0),
        flanks=(_indices(flank_row & (vertices[:, 1] < 0.0)), _indices(flank_row & (vertices[:, 1] > 0.0))),
        crest=_indices(crest_row),
        foot_height=foot,
    )


def _complete(start: FloatArray, extent: FloatArray, edge_length: float, base_edge_length: float | None) -> Loft:
    """Complete a profile (m, 3) by the top, the sides and the base of a block, and loft the surface through its rings.

    The given profile must end horizontally, at the height of the top. The nodes' ``profile_index`` counts its points
    first.
    """
    if base_edge_length is not None:
        check_positive(base_edge_length, "base_edge_length")
    half_length, half_width, height = 0.5 * extent[0], 0.5 * extent[1], extent[2]
    angle = np.linspace(0.0, 0.5 * np.pi, 4 * SAMPLES)[1:]
    outwards, upwards = np.sin(angle) ** (2.0 / SHOULDER), np.cos(angle) ** (2.0 / SHOULDER)
    upwards[-1] = 0.0
    side = np.column_stack(
        [
            start[-1, 0] + (half_length - start[-1, 0]) * outwards,
            start[-1, 1] + (half_width - start[-1, 1]) * outwards,
            height * upwards,
        ]
    )
    # The rings of the base shrink to a line whose ends are about as far from the rim as its sides are.
    line = max(half_length - half_width, BASE_LINE * half_length)
    inwards = np.linspace(0.0, 1.0, SAMPLES)[1:]
    base = np.column_stack(
        [half_length + (line - half_length) * inwards, half_width * (1.0 - inwards), np.zeros(len(inwards))]
    )
    profile = np.concatenate([start, side, base])
    rim = len(start) + len(side) - 1
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))])
    part = np.clip((way - way[len(start) - 1]) / (way[rim] - way[len(start) - 1]), 0.0, 1.0)
    last = edge_length if base_edge_length is None else base_edge_length
    edge_lengths = edge_length + (last - edge_length) * part
    return _lofted(profile.tobytes(), edge_lengths.tobytes(), rim)


@lru_cache(maxsize=8)
def _lofted(profile: bytes, edge_lengths: bytes, rim: int) -> Loft:
    """Cached `loft`, with arrays given by their bytes: scenes are made repeatedly from the same few blocks."""
    surface = loft(np.frombuffer(profile).reshape(-1, 3), np.frombuffer(edge_lengths), (rim,))
    for array in (surface.vertices, surface.triangles, surface.profile_index):
        array.setflags(write=False)
    return surface


def _as_size(size: ArrayLike) -> FloatArray:
    extent = as_vector3(size, "size")
    for axis, value in enumerate(extent.tolist()):
        check_positive(value, f"size[{axis}]")
    return extent


def _check_less(value: float, name: str, limit: float, what: str) -> None:
    if not value < limit:
        raise ValueError(f"{name} must be less than {what} ({limit:g}), got {value:g}")


def _indices(members: BoolArray) -> Int32Array:
    """Indices at which an array is true, as a read-only array."""
    indices = np.flatnonzero(members).astype(np.int32)
    indices.setflags(write=False)
    return indices
