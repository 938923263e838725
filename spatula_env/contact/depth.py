"""Penetration depth of tools and organs after a step, measured over whole surfaces.

Contacts act on certain points of a surface. The depth is measured everywhere, so it also reveals penetration for which
no contact was found.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from spatula_env._kernels import array_kernel
from spatula_env.contact.corners import SUNK, encloses, fill_boxes, find_nearest, list_near
from spatula_env.contact.structures import NO_PAIR

PRECISION = 1e-5
"""Precision to which a depth is found [u]."""


@array_kernel
def fill_under(
    plane_normals: np.ndarray, plane_offsets: np.ndarray, local: np.ndarray, a: int, b: int, c: int, enough: float,
    under: np.ndarray,
) -> float:  # fmt: skip
    """Write how deep the corners of a triangle are under each face of a tool.

    Args:
        plane_normals: (P, 3) of the tool.
        plane_offsets: (P,) of the tool [u].
        local: (3, V) the organ's vertices in the tool's frame [u].
        a: First corner.
        b: Second corner.
        c: Third corner.
        enough: If no corner is deeper than this under a face, the faces that follow are left out [u].
        under: (P, 3) written [u].

    Returns:
        Upper bound on the depth in the tool of any point of the triangle [u].
    """
    most = np.inf
    for p in range(plane_offsets.shape[0]):
        nx, ny, nz, offset = plane_normals[p, 0], plane_normals[p, 1], plane_normals[p, 2], plane_offsets[p]
        under[p, 0] = offset - nx * local[0, a] - ny * local[1, a] - nz * local[2, a]
        under[p, 1] = offset - nx * local[0, b] - ny * local[1, b] - nz * local[2, b]
        under[p, 2] = offset - nx * local[0, c] - ny * local[1, c] - nz * local[2, c]
        most = min(most, max(under[p, 0], under[p, 1], under[p, 2]))
        if most <= enough:
            break
    return most


@array_kernel
def clip_triangle(under: np.ndarray, depth: float, first: np.ndarray, second: np.ndarray) -> tuple[int, bool]:
    """Clip a triangle to the part that is at least `depth` under all faces of a tool: a convex polygon.

    Args:
        under: (P, 3) how deep the triangle's corners are under each face [u].
        depth: The depth [u].
        first: (P + 4, 3) written, as is the next: one of the two receives the weights of the polygon's corners.
        second: (P + 4, 3).

    Returns:
        The number of the polygon's corners, and whether their weights are in `second`.
    """
    weights, clipped, is_second = first, second, False
    count = 3
    for i in range(3):
        for k in range(3):
            weights[i, k] = 1.0 if i == k else 0.0
    for p in range(under.shape[0]):
        a, b, c = under[p, 0] - depth, under[p, 1] - depth, under[p, 2] - depth
        if a >= 0.0 and b >= 0.0 and c >= 0.0:
            continue
        left = 0
        last = count - 1
        before = weights[last, 0] * a + weights[last, 1] * b + weights[last, 2] * c
        for i in range(count):
            here = weights[i, 0] * a + weights[i, 1] * b + weights[i, 2] * c
            if (here >= 0.0) != (before >= 0.0):
                part = before / (before - here)
                for k in range(3):
                    clipped[left, k] = weights[last, k] + part * (weights[i, k] - weights[last, k])
                left += 1
            if here >= 0.0:
                for k in range(3):
                    clipped[left, k] = weights[i, k]
                left += 1
            last, before = i, here
        if left == 0:
            return 0, is_second
        count = left
        weights, clipped, is_second = clipped, weights, not is_second
    return count, is_second


@array_kernel
def _reaches(under: np.ndarray, depth: float, first: np.ndarray, second: np.ndarray) -> float:
    """Bound the depth of the part of a triangle that is at least `depth` under all faces of a tool.

    Args:
        under: (P, 3) how deep the triangle's corners are under each face [u].
        depth: The depth [u].
        first: (P + 4, 3) workspace.
        second: (P + 4, 3) workspace.

    Returns:
        Upper bound on the depth of that part in the tool, from the depths of its corners under each face [u]; 0 if no
        part is that deep.
    """
    count, is_second = clip_triangle(under, depth, first, second)
    if count == 0:
        return 0.0
    weights = second if is_second else first
    bound = np.inf
    for p in range(under.shape[0]):
        deepest = 0.0
        for i in range(count):
            at = weights[i, 0] * under[p, 0] + weights[i, 1] * under[p, 1] + weights[i, 2] * under[p, 2]
            deepest = max(deepest, at)
        bound = min(bound, deepest)
    return bound


@array_kernel
def surface_depth(tool: Any, local: np.ndarray, triangles: np.ndarray, found: int, known: float, scratch: Any) -> float:
    """Greatest depth of an organ's surface in a tool: the distance of any of its points from the tool's nearest face.

    Args:
        tool: `ToolGeometry`.
        local: (3, V) the organ's vertices in the tool's frame [u].
        triangles: (T, 3).
        found: Number of triangles that come near the tool.
        known: A depth that has been found elsewhere [u].
        scratch: `Scratch`; its `near` holds the indices of these triangles.

    Returns:
        The depth, to `PRECISION`, or `known` if that is more [u].
    """
    plane_normals, plane_offsets, extent = tool.plane_normals, tool.plane_offsets, tool.extent
    under, near = scratch.under[: plane_offsets.shape[0]], scratch.near
    first, second = scratch.polygon, scratch.clipped
    greatest = known
    for k in range(found):
        t = near[k]
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        apart = False
        for axis in range(3):
            x, y, z = local[axis, a], local[axis, b], local[axis, c]
            apart |= (min(x, y, z) > extent[3 + axis]) | (max(x, y, z) < extent[axis])
        if apart:
            continue
        most = fill_under(plane_normals, plane_offsets, local, a, b, c, greatest, under)
        if most <= greatest + PRECISION:
            continue
        low, high = greatest, _reaches(under, greatest + PRECISION, first, second)
        # Often one face is the nearest one for all of that part; then the bound is the depth itself.
        middle = high - PRECISION
        while high - low > PRECISION:
            bound = _reaches(under, middle, first, second)
            if bound > 0.0:
                low, high = middle, min(high, bound)
            else:
                high = middle
            middle = 0.5 * (low + high)
        greatest = max(greatest, low)
    return greatest


@array_kernel
def pair_depth(tool: Any, local: np.ndarray, triangles: np.ndarray, pair: int, known: float, scratch: Any) -> float:
    """Greatest depth of an organ's surface in a tool and of the tool's corners in the organ.

    The depth of a corner that the organ encloses is its distance from the organ's surface.

    Args:
        tool: `ToolGeometry`.
        local: (3, V) the organ's vertices in the tool's frame [u].
        triangles: (T, 3).
        pair: Index of the tool and the organ among all pairs. If `scratch.listed` names this pair, the triangles near
            the tool and the distances of its corners are taken from `scratch`.
        known: A depth that has been found elsewhere [u].
        scratch: `Scratch`.

    Returns:
        The depth, to `PRECISION`, or `known` if that is more [u].
    """
    corners, extent, turned = tool.corners, tool.extent, scratch.turned
    greatest, reach = known, SUNK * extent[7]
    nearest, near, boxes, away, listed = scratch.nearest, scratch.near, scratch.boxes, scratch.away, scratch.listed
    found, is_listed, distances = listed[1], listed[0] == pair, scratch.corner_distances
    if not is_listed:
        listed[0] = NO_PAIR
        found = list_near(extent, local, triangles, reach, near, scratch.codes)
        fill_boxes(local, triangles, near, found, boxes)
    if found == 0 and not encloses(local, triangles, corners[0, 0], corners[0, 1], corners[0, 2], turned):
        # No surface is near the tool: it is outside as a whole.
        return known
    for k in range(corners.shape[0]):
        x, y, z = corners[k, 0], corners[k, 1], corners[k, 2]
        if is_listed and np.isfinite(distances[k]):
            distance = distances[k]
        else:
            t = find_nearest(local, triangles, near, found, x, y, z, np.inf, boxes, away, nearest)
            distance = nearest[0] if t >= 0 else -np.inf
        if distance < -greatest and encloses(local, triangles, x, y, z, turned):
            # Beyond `reach`, a triangle that is not in the list of those near the tool may be nearer.
            if distance < -reach:
                fill_boxes(local, triangles, near, -1, scratch.other_boxes)
                find_nearest(local, triangles, near, -1, x, y, z, np.inf, scratch.other_boxes, away, nearest)
                distance = nearest[0]
            greatest = max(greatest, abs(distance))
    return surface_depth(tool, local, triangles, found, greatest, scratch)
