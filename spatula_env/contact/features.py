"""Contacts of a tool and an organ in one query, as constraints on points of the organ's surface.

A convex tool and a triangle surface that are apart meet first at a vertex of the organ and a face of the tool, at a
corner of the tool and a triangle, or at an edge of each. Constraints at all of these keep the surface out of the tool,
however coarse both are. The flagged contact nodes, the published method, add theirs; between nodes, at the tool's rim
and on faces that carry no nodes the other three kinds take their place.

The face that has met a point is found by `path.entry_plane`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from spatula_env._kernels import array_kernel
from spatula_env.contact.corners import gather_corners, gather_sunk_corners
from spatula_env.contact.path import MARGIN, RESIDUAL_TOLERANCE, entry_plane
from spatula_env.contact.rows import ON_EDGE, ON_GROUND, ON_NODE, ON_VERTEX, append_constraint, constraint_name
from spatula_env.contact.structures import (
    FOURTH,
    FRICTION,
    GROUND,
    NO_VERTEX,
    NORMAL,
    ORIGIN,
    OWNER,
    PLANE,
    POINT,
    WEIGHTS,
)

EDGE_PART = 0.5
"""An edge of the organ that moves farther between two queries than this part of the tool's thickness is also checked at
times in between, about one for each such part."""

MOST_SAMPLES = 16
"""Most times between two queries at which an edge is checked."""

BISECTIONS = 8
"""Steps of bisection to find when an edge met the tool."""

PASSES_UNDECIDED = 2
"""After this many passes a vertex of the organ stays before the face of the tool that has pushed it."""

PASSES_AS_MET = 6
"""After this many passes corners of the tool push a triangle also where they are now, and not only where they met
it."""

ROUNDING = 1e-12
"""Greatest rounding error of a height interpolated between two others, relative to the greater of them."""

PARALLEL = 1e-6
"""Edges are parallel if the sine of the angle between them is no more than this."""


@array_kernel
def gather_ground(
    table: Any,
    count: int,
    vertices: np.ndarray,
    reference: np.ndarray,
    inverse_mass: np.ndarray,
    height: float,
    friction: float,
) -> int:
    """Append one constraint for each vertex that is below the ground or touches it. Returns the new count."""
    rows, features, names = table.rows, table.features, table.names
    for i in range(vertices.shape[0]):
        if vertices[i, 2] > height + MARGIN or inverse_mass[i] == 0.0:
            continue
        row = rows[count]
        row[:] = 0.0
        features[count, 0], features[count, 1], features[count, 2] = i, i, i
        features[count, FOURTH], features[count, OWNER], features[count, PLANE] = NO_VERTEX, GROUND, -1
        names[count] = constraint_name(ON_GROUND, 0, i, i)
        row[WEIGHTS], row[NORMAL + 2], row[FRICTION] = 1.0, 1.0, friction
        row[POINT], row[POINT + 1], row[POINT + 2] = vertices[i, 0], vertices[i, 1], height
        for axis in range(3):
            row[ORIGIN + axis] = reference[i, axis]
        count += 1
    return count


@array_kernel
def gather_nodes(
    table: Any, count: int, tool: Any, nodes: Any, last: np.ndarray, triangles: np.ndarray, placement: Any
) -> int:
    """Append one constraint for each flagged node, which keeps its contact point before the node's face."""
    flags, triangle, record = nodes.flags, nodes.triangle, nodes.record
    points, normals, face = tool.nodes, tool.normals, tool.face
    for i in range(points.shape[0]):
        if flags[i]:
            t = triangle[i]
            count = append_constraint(
                table, count,
                (triangles[t, 0], triangles[t, 1], triangles[t, 2]),
                (record[i, 0], record[i, 1], record[i, 2]),
                (normals[i, 0], normals[i, 1], normals[i, 2]),
                (points[i, 0], points[i, 1], points[i, 2]),
                last, placement, face[i], constraint_name(ON_NODE, i, placement.first_vertex, 0),
            )  # fmt: skip
    return count


