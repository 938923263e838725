"""Intersections of rays with a triangle surface.

There are two ways to compute them. `intersect_triangle` is Möller and Trumbore's test (Fast, minimum storage
ray-triangle intersection, Journal of Graphics Tools 2(1), 1997) for one ray and one triangle; `cast_ray` applies it to
every triangle. `cast_columns` casts all rays of a tool at once: in the frame of a group of parallel lines the test
becomes two-dimensional, most triangles fall outside the group's rectangle, and each line is tested only with the few
triangles above or below it.

`cast_columns` is watertight. The side of an edge on which a line passes is decided by the sign of a 2 x 2
determinant, computed so that the two triangles which share the edge see exactly opposite signs; where rounding could
spoil the sign it is recomputed without rounding error, and a line that passes exactly through an edge or a vertex is
treated as if moved by an infinitesimal amount, first along +u, then along +v. A line therefore meets exactly one of
the triangles around a vertex or an edge that it crosses, and at a silhouette both or none.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from spatula_env._kernels import ARRAYS, array_kernel, kernel
from spatula_env.contact.structures import NO_HIT

F8, F8_2, I4_2 = ARRAYS["f8"], ARRAYS["f8_2"], ARRAYS["i4_2"]

MOELLER_TRUMBORE_EPSILON = 1e-12
"""A ray whose determinant is smaller than this times the lengths involved is parallel to the triangle."""

TIE_TOLERANCE = 1e-12
"""Hits whose distances differ by less than this, relative to the coordinates' size, are one event."""


@array_kernel
def intersect_triangle(
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
) -> tuple[bool, float, float, float]:
    """Möller-Trumbore: where the line origin + t direction meets the triangle (a, b, c).

    Args:
        ox: Origin.
        oy: Origin.
        oz: Origin.
        dx: Direction; t is in its length.
        dy: Direction.
        dz: Direction.
        a: (3,) first corner.
        b: (3,) second corner.
        c: (3,) third corner.

    Returns:
        (hit, t, v, w): the point is (1 - v - w) a + v b + w c = origin + t direction; t may be negative.
    """
    e1x, e1y, e1z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    e2x, e2y, e2z = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
    determinant = e1x * px + e1y * py + e1z * pz
    size = (abs(e1x) + abs(e1y) + abs(e1z)) * (abs(px) + abs(py) + abs(pz))
    if abs(determinant) <= MOELLER_TRUMBORE_EPSILON * size:
        return False, 0.0, 0.0, 0.0
    inverse = 1.0 / determinant
    tx, ty, tz = ox - a[0], oy - a[1], oz - a[2]
    v = (tx * px + ty * py + tz * pz) * inverse
    # The tolerance keeps rays through shared edges, where both triangles may round to just outside.
    if v < -1e-12 or v > 1.0 + 1e-12:
        return False, 0.0, 0.0, 0.0
    qx, qy, qz = ty * e1z - tz * e1y, tz * e1x - tx * e1z, tx * e1y - ty * e1x
    w = (dx * qx + dy * qy + dz * qz) * inverse
    if w < -1e-12 or v + w > 1.0 + 1e-12:
        return False, 0.0, 0.0, 0.0
    t = (e2x * qx + e2y * qy + e2z * qz) * inverse
    return True, t, v, w


@array_kernel
def _first_met(
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, vertices: np.ndarray, triangles: np.ndarray
) -> tuple[int, float, float, float, float]:
    """Implementation of `cast_ray`, with the ray's origin and direction as scalars."""
    best, best_t, best_v, best_w, facing = NO_HIT, np.inf, 0.0, 0.0, 0.0
    for k in range(triangles.shape[0]):
        a, b, c = vertices[triangles[k, 0]], vertices[triangles[k, 1]], vertices[triangles[k, 2]]
        hit, t, v, w = intersect_triangle(ox, oy, oz, dx, dy, dz, a, b, c)
        if hit and 0.0 <= t < best_t:
            nx = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
            ny = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
            nz = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
            best, best_t, best_v, best_w = k, t, v, w
            facing = 1.0 if nx * dx + ny * dy + nz * dz > 0.0 else -1.0
    return best, best_t, best_v, best_w, facing


