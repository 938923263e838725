"""The rasteriser, which finds the triangle that each sample of a picture shows.

A picture is made in these steps, at `supersample` x `supersample` samples per pixel:

1. `vertices.place` turns world points into homogeneous sample coordinates (X, Y, W): the sample is (X / W, Y / W), W
   the depth along the optical axis. Triangles are rasterised in these coordinates, without dividing first (M. Olano
   and T. Greer, "Triangle scan conversion using 2D homogeneous coordinates", 1997): the edge functions and 1 / W are
   linear over the picture even for a triangle that reaches behind the eye, so the near plane and a cut are two more
   half-planes of each row, not new polygons. Everything that varies linearly over the triangle also becomes linear in
   the sample coordinate once it is divided by W: normals, colours and texture coordinates.
2. `prepare` writes these functions for every triangle that may be visible.
3. `compose.draw_picture` then goes down the picture in bands of a few rows, so that the samples stay in the cache.
   `draw_opaque` finds, for every sample of a band, the nearest triangle and its 1 / W. A sample on an edge shared by
   two triangles belongs to exactly one of them. `draw_cap` closes cut meshes.
4. `translucent.draw_translucent` goes through the translucent triangles from front to back and keeps, for every sample,
   the share of the light from behind that still comes through; the sum is the same as blending from back to front.
5. `compose.resolve` shades each triangle once in each pixel where samples show it, weights by samples, and encodes.

Nothing here is compiled with fast-math, and no loop runs in parallel: equal input gives equal bytes.
"""

from __future__ import annotations

import math

import numpy as np

from spatula_env._kernels import kernel
from spatula_env.render.layout import (
    BACK,
    CAPPED,
    COLOR,
    CORE,
    CUT,
    DEPTH,
    DRAW_BACK,
    EYE,
    FAR,
    MARK,
    NEAR,
    NORMAL,
    PLANE,
    RAY,
    RAY_X,
    RAY_Y,
    SMOOTH,
    TEXTURED,
    TRANSLUCENT,
    Floats,
    Indices,
    Singles,
    inlined,
)
from spatula_env.render.vertices import triangle_normal


@inlined
def edges(p: Floats, a: int, b: int, c: int, edge: Floats) -> float:
    """Edge functions (3, 3) of a triangle, edge[i] . (x, y, 1), each opposite to its vertex; returns det.

    The same edge in the reverse direction gets exactly the negative numbers, so that no seams open.
    """
    for k in range(3):
        i = b if k == 0 else (c if k == 1 else a)
        j = c if k == 0 else (a if k == 1 else b)
        edge[k, 0] = p[i, 1] * p[j, 2] - p[i, 2] * p[j, 1]
        edge[k, 1] = p[i, 2] * p[j, 0] - p[i, 0] * p[j, 2]
        edge[k, 2] = p[i, 0] * p[j, 1] - p[i, 1] * p[j, 0]
    return float(p[a, 0] * edge[0, 0] + p[a, 1] * edge[0, 1] + p[a, 2] * edge[0, 2])


@inlined
def is_thin(p: Floats, a: int, b: int, c: int, det: float) -> bool:
    """Whether a triangle covers so little (1e-5 of a sample) that its functions are rounding errors."""
    return not abs(det) > 2e-5 * abs(p[a, 2] * p[b, 2] * p[c, 2])


