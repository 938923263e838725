"""The face of a tool through which a point of an organ has come.

Between two queries a point of the organ moves in the tool's frame from one place to another. At the first it was
outside of the tool, or on it. If the straight path between the places leads into the tool, the face through which it
enters is the one that pushes the point, however thin the tool is and wherever the path ends.
"""

from __future__ import annotations

import numpy as np

from spatula_env._kernels import array_kernel

MARGIN = 1e-4
"""A point no farther from a plane than this touches it [u]."""

SLACK = 2e-3
"""How far behind a face a point may have been and still count as having been before it, as the response may leave it
there [u]."""

RESIDUAL_TOLERANCE = 1e-3
"""Contacts are looked for again at the positions that the last solve has found, until none is deeper than this [u]."""

ON_PLANE = 1e-9
"""A point that ends no deeper than this behind a plane ends on it [u]."""


@array_kernel
def entry_plane(
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
    plane_normals: np.ndarray,
    plane_offsets: np.ndarray,
    touching: float,
) -> int:
    """Find the plane through which a point came into a convex body.

    Args:
        ax: Where it was, in the body's frame [u].
        ay: Where it was.
        az: Where it was.
        bx: Where it is [u].
        by: Where it is.
        bz: Where it is.
        plane_normals: (P, 3) outward unit normals.
        plane_offsets: (P,) normal . x on each plane [u].
        touching: The point has not come through a plane if its final height over it is this or more [u]. Use `MARGIN`
            for a point that may rest on a plane; -`ON_PLANE` for one that was chosen to end on a plane and slides
            along it.

    Returns:
        The plane's index, also if the point has left the body again on the other side; -1 if it was never inside. A
        point that touches the body counts as inside. If the point was inside already, the plane nearest to where it
        was. If it came in at an edge, the one of the planes there against which it moves fastest.
    """
    planes = plane_normals.shape[0]
    leaves = np.inf
    nearest, nearest_before = -1, -np.inf
    for p in range(planes):
        nx, ny, nz = plane_normals[p, 0], plane_normals[p, 1], plane_normals[p, 2]
        after = nx * bx + ny * by + nz * bz - plane_offsets[p]
        before = nx * ax + ny * ay + nz * az - plane_offsets[p]
        if after > MARGIN:
            if before >= -SLACK:
                return -1
            leaves = min(leaves, before / (before - after))
        elif before > nearest_before:
            nearest, nearest_before = p, before
    # A face that the response left the point slightly behind counts only if there is no face that the point was before.
    for attempt in range(2):
        slack = MARGIN if attempt == 0 else SLACK
        enters = -1.0
        for p in range(planes):
            nx, ny, nz = plane_normals[p, 0], plane_normals[p, 1], plane_normals[p, 2]
            after = nx * bx + ny * by + nz * bz - plane_offsets[p]
            before = nx * ax + ny * ay + nz * az - plane_offsets[p]
            if before >= -slack and after < touching:
                enters = max(enters, before / (before - after) if before > 0.0 and before > after else 0.0)
        if enters < 0.0:
            continue
        if enters >= leaves:
            return -1
        best, fastest = -1, -np.inf
        for p in range(planes):
            nx, ny, nz = plane_normals[p, 0], plane_normals[p, 1], plane_normals[p, 2]
            after = nx * bx + ny * by + nz * bz - plane_offsets[p]
            before = nx * ax + ny * ay + nz * az - plane_offsets[p]
            if before < -slack or after >= touching:
                continue
            if before + (after - before) * min(enters, 1.0) >= -slack and before - after > fastest:
                best, fastest = p, before - after
        return best
    return nearest if leaves == np.inf else -1