@kernel("Tuple((i8, f8, f8, f8, f8))(f8[::1], f8[::1], f8[:,::1], i4[:,::1])")
def cast_ray(
    origin: np.ndarray, direction: np.ndarray, vertices: np.ndarray, triangles: np.ndarray
) -> tuple[int, float, float, float, float]:
    """The first triangle that a ray meets, by testing every one.

    Args:
        origin: (3,) start of the ray [u].
        direction: (3,) its direction; distances are in this vector's length.
        vertices: (V, 3) [u].
        triangles: (T, 3).

    Returns:
        (triangle, t, v, w, facing): index or -1; distance; weights of the second and third corner; and the sign of
        the triangle's normal along the direction: positive where the ray leaves the body, negative where it enters.
    """
    ox, oy, oz = origin[0], origin[1], origin[2]
    dx, dy, dz = direction[0], direction[1], direction[2]
    return _first_met(ox, oy, oz, dx, dy, dz, vertices, triangles)


@array_kernel
def _two_product(a: float, b: float) -> tuple[float, float]:
    """The product and its rounding error, a b = p + e exactly (Dekker, Numerische Mathematik 18, 1971)."""
    p = a * b
    split_a = 134217729.0 * a
    high_a = split_a - (split_a - a)
    low_a = a - high_a
    split_b = 134217729.0 * b
    high_b = split_b - (split_b - b)
    low_b = b - high_b
    return p, ((high_a * high_b - p) + high_a * low_b + low_a * high_b) + low_a * low_b


@array_kernel
def edge_function(au: float, av: float, bu: float, bv: float) -> tuple[float, int]:
    """On which side of the directed edge a -> b the origin lies, in the plane.

    Args:
        au: First coordinate of a, relative to the point asked about.
        av: Second coordinate of a.
        bu: First coordinate of b.
        bv: Second coordinate of b.

    Returns:
        (determinant, side): twice the signed area of (origin, a, b); and its sign, +1 or -1, where the sign of a
        vanishing determinant is that for the origin moved by an infinitesimal step along +u, then along +v. It is 0
        only if a equals b. Exchanging a and b exchanges the signs exactly.
    """
    left, right = au * bv, av * bu
    determinant = left - right
    # 3.4e-16 > 1.5 * 2**-52: bound on the rounding error of the two products and their difference.
    if abs(determinant) > 3.4e-16 * (abs(left) + abs(right)):
        return determinant, 1 if determinant > 0.0 else -1
    left, left_error = _two_product(au, bv)
    right, right_error = _two_product(av, bu)
    determinant = (left - right) + (left_error - right_error)
    if determinant > 0.0:
        return determinant, 1
    if determinant < 0.0:
        return determinant, -1
    # A step (s, 0) changes the determinant by s (av - bv); a step (0, s) by s (bu - au).
    if av != bv:
        return 0.0, 1 if av > bv else -1
    if au != bu:
        return 0.0, 1 if bu > au else -1
    return 0.0, 0


@array_kernel
def line_meets_triangle(
    pu: float,
    pv: float,
    au: float,
    av: float,
    bu: float,
    bv: float,
    cu: float,
    cv: float,
) -> tuple[int, float, float, float]:
    """Whether a point p lies in a triangle (a, b, c) of the plane; in a mesh, each point lies in one triangle only.

    Returns:
        (facing, weight_a, weight_b, weight_c): +1 if the triangle is counter-clockwise about p (its normal has a
        positive component along w), -1 if clockwise, 0 if p is outside; and the barycentric weights of p.
    """
    au, av, bu, bv, cu, cv = au - pu, av - pv, bu - pu, bv - pv, cu - pu, cv - pv
    area_c, side_c = edge_function(au, av, bu, bv)
    area_a, side_a = edge_function(bu, bv, cu, cv)
    if side_a != side_c:
        return 0, 0.0, 0.0, 0.0
    area_b, side_b = edge_function(cu, cv, au, av)
    if side_b != side_c or side_c == 0:
        return 0, 0.0, 0.0, 0.0
    scale = 1.0 / (area_a + area_b + area_c)
    return side_c, area_a * scale, area_b * scale, area_c * scale


@array_kernel
def _record_hit(
    hits: np.ndarray,
    distances: np.ndarray,
    node: int,
    side: int,
    distance: float,
    facing: int,
    triangle: int,
    tie: float,
) -> None:
    """Keep the nearest hit of one ray, and the sum of facings of all hits at that same distance.

    `hits[node, side]` holds (triangle, facing): the triangle is one that the ray leaves through, if the nearest event
    has any.
    """
    nearest = distances[node, side]
    if distance < nearest - tie:
        distances[node, side] = distance
        hits[node, side, 0] = triangle
        hits[node, side, 1] = facing
    elif distance <= nearest + tie:
        hits[node, side, 1] += facing
        if facing > 0:
            hits[node, side, 0] = triangle