@array_kernel
def find_candidates(extent: np.ndarray, organ: Any, triangles: np.ndarray) -> int:
    """List the triangles that may have met the tool on their paths since the last query. Returns how many there are."""
    local, last, codes, candidates = organ.local, organ.last_local, organ.codes, organ.candidates
    low_x, low_y, low_z = extent[0] - MARGIN, extent[1] - MARGIN, extent[2] - MARGIN
    high_x, high_y, high_z = extent[3] + MARGIN, extent[4] + MARGIN, extent[5] + MARGIN
    for i in range(local.shape[1]):
        codes[i] = (
            (max(local[0, i], last[0, i]) < low_x)
            | ((max(local[1, i], last[1, i]) < low_y) << 1)
            | ((max(local[2, i], last[2, i]) < low_z) << 2)
            | ((min(local[0, i], last[0, i]) > high_x) << 3)
            | ((min(local[1, i], last[1, i]) > high_y) << 4)
            | ((min(local[2, i], last[2, i]) > high_z) << 5)
        )
    found = 0
    for t in range(triangles.shape[0]):
        a, b, c = np.uint32(triangles[t, 0]), np.uint32(triangles[t, 1]), np.uint32(triangles[t, 2])
        if codes[a] & codes[b] & codes[c] == 0:
            candidates[found] = t
            found += 1
    return found


@array_kernel
def pushed_by(known: int, table: Any, owner: int, name: int, plane: int) -> int:
    """The face of a tool by which a contact pushed in the last pass.

    Args:
        known: Number of contacts that pushed.
        table: `ConstraintTable` of them.
        owner: Index of the tool.
        name: Name of the contact.
        plane: The face to return if this contact did not push.

    Returns:
        Index of the face.
    """
    names, features = table.names, table.features
    for e in range(known):
        if names[e] == name and features[e, OWNER] == owner:
            return int(features[e, PLANE])
    return plane


@array_kernel
def gather_vertices(table: Any, count: int, tool: Any, organ: Any, placement: Any, tried: int, trial: Any) -> int:
    """Append one constraint for each vertex of the organ that came into the tool or touches it.

    The path of a vertex depends on where the last solve has put it, so it might be put onto one face and then onto
    another, pass after pass. Therefore a vertex that one of the `tried` constraints in `trial` has pushed stays before
    the same face.
    """
    local, last, codes = organ.local, organ.last_local, organ.codes
    plane_normals, plane_offsets = tool.plane_normals, tool.plane_offsets
    for i in range(local.shape[1]):
        if codes[i] != 0:
            continue
        x, y, z = local[0, i], local[1, i], local[2, i]
        p = entry_plane(last[0, i], last[1, i], last[2, i], x, y, z, plane_normals, plane_offsets, MARGIN)
        if p < 0:
            continue
        name = constraint_name(ON_VERTEX, 0, i + placement.first_vertex, 0)
        p = pushed_by(tried, trial, placement.owner, name, p)
        nx, ny, nz = plane_normals[p, 0], plane_normals[p, 1], plane_normals[p, 2]
        height = nx * x + ny * y + nz * z - plane_offsets[p]
        count = append_constraint(
            table, count, (i, i, i), (1.0, 0.0, 0.0), (nx, ny, nz),
            (x - height * nx, y - height * ny, z - height * nz), last, placement, p, name,
        )  # fmt: skip
    return count