@inlined
def bounds(p: Floats, a: int, b: int, c: int, near: float, width: int, height: int) -> tuple[int, int, int, int]:
    """Range of samples that the part of a triangle beyond the near plane can touch: x0, x1, y0, y1, ends excluded."""
    low_x = low_y = math.inf
    high_x = high_y = -math.inf
    for k in range(3):
        i = a if k == 0 else (b if k == 1 else c)
        j = b if k == 0 else (c if k == 1 else a)
        wi, wj = p[i, 2], p[j, 2]
        if wi >= near:
            x, y = p[i, 0] / wi, p[i, 1] / wi
            low_x, high_x = min(low_x, x), max(high_x, x)
            low_y, high_y = min(low_y, y), max(high_y, y)
        if (wi >= near) != (wj >= near):
            part = (near - wi) / (wj - wi)
            x = (p[i, 0] + part * (p[j, 0] - p[i, 0])) / near
            y = (p[i, 1] + part * (p[j, 1] - p[i, 1])) / near
            low_x, high_x = min(low_x, x), max(high_x, x)
            low_y, high_y = min(low_y, y), max(high_y, y)
    # One more on each side for rounding; the edge functions decide.
    if not (low_x < width + 1.0 and high_x > -1.0 and low_y < height + 1.0 and high_y > -1.0):
        return 0, 0, 0, 0
    x0 = int(max(low_x - 1.0, 0.0))
    x1 = int(min(high_x + 2.0, float(width)))
    y0 = int(max(low_y - 1.0, 0.0))
    y1 = int(min(high_y + 2.0, float(height)))
    return x0, x1, y0, y1


@inlined
def _add_limit(a: float, b: float, c: float, limits: Floats, t: int, k: int) -> int:
    """Write a x + b y + c >= 0 as a limit of each row's samples; returns the number of limits."""
    if a == 0.0:
        limits[t, k, 0] = b
        limits[t, k, 1] = c
        limits[t, k, 2] = 0.0
    else:
        limits[t, k, 0] = -b / a
        limits[t, k, 1] = -c / a
        limits[t, k, 2] = 1.0 if a > 0.0 else -1.0
    return k + 1


@inlined
def span(y: int, x0: int, x1: int, limits: Floats, t: int, count: int) -> tuple[int, int]:
    """Range of samples of row y inside all limits. A sample exactly on a left or an upper limit counts as inside."""
    middle = y + 0.5
    low, high = float(x0), float(x1)
    for k in range(count):
        value = limits[t, k, 0] * middle + limits[t, k, 1]
        side = limits[t, k, 2]
        if side > 0.0:
            low = max(low, value)
        elif side < 0.0:
            high = min(high, value)
        elif value < 0.0 or (value == 0.0 and limits[t, k, 0] <= 0.0):
            return 0, 0
    if not low < high:
        return 0, 0
    return math.ceil(low - 0.5), math.ceil(high - 0.5)


@inlined
def collect_limits(
    edge: Floats,
    det: float,
    near: float,
    crosses_near: bool,
    cut: bool,
    da: float,
    db: float,
    dc: float,
    limits: Floats,
    t: int,
) -> int:
    """All limits of a triangle: its edges, the near plane and the cut (signed distances of its vertices)."""
    sign = 1.0 if det > 0.0 else -1.0
    count = 0
    for k in range(3):
        count = _add_limit(sign * edge[k, 0], sign * edge[k, 1], sign * edge[k, 2], limits, t, count)
    if cut:
        count = _add_limit(
            -sign * (da * edge[0, 0] + db * edge[1, 0] + dc * edge[2, 0]),
            -sign * (da * edge[0, 1] + db * edge[1, 1] + dc * edge[2, 1]),
            -sign * (da * edge[0, 2] + db * edge[1, 2] + dc * edge[2, 2]),
            limits,
            t,
            count,
        )
    if crosses_near:
        count = _add_limit(
            -(edge[0, 0] + edge[1, 0] + edge[2, 0]) / det,
            -(edge[0, 1] + edge[1, 1] + edge[2, 1]) / det,
            1.0 / near - (edge[0, 2] + edge[1, 2] + edge[2, 2]) / det,
            limits,
            t,
            count,
        )
    return count


@inlined
def _plane_distance(points: Floats, i: int, parameters: Floats, m: int) -> float:
    """Signed distance of vertex i from mesh m's plane, positive on the side that is cut away."""
    return float(
        parameters[m, PLANE] * points[i, 0]
        + parameters[m, PLANE + 1] * points[i, 1]
        + parameters[m, PLANE + 2] * points[i, 2]
        - parameters[m, PLANE + 3]
    )


