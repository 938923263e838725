"""Constraints that push out triangles of an organ that are in a tool although the contacts found so far hold.

The face that has met a point is normally found from the point's path (`features`). Where an organ is stretched or
folded so much that constraints contradict each other, a solve may leave it in a tool, and the face through which it
came can no longer be told. Then the present position decides: the tool belongs on the outer side of the surface.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from spatula_env._kernels import array_kernel
from spatula_env.contact.depth import clip_triangle, fill_under
from spatula_env.contact.features import pushed_by
from spatula_env.contact.flags import fill_local_normal
from spatula_env.contact.path import MARGIN
from spatula_env.contact.rows import ON_SURFACE, append_constraint, constraint_name

FACING = 0.1
"""Greatest cosine of the angle between the normals of a face and of a triangle at which the face pushes the triangle:
they must point against each other, or nearly be perpendicular. Of the two sides of a thin tool one satisfies this,
however deep the triangle is."""

SHALLOW = 0.25
"""Depth, as a part of the tool's thickness, below which a triangle counts as still being where it came in. `TURNED`
then takes the place of `FACING`."""

TURNED = 0.7
"""Greatest cosine of the angle between the normals at which a face pushes a shallow triangle, as is needed at a rim."""


@array_kernel
def _way_out(under: np.ndarray, facing: np.ndarray, weights: np.ndarray, count: int, shallow: float) -> int:
    """Of the faces that may push a triangle, the one behind which it is least deep; -1 if there is none.

    Args:
        under: (P, 3) how deep the triangle's corners are under each face; see `depth.fill_under` [u].
        facing: (P,) cosine of the angle between each face's normal and the triangle's.
        weights: (., 3) weights of the corners of the part of the triangle that is in the tool.
        count: Number of these corners.
        shallow: Depth below which the part counts as shallow; see `SHALLOW` [u].
    """
    best, least = -1, np.inf
    for p in range(under.shape[0]):
        deepest = 0.0
        for i in range(count):
            at = weights[i, 0] * under[p, 0] + weights[i, 1] * under[p, 1] + weights[i, 2] * under[p, 2]
            deepest = max(deepest, at)
        if deepest < least and (facing[p] <= FACING or (deepest < shallow and facing[p] <= TURNED)):
            best, least = p, deepest
    return best


@array_kernel
def gather_sunk_triangles(
    table: Any,
    count: int,
    tool: Any,
    organ: Any,
    triangles: np.ndarray,
    placement: Any,
    tried: int,
    trial: Any,
    scratch: Any,
) -> int:
    """Append a constraint for each triangle that is in the tool, which pushes its deepest point out.

    Arguments as in `features.gather_features`; the table must have room for all triangles. Only triangles near the
    tool, by the codes that `features.find_candidates` has written, are considered. Returns the new count.
    """
    local, last, extent, codes = organ.local, organ.last_local, tool.extent, organ.codes
    plane_normals, plane_offsets = tool.plane_normals, tool.plane_offsets
    planes = plane_offsets.shape[0]
    under, facing, normal = scratch.under[:planes], scratch.facing, scratch.normal
    first, second = scratch.polygon, scratch.clipped
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if codes[a] & codes[b] & codes[c] != 0:
            continue
        if fill_under(plane_normals, plane_offsets, local, a, b, c, MARGIN, under) <= MARGIN:
            continue
        corners, is_second = clip_triangle(under, MARGIN, first, second)
        if corners == 0:
            continue
        weights = second if is_second else first
        fill_local_normal(local, triangles[t], normal)
        if not np.isfinite(normal[0] + normal[1] + normal[2]):
            # A triangle without area has no outside.
            continue
        for p in range(planes):
            facing[p] = 0.0
            for axis in range(3):
                facing[p] += plane_normals[p, axis] * normal[axis]
        name = constraint_name(ON_SURFACE, 0, t, placement.first_vertex)
        way_out = _way_out(under, facing, weights, corners, SHALLOW * extent[7])
        p = pushed_by(tried, trial, placement.owner, name, way_out)
        if p < 0:
            continue
        deepest, place = 0.0, 0
        for i in range(corners):
            at = weights[i, 0] * under[p, 0] + weights[i, 1] * under[p, 1] + weights[i, 2] * under[p, 2]
            if at > deepest:
                deepest, place = at, i
        if deepest > extent[7]:
            continue
        wa, wb, wc = weights[place, 0], weights[place, 1], weights[place, 2]
        x = wa * local[0, a] + wb * local[0, b] + wc * local[0, c]
        y = wa * local[1, a] + wb * local[1, b] + wc * local[1, c]
        z = wa * local[2, a] + wb * local[2, b] + wc * local[2, c]
        nx, ny, nz = plane_normals[p, 0], plane_normals[p, 1], plane_normals[p, 2]
        count = append_constraint(
            table, count, (a, b, c), (wa, wb, wc), (nx, ny, nz),
            (x + deepest * nx, y + deepest * ny, z + deepest * nz), last, placement, p, name,
        )  # fmt: skip
    return count
