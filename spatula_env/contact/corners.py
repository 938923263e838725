"""Contacts of a tool's corners with an organ's surface.

A corner is a point, and the surface a mesh of moving triangles. The triangle that a corner has come through is found
from its path relative to the surface since the last query, or, where that shows none, from its present position.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from spatula_env._kernels import array_kernel
from spatula_env.contact.flags import fill_local_normal, triangle_weights
from spatula_env.contact.path import MARGIN, RESIDUAL_TOLERANCE, SLACK
from spatula_env.contact.rows import ON_CORNER, append_constraint, constraint_name

OUTSIDE_TRIANGLE = 0.02
"""How far outside of a triangle, relative to its size, a corner may be and still be kept from going through it, as the
triangle has moved since they met."""

MEETING_STEPS = 4
"""Most steps of false position to find when a corner and a triangle met."""

SUNK = 0.5
"""A corner that was no deeper in the organ than this part of the tool's thickness is pushed out to the nearest point of
the surface."""

TIE = 1.0 + 1e-9
"""Squared distances whose ratio is smaller than this count as equal."""


@array_kernel
def best_plane(plane_normals: np.ndarray, nx: float, ny: float, nz: float) -> int:
    """Index of the tool's face whose normal is nearest to a direction."""
    best, largest = 0, -np.inf
    for p in range(plane_normals.shape[0]):
        along = plane_normals[p, 0] * nx + plane_normals[p, 1] * ny + plane_normals[p, 2] * nz
        if along > largest:
            best, largest = p, along
    return best


@array_kernel
def meeting_weights(
    last: np.ndarray,
    local: np.ndarray,
    a: int,
    b: int,
    c: int,
    x: float,
    y: float,
    z: float,
    last_height: float,
    height: float,
    moving: np.ndarray,
) -> tuple[float, float, float]:
    """Barycentric weights of a point where the plane of a moving triangle met it.

    Args:
        last: (3, V) vertices before [u].
        local: (3, V) vertices now [u].
        a: First corner.
        b: Second corner.
        c: Third corner.
        x: The point [u].
        y: The point [u].
        z: The point [u].
        last_height: Height of the point over the plane before [u].
        height: Its height now, not greater than `MARGIN` [u].
        moving: (3, 3) workspace.

    Returns:
        Weights of the triangle's corners at the time of the meeting.
    """
    low, high = 0.0, 1.0
    at_low, at_high = max(last_height, 0.0), min(height, 0.0)
    wa, wb, wc = 0.0, 0.0, 0.0
    for _ in range(MEETING_STEPS):
        # The height is, up to the length of the normal, a cubic in time; its root is found by false position.
        time = low + (high - low) * at_low / (at_low - at_high) if at_low > at_high else high
        for axis in range(3):
            moving[axis, 0] = last[axis, a] + time * (local[axis, a] - last[axis, a])
            moving[axis, 1] = last[axis, b] + time * (local[axis, b] - last[axis, b])
            moving[axis, 2] = last[axis, c] + time * (local[axis, c] - last[axis, c])
        wa, wb, wc = triangle_weights(moving, 0, 1, 2, x, y, z)
        ux, uy, uz = moving[0, 1] - moving[0, 0], moving[1, 1] - moving[1, 0], moving[2, 1] - moving[2, 0]
        vx, vy, vz = moving[0, 2] - moving[0, 0], moving[1, 2] - moving[1, 0], moving[2, 2] - moving[2, 0]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        above = (nx * (x - moving[0, 0]) + ny * (y - moving[1, 0]) + nz * (z - moving[2, 0])) / np.sqrt(
            nx * nx + ny * ny + nz * nz
        )
        if abs(above) <= MARGIN or time >= 1.0:
            break
        if above > 0.0:
            low, at_low = time, above
        else:
            high, at_high = time, above
    return wa, wb, wc


@array_kernel
def _swept_range(local: np.ndarray, last: np.ndarray, axis: int, a: int, b: int, c: int) -> tuple[float, float]:
    """Least and greatest coordinate of a triangle between two queries, with a margin."""
    low = min(min(local[axis, a], local[axis, b], local[axis, c]), min(last[axis, a], last[axis, b], last[axis, c]))
    high = max(max(local[axis, a], local[axis, b], local[axis, c]), max(last[axis, a], last[axis, b], last[axis, c]))
    return low - MARGIN, high + MARGIN