@array_kernel
def ridge_contact(
    ridges: np.ndarray,
    corners: np.ndarray,
    plane_normals: np.ndarray,
    f: int,
    g: int,
    local: np.ndarray,
    a: int,
    b: int,
    result: np.ndarray,
) -> bool:
    """Find the contact of an edge of the organ with the tool's edge between faces f and g.

    Args:
        ridges: (P, P, 2) of the tool.
        corners: (K, 3) of the tool [u].
        plane_normals: (P, 3) of the tool.
        f: Index of one face.
        g: Index of the other face.
        local: (3, V) vertices of the organ in the tool's frame [u].
        a: First vertex of the organ's edge.
        b: Second vertex.
        result: (7,) written: the place on the organ's edge as a fraction of its length, the normal, and the point on
            the tool's edge.

    Returns:
        Whether there is such a contact: not if the faces share no edge, if the edges are parallel, or if their common
        normal is not between the normals of the faces.
    """
    if ridges[f, g, 0] < 0:
        return False
    start, end = corners[ridges[f, g, 0]], corners[ridges[f, g, 1]]
    ux, uy, uz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    wx, wy, wz = local[0, b] - local[0, a], local[1, b] - local[1, a], local[2, b] - local[2, a]
    nx, ny, nz = wy * uz - wz * uy, wz * ux - wx * uz, wx * uy - wy * ux
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    ridge_length = np.sqrt(ux * ux + uy * uy + uz * uz)
    if length <= PARALLEL * ridge_length * np.sqrt(wx * wx + wy * wy + wz * wz):
        return False
    nf, ng = plane_normals[f], plane_normals[g]
    along_f = nx * nf[0] + ny * nf[1] + nz * nf[2]
    along_g = nx * ng[0] + ny * ng[1] + nz * ng[2]
    sign = 1.0 if along_f + along_g > 0.0 else -1.0
    along_f, along_g = sign * along_f, sign * along_g
    cosine = nf[0] * ng[0] + nf[1] * ng[1] + nf[2] * ng[2]
    # n = alpha nf + beta ng; neither coefficient may be negative.
    if along_f - cosine * along_g < 0.0 or along_g - cosine * along_f < 0.0:
        return False
    scale = sign / length
    nx, ny, nz = nx * scale, ny * scale, nz * scale
    mx, my, mz = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux
    across = wx * mx + wy * my + wz * mz
    to_ridge = (start[0] - local[0, a]) * mx + (start[1] - local[1, a]) * my + (start[2] - local[2, a]) * mz
    place = min(max(to_ridge / across, 0.0), 1.0)
    px, py, pz = local[0, a] + place * wx, local[1, a] + place * wy, local[2, a] + place * wz
    part = ((px - start[0]) * ux + (py - start[1]) * uy + (pz - start[2]) * uz) / (ridge_length * ridge_length)
    part = min(max(part, 0.0), 1.0)
    result[0] = place
    result[1], result[2], result[3] = nx, ny, nz
    result[4], result[5], result[6] = start[0] + part * ux, start[1] + part * uy, start[2] + part * uz
    return True


@array_kernel
def fill_heights(
    plane_normals: np.ndarray,
    plane_offsets: np.ndarray,
    last: np.ndarray,
    local: np.ndarray,
    a: int,
    b: int,
    heights: np.ndarray,
) -> bool:
    """Write the heights of the ends of an organ's edge over the tool's faces; they change linearly between two queries.

    If a face separates edge and tool all the time, the function returns at once and leaves the other rows as they are.

    Args:
        plane_normals: (P, 3) of the tool.
        plane_offsets: (P,) of the tool [u].
        last: (3, V) vertices at time 0, the last query [u].
        local: (3, V) vertices at time 1, this query [u].
        a: First vertex of the edge.
        b: Second vertex.
        heights: (P, 4) written: of a and b at time 0, of a and b at time 1; negative behind a face [u].

    Returns:
        Whether there is such a separating face.
    """
    for p in range(plane_offsets.shape[0]):
        nx, ny, nz, offset = plane_normals[p, 0], plane_normals[p, 1], plane_normals[p, 2], plane_offsets[p]
        a_before = nx * last[0, a] + ny * last[1, a] + nz * last[2, a] - offset
        b_before = nx * last[0, b] + ny * last[1, b] + nz * last[2, b] - offset
        a_now = nx * local[0, a] + ny * local[1, a] + nz * local[2, a] - offset
        b_now = nx * local[0, b] + ny * local[1, b] + nz * local[2, b] - offset
        heights[p, 0], heights[p, 1], heights[p, 2], heights[p, 3] = a_before, b_before, a_now, b_now
        # Heights at times in between are within these, except for rounding.
        least, greatest = min(a_before, b_before, a_now, b_now), max(a_before, b_before, a_now, b_now)
        if least - MARGIN > ROUNDING * greatest:
            return True
    return False