@inlined
def plane_distances(
    points: Floats, a: int, b: int, c: int, parameters: Floats, m: int, cut: bool
) -> tuple[float, float, float]:
    """Distances of three vertices as `_plane_distance` gives them, or zeros if the mesh is not cut."""
    if not cut:
        return 0.0, 0.0, 0.0
    return (
        _plane_distance(points, a, parameters, m),
        _plane_distance(points, b, parameters, m),
        _plane_distance(points, c, parameters, m),
    )


@inlined
def _begin(
    t: int,
    points: Floats,
    p: Floats,
    triangles: Indices,
    m: int,
    cut: bool,
    draw_back: bool,
    parameters: Floats,
    near: float,
    far: float,
    width: int,
    height: int,
    edge: Floats,
    limits: Floats,
) -> tuple[int, int, int, int, int, float]:
    """Prepare triangle t: number of limits (0: nothing to draw), x0, x1, y0, y1, det."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    wa, wb, wc = p[a, 2], p[b, 2], p[c, 2]
    lowest, highest = min(wa, wb, wc), max(wa, wb, wc)
    if highest < near or lowest > far:
        return 0, 0, 0, 0, 0, 0.0
    det = edges(p, a, b, c, edge)
    # Fronts have a negative determinant: y points down in the picture.
    if (det > 0.0 and not draw_back) or is_thin(p, a, b, c, det):
        return 0, 0, 0, 0, 0, 0.0
    x0, x1, y0, y1 = bounds(p, a, b, c, near, width, height)
    if x0 >= x1 or y0 >= y1:
        return 0, 0, 0, 0, 0, 0.0
    da, db, dc = plane_distances(points, a, b, c, parameters, m, cut)
    if min(da, db, dc) > 0.0:
        return 0, 0, 0, 0, 0, 0.0
    cut = max(da, db, dc) > 0.0
    count = collect_limits(edge, det, near, lowest < near, cut, da, db, dc, limits, t)
    return count, x0, x1, y0, y1, det


@inlined
def _fill_functions(
    t: int,
    m: int,
    points: Floats,
    normals: Floats,
    colors: Floats,
    texture: Floats,
    triangles: Indices,
    flags: Indices,
    parameters: Floats,
    edge: Floats,
    det: float,
    functions: Floats,
) -> None:
    """Write the shading functions of triangle t (see `layout`)."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    back = det > 0.0
    side = -1.0 if back else 1.0
    inverse = 1.0 / det
    smooth = flags[m] & SMOOTH != 0
    textured = flags[m] & TEXTURED != 0
    for j in range(3):
        ea, eb, ec = edge[0, j] * inverse, edge[1, j] * inverse, edge[2, j] * inverse
        functions[t, DEPTH + j] = ea + eb + ec
        for k in range(3):
            if back:
                functions[t, COLOR + 3 * k + j] = parameters[m, BACK + k] * (ea + eb + ec)
            else:
                functions[t, COLOR + 3 * k + j] = ea * colors[a, k] + eb * colors[b, k] + ec * colors[c, k]
        if smooth:
            for k in range(3):
                functions[t, NORMAL + 3 * k + j] = side * (ea * normals[a, k] + eb * normals[b, k] + ec * normals[c, k])
        if textured:
            for k in range(3):
                functions[t, MARK + 3 * k + j] = ea * texture[a, k] + eb * texture[b, k] + ec * texture[c, k]
    if not smooth:
        nx, ny, nz = triangle_normal(points, triangles, t)
        for k in range(3):
            functions[t, NORMAL + 3 * k] = functions[t, NORMAL + 3 * k + 1] = 0.0
        functions[t, NORMAL + 2] = side * nx
        functions[t, NORMAL + 5] = side * ny
        functions[t, NORMAL + 8] = side * nz


