"""Contact pressure on the organ as filled contours, made of separate meshes as viser's meshes have one colour each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spatula_env.render.palette import PRESSURE_LIMITS
from spatula_env.teleop.device import FloatArray

IntArray = NDArray[np.int32]

LEVELS = (150.0, 500.0, 1000.0, 1500.0, 2100.0, PRESSURE_LIMITS[0], 3300.0, PRESSURE_LIMITS[1], 5500.0, 7500.0)
"""Pressures at which the colour changes [Pa]; they include the limits for warnings."""

REACH = 0.42
"""Distance around a contact node within which the organ is coloured [u]: large, as tools hide what lies under them."""


def pressure_field(
    points: FloatArray, normals: FloatArray, places: FloatArray, out: FloatArray, pressures: FloatArray
) -> FloatArray:
    """Spread the pressure on the contact nodes of a tool over the organ's surface.

    Args:
        points: (V, 3) vertices of the surface [u].
        normals: (V, 3) outward normals.
        places: (n, 3) contact nodes [u].
        out: (n, 3) outward normals of the nodes' faces.
        pressures: (n,) [Pa].

    Returns:
        (V,) [Pa].
    """
    field = np.zeros(len(points))
    pressing = np.flatnonzero(pressures > 0.2 * LEVELS[0])
    if len(pressing) == 0:
        return field
    places, out, pressures = places[pressing], out[pressing], pressures[pressing]
    low, high = places.min(axis=0) - REACH, places.max(axis=0) + REACH
    near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    if len(near) == 0:
        return field
    away = ((points[near, None] - places) ** 2).sum(axis=2) / REACH**2
    # Colour the wall that faces the pressing tool face; not another wall nearby.
    facing = np.clip(0.3 - 2.0 * (normals[near] @ out.T), 0.0, 1.0)
    field[near] = (np.maximum(1.0 - away, 0.0) * facing * pressures).max(axis=1)
    return field


def split_at_levels(
    points: FloatArray, triangles: IntArray, values: FloatArray, levels: tuple[float, ...]
) -> tuple[FloatArray, IntArray, NDArray[np.intp]]:
    """Cut triangles along the level lines of a piecewise linear function.

    Args:
        points: (V, k) vertices.
        triangles: (T, 3).
        values: (V,) values at the vertices.
        levels: Levels in ascending order.

    Returns:
        Vertices (V', k), starting with the given ones; triangles (T', 3), with the same winding; and the number of
        levels below each triangle (T',).
    """
    points, values = np.asarray(points, dtype=np.float64), np.asarray(values, dtype=np.float64)
    triangles = np.asarray(triangles, dtype=np.int32).reshape(-1, 3)
    for level in levels:
        above = values >= level
        corners = above[triangles]
        number = corners.sum(axis=1)
        cut = np.flatnonzero((number == 1) | (number == 2))
        if len(cut) == 0:
            continue
        # One corner is alone on its side of the level: rotate the triangle so that it comes first.
        alone = np.argmax(corners[cut] == (number[cut] == 1)[:, None], axis=1)
        first, second, third = (
            np.take_along_axis(triangles[cut], ((alone + step) % 3)[:, None], axis=1)[:, 0] for step in range(3)
        )
        ends = np.sort(np.stack([np.stack([first, second], 1), np.stack([first, third], 1)]).reshape(-1, 2), axis=1)
        # np.unique sorts one number per edge faster than two.
        names, of_end = np.unique(ends[:, 0].astype(np.int64) * len(points) + ends[:, 1], return_inverse=True)
        edges = np.column_stack(np.divmod(names, len(points)))
        from_value, to_value = values[edges[:, 0]], values[edges[:, 1]]
        part = ((level - from_value) / (to_value - from_value))[:, None]
        new = len(points) + of_end.reshape(2, -1)
        to_second, to_third = new.astype(np.int32)
        points = np.concatenate([points, (1.0 - part) * points[edges[:, 0]] + part * points[edges[:, 1]]])
        values = np.concatenate([values, np.full(len(edges), level)])
        pieces = [(first, to_second, to_third), (to_second, second, third), (to_second, third, to_third)]
        whole = np.delete(triangles, cut, axis=0)
        triangles = np.concatenate([whole, *(np.stack(piece, axis=1) for piece in pieces)]).astype(np.int32)
    # Classify by the mean value, which lies clearly on one side of each level.
    band = np.searchsorted(np.array(levels), values[triangles].mean(axis=1), side="right")
    return points, triangles, band


def pressure_contours(
    points: FloatArray, normals: FloatArray, triangles: IntArray, field: FloatArray, lift: float
) -> list[tuple[FloatArray, IntArray] | None]:
    """Split the surface into pieces by pressure.

    Args:
        points: (V, 3) vertices of the surface [u].
        normals: (V, 3) outward normals.
        triangles: (T, 3).
        field: (V,) pressure [Pa].
        lift: Height of the pieces above the surface, which makes them visible [u].

    Returns:
        For each of `LEVELS`, vertices (k, 3) [u] and triangles (m, 3) where the pressure lies between it and the next
        level; None if there is no such place.
    """
    pieces: list[tuple[FloatArray, IntArray] | None] = [None] * len(LEVELS)
    pressed = triangles[(field[triangles] >= LEVELS[0]).any(axis=1)]
    if len(pressed) == 0:
        return pieces
    used, local = np.unique(pressed, return_inverse=True)
    lifted = points[used] + lift * normals[used]
    places, cut, band = split_at_levels(lifted, local.reshape(-1, 3).astype(np.int32), field[used], LEVELS)
    for index in range(len(LEVELS)):
        piece = cut[band == index + 1]
        if len(piece):
            kept, inner = np.unique(piece, return_inverse=True)
            pieces[index] = places[kept], inner.reshape(-1, 3).astype(np.int32)
    return pieces