@array_kernel
def fill_clipping(heights: np.ndarray, clipping: np.ndarray) -> int:
    """Write the rows of heights (P, 4), from `fill_heights`, whose faces may clip the edge, into clipping (P, 4).

    The whole edge stays behind the other faces all the time.

    Returns:
        The number of these rows.
    """
    count = 0
    for p in range(heights.shape[0]):
        one, other, third, fourth = heights[p, 0], heights[p, 1], heights[p, 2], heights[p, 3]
        least, greatest = min(one, other, third, fourth), max(one, other, third, fourth)
        if greatest - MARGIN > -ROUNDING * max(-least, greatest):
            clipping[count, 0], clipping[count, 1], clipping[count, 2], clipping[count, 3] = one, other, third, fourth
            count += 1
    return count


@array_kernel
def clip_edge(heights: np.ndarray, time: float) -> tuple[float, float, int, int]:
    """The part of an organ's edge that is in the tool, or touches it, at a time between two queries.

    Args:
        heights: (P, 4) from `fill_heights` [u].
        time: From 0 to 1; vertices move on straight lines.

    Returns:
        (first, end, plane_in, plane_out): where the edge enters and leaves the tool, as fractions of its length, with
        first > end if it stays outside; and the faces through which it does, -1 where it begins or ends inside.
    """
    first, end = 0.0, 1.0
    plane_in, plane_out = -1, -1
    for p in range(heights.shape[0]):
        at_start = heights[p, 0] + time * (heights[p, 2] - heights[p, 0]) - MARGIN
        at_end = heights[p, 1] + time * (heights[p, 3] - heights[p, 1]) - MARGIN
        if at_start > 0.0 and at_end > 0.0:
            return 2.0, 0.0, -1, -1
        if at_start > 0.0:
            place = at_start / (at_start - at_end)
            if place > first:
                first, plane_in = place, p
        elif at_end > 0.0:
            place = at_start / (at_start - at_end)
            if place < end:
                end, plane_out = place, p
        if first > end:
            return 2.0, 0.0, -1, -1
    return first, end, plane_in, plane_out


@array_kernel
def touched_plane(heights: np.ndarray, which: int, time: float, other: int, within: float = 2.0 * MARGIN) -> int:
    """The face that an end of an edge touches, or is `within` [u] behind, at a time between two queries; -1 if none.

    A vertex on the tool's rim touches two faces. The result is then the one that is not `other`, the face through which
    the edge leaves the tool at its other end: between two different faces the edge lies over a third, or over the
    tool's edge.
    """
    best, highest, second = -1, -within, -1
    for p in range(heights.shape[0]):
        height = heights[p, which] + time * (heights[p, 2 + which] - heights[p, which])
        if height <= -within:
            continue
        if p == other:
            second = p
        elif height > highest:
            best, highest = p, height
    return best if best >= 0 else second


@array_kernel
def least_deep_plane(heights: np.ndarray, time: float, first: float, end: float) -> int:
    """The face behind which the part of an edge from `first` to `end` is least deep, at a time between two queries."""
    best, least = -1, np.inf
    for p in range(heights.shape[0]):
        at_start = heights[p, 0] + time * (heights[p, 2] - heights[p, 0])
        at_end = heights[p, 1] + time * (heights[p, 3] - heights[p, 1])
        deepest = -min(at_start + first * (at_end - at_start), at_start + end * (at_end - at_start))
        if deepest < least:
            best, least = p, deepest
    return best


@array_kernel
def meeting_time(heights: np.ndarray, samples: int) -> float:
    """The time between two queries at which an edge of the organ first touched the tool.

    Args:
        heights: (P, 4) from `fill_heights`, or only the rows that `fill_clipping` writes [u].
        samples: Number of times at which the edge is checked.

    Returns:
        The time from 0 to 1; 2 if it did not touch the tool.
    """
    first, end, _, _ = clip_edge(heights, 0.0)
    if first <= end:
        return 0.0
    low, high = 0.0, 2.0
    for sample in range(1, samples + 1):
        first, end, _, _ = clip_edge(heights, sample / samples)
        if first <= end:
            high = sample / samples
            break
        low = sample / samples
    if high > 1.0:
        return 2.0
    for _ in range(BISECTIONS):
        time = 0.5 * (low + high)
        first, end, _, _ = clip_edge(heights, time)
        if first <= end:
            high = time
        else:
            low = time
    return high


