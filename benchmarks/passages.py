"""Finds where an organ's surface has gone right through a tool, from the paths of vertices in the tool's frame."""

from __future__ import annotations

import numpy as np

from spatula_env._kernels import inline_kernel, kernel

PARALLEL = 1e-6
"""Unit normals count as opposite if their dot product is within this of -1, and as parallel likewise."""


@kernel()
def find_passages(
    before: np.ndarray,
    after: np.ndarray,
    sides_before: np.ndarray,
    sides_after: np.ndarray,
    normals: np.ndarray,
    offsets: np.ndarray,
    rim: float,
    entries: np.ndarray,
    ways: np.ndarray,
) -> bool:
    """Find the vertices that have gone right through a convex body, on straight paths in its frame.

    Args:
        before: (V, 3) positions of the vertices at the last call, in the body's frame [u].
        after: (V, 3) positions now [u].
        sides_before: (V,) bit set of the sides of a box around the body that each vertex was outside of.
        sides_after: (V,) the same for now. A vertex that stays outside one of the sides is skipped.
        normals: (F, 3) outward unit normals of the body's faces.
        offsets: (F,) of the faces' planes [u].
        rim: Least distance of a path, where it crosses the two faces, from all faces that are not parallel to them [u].
        entries: (V,) face by which each vertex inside the body came in, -1 for other vertices and where unknown; kept
            from call to call.
        ways: (V,) output: face by which each vertex came in that left by the opposite one, -1 for other vertices.

    Returns:
        Whether any vertex has gone through.
    """
    faces = normals.shape[0]
    found = False
    for v in range(before.shape[0]):
        ways[v] = -1
        if sides_before[v] & sides_after[v]:
            entries[v] = -1
            continue
        first, last = 0.0, 1.0
        entry, out = entries[v], -1
        for f in range(faces):
            start, end = -offsets[f], -offsets[f]
            for k in range(3):
                start += normals[f, k] * before[v, k]
                end += normals[f, k] * after[v, k]
            if start >= 0.0 and end >= 0.0:
                first = 2.0
                break
            if start >= 0.0:
                part = start / (start - end)
                if part >= first:
                    first, entry = part, f
            elif end >= 0.0:
                part = start / (start - end)
                if part <= last:
                    last, out = part, f
        if first > last:
            entries[v] = -1
            continue
        if out < 0:
            entries[v] = entry
            continue
        entries[v] = -1
        if entry < 0:
            continue
        across = 0.0
        for k in range(3):
            across += normals[entry, k] * normals[out, k]
        if across > -1.0 + PARALLEL:
            continue
        within = True
        for f in range(faces):
            alignment, depth_in, depth_out = 0.0, offsets[f], offsets[f]
            for k in range(3):
                alignment += normals[f, k] * normals[entry, k]
                depth_in -= normals[f, k] * (before[v, k] + first * (after[v, k] - before[v, k]))
                depth_out -= normals[f, k] * (before[v, k] + last * (after[v, k] - before[v, k]))
            if abs(alignment) < 1.0 - PARALLEL and min(depth_in, depth_out) < rim:
                within = False
        if within:
            ways[v] = entry
            found = True
    return found


@inline_kernel
def _outward(vertices: np.ndarray, triangles: np.ndarray, v: int, way: np.ndarray) -> float:
    """Component along `way` (3,) of the outward normal at vertex v, not normalised: the sum over adjacent triangles."""
    x, y, z = 0.0, 0.0, 0.0
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if a == v or b == v or c == v:
            px, py, pz = (
                vertices[b, 0] - vertices[a, 0],
                vertices[b, 1] - vertices[a, 1],
                vertices[b, 2] - vertices[a, 2],
            )
            qx, qy, qz = (
                vertices[c, 0] - vertices[a, 0],
                vertices[c, 1] - vertices[a, 1],
                vertices[c, 2] - vertices[a, 2],
            )
            x += py * qz - pz * qy
            y += pz * qx - px * qz
            z += px * qy - py * qx
    total: float = x * way[0] + y * way[1] + z * way[2]
    return total


@kernel()
def count_passages(
    before: np.ndarray, triangles: np.ndarray, normals: np.ndarray, ways: np.ndarray, strayed: np.ndarray
) -> tuple[int, int]:
    """Count the vertices that have gone through, with the outside and with the inside of their surface ahead.

    A vertex that goes back through the body is not counted.

    Args:
        before: (V, 3) positions of the vertices at the last call, in the body's frame [u].
        triangles: (T, 3) of the surface, counter-clockwise from outside.
        normals: (F, 3) outward unit normals of the body's faces.
        ways: (V,) face by which each vertex came in, -1 for vertices that have not gone through.
        strayed: (V,) face by which each vertex came in that has gone through and not back, -1 for other vertices; kept
            from call to call.
    """
    passages, turned = 0, 0
    for v in range(ways.shape[0]):
        way = ways[v]
        if way < 0:
            continue
        if strayed[v] >= 0:
            along = 0.0
            for k in range(3):
                along += normals[strayed[v], k] * normals[way, k]
            if along < 0.0:
                strayed[v] = -1
                continue
        strayed[v] = way
        if _outward(before, triangles, v, normals[way]) < 0.0:
            passages += 1
        else:
            turned += 1
    return passages, turned