@kernel(
    "void(f8[:,::1], f8[:,::1], i4[:,::1], i4[::1], i8, f8[:,::1], f8[:,::1], f8[:,::1], i4[::1], f8[:,::1],"
    " f8[::1], i8, i8, i4[:,::1], f8[:,:,::1], f8[:,::1])"
)
def prepare(
    points: Floats,
    p: Floats,
    triangles: Indices,
    owner: Indices,
    count: int,
    normals: Floats,
    colors: Floats,
    texture: Floats,
    flags: Indices,
    parameters: Floats,
    view: Floats,
    width: int,
    height: int,
    extents: Indices,
    limits: Floats,
    functions: Floats,
) -> None:
    """Find where triangles may be visible, and write their functions.

    Args:
        points: world positions (N, 3).
        p: homogeneous sample coordinates (N, 3).
        triangles: (T, 3).
        owner: mesh of each triangle (T,).
        count: triangles in use.
        normals: of the vertices (N, 3).
        colors: of the vertices, linear (N, 3).
        texture: coordinates of the vertices (N, 3).
        flags: of the meshes (M,).
        parameters: of the meshes (M, PARAMETERS).
        view: the view array.
        width: samples in a row.
        height: rows of samples.
        extents: (T, 6) to write: number of limits (0: not visible), x0, x1, y0, y1 of the samples it may touch, the
            ends excluded, and 1 for a back, -1 for a front.
        limits: (T, 5, 3) to write: half-planes of each row's samples (see `span`).
        functions: (T, FUNCTIONS) to write (see `layout`).
    """
    edge = np.empty((3, 3))
    for t in range(count):
        m = owner[t]
        # The backs of a capped mesh are not drawn, but counted for its cap.
        back = flags[m] & (DRAW_BACK | CAPPED) != 0
        n, x0, x1, y0, y1, det = _begin(
            t,
            points,
            p,
            triangles,
            m,
            flags[m] & CUT != 0,
            back,
            parameters,
            view[NEAR],
            # Every crossing of a capped mesh counts, however far away.
            math.inf if flags[m] & CAPPED else view[FAR],
            width,
            height,
            edge,
            limits,
        )
        extents[t, 0] = n
        if n == 0:
            continue
        extents[t, 1], extents[t, 2], extents[t, 3], extents[t, 4] = x0, x1, y0, y1
        extents[t, 5] = 1 if det > 0.0 else -1
        _fill_functions(t, m, points, normals, colors, texture, triangles, flags, parameters, edge, det, functions)


@kernel("void(i8, i8, i8, i8, i4[:,::1], f8[:,:,::1], f8[:,::1], i4[::1], i4[::1], f4[::1], i4[::1], i4[:,::1])")
def draw_opaque(
    top: int,
    bottom: int,
    width: int,
    count: int,
    extents: Indices,
    limits: Floats,
    functions: Floats,
    owner: Indices,
    flags: Indices,
    depth: Singles,
    shown: Indices,
    rows: Indices,
) -> None:
    """Find the nearest opaque triangle of every sample of a band.

    Args:
        top: first row of samples.
        bottom: end of the rows.
        width: samples in a row.
        count: triangles in use.
        extents: see `prepare`.
        limits: see `prepare`.
        functions: see `prepare`.
        owner: mesh of each triangle (T,).
        flags: of the meshes (M,).
        depth: 1 / W of each sample of the band, larger is nearer; starts with that of the background.
        shown: triangle of each sample of the band, starts at -1 for none.
        rows: (bottom - top, 2) range of samples touched in each row, widened here.
    """
    for t in range(count):
        n = extents[t, 0]
        y0, y1 = max(extents[t, 3], top), min(extents[t, 4], bottom)
        if n == 0 or y0 >= y1:
            continue
        kind = flags[owner[t]]
        if kind & (TRANSLUCENT | CORE) or (kind & CAPPED and not kind & DRAW_BACK and extents[t, 5] > 0):
            continue
        x0, x1 = extents[t, 1], extents[t, 2]
        za, zb, zc = functions[t, DEPTH], functions[t, DEPTH + 1], functions[t, DEPTH + 2]
        for y in range(y0, y1):
            low, high = span(y, x0, x1, limits, t, n)
            if low >= high:
                continue
            row = y - top
            rows[row, 0] = min(rows[row, 0], low)
            rows[row, 1] = max(rows[row, 1], high)
            start = zb * (y + 0.5) + zc + 0.5 * za
            row *= width
            for x in range(low, high):
                value = np.float32(start + za * x)
                if value > depth[row + x]:
                    depth[row + x] = value
                    shown[row + x] = t