@array_kernel
def stays_over(heights: np.ndarray, plane: int, ridges: np.ndarray) -> bool:
    """Whether an edge stays over a face from one query to the next, without passing over the face's rim.

    Both its ends must stay behind the planes of all neighbouring faces, and no end that is behind the face now may lie
    on one of these planes, where a solve has put it.
    """
    for p in range(heights.shape[0]):
        if ridges[plane, p, 0] >= 0:
            for row in range(4):
                if heights[p, row] > MARGIN:
                    return False
            for row in range(2, 4):
                if heights[plane, row] < -RESIDUAL_TOLERANCE < heights[p, row]:
                    return False
    return True


@array_kernel
def border_reached(heights: np.ndarray, which: int, time: float, met: int, samples: int, ridges: np.ndarray) -> int:
    """The neighbouring face through which an edge leaves the tool once its end has swung past the rim of the face met.

    Args:
        heights: (P, 4) from `fill_heights` [u].
        which: 0 for the first end of the edge, 1 for the second.
        time: Time at which the edge first touched the tool.
        met: Index of the face that it touched.
        samples: Number of times between two queries at which the edge is checked.
        ridges: (P, P, 2) of the tool.

    Returns:
        Index of the face; -1 if there is none.
    """
    for sample in range(1, samples + 1):
        now = sample / samples
        behind = heights[met, which] + now * (heights[met, 2 + which] - heights[met, which])
        if now <= time or behind > -MARGIN:
            continue
        first, end, plane_in, plane_out = clip_edge(heights, now)
        border = plane_in if which == 0 else plane_out
        if first <= end and border < 0:
            # A solve has put the end approximately on the face that it came to.
            border = touched_plane(heights, which, now, met, RESIDUAL_TOLERANCE)
        if first <= end and border >= 0 and border != met and ridges[met, border, 0] >= 0:
            return border
    return -1