@array_kernel
def gather_corners(
    table: Any,
    count: int,
    room: int,
    tool: Any,
    organ: Any,
    triangles: np.ndarray,
    found: int,
    placement: Any,
    slid: bool,
    scratch: Any,
) -> int:
    """Append one constraint for each corner of the tool and each triangle that it came through or touches.

    The constraint pushes the point of the triangle that the corner met. If they may have `slid` on each other since, a
    second constraint pushes the triangle where the corner is now.

    Writes into `scratch` the least height of each corner over the planes of these triangles, infinite where there is
    none [u]; and whether the corner is behind any triangle near its path.
    """
    local, last, corners, candidates = organ.local, organ.last_local, tool.corners, organ.candidates
    plane_normals, first_vertex = tool.plane_normals, placement.first_vertex
    normal, last_normal, moving = scratch.normal, scratch.last_normal, scratch.moving
    heights, behind = scratch.corner_heights, scratch.corner_behind
    heights[:] = np.inf
    behind[:] = False
    for k in range(found):
        t = candidates[k]
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        has_normals = False
        low_x, high_x = _swept_range(local, last, 0, a, b, c)
        low_y, high_y = _swept_range(local, last, 1, a, b, c)
        low_z, high_z = _swept_range(local, last, 2, a, b, c)
        for corner in range(corners.shape[0]):
            outside = (corners[corner, 0] < low_x) | (corners[corner, 0] > high_x)
            outside |= (corners[corner, 1] < low_y) | (corners[corner, 1] > high_y)
            outside |= (corners[corner, 2] < low_z) | (corners[corner, 2] > high_z)
            if outside:
                continue
            if not has_normals:
                fill_local_normal(local, triangles[t], normal)
                fill_local_normal(last, triangles[t], last_normal)
                has_normals = True
            x, y, z = corners[corner, 0], corners[corner, 1], corners[corner, 2]
            # Heights of the corner over the triangle's plane, on the organ's outer side.
            height = normal[0] * (x - local[0, a]) + normal[1] * (y - local[1, a]) + normal[2] * (z - local[2, a])
            last_height = (
                last_normal[0] * (x - last[0, a])
                + last_normal[1] * (y - last[1, a])
                + last_normal[2] * (z - last[2, a])
            )
            behind[corner] |= height < -MARGIN
            # Negated so that a triangle without area, whose heights are NaN, is skipped, too.
            if not (height <= MARGIN and last_height >= -SLACK) or count == room:
                continue
            wa, wb, wc = meeting_weights(last, local, a, b, c, x, y, z, last_height, height, moving)
            if min(wa, wb, wc) < -OUTSIDE_TRIANGLE:
                continue
            heights[corner] = min(heights[corner], height)
            count = append_constraint(
                table, count, (a, b, c), (wa, wb, wc), (-normal[0], -normal[1], -normal[2]), (x, y, z), last,
                placement, best_plane(plane_normals, -normal[0], -normal[1], -normal[2]),
                constraint_name(ON_CORNER, corner, first_vertex, t),
            )  # fmt: skip
            if not slid or height >= -RESIDUAL_TOLERANCE or count == room:
                continue
            # The point that the corner met has moved away from it: to push there turns the triangle, and hardly moves
            # it where the corner is.
            wa, wb, wc = triangle_weights(local, a, b, c, x, y, z)
            if min(wa, wb, wc) >= 0.0:
                count = append_constraint(
                    table, count, (a, b, c), (wa, wb, wc), (-normal[0], -normal[1], -normal[2]), (x, y, z), last,
                    placement, best_plane(plane_normals, -normal[0], -normal[1], -normal[2]),
                    constraint_name(ON_CORNER, corners.shape[0] + corner, first_vertex, t),
                )  # fmt: skip
    return count


