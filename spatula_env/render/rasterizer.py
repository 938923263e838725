"""The rasteriser's kernels: pure functions on arrays that the `Renderer` owns.

A picture is made in these steps, at `supersample` x `supersample` samples per pixel:

1. `place` turns world points into homogeneous sample coordinates (X, Y, W): the sample is (X / W, Y / W), W the depth
   along the optical axis. Triangles are rasterised in these coordinates, without dividing first (M. Olano and
   T. Greer, "Triangle scan conversion using 2D homogeneous coordinates", 1997): the edge functions and 1 / W are
   linear over the picture even for a triangle that reaches behind the eye, so the near plane and a cut are two more
   half-planes of each row, not new polygons.
2. `draw_opaque` leaves, for every sample, the nearest triangle and its 1 / W. A sample on an edge shared by two
   triangles belongs to exactly one of them. `draw_cap` closes cut meshes.
3. `draw_translucent` goes through the translucent triangles from front to back and keeps for every sample what is
   left of the light behind; that sums to the same as blending from back to front.
4. `resolve` shades each triangle once in each pixel where samples show it, weights by samples, and encodes.

Shadows on meshes come from a depth map along the key light. A mesh does not shadow itself: on a coarse mesh with
smooth normals that would show the facets. Shadows on the ground are a blurred silhouette along the key light, and a
wider one straight down that fades with height, for the light from all around that does not reach under things.

Nothing here is compiled with fast-math, and no loop runs in parallel: equal input gives equal bytes.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from spatula_env._kernels import inline_kernel, kernel

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Indices = NDArray[np.int32]
Bytes = NDArray[np.uint8]

# Bits of a mesh's flags.
SMOOTH = 1
DRAW_BACK = 2
CUT = 4
UNLIT = 8
CAPPED = 16
CASTS = 32
RECEIVES = 64
TEXTURED = 128
LINE = 256
TRANSLUCENT = 512

# Columns of a mesh's parameters.
OPACITY = 0
BACK = 1  # to 3: linear colour of the backs
PLANE = 4  # to 7: normal and offset; normal . x > offset is cut away
SPECULAR = 8
SHININESS = 9  # how many times to square
METALLIC = 10
SUBSURFACE = 11
RIM = 12
GRAIN = 13
MOTTLE = 14
PARAMETERS = 15

# The view array.
EYE = 0
RAY = 3  # ray of sample coordinate (x, y): RAY + x RAY_X + y RAY_Y, whose part along the axis is 1
RAY_X = 6
RAY_Y = 9
FOCAL = 12  # samples
NEAR = 13
FAR = 14
GROUND_SEEN = 15
GROUND_HEIGHT = 16
VIEW = 17

# The light array.
KEY_DIRECTION = 0
KEY = 3
FILL_DIRECTION = 4
FILL = 7
AMBIENT = 8
SHADOW = 9
SOFTNESS = 10
GROUND_SHADOW = 11
AXIS_U = 12  # the light's map: u = (U . x - U0) * MAP_SCALE, in texels
AXIS_V = 15
MAP_U = 18
MAP_V = 19
MAP_SCALE = 20
UNDER_X = 21  # the map straight down: (x - UNDER_X) * UNDER_SCALE
UNDER_Y = 22
UNDER_SCALE = 23
HAS_SHADOWS = 24
LIGHT = 25

# Linear colours of the room.
_SKY = (0.98, 1.0, 1.04)
_BOUNCE = (0.52, 0.47, 0.45)
_KEY_COLOR = (1.0, 0.975, 0.94)
_FILL_COLOR = (0.86, 0.94, 1.0)
# Shadows on the ground take this much of each channel: a little blue is left, as from a sky.
_SHADOW_TINT = (1.0, 0.985, 0.955)

TONES = 8192
"""Steps of linear light in the encoding table: fine enough that every 8-bit value comes back as itself."""


def _noise_table() -> Floats:
    """256 numbers in -1..1 without order, from the minimal standard generator of Park and Miller (1988)."""
    state, values = 20240229, []
    for _ in range(256):
        state = state * 48271 % 2147483647
        values.append(2.0 * state / 2147483647.0 - 1.0)
    table = np.array(values)
    table.flags.writeable = False
    return table


_NOISE = _noise_table()


@kernel("void(f8[:,::1], i8, i8, f8[:,::1], f8[:,::1])")
def place(points: Floats, first: int, last: int, matrix: Floats, out: Floats) -> None:
    """Apply an affine map (3, 4) to the points first..last."""
    for i in range(first, last):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for k in range(3):
            out[i, k] = matrix[k, 0] * x + matrix[k, 1] * y + matrix[k, 2] * z + matrix[k, 3]


@inline_kernel
def _triangle_normal(points: Floats, triangles: Indices, t: int) -> tuple[float, float, float]:
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@kernel("void(f8[:,::1], i4[:,::1], i8, i8, i8, i8, f8[:,::1])")
def vertex_normals(
    points: Floats,
    triangles: Indices,
    first_point: int,
    last_point: int,
    first_triangle: int,
    last_triangle: int,
    normals: Floats,
) -> None:
    """Sum of the area-weighted normals of the triangles around each vertex, not of unit length."""
    for i in range(first_point, last_point):
        normals[i, 0] = normals[i, 1] = normals[i, 2] = 0.0
    for t in range(first_triangle, last_triangle):
        nx, ny, nz = _triangle_normal(points, triangles, t)
        for k in range(3):
            i = triangles[t, k]
            normals[i, 0] += nx
            normals[i, 1] += ny
            normals[i, 2] += nz


@inline_kernel
def _before(points: Floats, a: int, b: int) -> bool:
    """An order of two points that does not depend on which is named first."""
    for k in range(3):
        if points[a, k] != points[b, k]:
            return points[a, k] < points[b, k]
    return a < b


@kernel("i8(i4[:,::1], i8, i8, i4[:,::1], i8, i8, f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1])")
def refine(
    triangles: Indices,
    first: int,
    last: int,
    out: Indices,
    out_first: int,
    vertex: int,
    points: Floats,
    normals: Floats,
    colors: Floats,
    texture: Floats,
) -> int:
    """Split each triangle in four along a curved surface that the vertex normals suggest.

    The middle of an edge is moved three quarters of the way to the mean of its projections onto the tangent planes of
    the edge's ends (T. Boubekeur and M. Alexa, "Phong tessellation", 2008). Both triangles of an edge compute the
    same middle to the last bit, so no seam opens.

    Args:
        triangles: (T, 3).
        first: first triangle to split.
        last: end of the triangles to split.
        out: (T', 3), where four triangles for each are written.
        out_first: first row of `out` to write.
        vertex: first free vertex; three are added for each triangle.
        points: (N, 3).
        normals: vertex normals (N, 3) of any length.
        colors: linear colours (N, 3).
        texture: texture coordinates (N, 3).

    Returns:
        The next free vertex.
    """
    row = out_first
    middle = np.empty(3, dtype=np.int64)
    for t in range(first, last):
        for k in range(3):
            a, b = triangles[t, k], triangles[t, (k + 1) % 3]
            if not _before(points, a, b):
                a, b = b, a
            la = math.sqrt(normals[a, 0] ** 2 + normals[a, 1] ** 2 + normals[a, 2] ** 2)
            lb = math.sqrt(normals[b, 0] ** 2 + normals[b, 1] ** 2 + normals[b, 2] ** 2)
            # Half an edge along each normal is how far the middle is off each tangent plane.
            off_a = off_b = 0.0
            for j in range(3):
                half = 0.5 * (points[b, j] - points[a, j])
                off_a += half * normals[a, j]
                off_b -= half * normals[b, j]
            ia, ib = 1.0 / max(la, 1e-300), 1.0 / max(lb, 1e-300)
            off_a *= 0.375 * ia
            off_b *= 0.375 * ib
            for j in range(3):
                na, nb = normals[a, j] * ia, normals[b, j] * ib
                points[vertex, j] = 0.5 * (points[a, j] + points[b, j]) - off_a * na - off_b * nb
                normals[vertex, j] = na + nb
                colors[vertex, j] = 0.5 * (colors[a, j] + colors[b, j])
                texture[vertex, j] = 0.5 * (texture[a, j] + texture[b, j])
            middle[k] = vertex
            vertex += 1
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ab, bc, ca = middle[0], middle[1], middle[2]
        out[row, 0], out[row, 1], out[row, 2] = a, ab, ca
        out[row + 1, 0], out[row + 1, 1], out[row + 1, 2] = b, bc, ab
        out[row + 2, 0], out[row + 2, 1], out[row + 2, 2] = c, ca, bc
        out[row + 3, 0], out[row + 3, 1], out[row + 3, 2] = ab, bc, ca
        row += 4
    return vertex


@kernel("void(f8[:,::1], i8, i8, f8[:,::1])")
def to_linear(colors: Floats, first: int, last: int, out: Floats) -> None:
    """Decode sRGB (IEC 61966-2-1) into out[first..last]."""
    for i in range(first, last):
        for k in range(3):
            value = colors[i - first, k]
            if value <= 0.04045:
                out[i, k] = value / 12.92
            else:
                out[i, k] = ((value + 0.055) / 1.055) ** 2.4


@kernel("i8(f8[:,::1], f8[:,::1], f8, b1, f8, f8[:,::1], i8)")
def widen_lines(
    starts: Floats, ends: Floats, width: float, in_pixels: bool, focal: float, out: Floats, first: int
) -> int:
    """Turn lines into quadrilaterals that face the camera.

    Args:
        starts: homogeneous sample coordinates (S, 3).
        ends: the same of the ends.
        width: in samples or in u.
        in_pixels: whether the width is in samples.
        focal: focal length in samples.
        out: four corners for each line are written from row `first` on.
        first: see `out`.

    Returns:
        The row after the last one written; a line behind the eye gets four equal corners.
    """
    row = first
    near = 1e-3
    for i in range(len(starts)):
        ax, ay, aw = starts[i, 0], starts[i, 1], starts[i, 2]
        bx, by, bw = ends[i, 0], ends[i, 1], ends[i, 2]
        if aw < near and bw < near:
            for k in range(4):
                out[row + k, 0] = out[row + k, 1] = 0.0
                out[row + k, 2] = -1.0
            row += 4
            continue
        if aw < near:
            part = (near - aw) / (bw - aw)
            ax, ay, aw = ax + part * (bx - ax), ay + part * (by - ay), near
        elif bw < near:
            part = (near - bw) / (aw - bw)
            bx, by, bw = bx + part * (ax - bx), by + part * (ay - by), near
        dx, dy = bx / bw - ax / aw, by / bw - ay / aw
        length = math.sqrt(dx * dx + dy * dy)
        if length > 1e-9:
            dx, dy = dx / length, dy / length
        else:
            dx, dy = 1.0, 0.0
        # Half widths times W; a line is never thinner than a sample, or it would break up.
        if in_pixels:
            ha, hb = 0.5 * width * aw, 0.5 * width * bw
        else:
            ha = max(0.5 * width * focal, 0.5 * aw)
            hb = max(0.5 * width * focal, 0.5 * bw)
        # Each end reaches half a width further, so that joints close. A touch nearer to the eye than the surface
        # that the line lies on: scaling all three coordinates changes the depth and not the place.
        lift = 0.999
        out[row, 0] = lift * (ax + ha * (-dx - dy))
        out[row, 1] = lift * (ay + ha * (-dy + dx))
        out[row, 2] = lift * aw
        out[row + 1, 0] = lift * (ax + ha * (-dx + dy))
        out[row + 1, 1] = lift * (ay + ha * (-dy - dx))
        out[row + 1, 2] = lift * aw
        out[row + 2, 0] = lift * (bx + hb * (dx + dy))
        out[row + 2, 1] = lift * (by + hb * (dy - dx))
        out[row + 2, 2] = lift * bw
        out[row + 3, 0] = lift * (bx + hb * (dx - dy))
        out[row + 3, 1] = lift * (by + hb * (dy + dx))
        out[row + 3, 2] = lift * bw
        row += 4
    return row


# --------------------------------------------------------------------------------------------- one triangle


@inline_kernel
def _edges(p: Floats, a: int, b: int, c: int, edge: Floats) -> float:
    """Edge functions (3, 3) of a triangle, edge[i] . (x, y, 1), each opposite to its vertex; returns det.

    An edge named the other way round gets exactly the negative numbers: that closes seams.
    """
    for k in range(3):
        i = b if k == 0 else (c if k == 1 else a)
        j = c if k == 0 else (a if k == 1 else b)
        edge[k, 0] = p[i, 1] * p[j, 2] - p[i, 2] * p[j, 1]
        edge[k, 1] = p[i, 2] * p[j, 0] - p[i, 0] * p[j, 2]
        edge[k, 2] = p[i, 0] * p[j, 1] - p[i, 1] * p[j, 0]
    return p[a, 0] * edge[0, 0] + p[a, 1] * edge[0, 1] + p[a, 2] * edge[0, 2]


@inline_kernel
def _is_thin(p: Floats, a: int, b: int, c: int, det: float) -> bool:
    """Whether a triangle covers so little (1e-5 of a sample) that its functions are rounding errors."""
    return not abs(det) > 2e-5 * abs(p[a, 2] * p[b, 2] * p[c, 2])


@inline_kernel
def _bounds(
    p: Floats, a: int, b: int, c: int, near: float, width: int, height: int
) -> tuple[int, int, int, int]:
    """Samples that the part of a triangle beyond the near plane can touch: x0, x1, y0, y1, ends excluded."""
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


@inline_kernel
def _limit(a: float, b: float, c: float, limits: Floats, k: int) -> int:
    """Write a x + b y + c >= 0 as a limit of each row's samples; returns the number of limits."""
    if a == 0.0:
        limits[k, 0] = b
        limits[k, 1] = c
        limits[k, 2] = 0.0
    else:
        limits[k, 0] = -b / a
        limits[k, 1] = -c / a
        limits[k, 2] = 1.0 if a > 0.0 else -1.0
    return k + 1


@inline_kernel
def _span(y: int, x0: int, x1: int, limits: Floats, count: int) -> tuple[int, int]:
    """Samples of row y inside all limits. A sample right on a limit is inside on the left and the upper side only."""
    middle = y + 0.5
    low, high = float(x0), float(x1)
    for k in range(count):
        value = limits[k, 0] * middle + limits[k, 1]
        side = limits[k, 2]
        if side > 0.0:
            low = max(low, value)
        elif side < 0.0:
            high = min(high, value)
        elif value < 0.0 or (value == 0.0 and limits[k, 0] <= 0.0):
            return 0, 0
    if not low < high:
        return 0, 0
    return int(math.ceil(low - 0.5)), int(math.ceil(high - 0.5))


@inline_kernel
def _limits(
    edge: Floats,
    det: float,
    near: float,
    crosses_near: bool,
    cut: bool,
    da: float,
    db: float,
    dc: float,
    limits: Floats,
) -> int:
    """All limits of a triangle: its edges, the near plane and the cut (signed distances of its vertices)."""
    sign = 1.0 if det > 0.0 else -1.0
    count = 0
    for k in range(3):
        count = _limit(sign * edge[k, 0], sign * edge[k, 1], sign * edge[k, 2], limits, count)
    if cut:
        count = _limit(
            -sign * (da * edge[0, 0] + db * edge[1, 0] + dc * edge[2, 0]),
            -sign * (da * edge[0, 1] + db * edge[1, 1] + dc * edge[2, 1]),
            -sign * (da * edge[0, 2] + db * edge[1, 2] + dc * edge[2, 2]),
            limits,
            count,
        )
    if crosses_near:
        count = _limit(
            -(edge[0, 0] + edge[1, 0] + edge[2, 0]) / det,
            -(edge[0, 1] + edge[1, 1] + edge[2, 1]) / det,
            1.0 / near - (edge[0, 2] + edge[1, 2] + edge[2, 2]) / det,
            limits,
            count,
        )
    return count


@inline_kernel
def _plane_distance(points: Floats, i: int, parameters: Floats, m: int) -> float:
    """How far vertex i is on the side of mesh m's plane that is cut away."""
    return (
        parameters[m, PLANE] * points[i, 0]
        + parameters[m, PLANE + 1] * points[i, 1]
        + parameters[m, PLANE + 2] * points[i, 2]
        - parameters[m, PLANE + 3]
    )


@inline_kernel
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
    det = _edges(p, a, b, c, edge)
    # Fronts have a negative determinant: y points down in the picture.
    if (det > 0.0 and not draw_back) or _is_thin(p, a, b, c, det):
        return 0, 0, 0, 0, 0, 0.0
    x0, x1, y0, y1 = _bounds(p, a, b, c, near, width, height)
    if x0 >= x1 or y0 >= y1:
        return 0, 0, 0, 0, 0, 0.0
    da = db = dc = 0.0
    if cut:
        da = _plane_distance(points, a, parameters, m)
        db = _plane_distance(points, b, parameters, m)
        dc = _plane_distance(points, c, parameters, m)
        if min(da, db, dc) > 0.0:
            return 0, 0, 0, 0, 0, 0.0
        cut = max(da, db, dc) > 0.0
    count = _limits(edge, det, near, lowest < near, cut, da, db, dc, limits)
    return count, x0, x1, y0, y1, det


# ---------------------------------------------------------------------------------------------- visibility


@kernel("void(i4[:,::1], i8, f4[::1], f4[::1], i4[::1], f4[::1], i4[::1], b1)")
def clear(
    rows: Indices,
    width: int,
    background: Singles,
    depth: Singles,
    shown: Indices,
    left: Singles,
    stamp: Indices,
    translucent: bool,
) -> None:
    """Undo the previous picture where it drew: rows[y] = first and last (excluded) sample touched in row y."""
    for y in range(len(rows)):
        for i in range(y * width + rows[y, 0], y * width + rows[y, 1]):
            depth[i] = background[i]
            shown[i] = -1
        if translucent:
            for i in range(y * width + rows[y, 0], y * width + rows[y, 1]):
                left[i] = 1.0
                stamp[i] = -1
        rows[y, 0] = width
        rows[y, 1] = 0


@kernel(
    "void(f8[:,::1], f8[:,::1], i4[:,::1], i4[::1], i8, i4[::1], f8[:,::1], f8[::1], i8, i8,"
    " f4[::1], i4[::1], i4[:,::1], f8[:,::1])"
)
def draw_opaque(
    points: Floats,
    p: Floats,
    triangles: Indices,
    owner: Indices,
    count: int,
    flags: Indices,
    parameters: Floats,
    view: Floats,
    width: int,
    height: int,
    depth: Singles,
    shown: Indices,
    rows: Indices,
    barycentric: Floats,
) -> None:
    """Nearest opaque triangle of every sample.

    Args:
        points: world positions (N, 3).
        p: homogeneous sample coordinates (N, 3).
        triangles: (T, 3).
        owner: mesh of each triangle (T,).
        count: triangles in use.
        flags: of the meshes (M,).
        parameters: of the meshes (M, PARAMETERS).
        view: the view array.
        width: samples in a row.
        height: rows of samples.
        depth: 1 / W of each sample; larger is nearer. Starts with that of the ground or of the far plane.
        shown: triangle of each sample, -1 for none.
        rows: range of samples touched in each row, widened here.
        barycentric: (T, 9) coefficients of (weight / W) for each vertex, written for every triangle that may show.
    """
    edge = np.empty((3, 3))
    limits = np.empty((5, 3))
    near, far = view[NEAR], view[FAR]
    for t in range(count):
        m = owner[t]
        if flags[m] & TRANSLUCENT:
            continue
        cut, back = flags[m] & CUT != 0, flags[m] & DRAW_BACK != 0
        n, x0, x1, y0, y1, det = _begin(
            t, points, p, triangles, m, cut, back, parameters, near, far, width, height, edge, limits
        )
        if n == 0:
            continue
        inverse = 1.0 / det
        for k in range(3):
            for j in range(3):
                barycentric[t, 3 * k + j] = edge[k, j] * inverse
        za = (edge[0, 0] + edge[1, 0] + edge[2, 0]) * inverse
        zb = (edge[0, 1] + edge[1, 1] + edge[2, 1]) * inverse
        zc = (edge[0, 2] + edge[1, 2] + edge[2, 2]) * inverse
        for y in range(y0, y1):
            low, high = _span(y, x0, x1, limits, n)
            if low >= high:
                continue
            rows[y, 0] = min(rows[y, 0], low)
            rows[y, 1] = max(rows[y, 1], high)
            start = zb * (y + 0.5) + zc + 0.5 * za
            row = y * width
            for x in range(low, high):
                value = np.float32(start + za * x)
                if value > depth[row + x]:
                    depth[row + x] = value
                    shown[row + x] = t


@kernel(
    "void(f8[:,::1], f8[:,::1], i4[:,::1], i8, i8, i8, f8[:,::1], f8[::1], i8, i8,"
    " f4[::1], i4[::1], i4[:,::1], i4[::1])"
)
def draw_cap(
    points: Floats,
    p: Floats,
    triangles: Indices,
    first: int,
    last: int,
    m: int,
    parameters: Floats,
    view: Floats,
    width: int,
    height: int,
    depth: Singles,
    shown: Indices,
    rows: Indices,
    inside: Indices,
) -> None:
    """Close the cut of mesh m.

    A ray that enters the kept half-space at the plane is inside a closed mesh there if, beyond the plane, it crosses
    one more back than fronts. `inside` counts that, and is left at zero.
    """
    edge = np.empty((3, 3))
    limits = np.empty((5, 3))
    nx, ny, nz = parameters[m, PLANE], parameters[m, PLANE + 1], parameters[m, PLANE + 2]
    gap = parameters[m, PLANE + 3] - (nx * view[EYE] + ny * view[EYE + 1] + nz * view[EYE + 2])
    if gap >= 0.0:
        # The eye is on the kept side: no ray enters there.
        return
    touched = np.empty((height, 2), dtype=np.int32)
    touched[:, 0] = width
    touched[:, 1] = 0
    near = view[NEAR]
    for t in range(first, last):
        n, x0, x1, y0, y1, det = _begin(
            t, points, p, triangles, m, True, True, parameters, near, math.inf, width, height, edge, limits
        )
        if n == 0:
            continue
        step = 1 if det > 0.0 else -1
        for y in range(y0, y1):
            low, high = _span(y, x0, x1, limits, n)
            if low < high:
                touched[y, 0] = min(touched[y, 0], low)
                touched[y, 1] = max(touched[y, 1], high)
                for i in range(y * width + low, y * width + high):
                    inside[i] += step
    # 1 / W of the plane.
    za = (nx * view[RAY_X] + ny * view[RAY_X + 1] + nz * view[RAY_X + 2]) / gap
    zb = (nx * view[RAY_Y] + ny * view[RAY_Y + 1] + nz * view[RAY_Y + 2]) / gap
    zc = (nx * view[RAY] + ny * view[RAY + 1] + nz * view[RAY + 2]) / gap
    for y in range(height):
        low, high = touched[y, 0], touched[y, 1]
        if low >= high:
            continue
        rows[y, 0] = min(rows[y, 0], low)
        rows[y, 1] = max(rows[y, 1], high)
        start = zb * (y + 0.5) + zc + 0.5 * za
        for x in range(low, high):
            i = y * width + x
            if inside[i] > 0:
                value = start + za * x
                if value > depth[i] and value <= 1.0 / near:
                    depth[i] = value
                    shown[i] = -2 - m
            inside[i] = 0


# ------------------------------------------------------------------------------------------------- shadows


@inline_kernel
def _draw_flat(
    points: Floats,
    p: Floats,
    triangles: Indices,
    owner: Indices,
    count: int,
    flags: Indices,
    parameters: Floats,
    depth: Singles,
    shown: Indices,
) -> None:
    """Nearest caster in a parallel projection: p holds x and y in texels and the height towards the viewer."""
    edge = np.empty((3, 3))
    limits = np.empty((5, 3))
    size = depth.shape[0]
    q = np.ones((3, 3))
    for t in range(count):
        m = owner[t]
        if not flags[m] & CASTS:
            continue
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        cut = flags[m] & CUT != 0
        da = db = dc = 0.0
        if cut:
            da = _plane_distance(points, a, parameters, m)
            db = _plane_distance(points, b, parameters, m)
            dc = _plane_distance(points, c, parameters, m)
            if min(da, db, dc) > 0.0:
                continue
            cut = max(da, db, dc) > 0.0
        for k in range(2):
            q[0, k], q[1, k], q[2, k] = p[a, k], p[b, k], p[c, k]
        det = _edges(q, 0, 1, 2, edge)
        if _is_thin(q, 0, 1, 2, det):
            continue
        x0, x1, y0, y1 = _bounds(q, 0, 1, 2, 0.5, size, size)
        if x0 >= x1 or y0 >= y1:
            continue
        n = _limits(edge, det, 0.5, False, cut, da, db, dc, limits)
        za = (edge[0, 0] * p[a, 2] + edge[1, 0] * p[b, 2] + edge[2, 0] * p[c, 2]) / det
        zb = (edge[0, 1] * p[a, 2] + edge[1, 1] * p[b, 2] + edge[2, 1] * p[c, 2]) / det
        zc = (edge[0, 2] * p[a, 2] + edge[1, 2] * p[b, 2] + edge[2, 2] * p[c, 2]) / det
        for y in range(y0, y1):
            low, high = _span(y, x0, x1, limits, n)
            start = zb * (y + 0.5) + zc + 0.5 * za
            for x in range(low, high):
                value = np.float32(start + za * x)
                if value > depth[y, x]:
                    depth[y, x] = value
                    shown[y, x] = m


@inline_kernel
def _blur(texture: Singles, line: Floats, radius: int) -> None:
    """Two box filters of 2 radius + 1 texels in each direction, in place: nearly a Gaussian."""
    size = texture.shape[0]
    norm = 1.0 / (2 * radius + 1)
    for _ in range(2):
        for y in range(size):
            total = 0.0
            for x in range(size):
                line[x] = texture[y, x]
            for x in range(min(radius, size)):
                total += line[x]
            for x in range(size):
                if x + radius < size:
                    total += line[x + radius]
                if x - radius - 1 >= 0:
                    total -= line[x - radius - 1]
                texture[y, x] = total * norm
    # Down the columns with one running sum for each, row by row: the memory is laid out in rows.
    for _ in range(2):
        for x in range(size):
            line[x] = 0.0
        ring = np.zeros((2 * radius + 1, size), dtype=np.float32)
        for y in range(size + radius):
            slot = y % (2 * radius + 1)
            for x in range(size):
                line[x] -= ring[slot, x]
                ring[slot, x] = texture[y, x] if y < size else np.float32(0.0)
                line[x] += ring[slot, x]
            if y >= radius:
                for x in range(size):
                    texture[y - radius, x] = line[x] * norm


@kernel(
    "void(f8[:,::1], f8[:,::1], i4[:,::1], i4[::1], i8, i8, i4[::1], f8[:,::1], i4[:,::1], f8[::1], f8[::1],"
    " f4[:,::1], i4[:,::1], f4[:,::1], f4[:,::1], i4[:,::1], f4[:,::1], f8[:,::1])"
)
def cast_shadows(
    points: Floats,
    p: Floats,
    triangles: Indices,
    owner: Indices,
    count: int,
    meshes: int,
    flags: Indices,
    parameters: Floats,
    ranges: Indices,
    view: Floats,
    light: Floats,
    map_depth: Singles,
    map_mesh: Indices,
    silhouette: Singles,
    under_depth: Singles,
    under_mesh: Indices,
    under: Singles,
    others: Floats,
) -> None:
    """Draw the maps that shadows are looked up in.

    Args:
        points: world positions (N, 3).
        p: scratch (N, 3).
        triangles: (T, 3).
        owner: mesh of each triangle (T,).
        count: triangles in use.
        meshes: meshes in use.
        flags: of the meshes.
        parameters: of the meshes.
        ranges: first and last (excluded) vertex of each mesh (M, 2).
        view: the view array.
        light: the light array; the places of the maps are written to it.
        map_depth: (S, S) height of the nearest caster along the key light.
        map_mesh: (S, S) its mesh, -1 for none.
        silhouette: (S, S) how much of the key light is blocked, blurred.
        under_depth: (R, R) scratch.
        under_mesh: (R, R) scratch.
        under: (R, R) how much of the sky is blocked close to the ground, blurred.
        others: (M, 4) rectangle of the map in which another mesh can shadow this one: u0, u1, v0, v1.
    """
    size, under_size = map_depth.shape[0], under.shape[0]
    soft = light[SOFTNESS]
    height = view[GROUND_HEIGHT]
    # Ranges along the light's axes and the world's x and y: of each mesh, then of all.
    boxes = np.empty((meshes, 4))
    box = np.array([math.inf, -math.inf, math.inf, -math.inf, math.inf, -math.inf, math.inf, -math.inf])
    for m in range(meshes):
        boxes[m, 0] = boxes[m, 2] = math.inf
        boxes[m, 1] = boxes[m, 3] = -math.inf
        if not flags[m] & CASTS:
            continue
        for i in range(ranges[m, 0], ranges[m, 1]):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            u = light[AXIS_U] * x + light[AXIS_U + 1] * y + light[AXIS_U + 2] * z
            v = light[AXIS_V] * x + light[AXIS_V + 1] * y + light[AXIS_V + 2] * z
            p[i, 0] = u
            p[i, 1] = v
            p[i, 2] = light[KEY_DIRECTION] * x + light[KEY_DIRECTION + 1] * y + light[KEY_DIRECTION + 2] * z
            boxes[m, 0], boxes[m, 1] = min(boxes[m, 0], u), max(boxes[m, 1], u)
            boxes[m, 2], boxes[m, 3] = min(boxes[m, 2], v), max(boxes[m, 3], v)
            box[4], box[5] = min(box[4], x), max(box[5], x)
            box[6], box[7] = min(box[6], y), max(box[7], y)
        box[0], box[1] = min(box[0], boxes[m, 0]), max(box[1], boxes[m, 1])
        box[2], box[3] = min(box[2], boxes[m, 2]), max(box[3], boxes[m, 3])
    light[HAS_SHADOWS] = 0.0
    if not box[0] < box[1]:
        return
    light[HAS_SHADOWS] = 1.0

    extent = max(box[1] - box[0], box[3] - box[2], 1e-6)
    # What a shadow's border needs around the casters; two blurs of a radius reach two radii.
    texel = (extent + 4.0 * soft) / (size - 8)
    radius = min(max(int(soft / texel + 0.5), 1), size // 8)
    light[MAP_SCALE] = 1.0 / texel
    light[MAP_U] = 0.5 * (box[0] + box[1]) - 0.5 * size * texel
    light[MAP_V] = 0.5 * (box[2] + box[3]) - 0.5 * size * texel
    for m in range(meshes):
        others[m, 0] = others[m, 2] = math.inf
        others[m, 1] = others[m, 3] = -math.inf
        for k in range(meshes):
            if k != m and boxes[k, 0] <= boxes[k, 1]:
                others[m, 0] = min(others[m, 0], (boxes[k, 0] - light[MAP_U]) / texel - 3.0)
                others[m, 1] = max(others[m, 1], (boxes[k, 1] - light[MAP_U]) / texel + 3.0)
                others[m, 2] = min(others[m, 2], (boxes[k, 2] - light[MAP_V]) / texel - 3.0)
                others[m, 3] = max(others[m, 3], (boxes[k, 3] - light[MAP_V]) / texel + 3.0)
        if flags[m] & CASTS:
            for i in range(ranges[m, 0], ranges[m, 1]):
                p[i, 0] = (p[i, 0] - light[MAP_U]) / texel
                p[i, 1] = (p[i, 1] - light[MAP_V]) / texel
    map_depth[:] = -math.inf
    map_mesh[:] = -1
    _draw_flat(points, p, triangles, owner, count, flags, parameters, map_depth, map_mesh)
    if view[GROUND_SEEN] == 0.0:
        return

    line = np.empty(size)
    for y in range(size):
        for x in range(size):
            m = map_mesh[y, x]
            silhouette[y, x] = parameters[m, OPACITY] if m >= 0 else 0.0
    _blur(silhouette, line, radius)

    wide = 2.0 * soft
    extent = max(box[5] - box[4], box[7] - box[6], 1e-6)
    texel = (extent + 4.0 * wide) / (under_size - 4)
    radius = min(max(int(wide / texel + 0.5), 1), under_size // 8)
    light[UNDER_SCALE] = 1.0 / texel
    light[UNDER_X] = 0.5 * (box[4] + box[5]) - 0.5 * under_size * texel
    light[UNDER_Y] = 0.5 * (box[6] + box[7]) - 0.5 * under_size * texel
    for m in range(meshes):
        if flags[m] & CASTS:
            for i in range(ranges[m, 0], ranges[m, 1]):
                p[i, 0] = (points[i, 0] - light[UNDER_X]) / texel
                p[i, 1] = (points[i, 1] - light[UNDER_Y]) / texel
                p[i, 2] = height - points[i, 2]
    under_depth[:] = -math.inf
    _draw_flat(points, p, triangles, owner, count, flags, parameters, under_depth, under_mesh)
    reach = 1.0 / max(4.0 * soft, 1e-6)
    for y in range(under_size):
        for x in range(under_size):
            value = under_depth[y, x]
            if value == -math.inf:
                under[y, x] = 0.0
            else:
                fall = 1.0 + max(-value, np.float32(0.0)) * reach
                under[y, x] = 1.0 / (fall * fall)
    _blur(under, line, radius)


@inline_kernel
def _sample(texture: Singles, x: float, y: float) -> float:
    """Bilinear look-up at texel coordinates; zero outside."""
    size = texture.shape[0]
    x -= 0.5
    y -= 0.5
    if not (x >= 0.0 and y >= 0.0 and x < size - 1 and y < size - 1):
        return 0.0
    i, j = int(x), int(y)
    fx, fy = x - i, y - j
    top = texture[j, i] + fx * (texture[j, i + 1] - texture[j, i])
    low = texture[j + 1, i] + fx * (texture[j + 1, i + 1] - texture[j + 1, i])
    return top + fy * (low - top)


@inline_kernel
def _mesh_shadow(
    px: float,
    py: float,
    pz: float,
    m: int,
    light: Floats,
    map_depth: Singles,
    map_mesh: Indices,
    others: Floats,
) -> float:
    """Part of the key light that other meshes keep from a point of mesh m, over 4 x 4 texels with soft weights."""
    u = (light[AXIS_U] * px + light[AXIS_U + 1] * py + light[AXIS_U + 2] * pz - light[MAP_U]) * light[MAP_SCALE]
    v = (light[AXIS_V] * px + light[AXIS_V + 1] * py + light[AXIS_V + 2] * pz - light[MAP_V]) * light[MAP_SCALE]
    if not (u > others[m, 0] and u < others[m, 1] and v > others[m, 2] and v < others[m, 3]):
        return 0.0
    size = map_depth.shape[0]
    i, j = int(u - 0.5) - 1, int(v - 0.5) - 1
    if i < 0 or j < 0 or i + 4 > size or j + 4 > size:
        return 0.0
    fx, fy = u - 0.5 - (i + 1), v - 0.5 - (j + 1)
    own = light[KEY_DIRECTION] * px + light[KEY_DIRECTION + 1] * py + light[KEY_DIRECTION + 2] * pz
    total = 0.0
    for b in range(4):
        part = 0.0
        for a in range(4):
            other = map_mesh[j + b, i + a]
            if other != m and other >= 0 and map_depth[j + b, i + a] > own:
                part += (1.0 - fx) if a == 0 else (fx if a == 3 else 1.0)
        total += part * ((1.0 - fy) if b == 0 else (fy if b == 3 else 1.0))
    return total / 9.0


# ------------------------------------------------------------------------------------------------- shading


@inline_kernel
def _streaks(coordinate: float, footprint: float) -> float:
    """Brush marks, in -1..1: three octaves of value noise, each left out where a pixel is wider than its waves."""
    total = 0.0
    for octave in range(3):
        frequency = 14.0 if octave == 0 else (43.0 if octave == 1 else 131.0)
        weight = 1.0 - 1.5 * footprint * frequency
        if weight <= 0.0:
            break
        position = coordinate * frequency + 1000.0
        index = int(math.floor(position))
        part = position - index
        low, high = _NOISE[index & 255], _NOISE[(index + 1) & 255]
        total += min(weight, 1.0) * (low + (high - low) * part) * (0.5 if octave == 0 else 0.4)
    return total


@inline_kernel
def _lattice(x: int, y: int, z: int) -> float:
    return _NOISE[(x * 73 + y * 179 + z * 283 + (x ^ (y * 7) ^ (z * 13)) * 31) & 255]


@inline_kernel
def _value_noise(x: float, y: float, z: float) -> float:
    """Smooth noise in -1..1: random numbers at whole coordinates, joined by cubics."""
    i, j, k = int(math.floor(x)), int(math.floor(y)), int(math.floor(z))
    fx, fy, fz = x - i, y - j, z - k
    fx, fy, fz = fx * fx * (3.0 - 2.0 * fx), fy * fy * (3.0 - 2.0 * fy), fz * fz * (3.0 - 2.0 * fz)
    total = 0.0
    for c in range(2):
        a = _lattice(i, j, k + c)
        a += fx * (_lattice(i + 1, j, k + c) - a)
        b = _lattice(i, j + 1, k + c)
        b += fx * (_lattice(i + 1, j + 1, k + c) - b)
        total += (a + fy * (b - a)) * (fz if c == 1 else 1.0 - fz)
    return total


@inline_kernel
def _mottle(x: float, y: float, z: float, footprint: float) -> tuple[float, float]:
    """Patches of paler and redder tissue (-1..1), and vessels (0..1), along which a noise crosses zero."""
    broad = _value_noise(0.55 * x + 7.3, 0.55 * y + 1.7, 0.55 * z + 4.1)
    fine = _value_noise(2.3 * x + 0.35 * broad, 2.3 * y + 9.2, 2.3 * z)
    ridge = abs(0.5 * broad + 0.5 * fine)
    width = 0.03 + 1.2 * footprint
    vessel = max(1.0 - ridge / width, 0.0) * min(0.04 / width, 1.0)
    if vessel > 0.0:
        # A zero of a noise is a closed line; a second noise breaks it into branches that taper.
        gate = _value_noise(1.1 * x + 3.9, 1.1 * y + 5.3, 1.1 * z + 8.8)
        vessel *= min(max(3.0 * gate, 0.0), 1.0)
    return 0.6 * broad + 0.4 * fine, vessel


@inline_kernel
def _light_up(
    px: float,
    py: float,
    pz: float,
    nx: float,
    ny: float,
    nz: float,
    vx: float,
    vy: float,
    vz: float,
    red: float,
    green: float,
    blue: float,
    streak: float,
    m: int,
    flags: Indices,
    parameters: Floats,
    view: Floats,
    light: Floats,
    map_depth: Singles,
    map_mesh: Indices,
    others: Floats,
) -> tuple[float, float, float]:
    """Light that leaves a point towards the eye; n and v are unit vectors and n . v is not negative."""
    lx, ly, lz = light[KEY_DIRECTION], light[KEY_DIRECTION + 1], light[KEY_DIRECTION + 2]
    n_l = nx * lx + ny * ly + nz * lz
    n_v = nx * vx + ny * vy + nz * vz
    grazing = 1.0 - min(max(n_v, 0.0), 1.0)
    fresnel = grazing * grazing
    fresnel = fresnel * fresnel * grazing

    lit = 1.0
    if light[HAS_SHADOWS] != 0.0 and flags[m] & RECEIVES:
        lit = 1.0 - light[SHADOW] * _mesh_shadow(px, py, pz, m, light, map_depth, map_mesh, others)
    key = light[KEY] * lit

    # Light bleeds around the terminator, red the furthest.
    bleed = parameters[m, SUBSURFACE]
    wrap_red, wrap_green, wrap_blue = 0.50 * bleed, 0.22 * bleed, 0.16 * bleed
    key_red = key * max(n_l + wrap_red, 0.0) / (1.0 + wrap_red)
    key_green = key * max(n_l + wrap_green, 0.0) / (1.0 + wrap_green)
    key_blue = key * max(n_l + wrap_blue, 0.0) / (1.0 + wrap_blue)

    fill = 0.5 + 0.5 * (
        nx * light[FILL_DIRECTION] + ny * light[FILL_DIRECTION + 1] + nz * light[FILL_DIRECTION + 2]
    )
    fill = light[FILL] * fill * fill

    up = 0.5 + 0.5 * nz
    ambient = light[AMBIENT]
    if view[GROUND_SEEN] != 0.0:
        # Near the ground, what faces down sees its own shadow.
        away = 1.0 + max(pz - view[GROUND_HEIGHT], 0.0) / max(4.0 * light[SOFTNESS], 1e-6)
        ambient *= 1.0 - 0.65 * (1.0 - up) / (away * away)
    sky_red = ambient * (_BOUNCE[0] + up * (_SKY[0] - _BOUNCE[0]))
    sky_green = ambient * (_BOUNCE[1] + up * (_SKY[1] - _BOUNCE[1]))
    sky_blue = ambient * (_BOUNCE[2] + up * (_SKY[2] - _BOUNCE[2]))

    # Blinn-Phong: the half vector of two unit vectors has the length sqrt(2 + 2 l . v).
    shine = 0.0
    specular = parameters[m, SPECULAR]
    if specular > 0.0 and n_l > 0.0:
        half = 2.0 + 2.0 * (lx * vx + ly * vy + lz * vz)
        shine = (n_l + n_v) / math.sqrt(max(half, 1e-12))
        broad = 0.0
        squarings = int(parameters[m, SHININESS])
        for k in range(squarings):
            shine *= shine
            if k == squarings - 4:
                broad = shine
        # A wide sheen under the sharp highlight, as from a film of liquid that is not quite even.
        shine = specular * key * (shine + 0.10 * broad) * (0.6 + 0.4 * fresnel) * min(4.0 * n_l, 1.0)

    edge = parameters[m, RIM] * fresnel * ambient * (0.35 + 0.65 * up) * 2.0

    metal = parameters[m, METALLIC]
    if metal > 0.0:
        # A metal mirrors the room: a pale floor, a darker band at the horizon, a bright ceiling with a soft box.
        rz = 2.0 * n_v * nz - vz + 0.35 * streak
        r_l = 2.0 * n_v * n_l - (vx * lx + vy * ly + vz * lz) + 0.25 * streak
        if rz < 0.0:
            room = 0.34 - 0.34 * max(rz, -1.0)
        else:
            room = 0.34 + 0.62 * min(rz, 1.0)
        box = min(max((r_l - 0.55) * 2.5, 0.0), 1.0)
        room += 0.75 * lit * box * box * (3.0 - 2.0 * box)
        room = room * (ambient * 2.0) * (1.0 + 0.35 * streak)
        key_red *= 1.0 - 0.75 * metal
        key_green *= 1.0 - 0.75 * metal
        key_blue *= 1.0 - 0.75 * metal
        sky_red += metal * (room - sky_red)
        sky_green += metal * (room - sky_green)
        sky_blue += metal * (room * 1.02 - sky_blue)

    return (
        red * (_KEY_COLOR[0] * key_red + _FILL_COLOR[0] * fill + sky_red) + _KEY_COLOR[0] * shine + edge,
        green * (_KEY_COLOR[1] * key_green + _FILL_COLOR[1] * fill + sky_green) + _KEY_COLOR[1] * shine + edge,
        blue * (_KEY_COLOR[2] * key_blue + _FILL_COLOR[2] * fill + sky_blue) + _KEY_COLOR[2] * shine + edge,
    )


@inline_kernel
def _shade(
    t: int,
    x: float,
    y: float,
    points: Floats,
    triangles: Indices,
    owner: Indices,
    barycentric: Floats,
    normals: Floats,
    colors: Floats,
    texture: Floats,
    flags: Indices,
    parameters: Floats,
    view: Floats,
    light: Floats,
    map_depth: Singles,
    map_mesh: Indices,
    others: Floats,
) -> tuple[float, float, float]:
    """Colour, in linear light, of triangle t (or of the cap of mesh -2 - t) at sample coordinate (x, y)."""
    rx = view[RAY] + x * view[RAY_X] + y * view[RAY_Y]
    ry = view[RAY + 1] + x * view[RAY_X + 1] + y * view[RAY_Y + 1]
    rz = view[RAY + 2] + x * view[RAY_X + 2] + y * view[RAY_Y + 2]
    streak = 0.0
    if t < 0:
        m = -2 - t
        red, green, blue = parameters[m, BACK], parameters[m, BACK + 1], parameters[m, BACK + 2]
        if flags[m] & UNLIT:
            return red, green, blue
        nx, ny, nz = parameters[m, PLANE], parameters[m, PLANE + 1], parameters[m, PLANE + 2]
        gap = parameters[m, PLANE + 3] - (nx * view[EYE] + ny * view[EYE + 1] + nz * view[EYE + 2])
        w = gap / (nx * rx + ny * ry + nz * rz)
    else:
        m = owner[t]
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        # At a silhouette the middle of the samples may lie a little outside: hold the weights inside.
        wa = max(barycentric[t, 0] * x + barycentric[t, 1] * y + barycentric[t, 2], 0.0)
        wb = max(barycentric[t, 3] * x + barycentric[t, 4] * y + barycentric[t, 5], 0.0)
        wc = max(barycentric[t, 6] * x + barycentric[t, 7] * y + barycentric[t, 8], 0.0)
        w = 1.0 / (wa + wb + wc)
        wa *= w
        wb *= w
        wc *= w
        red = wa * colors[a, 0] + wb * colors[b, 0] + wc * colors[c, 0]
        green = wa * colors[a, 1] + wb * colors[b, 1] + wc * colors[c, 1]
        blue = wa * colors[a, 2] + wb * colors[b, 2] + wc * colors[c, 2]
        if flags[m] & (UNLIT | LINE):
            return red, green, blue
        # Which side is seen is a matter of the triangle, not of its smooth normal.
        fx, fy, fz = _triangle_normal(points, triangles, t)
        back = (
            fx * (view[EYE] - points[a, 0]) + fy * (view[EYE + 1] - points[a, 1]) + fz * (view[EYE + 2] - points[a, 2])
        ) < 0.0
        if flags[m] & SMOOTH:
            nx = wa * normals[a, 0] + wb * normals[b, 0] + wc * normals[c, 0]
            ny = wa * normals[a, 1] + wb * normals[b, 1] + wc * normals[c, 1]
            nz = wa * normals[a, 2] + wb * normals[b, 2] + wc * normals[c, 2]
        else:
            nx, ny, nz = fx, fy, fz
        if back:
            red, green, blue = parameters[m, BACK], parameters[m, BACK + 1], parameters[m, BACK + 2]
            nx, ny, nz = -nx, -ny, -nz
        if flags[m] & TEXTURED:
            gx = wa * texture[a, 0] + wb * texture[b, 0] + wc * texture[c, 0]
            gy = wa * texture[a, 1] + wb * texture[b, 1] + wc * texture[c, 1]
            gz = wa * texture[a, 2] + wb * texture[b, 2] + wc * texture[c, 2]
            if parameters[m, GRAIN] > 0.0:
                streak = parameters[m, GRAIN] * _streaks(gy + gz, w / view[FOCAL])
            if parameters[m, MOTTLE] > 0.0 and not back:
                patch, vessel = _mottle(gx, gy, gz, w / view[FOCAL])
                patch *= parameters[m, MOTTLE]
                vessel *= parameters[m, MOTTLE]
                red *= (1.0 + 0.22 * patch) * (1.0 - 0.30 * vessel)
                green *= (1.0 + 0.45 * patch) * (1.0 - 0.68 * vessel)
                blue *= (1.0 + 0.40 * patch) * (1.0 - 0.58 * vessel)
    scale = 1.0 / math.sqrt(max(nx * nx + ny * ny + nz * nz, 1e-300))
    nx, ny, nz = nx * scale, ny * scale, nz * scale
    scale = -1.0 / math.sqrt(rx * rx + ry * ry + rz * rz)
    return _light_up(
        view[EYE] + w * rx,
        view[EYE + 1] + w * ry,
        view[EYE + 2] + w * rz,
        nx,
        ny,
        nz,
        scale * rx,
        scale * ry,
        scale * rz,
        red,
        green,
        blue,
        streak,
        m,
        flags,
        parameters,
        view,
        light,
        map_depth,
        map_mesh,
        others,
    )


_SCENE = (
    "f8[:,::1], i4[:,::1], i4[::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1],"
    " i4[::1], f8[:,::1], f8[::1], f8[::1], f4[:,::1], i4[:,::1], f8[:,::1]"
)
"""What `_shade` reads, from `points` to `others`."""


@kernel("i8(f8[:,::1], i4[:,::1], i4[::1], i8, i4[::1], f8[::1], i8[::1])")
def sort_translucent(
    p: Floats, triangles: Indices, owner: Indices, count: int, flags: Indices, keys: Floats, order: NDArray[np.int64]
) -> int:
    """Write the translucent triangles to `order`, nearest first; returns how many."""
    n = 0
    for t in range(count):
        if flags[owner[t]] & TRANSLUCENT:
            order[n] = t
            keys[n] = p[triangles[t, 0], 2] + p[triangles[t, 1], 2] + p[triangles[t, 2], 2]
            n += 1
    order[:n] = order[:n][np.argsort(keys[:n], kind="mergesort")]
    return n


@kernel(
    "void(i8[::1], i8, f8[:,::1], i8, i8, i8, f4[::1], f4[::1], i4[::1], i4[:,::1], f4[:,:,::1]," + _SCENE + ")"
)
def draw_translucent(
    order: NDArray[np.int64],
    count: int,
    p: Floats,
    width: int,
    height: int,
    supersample: int,
    depth: Singles,
    left: Singles,
    stamp: Indices,
    rows: Indices,
    total: Singles,
    points: Floats,
    triangles: Indices,
    owner: Indices,
    barycentric: Floats,
    normals: Floats,
    colors: Floats,
    texture: Floats,
    flags: Indices,
    parameters: Floats,
    view: Floats,
    light: Floats,
    map_depth: Singles,
    map_mesh: Indices,
    others: Floats,
) -> None:
    """Add the translucent triangles, nearest first.

    Args:
        order: triangles, nearest first.
        count: how many of them.
        p: homogeneous sample coordinates (N, 3).
        width: samples in a row.
        height: rows of samples.
        supersample: samples along a pixel's side.
        depth: 1 / W of what is opaque.
        left: part of the light from behind that still comes through each sample, starts at 1.
        stamp: last line object that covered a sample.
        rows: range of samples touched in each row, widened here.
        total: (H, W, 3) light of the translucent triangles in each pixel so far; starts at zero.
        points: and the rest: see `_shade`.
    """
    edge = np.empty((3, 3))
    limits = np.empty((5, 3))
    spans = np.empty((supersample, 2), dtype=np.int64)
    near, far = view[NEAR], view[FAR]
    share = 1.0 / (supersample * supersample)
    for k in range(count):
        t = order[k]
        m = owner[t]
        cut, back = flags[m] & CUT != 0, flags[m] & DRAW_BACK != 0
        n, x0, x1, y0, y1, det = _begin(
            t, points, p, triangles, m, cut, back, parameters, near, far, width, height, edge, limits
        )
        if n == 0:
            continue
        inverse = 1.0 / det
        for i in range(3):
            for j in range(3):
                barycentric[t, 3 * i + j] = edge[i, j] * inverse
        za = (edge[0, 0] + edge[1, 0] + edge[2, 0]) * inverse
        zb = (edge[0, 1] + edge[1, 1] + edge[2, 1]) * inverse
        zc = (edge[0, 2] + edge[1, 2] + edge[2, 2]) * inverse
        alpha = parameters[m, OPACITY]
        line = flags[m] & LINE != 0
        for py in range(y0 // supersample, (y1 - 1) // supersample + 1):
            first, last = width, 0
            for j in range(supersample):
                low, high = _span(py * supersample + j, x0, x1, limits, n)
                spans[j, 0], spans[j, 1] = low, high
                if low < high:
                    y = py * supersample + j
                    rows[y, 0] = min(rows[y, 0], low)
                    rows[y, 1] = max(rows[y, 1], high)
                    first, last = min(first, low), max(last, high)
            if first >= last:
                continue
            for px in range(first // supersample, (last - 1) // supersample + 1):
                weight = mean_x = mean_y = 0.0
                for j in range(supersample):
                    y = py * supersample + j
                    row = y * width
                    start = zb * (y + 0.5) + zc + 0.5 * za
                    for x in range(max(spans[j, 0], px * supersample), min(spans[j, 1], (px + 1) * supersample)):
                        if np.float32(start + za * x) <= depth[row + x] or (line and stamp[row + x] == m):
                            continue
                        part = left[row + x] * alpha
                        left[row + x] -= part
                        weight += part
                        mean_x += part * (x + 0.5)
                        mean_y += part * (y + 0.5)
                        if line:
                            stamp[row + x] = m
                if weight > 0.0:
                    red, green, blue = _shade(
                        t,
                        mean_x / weight,
                        mean_y / weight,
                        points,
                        triangles,
                        owner,
                        barycentric,
                        normals,
                        colors,
                        texture,
                        flags,
                        parameters,
                        view,
                        light,
                        map_depth,
                        map_mesh,
                        others,
                    )
                    weight *= share
                    total[py, px, 0] += weight * red
                    total[py, px, 1] += weight * green
                    total[py, px, 2] += weight * blue


# ------------------------------------------------------------------------------------- background and result


@inline_kernel
def _encode(value: float, tones: Bytes) -> int:
    return tones[int(min(max(value, 0.0), 1.0) * (TONES - 1) + 0.5)]


@inline_kernel
def _stripes(position: float, footprint: float, tile: float, line: float) -> float:
    """Part of the interval of length `footprint` around `position` that lines at the multiples of `tile` cover."""
    low = (position - 0.5 * footprint + 0.5 * line) / tile
    high = (position + 0.5 * footprint + 0.5 * line) / tile
    part = line / tile
    low_whole, high_whole = math.floor(low), math.floor(high)
    covered = (high_whole - low_whole) * part + min(high - high_whole, part) - min(low - low_whole, part)
    return covered * tile / footprint


@kernel("void(f8[::1], f8[::1], i8, i8, i8, u1[::1], f4[:,:,::1], f4[:,::1], u1[:,:,::1], f4[::1])")
def draw_background(
    view: Floats,
    ground: Floats,
    width: int,
    height: int,
    supersample: int,
    tones: Bytes,
    light: Singles,
    weight: Singles,
    encoded: Bytes,
    depth: Singles,
) -> None:
    """The background with the ground on it, which stays while camera, background and ground do.

    Args:
        view: the view array.
        ground: linear colours of the top (3), the bottom (3), the ground (3) and its lines (3), style (0 plain,
            1 grid, 2 checker), tile, line width, centre x and y, start and end of the fading.
        width: pixels.
        height: pixels.
        supersample: samples along a pixel's side.
        tones: the encoding table.
        light: linear colours (H, W, 3) to write.
        weight: how much of the ground each pixel shows (H, W), to write.
        encoded: the picture (H, W, 3) to write.
        depth: 1 / W of each sample, to write.
    """
    seen = view[GROUND_SEEN] != 0.0
    style, tile, line = ground[12], ground[13], ground[14]
    drop = view[GROUND_HEIGHT] - view[EYE + 2]
    for py in range(height):
        part = (py + 0.5) / height
        y = (py + 0.5) * supersample
        for px in range(width):
            x = (px + 0.5) * supersample
            red = ground[0] + part * (ground[3] - ground[0])
            green = ground[1] + part * (ground[4] - ground[1])
            blue = ground[2] + part * (ground[5] - ground[2])
            show = 0.0
            rz = view[RAY + 2] + x * view[RAY_X + 2] + y * view[RAY_Y + 2]
            if seen and rz < 0.0:
                w = drop / rz
                gx = view[EYE] + w * (view[RAY] + x * view[RAY_X] + y * view[RAY_Y])
                gy = view[EYE + 1] + w * (view[RAY + 1] + x * view[RAY_X + 1] + y * view[RAY_Y + 1])
                away = math.sqrt((gx - ground[15]) ** 2 + (gy - ground[16]) ** 2)
                fade = min(max((away - ground[17]) / (ground[18] - ground[17]), 0.0), 1.0)
                show = 1.0 - fade * fade * (3.0 - 2.0 * fade)
                second = 0.0
                if show > 0.0 and style > 0.0:
                    # Extent of the pixel on the ground along x and y: derivatives of gx and gy.
                    jx = abs(w * (view[RAY_X] - (gx - view[EYE]) / w * view[RAY_X + 2] / rz)) + abs(
                        w * (view[RAY_Y] - (gx - view[EYE]) / w * view[RAY_Y + 2] / rz)
                    )
                    jy = abs(w * (view[RAY_X + 1] - (gy - view[EYE + 1]) / w * view[RAY_X + 2] / rz)) + abs(
                        w * (view[RAY_Y + 1] - (gy - view[EYE + 1]) / w * view[RAY_Y + 2] / rz)
                    )
                    jx, jy = max(jx * supersample, 1e-9), max(jy * supersample, 1e-9)
                    gx -= ground[15]
                    gy -= ground[16]
                    if style == 1.0:
                        along = (1.0 - _stripes(gx, jx, tile, line)) * (1.0 - _stripes(gy, jy, tile, line))
                        second = 1.0 - along
                    else:
                        # The product of two square waves, each averaged over the pixel.
                        wave_x = 2.0 * _stripes(gx - 0.5 * tile, jx, 2.0 * tile, tile) - 1.0
                        wave_y = 2.0 * _stripes(gy - 0.5 * tile, jy, 2.0 * tile, tile) - 1.0
                        second = 0.5 - 0.5 * wave_x * wave_y
                red += show * (ground[6] + second * (ground[9] - ground[6]) - red)
                green += show * (ground[7] + second * (ground[10] - ground[7]) - green)
                blue += show * (ground[8] + second * (ground[11] - ground[8]) - blue)
            light[py, px, 0], light[py, px, 1], light[py, px, 2] = red, green, blue
            weight[py, px] = show
            encoded[py, px, 0] = _encode(red, tones)
            encoded[py, px, 1] = _encode(green, tones)
            encoded[py, px, 2] = _encode(blue, tones)
    for y in range(height * supersample):
        for x in range(width * supersample):
            value = 1.0 / view[FAR]
            if seen:
                rz = view[RAY + 2] + (x + 0.5) * view[RAY_X + 2] + (y + 0.5) * view[RAY_Y + 2]
                value = max(value, rz / drop)
                if value > 1.0 / view[NEAR]:
                    value = 1.0 / view[FAR]
            depth[y * width * supersample + x] = value


@inline_kernel
def _shadow_rows(
    view: Floats, light: Floats, matrix: Floats, size: int, under_size: int, supersample: int, width: int, height: int
) -> tuple[int, int, int, int]:
    """Pixels where the ground may be in shadow: x0, x1, y0, y1, ends excluded."""
    low_x = low_y = math.inf
    high_x = high_y = -math.inf
    for corner in range(8):
        i, j = corner & 1, (corner >> 1) & 1
        if corner < 4:
            u, v = light[MAP_U] + i * size / light[MAP_SCALE], light[MAP_V] + j * size / light[MAP_SCALE]
            x = u * light[AXIS_U] + v * light[AXIS_V]
            y = u * light[AXIS_U + 1] + v * light[AXIS_V + 1]
            z = u * light[AXIS_U + 2] + v * light[AXIS_V + 2]
            part = (view[GROUND_HEIGHT] - z) / light[KEY_DIRECTION + 2]
            x += part * light[KEY_DIRECTION]
            y += part * light[KEY_DIRECTION + 1]
        else:
            x = light[UNDER_X] + i * under_size / light[UNDER_SCALE]
            y = light[UNDER_Y] + j * under_size / light[UNDER_SCALE]
        z = view[GROUND_HEIGHT]
        w = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
        if w < view[NEAR]:
            return 0, width, 0, height
        px = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]) / (w * supersample)
        py = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]) / (w * supersample)
        low_x, high_x = min(low_x, px), max(high_x, px)
        low_y, high_y = min(low_y, py), max(high_y, py)
    return (
        int(min(max(low_x, 0.0), float(width))),
        int(min(max(high_x + 1.0, 0.0), float(width))),
        int(min(max(low_y, 0.0), float(height))),
        int(min(max(high_y + 1.0, 0.0), float(height))),
    )


@kernel(
    "void(i8, i8, i8, f8[:,::1], u1[::1], i4[::1], f4[::1], i4[:,::1], f4[:,:,::1], b1, f4[:,:,::1], f4[:,::1],"
    " f4[:,::1], f4[:,::1], u1[:,:,::1]," + _SCENE + ")"
)
def resolve(
    width: int,
    height: int,
    supersample: int,
    matrix: Floats,
    tones: Bytes,
    shown: Indices,
    left: Singles,
    rows: Indices,
    total: Singles,
    translucent: bool,
    background: Singles,
    ground_weight: Singles,
    silhouette: Singles,
    under: Singles,
    picture: Bytes,
    points: Floats,
    triangles: Indices,
    owner: Indices,
    barycentric: Floats,
    normals: Floats,
    colors: Floats,
    texture: Floats,
    flags: Indices,
    parameters: Floats,
    view: Floats,
    light: Floats,
    map_depth: Singles,
    map_mesh: Indices,
    others: Floats,
) -> None:
    """Shade, mix the samples of each pixel, and encode, where the picture differs from the bare background.

    Args:
        width: pixels.
        height: pixels.
        supersample: samples along a pixel's side.
        matrix: world to homogeneous sample coordinates (3, 4).
        tones: the encoding table.
        shown: triangle or cap of each sample, -1 for none.
        left: part of the light that comes through what is translucent, for each sample.
        rows: range of samples touched in each row.
        total: light of the translucent triangles (H, W, 3); it is set to zero again.
        translucent: whether there are any.
        background: linear colours (H, W, 3).
        ground_weight: how much of the ground each pixel shows (H, W).
        silhouette: see `cast_shadows`.
        under: see `cast_shadows`.
        picture: (H, W, 3), which holds the encoded background.
        points: and the rest: see `_shade`.
    """
    stride = width * supersample
    samples = supersample * supersample
    share = 1.0 / samples
    group = np.empty(samples, dtype=np.int32)
    group_left = np.ones(samples)
    shadows = light[HAS_SHADOWS] != 0.0 and view[GROUND_SEEN] != 0.0 and light[GROUND_SHADOW] > 0.0
    sx0 = sx1 = sy0 = sy1 = 0
    if shadows:
        sx0, sx1, sy0, sy1 = _shadow_rows(
            view, light, matrix, silhouette.shape[0], under.shape[0], supersample, width, height
        )
    drop = view[GROUND_HEIGHT] - view[EYE + 2]
    for py in range(height):
        first, last = stride, 0
        for j in range(supersample):
            first = min(first, rows[py * supersample + j, 0])
            last = max(last, rows[py * supersample + j, 1])
        first, last = first // supersample, (last + supersample - 1) // supersample
        shaded = shadows and py >= sy0 and py < sy1
        if shaded:
            first, last = min(first, sx0), max(last, sx1)
        for px in range(first, last):
            # The samples of this pixel: one triangle in all of them is by far the most frequent.
            same = True
            bare = 0.0
            for j in range(supersample):
                start = (py * supersample + j) * stride + px * supersample
                for i in range(supersample):
                    t = shown[start + i]
                    k = j * supersample + i
                    group[k] = t
                    same = same and t == group[0]
                    if translucent:
                        group_left[k] = left[start + i]
                    if t == -1:
                        bare += group_left[k]
            red = green = blue = 0.0
            if bare > 0.0:
                red, green, blue = background[py, px, 0], background[py, px, 1], background[py, px, 2]
                show = ground_weight[py, px]
                if shaded and show > 0.0:
                    x, y = (px + 0.5) * supersample, (py + 0.5) * supersample
                    w = drop / (view[RAY + 2] + x * view[RAY_X + 2] + y * view[RAY_Y + 2])
                    gx = view[EYE] + w * (view[RAY] + x * view[RAY_X] + y * view[RAY_Y])
                    gy = view[EYE + 1] + w * (view[RAY + 1] + x * view[RAY_X + 1] + y * view[RAY_Y + 1])
                    gz = view[GROUND_HEIGHT]
                    u = light[AXIS_U] * gx + light[AXIS_U + 1] * gy + light[AXIS_U + 2] * gz
                    v = light[AXIS_V] * gx + light[AXIS_V + 1] * gy + light[AXIS_V + 2] * gz
                    dark = _sample(
                        silhouette, (u - light[MAP_U]) * light[MAP_SCALE], (v - light[MAP_V]) * light[MAP_SCALE]
                    )
                    close = _sample(
                        under, (gx - light[UNDER_X]) * light[UNDER_SCALE], (gy - light[UNDER_Y]) * light[UNDER_SCALE]
                    )
                    depth = light[GROUND_SHADOW] * show
                    dark = 1.0 - (1.0 - 0.48 * depth * dark) * (1.0 - 0.62 * depth * close)
                    red *= 1.0 - _SHADOW_TINT[0] * dark
                    green *= 1.0 - _SHADOW_TINT[1] * dark
                    blue *= 1.0 - _SHADOW_TINT[2] * dark
                red, green, blue = red * bare * share, green * bare * share, blue * bare * share
            if not (same and group[0] == -1):
                for k in range(samples):
                    t = group[k]
                    if t == -1:
                        continue
                    weight = mean_x = mean_y = 0.0
                    if same:
                        for i in range(samples):
                            weight += group_left[i]
                        mean_x, mean_y = 0.5 * supersample, 0.5 * supersample
                    else:
                        members = 0
                        for i in range(k, samples):
                            if group[i] == t:
                                weight += group_left[i]
                                mean_x += i % supersample + 0.5
                                mean_y += i // supersample + 0.5
                                members += 1
                                if i > k:
                                    group[i] = -1
                        mean_x /= members
                        mean_y /= members
                    part_red, part_green, part_blue = _shade(
                        t,
                        px * supersample + mean_x,
                        py * supersample + mean_y,
                        points,
                        triangles,
                        owner,
                        barycentric,
                        normals,
                        colors,
                        texture,
                        flags,
                        parameters,
                        view,
                        light,
                        map_depth,
                        map_mesh,
                        others,
                    )
                    # What is brighter than white is cut here, or a highlight would have jagged edges.
                    weight *= share
                    red += weight * min(part_red, 1.0)
                    green += weight * min(part_green, 1.0)
                    blue += weight * min(part_blue, 1.0)
                    if same:
                        break
            if translucent:
                red += total[py, px, 0]
                green += total[py, px, 1]
                blue += total[py, px, 2]
                total[py, px, 0] = total[py, px, 1] = total[py, px, 2] = 0.0
            picture[py, px, 0] = _encode(red, tones)
            picture[py, px, 1] = _encode(green, tones)
            picture[py, px, 2] = _encode(blue, tones)


@kernel("void(i8, i8, i8, f4[::1], i4[::1], i4[::1], f4[:,::1])")
def resolve_depth(
    width: int, height: int, supersample: int, depth: Singles, shown: Indices, owner: Indices, out: Singles
) -> None:
    """Depth of each pixel: of the mesh that is nearest in it, averaged over that mesh's samples.

    1 / W is linear over the picture, so its mean over a pixel that one plane fills is exact at the pixel's centre; and
    no depth between two objects comes out at a border, where nothing is.
    """
    stride = width * supersample
    for py in range(height):
        for px in range(width):
            nearest = np.float32(-1.0)
            mesh = -1
            for j in range(supersample):
                for i in range(supersample):
                    k = (py * supersample + j) * stride + px * supersample + i
                    if depth[k] > nearest:
                        nearest = depth[k]
                        t = shown[k]
                        mesh = owner[t] if t >= 0 else t
            total, members = 0.0, 0
            for j in range(supersample):
                for i in range(supersample):
                    k = (py * supersample + j) * stride + px * supersample + i
                    t = shown[k]
                    if (owner[t] if t >= 0 else t) == mesh:
                        total += depth[k]
                        members += 1
            out[py, px] = members / total