@array_kernel
def gather_edges(
    table: Any,
    count: int,
    tool: Any,
    organ: Any,
    triangles: np.ndarray,
    found: int,
    placement: Any,
    again: bool,
    scratch: Any,
) -> int:
    """Append constraints for each edge of the organ that came into the tool or touches it.

    When an edge first touches the tool, hardly any of it is inside. The faces through which that part enters and leaves
    show what the edge lies over: an edge of the tool that two faces share, or one face between two of the edges around
    it. An edge that lay on a face may afterwards swing over the face's rim. In the first pass an edge may also swing so
    far merely because nothing holds its other end yet; therefore this is checked only when contacts are looked for
    `again`, where a solve has put the organ.
    """
    local, last, candidates, codes = organ.local, organ.last_local, organ.candidates, organ.codes
    plane_normals, plane_offsets, extent = tool.plane_normals, tool.plane_offsets, tool.extent
    ridges, corners = tool.ridges, tool.corners
    contact, heights, clipping = scratch.contact, scratch.heights[: plane_offsets.shape[0]], scratch.clipping
    for k in range(found):
        t = candidates[k]
        for side in range(3):
            a, b = triangles[t, side], triangles[t, (side + 1) % 3]
            # Two triangles share an edge, in opposite directions: skip one of them. Codes tell beyond which sides of
            # the tool's box a vertex was at the last query and still is.
            if a > b or codes[a] & codes[b] != 0:
                continue
            if fill_heights(plane_normals, plane_offsets, last, local, a, b, heights):
                continue
            time, way = 0.0, 0.0
            for axis in range(3):
                way = max(way, abs(local[axis, a] - last[axis, a]), abs(local[axis, b] - last[axis, b]))
            samples = min(1 + int(way / (EDGE_PART * extent[7])), MOST_SAMPLES)
            # Most edges that get here touched the tool at the last query already.
            first, end, plane_in, plane_out = clip_edge(heights, time)
            if first > end:
                time = meeting_time(clipping[: fill_clipping(heights, clipping)], samples)
                if time > 1.0:
                    continue
                first, end, plane_in, plane_out = clip_edge(heights, time)
            # An end that touches a face counts as having come in through it.
            if plane_in < 0:
                plane_in = touched_plane(heights, 0, time, plane_out)
            if plane_out < 0:
                plane_out = touched_plane(heights, 1, time, plane_in)
            # The face over which the edge lay.
            met = least_deep_plane(heights, time, first, end)
            lies = not again or stays_over(heights, met, ridges)
            nx, ny, nz = plane_normals[met, 0], plane_normals[met, 1], plane_normals[met, 2]
            for which in range(2):
                border = plane_in if which == 0 else plane_out
                if (border < 0 or border == met) and not lies:
                    border = border_reached(heights, which, time, met, samples, ridges)
                if border < 0 or border == met:
                    continue
                if ridge_contact(ridges, corners, plane_normals, border, met, local, a, b, contact):
                    s = contact[0]
                    along = contact[1] * nx + contact[2] * ny + contact[3] * nz
                    count = append_constraint(
                        table, count, (a, b, b), (1.0 - s, s, 0.0),
                        (contact[1], contact[2], contact[3]), (contact[4], contact[5], contact[6]), last, placement,
                        met if along > 0.7 else border,
                        constraint_name(ON_EDGE, which, a + placement.first_vertex, b + placement.first_vertex),
                    )  # fmt: skip
                else:
                    place = first if which == 0 else end
                    x = local[0, a] + place * (local[0, b] - local[0, a])
                    y = local[1, a] + place * (local[1, b] - local[1, a])
                    z = local[2, a] + place * (local[2, b] - local[2, a])
                    depth = nx * x + ny * y + nz * z - plane_offsets[met]
                    count = append_constraint(
                        table, count, (a, b, b), (1.0 - place, place, 0.0), (nx, ny, nz),
                        (x - depth * nx, y - depth * ny, z - depth * nz), last, placement, met,
                        constraint_name(ON_EDGE, 2 + which, a + placement.first_vertex, b + placement.first_vertex),
                    )  # fmt: skip
    return count


@array_kernel
def gather_features(
    table: Any,
    count: int,
    tool: Any,
    organ: Any,
    triangles: np.ndarray,
    found: int,
    placement: Any,
    again: bool,
    attempt: int,
    tried: int,
    trial: Any,
    scratch: Any,
) -> int:
    """Append constraints where vertices and faces, corners and triangles, and edges and edges have met.

    Args:
        table: `ConstraintTable` with room for 9 more for each candidate and each corner of the tool.
        count: Number of constraints so far.
        tool: `ToolGeometry`.
        organ: `LocalOrgan`. In the first pass, `attempt` 0, it is where its springs have thrown it; in later ones where
            solves have put it.
        triangles: (T, 3) of the organ.
        found: Number of candidates; see `find_candidates`.
        placement: `Placement` of the tool.
        again: See `gather_edges`.
        attempt: Index of the pass.
        tried: Number of constraints that pushed in the last pass.
        trial: `ConstraintTable` of them.
        scratch: `Scratch`.

    Returns:
        The new count.
    """
    corners, undecided = tool.corners.shape[0], attempt < PASSES_UNDECIDED
    count = gather_vertices(table, count, tool, organ, placement, 0 if undecided else tried, trial)
    first = count
    count = gather_corners(
        table, count, first + 8 * corners, tool, organ, triangles, found, placement, attempt >= PASSES_AS_MET, scratch
    )
    count = gather_sunk_corners(
        table, count, first, first + 9 * corners, tool, organ, triangles, found, placement, attempt > 0, scratch
    )
    return gather_edges(table, count, tool, organ, triangles, found, placement, again, scratch)