@array_kernel
def _cast_past_grazes(
    node: int,
    side: int,
    direction: float,
    pu: float,
    pv: float,
    height: float,
    local: np.ndarray,
    triangles: np.ndarray,
    hits: np.ndarray,
    distances: np.ndarray,
) -> None:
    """Cast one ray again beyond an event whose facings cancel: it grazed a silhouette and crossed nothing."""
    while hits[node, side, 1] == 0 and distances[node, side] < np.inf:
        grazed = distances[node, side]
        distances[node, side] = np.inf
        hits[node, side, 0] = NO_HIT
        for k in range(triangles.shape[0]):
            a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
            facing, wa, wb, wc = line_meets_triangle(
                pu, pv, local[0, a], local[1, a], local[0, b], local[1, b], local[0, c], local[1, c]
            )
            if facing != 0:
                z = wa * local[2, a] + wb * local[2, b] + wc * local[2, c]
                tie = TIE_TOLERANCE * (1.0 + abs(height) + abs(z))
                distance = direction * (z - height)
                if distance > grazed + tie:
                    towards = facing if direction > 0.0 else -facing
                    _record_hit(hits, distances, node, side, distance, towards, k, tie)


@array_kernel
def _fill_axes(frame: np.ndarray, rotation: np.ndarray, axes: np.ndarray) -> None:
    """Write the rows of a group's frame (3, 3), of a tool with a rotation matrix (9,), in the world (9,)."""
    for row in range(3):
        for column in range(3):
            axes[3 * row + column] = (
                frame[row, 0] * rotation[3 * column]
                + frame[row, 1] * rotation[3 * column + 1]
                + frame[row, 2] * rotation[3 * column + 2]
            )


@array_kernel
def _project(
    vertices: np.ndarray,
    position: np.ndarray,
    axes: np.ndarray,
    bounds: np.ndarray,
    local: np.ndarray,
    codes: np.ndarray,
) -> bool:
    """Write vertices (V, 3) in a group's axes (9,) into local (3, V), and beyond which of its bounds (4,) they are.

    Returns:
        Whether all coordinates are finite.
    """
    least_u, greatest_u, least_v, greatest_v = bounds[0], bounds[1], bounds[2], bounds[3]
    # Plain loops, so that they are vectorised.
    along_u, along_v, along_w = local[0], local[1], local[2]
    for i in range(vertices.shape[0]):
        x, y, z = vertices[i, 0] - position[0], vertices[i, 1] - position[1], vertices[i, 2] - position[2]
        along_u[i] = axes[0] * x + axes[1] * y + axes[2] * z
        along_v[i] = axes[3] * x + axes[4] * y + axes[5] * z
        along_w[i] = axes[6] * x + axes[7] * y + axes[8] * z
    broken = False
    for i in range(vertices.shape[0]):
        u, v = along_u[i], along_v[i]
        codes[i] = (u < least_u) | ((u > greatest_u) << 1) | ((v < least_v) << 2) | ((v > greatest_v) << 3)
        broken |= not abs(u + v + along_w[i]) < np.inf
    return not broken


@array_kernel
def _record_on_line(
    nodes: np.ndarray,
    node_height: np.ndarray,
    hits: np.ndarray,
    distances: np.ndarray,
    w: float,
    facing: int,
    triangle: int,
) -> None:
    """Record the meeting of a line and a triangle at a height w, for the two nodes (2,) on the line, -1 for none."""
    plus, minus = nodes[0], nodes[1]
    if plus >= 0:
        # The node on the +w face looks inwards along -w and outwards along +w.
        gap = node_height[plus] - w
        tie = TIE_TOLERANCE * (1.0 + abs(node_height[plus]) + abs(w))
        if gap >= 0.0:
            _record_hit(hits, distances, plus, 0, gap, -facing, triangle, tie)
        if gap <= 0.0:
            _record_hit(hits, distances, plus, 1, -gap, facing, triangle, tie)
    if minus >= 0:
        gap = w - node_height[minus]
        tie = TIE_TOLERANCE * (1.0 + abs(node_height[minus]) + abs(w))
        if gap >= 0.0:
            _record_hit(hits, distances, minus, 0, gap, facing, triangle, tie)
        if gap <= 0.0:
            _record_hit(hits, distances, minus, 1, -gap, -facing, triangle, tie)


