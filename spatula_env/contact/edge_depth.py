"""Depth of a tool's edges in an organ, between the tool's corners.

An edge that cuts into a surface is deeper in the organ than any point of the surface is in the tool: by a factor of up
to the square root of two where two faces meet at a right angle, and by more where the edge is sharper.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from spatula_env._kernels import array_kernel, inline_kernel
from spatula_env.contact.corners import SUNK, encloses, fill_boxes, find_nearest, list_near
from spatula_env.contact.flags import fill_local

EDGES_COUNT_FROM = 1e-3
"""Edges are measured only if the surface is deeper than this in the tool, or a corner in the organ: deeper than contact
leaves it once it has settled. To measure them in every step would take an eighth of a step's time [u]."""

SAMPLES = 8
"""Number of parts into which a stretch of an edge is divided for samples, before the search around the deepest one."""

CLOSING = 0.6180339887498949
"""Part of a bracket that one step of golden-section search leaves."""

PRECISION = 1e-5
"""Length of the bracket at which the search ends: the depth changes by no more than the distance along the edge [u]."""


@array_kernel
def next_crossing(
    local: np.ndarray, triangles: np.ndarray, near: np.ndarray, found: int, start: np.ndarray, end: np.ndarray,
    after: float,
) -> float:  # fmt: skip
    """Find the next place at which a segment goes through a surface.

    Args:
        local: (3, V) vertices [u].
        triangles: (T, 3).
        near: Indices of the triangles to test.
        found: Number of these.
        start: (3,) start of the segment [u].
        end: (3,) end of the segment [u].
        after: Only places beyond this one count, as a fraction of the segment.

    Returns:
        The place as a fraction of the segment; infinity if there is none.
    """
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    least = np.inf
    for k in range(found):
        a, b, c = triangles[near[k], 0], triangles[near[k], 1], triangles[near[k], 2]
        ux, uy, uz = local[0, b] - local[0, a], local[1, b] - local[1, a], local[2, b] - local[2, a]
        vx, vy, vz = local[0, c] - local[0, a], local[1, c] - local[1, a], local[2, c] - local[2, a]
        sx, sy, sz = start[0] - local[0, a], start[1] - local[1, a], start[2] - local[2, a]
        px, py, pz = dy * vz - dz * vy, dz * vx - dx * vz, dx * vy - dy * vx
        determinant = ux * px + uy * py + uz * pz
        if determinant == 0.0:
            continue
        first = (sx * px + sy * py + sz * pz) / determinant
        qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
        second = (dx * qx + dy * qy + dz * qz) / determinant
        if first < 0.0 or second < 0.0 or first + second > 1.0:
            continue
        place = (vx * qx + vy * qy + vz * qz) / determinant
        if after < place <= 1.0 and place < least:
            least = place
    return least


@array_kernel
def signed_distance(
    local: np.ndarray, triangles: np.ndarray, found: int, start: np.ndarray, end: np.ndarray, place: float,
    reach: float, scratch: Any,
) -> float:  # fmt: skip
    """Distance of a point of a segment from a surface; negative if it is behind the nearest triangle [u].

    Args:
        local: (3, V) vertices [u].
        triangles: (T, 3).
        found: Number of triangles in the list `near` of the workspace, with their boxes.
        start: (3,) start of the segment [u].
        end: (3,) end of the segment [u].
        place: Place of the point, as a fraction of the segment.
        reach: If no triangle in the list is within this distance, all triangles are searched [u].
        scratch: `Scratch`.
    """
    nearest, away = scratch.nearest, scratch.away
    x = start[0] + place * (end[0] - start[0])
    y = start[1] + place * (end[1] - start[1])
    z = start[2] + place * (end[2] - start[2])
    t = find_nearest(local, triangles, scratch.near, found, x, y, z, np.inf, scratch.boxes, away, nearest)
    if t < 0 or abs(nearest[0]) > reach:
        fill_boxes(local, triangles, scratch.near, -1, scratch.other_boxes)
        find_nearest(local, triangles, scratch.near, -1, x, y, z, np.inf, scratch.other_boxes, away, nearest)
    distance: float = nearest[0]
    return distance