@array_kernel
def closest_weights(
    local: np.ndarray, a: int, b: int, c: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Weights of the point of a triangle, vertices in local (3, V), that is closest to a point.

    Follows C. Ericson, Real-Time Collision Detection, 2005, section 5.1.5, which distinguishes the regions around the
    triangle in which the point may lie.
    """
    ux, uy, uz = local[0, b] - local[0, a], local[1, b] - local[1, a], local[2, b] - local[2, a]
    vx, vy, vz = local[0, c] - local[0, a], local[1, c] - local[1, a], local[2, c] - local[2, a]
    px, py, pz = x - local[0, a], y - local[1, a], z - local[2, a]
    d1, d2 = ux * px + uy * py + uz * pz, vx * px + vy * py + vz * pz
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    # The same two products from the second corner and from the third.
    d3, d4 = d1 - uu, d2 - uv
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    of_c = d1 * d4 - d3 * d2
    if of_c <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        along = d1 / (d1 - d3)
        return 1.0 - along, along, 0.0
    d5, d6 = d1 - uv, d2 - vv
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    of_b = d5 * d2 - d1 * d6
    if of_b <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        along = d2 / (d2 - d6)
        return 1.0 - along, 0.0, along
    of_a = d3 * d6 - d5 * d4
    if of_a <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        along = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 0.0, 1.0 - along, along
    total = of_a + of_b + of_c
    if not total > 0.0:
        return 1.0, 0.0, 0.0
    return 1.0 - of_b / total - of_c / total, of_b / total, of_c / total


@array_kernel
def list_near(
    extent: np.ndarray, local: np.ndarray, triangles: np.ndarray, reach: float, near: np.ndarray, codes: np.ndarray
) -> int:
    """List the triangles whose boxes are no farther than `reach` from a tool's box along any axis.

    Args:
        extent: (8,) of the tool, see `ToolGeometry`.
        local: (3, V) vertices in the tool's frame [u].
        triangles: (T, 3).
        reach: The distance [u].
        near: (T,) written: indices of the triangles.
        codes: (V,) workspace.

    Returns:
        The number of triangles.
    """
    low_x, low_y, low_z = extent[0] - reach, extent[1] - reach, extent[2] - reach
    high_x, high_y, high_z = extent[3] + reach, extent[4] + reach, extent[5] + reach
    for i in range(local.shape[1]):
        x, y, z = local[0, i], local[1, i], local[2, i]
        codes[i] = (
            (x < low_x) | ((y < low_y) << 1) | ((z < low_z) << 2)
            | ((x > high_x) << 3) | ((y > high_y) << 4) | ((z > high_z) << 5)
        )  # fmt: skip
    found = 0
    for t in range(triangles.shape[0]):
        a, b, c = np.uint32(triangles[t, 0]), np.uint32(triangles[t, 1]), np.uint32(triangles[t, 2])
        if codes[a] & codes[b] & codes[c] == 0:
            near[found] = t
            found += 1
    return found


@array_kernel
def list_around(triangles: np.ndarray, t: int, around: np.ndarray) -> int:
    """List a triangle and those that have a vertex in common with it, in around (T,). Returns how many there are."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    found = 0
    for other in range(triangles.shape[0]):
        shares = False
        for k in range(3):
            vertex = triangles[other, k]
            shares |= (vertex == a) | (vertex == b) | (vertex == c)
        if shares:
            around[found] = other
            found += 1
    return found


@array_kernel
def fill_boxes(local: np.ndarray, triangles: np.ndarray, near: np.ndarray, found: int, boxes: np.ndarray) -> None:
    """Write the boxes around triangles, least and greatest coordinates, into boxes (6, T) [u].

    Args:
        local: (3, V) [u].
        triangles: (T, 3).
        near: Indices of the triangles.
        found: Number of these; all triangles if it is negative.
        boxes: Written, in the order of `near`.
    """
    for k in range(found if found >= 0 else triangles.shape[0]):
        t = near[k] if found >= 0 else k
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        for axis in range(3):
            boxes[axis, k] = min(local[axis, a], local[axis, b], local[axis, c])
            boxes[3 + axis, k] = max(local[axis, a], local[axis, b], local[axis, c])


@array_kernel
def _fill_away(boxes: np.ndarray, count: int, x: float, y: float, z: float, away: np.ndarray) -> None:
    """Write the squared distances of a point from boxes (6, T) into away (T,) [u2]."""
    low_x, low_y, low_z, high_x, high_y, high_z = boxes[0], boxes[1], boxes[2], boxes[3], boxes[4], boxes[5]
    # Without a branch, so that the loop is vectorised.
    for k in range(count):
        along_x = max(low_x[k] - x, x - high_x[k], 0.0)
        along_y = max(low_y[k] - y, y - high_y[k], 0.0)
        along_z = max(low_z[k] - z, z - high_z[k], 0.0)
        away[k] = along_x * along_x + along_y * along_y + along_z * along_z


@array_kernel
def find_nearest(
    local: np.ndarray,
    triangles: np.ndarray,
    near: np.ndarray,
    found: int,
    x: float,
    y: float,
    z: float,
    reach: float,
    boxes: np.ndarray,
    away: np.ndarray,
    nearest: np.ndarray,
) -> int:
    """Find the triangle of an organ that is nearest to a point.

    Args:
        local: (3, V) [u].
        triangles: (T, 3).
        near: Indices of the triangles to search.
        found: Number of these; all triangles if it is negative.
        x: The point [u].
        y: The point [u].
        z: The point [u].
        reach: Greatest distance of the triangle from the point [u].
        boxes: (6, T) around the triangles to search, see `fill_boxes` [u].
        away: (T,) workspace.
        nearest: (4,) written: distance of the point, positive outside of the organ and negative inside [u]; weights of
            the closest point of the triangle.

    Returns:
        Index of the triangle; -1 if there is none.
    """
    best, least, steepest = -1, reach * reach, 0.0
    count = found if found >= 0 else triangles.shape[0]
    _fill_away(boxes, count, x, y, z, away)
    for k in range(count):
        if away[k] > least * TIE:
            continue
        t = near[k] if found >= 0 else k
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        wa, wb, wc = closest_weights(local, a, b, c, x, y, z)
        dx = x - wa * local[0, a] - wb * local[0, b] - wc * local[0, c]
        dy = y - wa * local[1, a] - wb * local[1, b] - wc * local[1, c]
        dz = z - wa * local[2, a] - wb * local[2, b] - wc * local[2, c]
        squared = dx * dx + dy * dy + dz * dz
        if squared > least * TIE:
            continue
        ux, uy, uz = local[0, b] - local[0, a], local[1, b] - local[1, a], local[2, b] - local[2, a]
        vx, vy, vz = local[0, c] - local[0, a], local[1, c] - local[1, a], local[2, c] - local[2, a]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        height = (nx * dx + ny * dy + nz * dz) / np.sqrt(nx * nx + ny * ny + nz * nz)
        # Where the closest point is on an edge or a vertex, the side is taken from the triangle that faces the point or
        # turns away from it most directly.
        if squared < least / TIE or best < 0 or abs(height) > steepest:
            best, steepest = t, abs(height)
            least = min(least, squared)
            nearest[0] = np.sqrt(squared) if height >= 0.0 else -np.sqrt(squared)
            nearest[1], nearest[2], nearest[3] = wa, wb, wc
    return best


@array_kernel
def encloses(local: np.ndarray, triangles: np.ndarray, x: float, y: float, z: float, turned: np.ndarray) -> bool:
    """Whether a point is inside an organ: whether a ray from it leaves the surface more often than it enters it.

    In an organ that was flattened or turned inside out, the orientation of the nearest triangle may be misleading.

    Args:
        local: (3, V) [u].
        triangles: (T, 3), counter-clockwise from outside.
        x: The point [u].
        y: The point [u].
        z: The point [u].
        turned: (3, V) workspace.

    Returns:
        Whether the point is inside.
    """
    # The ray is along (0.36, 0.48, 0.8), so that it meets surfaces along the tool's axes at no corner or edge.
    count = local.shape[1]
    u, v, w = turned[0], turned[1], turned[2]
    for i in range(count):
        px, py, pz = local[0, i] - x, local[1, i] - y, local[2, i] - z
        u[i] = 0.8 * px - 0.6 * py
        v[i] = 0.48 * px + 0.64 * py - 0.6 * pz
        w[i] = 0.36 * px + 0.48 * py + 0.8 * pz
    leaves = 0
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if max(w[a], w[b], w[c]) <= 0.0:
            continue
        of_a, of_b, of_c = u[b] * v[c] - v[b] * u[c], u[c] * v[a] - v[c] * u[a], u[a] * v[b] - v[a] * u[b]
        if of_a > 0.0 and of_b > 0.0 and of_c > 0.0:
            leaves += of_a * w[a] + of_b * w[b] + of_c * w[c] > 0.0
        elif of_a < 0.0 and of_b < 0.0 and of_c < 0.0:
            leaves -= of_a * w[a] + of_b * w[b] + of_c * w[c] < 0.0
    return leaves > 0


@array_kernel
def drop_outside(points: np.ndarray, flags: np.ndarray, local: np.ndarray, triangles: np.ndarray, scratch: Any) -> None:
    """Clear the flags of contact nodes that are not in the organ, as their rays met a part of it that is inside out.

    Args:
        points: (n, 3) the nodes [u].
        flags: (n,) changed.
        local: (3, V) vertices of the organ when the rays were cast [u].
        triangles: (T, 3).
        scratch: `Scratch`.
    """
    for i in range(flags.shape[0]):
        if flags[i] and not encloses(local, triangles, points[i, 0], points[i, 1], points[i, 2], scratch.turned):
            flags[i] = False


@array_kernel
def _find_slid(
    organ: Any, triangles: np.ndarray, swept: int, x: float, y: float, z: float, reach: float, scratch: Any
) -> int:
    """The triangle that a corner has gone behind, among those around the one nearest to it at the last query.

    Returns its index, -1 if there is none, and writes the nearest point into `scratch.nearest`; see `find_nearest`.
    """
    local, last, nearest, around = organ.local, organ.last_local, scratch.nearest, scratch.around
    boxes, away = scratch.other_boxes, scratch.away
    fill_boxes(last, triangles, organ.candidates, swept, boxes)
    t = find_nearest(last, triangles, organ.candidates, swept, x, y, z, reach, boxes, away, nearest)
    if t < 0 or not encloses(local, triangles, x, y, z, scratch.turned):
        return -1
    found = list_around(triangles, t, around)
    fill_boxes(local, triangles, around, found, boxes)
    t = find_nearest(local, triangles, around, found, x, y, z, np.inf, boxes, away, nearest)
    return t if -nearest[0] > MARGIN else -1


@array_kernel
def gather_sunk_corners(
    table: Any,
    count: int,
    first_row: int,
    room: int,
    tool: Any,
    organ: Any,
    triangles: np.ndarray,
    swept: int,
    placement: Any,
    settled: bool,
    scratch: Any,
) -> int:
    """Append a constraint for each corner of the tool that is in the organ and that no constraint so far pushes out.

    A corner that slides over an edge of the organ's mesh may pass the plane of the triangle that it comes to while it
    is still over the one that it leaves: its path then goes through neither. Its present position decides instead.

    Writes into `scratch` the triangles near the tool, their boxes, their number (`listed`), and the distances of the
    corners from them as far as these are computed.
    """
    local, last, corners, names = organ.local, organ.last_local, tool.corners, table.names
    reach = SUNK * tool.extent[7]
    nearest, normal, near = scratch.nearest, scratch.normal, scratch.near
    heights, behind, turned = scratch.corner_heights, scratch.corner_behind, scratch.turned
    boxes, away, others, distances = scratch.boxes, scratch.away, scratch.other_boxes, scratch.corner_distances
    found = list_near(tool.extent, local, triangles, reach, near, scratch.codes)
    fill_boxes(local, triangles, near, found, boxes)
    scratch.listed[1] = found
    has_last = False
    for corner in range(corners.shape[0]):
        x, y, z = corners[corner, 0], corners[corner, 1], corners[corner, 2]
        distances[corner] = np.inf
        if heights[corner] < -RESIDUAL_TOLERANCE or count == room:
            continue
        t = find_nearest(local, triangles, near, found, x, y, z, reach, boxes, away, nearest)
        depth = -nearest[0]
        if t >= 0:
            distances[corner] = nearest[0]
        if t < 0:
            # Nothing is near; or, where a solve has put the organ, the corner is so deep in it that the nearest way out
            # may be the wrong one. It slid no farther than to the triangles around the one where it was.
            if not (settled and behind[corner]):
                continue
            has_last = False
            t = _find_slid(organ, triangles, swept, x, y, z, reach, scratch)
            if t < 0:
                continue
            depth = -nearest[0]
        else:
            # A constraint from the corner's path that is violated by less than the tolerance pushes no more, however
            # deep the corner is behind a triangle beside. It does not count as holding the corner.
            least = -MARGIN if heights[corner] >= -MARGIN else RESIDUAL_TOLERANCE
            if depth < least or (depth > MARGIN and not encloses(local, triangles, x, y, z, turned)):
                continue
        wa, wb, wc = nearest[1], nearest[2], nearest[3]
        name = constraint_name(ON_CORNER, corner, placement.first_vertex, t)
        known = False
        for row in range(first_row, count):
            known = known or names[row] == name
        if known:
            continue
        # A corner that was deep in the organ before may have another way out.
        if not has_last:
            fill_boxes(last, triangles, near, found, others)
            has_last = True
        if find_nearest(last, triangles, near, found, x, y, z, np.inf, others, away, nearest) < 0:
            continue
        if nearest[0] < -reach:
            continue
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        fill_local_normal(local, triangles[t], normal)
        if depth > MARGIN:
            # Straight towards the nearest point, which may be on an edge or a vertex.
            normal[0] = (wa * local[0, a] + wb * local[0, b] + wc * local[0, c] - x) / depth
            normal[1] = (wa * local[1, a] + wb * local[1, b] + wc * local[1, c] - y) / depth
            normal[2] = (wa * local[2, a] + wb * local[2, b] + wc * local[2, c] - z) / depth
        if not np.isfinite(normal[0] + normal[1] + normal[2]):
            # A triangle without area: its neighbours determine the direction.
            continue
        count = append_constraint(
            table, count, (a, b, c), (wa, wb, wc), (-normal[0], -normal[1], -normal[2]), (x, y, z), last, placement,
            best_plane(tool.plane_normals, -normal[0], -normal[1], -normal[2]), name,
        )  # fmt: skip
    return count