@kernel(
    "void(i8, i8, i8, i8, i8, i8, i8, i8, i4[:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[::1], i4[::1],"
    " f4[::1], i4[::1], i4[:,::1])"
)
def draw_cap(
    top: int,
    bottom: int,
    width: int,
    m: int,
    first: int,
    last: int,
    cap: int,
    over: int,
    extents: Indices,
    limits: Floats,
    functions: Floats,
    parameters: Floats,
    view: Floats,
    inside: Indices,
    depth: Singles,
    shown: Indices,
    rows: Indices,
) -> None:
    """Close the cut of a mesh in a band.

    A ray that enters the kept half-space at the plane is inside a closed mesh there if, beyond the plane, it crosses
    one more back than fronts. Visible samples of the section are recorded as triangle `cap`, whose shading functions
    are written; its texture coordinates are world coordinates, since the inside has none.

    Args:
        top: first row of samples.
        bottom: end of the rows.
        width: samples in a row.
        m: the mesh.
        first: its first triangle.
        last: end of its triangles.
        cap: index of the triangle that represents the cap.
        over: -1, or the cap that this one is drawn on.
        extents: see `prepare`.
        limits: see `prepare`.
        functions: see `prepare`.
        parameters: of the meshes.
        view: the view array.
        inside: scratch for each sample of the band, all zero before and after.
        depth: see `draw_opaque`.
        shown: see `draw_opaque`.
        rows: see `draw_opaque`.
    """
    nx, ny, nz = parameters[m, PLANE], parameters[m, PLANE + 1], parameters[m, PLANE + 2]
    gap = parameters[m, PLANE + 3] - (nx * view[EYE] + ny * view[EYE + 1] + nz * view[EYE + 2])
    if gap >= 0.0:
        # The eye is on the kept side: no ray enters there.
        return
    for t in range(first, last):
        n = extents[t, 0]
        y0, y1 = max(extents[t, 3], top), min(extents[t, 4], bottom)
        if n == 0:
            continue
        for y in range(y0, y1):
            low, high = span(y, extents[t, 1], extents[t, 2], limits, t, n)
            if low < high:
                row = y - top
                rows[row, 0] = min(rows[row, 0], low)
                rows[row, 1] = max(rows[row, 1], high)
                for i in range(row * width + low, row * width + high):
                    inside[i] += extents[t, 5]
    normal = (nx, ny, nz)
    for j in range(3):
        # The ray's linear function: the part in x, the part in y, the constant.
        part = RAY_X if j == 0 else (RAY_Y if j == 1 else RAY)
        depth_part = (nx * view[part] + ny * view[part + 1] + nz * view[part + 2]) / gap
        functions[cap, DEPTH + j] = depth_part
        for k in range(3):
            functions[cap, NORMAL + 3 * k + j] = normal[k] if j == 2 else 0.0
            functions[cap, COLOR + 3 * k + j] = parameters[m, BACK + k] * depth_part
            functions[cap, MARK + 3 * k + j] = view[EYE + k] * depth_part + view[part + k]
    za, zb, zc = functions[cap, DEPTH], functions[cap, DEPTH + 1], functions[cap, DEPTH + 2]
    for y in range(top, bottom):
        start = zb * (y + 0.5) + zc + 0.5 * za
        row = y - top
        for x in range(rows[row, 0], rows[row, 1]):
            i = row * width + x
            if inside[i] > 0:
                value = start + za * x
                if over >= 0:
                    shown[i] = cap if shown[i] == over else shown[i]
                elif value > depth[i] and value <= 1.0 / view[NEAR]:
                    depth[i] = value
                    shown[i] = cap
            inside[i] = 0
