"""Test whether a convex body overlaps the volume that a closed surface encloses."""

from __future__ import annotations

import numpy as np

from spatula_env.arrays import FloatArray, IndexArray
from spatula_env.geometry.surface import triangle_normals, winding_numbers


def overlaps(
    vertices: FloatArray, triangles: IndexArray, corners: FloatArray, faces: IndexArray, tolerance: float = 0.0
) -> bool:
    """Whether a convex body reaches into the volume that a closed surface encloses.

    If it does, either the surface passes through the body, or the body is inside as a whole. So the triangles of the
    surface are clipped by the half-spaces whose intersection is the body (I. Sutherland and G. Hodgman, Reentrant
    polygon clipping, Communications of the ACM 17(1), 1974), and a point of the body is tested for being enclosed.

    Args:
        vertices: (V, 3) of the surface [u].
        triangles: (T, 3) of the surface, counter-clockwise from outside.
        corners: (K, 3) of the body [u].
        faces: (F, 3) triangles of the body's surface, counter-clockwise from outside.
        tolerance: Depth by which the body may reach into the surface without counting as overlapping [u].
    """
    normals = triangle_normals(corners, faces)
    offsets = (normals * corners[faces[:, 0]]).sum(axis=1) - tolerance
    low, high = corners.min(axis=0), corners.max(axis=0)
    shapes = vertices[triangles]
    near = ((shapes.max(axis=1) >= low) & (shapes.min(axis=1) <= high)).all(axis=1)
    shapes = shapes[near]
    outside = shapes @ normals.T > offsets  # (n, 3, F)
    for shape in shapes[~outside.all(axis=1).any(axis=1)]:
        if _reaches_into(shape, normals, offsets):
            return True
    inner = corners.mean(axis=0)
    return bool(winding_numbers(inner[None], vertices, triangles)[0] > 0.5)


def _reaches_into(polygon: FloatArray, normals: FloatArray, offsets: FloatArray) -> bool:
    """Whether a plane polygon (n, 3) has a point p with ``normals @ p <= offsets``, normals (F, 3) and offsets (F,)."""
    for normal, offset in zip(normals, offsets, strict=True):
        beyond = polygon @ normal - offset
        if (beyond <= 0.0).all():
            continue
        kept = []
        for index, (point, here) in enumerate(zip(polygon, beyond, strict=True)):
            before = index - 1
            there = beyond[before]
            if (here > 0.0) != (there > 0.0):
                kept.append(point + here / (here - there) * (polygon[before] - point))
            if here <= 0.0:
                kept.append(point)
        if not kept:
            return False
        polygon = np.array(kept)
    return True