@array_kernel
def stretch_depth(
    local: np.ndarray, triangles: np.ndarray, found: int, start: np.ndarray, end: np.ndarray, first: float, last: float,
    reach: float, scratch: Any,
) -> float:  # fmt: skip
    """Greatest distance of a stretch of a segment from a surface [u].

    Args:
        local: (3, V) vertices [u].
        triangles: (T, 3).
        found: Number of triangles in the list `near` of the workspace, with their boxes.
        start: (3,) start of the segment [u].
        end: (3,) end of the segment [u].
        first: Start of the stretch, as a fraction of the segment.
        last: End of the stretch, as a fraction of the segment.
        reach: If no triangle in the list is within this distance of a point, all triangles are searched [u].
        scratch: `Scratch`.

    Returns:
        The greatest distance of any sample, and of the points found around the farthest sample by golden-section
        search.
    """
    step, best, deepest = (last - first) / SAMPLES, 1, -1.0
    for i in range(1, SAMPLES):
        depth = abs(signed_distance(local, triangles, found, start, end, first + i * step, reach, scratch))
        if depth > deepest:
            best, deepest = i, depth
    low, high = first + (best - 1) * step, first + (best + 1) * step
    length = np.sqrt((end[0] - start[0]) ** 2 + (end[1] - start[1]) ** 2 + (end[2] - start[2]) ** 2)
    left, right = high - CLOSING * (high - low), low + CLOSING * (high - low)
    at_left = abs(signed_distance(local, triangles, found, start, end, left, reach, scratch))
    at_right = abs(signed_distance(local, triangles, found, start, end, right, reach, scratch))
    while (high - low) * length > PRECISION:
        if at_left < at_right:
            low, left, at_left = left, right, at_right
            right = low + CLOSING * (high - low)
            at_right = abs(signed_distance(local, triangles, found, start, end, right, reach, scratch))
        else:
            high, right, at_right = right, left, at_left
            left = high - CLOSING * (high - low)
            at_left = abs(signed_distance(local, triangles, found, start, end, left, reach, scratch))
    return max(deepest, at_left, at_right)


@array_kernel
def edge_depth(tool: Any, local: np.ndarray, triangles: np.ndarray, known: float, scratch: Any) -> float:
    """Greatest depth of a tool's edges in an organ: the distance from its surface of any of their points inside it.

    Args:
        tool: `ToolGeometry`.
        local: (3, V) the organ's vertices in the tool's frame [u].
        triangles: (T, 3).
        known: A depth that has been found elsewhere [u].
        scratch: `Scratch`.

    Returns:
        The depth, or `known` if that is more [u]. It is exact to `PRECISION` if on each stretch of an edge between two
        crossings of the surface the deepest point is near the deepest of the samples (see `SAMPLES`).
    """
    corners, ridges, near, greatest = tool.corners, tool.ridges, scratch.near, known
    listed = SUNK * tool.extent[7]
    found = list_near(tool.extent, local, triangles, listed, near, scratch.codes)
    if found == 0 and not encloses(local, triangles, corners[0, 0], corners[0, 1], corners[0, 2], scratch.turned):
        return known
    fill_boxes(local, triangles, near, found, scratch.boxes)
    for f in range(ridges.shape[0]):
        for g in range(f + 1, ridges.shape[0]):
            if ridges[f, g, 0] < 0:
                continue
            start, end = corners[ridges[f, g, 0]], corners[ridges[f, g, 1]]
            length = np.sqrt((end[0] - start[0]) ** 2 + (end[1] - start[1]) ** 2 + (end[2] - start[2]) ** 2)
            first = 0.0
            while first < 1.0:
                crossing = next_crossing(local, triangles, near, found, start, end, first)
                stop = min(crossing, 1.0)
                # No point is farther from the surface than from those ends of its stretch that lie on the surface.
                reach = (stop - first) * length * (0.5 if first > 0.0 and crossing < np.inf else 1.0)
                middle = 0.5 * (first + stop)
                if stop - first == 1.0:
                    # The edge goes through no surface; in most cases it is outside.
                    if signed_distance(local, triangles, found, start, end, middle, listed, scratch) >= 0.0:
                        break
                    reach = np.inf
                if reach > greatest and encloses(
                    local, triangles, start[0] + middle * (end[0] - start[0]), start[1] + middle * (end[1] - start[1]),
                    start[2] + middle * (end[2] - start[2]), scratch.turned,
                ):  # fmt: skip
                    greatest = max(
                        greatest, stretch_depth(local, triangles, found, start, end, first, stop, listed, scratch)
                    )
                first = stop
    return greatest


@inline_kernel
def depth_of_edges(world: Any, position: np.ndarray, rotation: np.ndarray, vertices: np.ndarray, known: float) -> float:
    """Greatest depth of the tools' edges in the organs; see `edge_depth`.

    Args:
        world: `WorldContacts`; its memories' `local` is written.
        position: (N, 3) of the tools [u].
        rotation: (N, 9) their rotation matrices, row by row.
        vertices: (V, 3) of the organs [u].
        known: Greatest depth that has been found elsewhere [u].

    Returns:
        The greatest depth [u]; `known` if that is more. If `known` is no more than `EDGES_COUNT_FROM`, edges are not
        measured, and it is returned.
    """
    depth, organ_count = known, len(world.surfaces)
    if known <= EDGES_COUNT_FROM:
        return depth
    for k in range(position.shape[0]):
        for o in range(organ_count):
            local = world.memories[k * organ_count + o].organ.local
            fill_local(position[k], rotation[k], vertices, world.first_vertices[o], local)
            depth = edge_depth(world.tools[k].geometry, local, world.surfaces[o], depth, world.room.scratch)
    return depth
