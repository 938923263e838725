"""Whether an organ's surface has gone right through a tool, from the paths of its vertices in the tool's frame."""

from __future__ import annotations

import numpy as np

from spatula_env._kernels import kernel

PARALLEL = 1e-6
"""Normals are opposite when their dot product is less than this above -1."""


@kernel("void(f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8, i4[::1], i4[::1])")
def find_passages(
    before: np.ndarray,
    after: np.ndarray,
    normals: np.ndarray,
    offsets: np.ndarray,
    rim: float,
    entries: np.ndarray,
    ways: np.ndarray,
) -> None:
    """Find the vertices that have gone right through a convex body, on straight paths in its frame.

    Args:
        before: (V, 3) where they were, in the body's frame [u].
        after: (V, 3) where they are [u].
        normals: (F, 3) outward unit normals of the body's faces.
        offsets: (F,) of the faces' planes [u].
        rim: Where a path crosses one of the two faces, it must be this far under the other ones [u].
        entries: (V,) by which face each vertex that is inside came in, -1 for the others and where it is not known;
            kept from call to call.
        ways: (V,) is filled: by which face each vertex came in that came out by the opposite one, -1 for the others.
    """
    faces = normals.shape[0]
    for v in range(before.shape[0]):
        ways[v] = -1
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