@array_kernel
def _cast_group(
    group: int, rays: Any, local: np.ndarray, codes: np.ndarray, triangles: np.ndarray, memory: Any
) -> None:
    """Cast the rays of a group at the triangles (T, 3), whose vertices `_project` has written."""
    row_u, row_columns, column_v = rays.row_u, rays.row_columns, rays.column_v
    first_row, last_row = rays.group_rows[group], rays.group_rows[group + 1]
    for k in range(triangles.shape[0]):
        # Unsigned, so that Numba does not check for negative indices, which count from the end.
        a, b, c = np.uint32(triangles[k, 0]), np.uint32(triangles[k, 1]), np.uint32(triangles[k, 2])
        if codes[a] & codes[b] & codes[c]:
            continue
        au, bu, cu = local[0, a], local[0, b], local[0, c]
        av, bv, cv = local[1, a], local[1, b], local[1, c]
        low_u, high_u = min(au, bu, cu), max(au, bu, cu)
        low_v, high_v = min(av, bv, cv), max(av, bv, cv)
        row = first_row
        if last_row - first_row > 8:
            row = first_row + np.searchsorted(row_u[first_row:last_row], low_u)
        while row < last_row and row_u[row] < low_u:
            row += 1
        while row < last_row and row_u[row] <= high_u:
            column, last_column = row_columns[row], row_columns[row + 1]
            if last_column - column > 8:
                column = column + np.searchsorted(column_v[column:last_column], low_v)
            while column < last_column and column_v[column] < low_v:
                column += 1
            while column < last_column and column_v[column] <= high_v:
                facing, wa, wb, wc = line_meets_triangle(row_u[row], column_v[column], au, av, bu, bv, cu, cv)
                if facing != 0:
                    w = wa * local[2, a] + wb * local[2, b] + wc * local[2, c]
                    _record_on_line(
                        rays.column_nodes[column], rays.node_height, memory.hits, memory.distances, w, facing, k
                    )
                column += 1
            row += 1


@array_kernel
def _cast_grazing(group: int, rays: Any, local: np.ndarray, triangles: np.ndarray, memory: Any) -> None:
    """Cast those rays of a group again whose nearest event is a graze."""
    hits, distances = memory.hits, memory.distances
    for row in range(rays.group_rows[group], rays.group_rows[group + 1]):
        for column in range(rays.row_columns[row], rays.row_columns[row + 1]):
            for slot in range(2):
                node = rays.column_nodes[column, slot]
                if node < 0:
                    continue
                for side in range(2):
                    if hits[node, side, 1] == 0 and distances[node, side] < np.inf:
                        # slot 0 looks inwards along -w; slot 1 along +w; outwards is the reverse.
                        direction = (-1.0 if slot == 0 else 1.0) * (1.0 if side == 0 else -1.0)
                        _cast_past_grazes(
                            node, side, direction, rays.row_u[row], rays.column_v[column], rays.node_height[node],
                            local, triangles, hits, distances,
                        )  # fmt: skip


@array_kernel
def cast_columns(
    position: np.ndarray,
    rotation: np.ndarray,
    vertices: np.ndarray,
    triangles: np.ndarray,
    rays: Any,
    memory: Any,
    organ: Any,
    axes: np.ndarray,
) -> int:
    """Cast every contact node's inward and outward ray at a surface.

    Args:
        position: (3,) of the tool [u].
        rotation: (9,) its rotation matrix, row by row.
        vertices: (V, 3) of the surface [u].
        triangles: (T, 3).
        rays: `RayLines` of the tool.
        memory: `NodeMemory`. Its `hits` (n, 2, 2) are the result: for each node the inward ray (0) and the outward ray
            (1), the triangle, or `NO_HIT`; and the facing, positive where the ray leaves the body, negative where it
            enters, 0 where it meets nothing. `distances` (n, 2): along the ray [u], infinite where it meets nothing.
        organ: `LocalOrgan`, for workspace.
        axes: (9,) workspace.

    Returns:
        0; 1 if a vertex or the pose is not finite; 2 if a triangle names a vertex that does not exist.
    """
    node_count, local, codes = rays.node_height.shape[0], organ.ray_local, organ.codes
    vertex_count, least, greatest = vertices.shape[0], 0, 0
    for k in range(triangles.shape[0]):
        a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        least, greatest = min(least, a, b, c), max(greatest, a, b, c)
    if least < 0 or greatest >= max(vertex_count, 1):
        return 2
    for i in range(node_count):
        for side in range(2):
            memory.hits[i, side, 0] = NO_HIT
            memory.hits[i, side, 1] = 0
            memory.distances[i, side] = np.inf
    for group in range(rays.frames.shape[0]):
        _fill_axes(rays.frames[group], rotation, axes)
        if not _project(vertices, position, axes, rays.bounds[group], local, codes):
            return 1
        _cast_group(group, rays, local, codes, triangles, memory)
        _cast_grazing(group, rays, local, triangles, memory)
    return 0
