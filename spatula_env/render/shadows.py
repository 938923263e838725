"""Shadows: maps drawn from the key light and from above.

Shadows on meshes come from a depth map along the key light. A mesh does not shadow itself, because on a coarse mesh
with smooth normals that would show the facets. Shadows on the ground are a blurred silhouette along the key light, and
a wider one straight down that fades with height, for the ambient light that does not reach under things.
"""

from __future__ import annotations

import math

import numpy as np

from spatula_env._kernels import inline_kernel, kernel
from spatula_env.render.layout import (
    AXIS_U,
    AXIS_V,
    CASTS,
    CUT,
    GROUND_HEIGHT,
    GROUND_SEEN,
    HAS_SHADOWS,
    KEY_DIRECTION,
    MAP_BOX,
    MAP_SCALE,
    MAP_U,
    MAP_V,
    OPACITY,
    SOFTNESS,
    UNDER_BOX,
    UNDER_SCALE,
    UNDER_X,
    UNDER_Y,
    Floats,
    Indices,
    Singles,
)
from spatula_env.render.rasterizer import bounds, collect_limits, edges, is_thin, plane_distances, span


@kernel("void(f8[:,::1], f8[:,::1], i4[:,::1], i4[::1], i8, i4[::1], f8[:,::1], f4[:,::1], i4[:,::1])")
def draw_flat(
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
    """Find the nearest caster in a parallel projection: p holds x and y in texels and the height towards the viewer."""
    edge = np.empty((3, 3))
    limits = np.empty((1, 5, 3))
    size = depth.shape[0]
    q = np.ones((3, 3))
    for t in range(count):
        m = owner[t]
        if not flags[m] & CASTS:
            continue
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        cut = flags[m] & CUT != 0
        da, db, dc = plane_distances(points, a, b, c, parameters, m, cut)
        if min(da, db, dc) > 0.0:
            continue
        cut = max(da, db, dc) > 0.0
        for k in range(2):
            q[0, k], q[1, k], q[2, k] = p[a, k], p[b, k], p[c, k]
        det = edges(q, 0, 1, 2, edge)
        if is_thin(q, 0, 1, 2, det):
            continue
        x0, x1, y0, y1 = bounds(q, 0, 1, 2, 0.5, size, size)
        if x0 >= x1 or y0 >= y1:
            continue
        n = collect_limits(edge, det, 0.5, False, cut, da, db, dc, limits, 0)
        za = (edge[0, 0] * p[a, 2] + edge[1, 0] * p[b, 2] + edge[2, 0] * p[c, 2]) / det
        zb = (edge[0, 1] * p[a, 2] + edge[1, 1] * p[b, 2] + edge[2, 1] * p[c, 2]) / det
        zc = (edge[0, 2] * p[a, 2] + edge[1, 2] * p[b, 2] + edge[2, 2] * p[c, 2]) / det
        for y in range(y0, y1):
            low, high = span(y, x0, x1, limits, 0, n)
            start = zb * (y + 0.5) + zc + 0.5 * za
            for x in range(low, high):
                value = np.float32(start + za * x)
                if value > depth[y, x]:
                    depth[y, x] = value
                    shown[y, x] = m


@kernel("void(f4[:,:,::1], i8, i8, f8[::1], f4[:,::1], i8)")
def _blur(maps: Singles, layer: int, size: int, line: Floats, ring: Singles, radius: int) -> None:
    """Two box filters of 2 radius + 1 texels in each direction, in place: nearly a Gaussian."""
    norm = 1.0 / (2 * radius + 1)
    for _ in range(2):
        for y in range(size):
            total = 0.0
            for x in range(size):
                line[x] = maps[layer, y, x]
            for x in range(min(radius, size)):
                total += line[x]
            for x in range(size):
                if x + radius < size:
                    total += line[x + radius]
                if x - radius - 1 >= 0:
                    total -= line[x - radius - 1]
                maps[layer, y, x] = total * norm
    # The columns are filtered row by row, with one running sum for each, because the memory is laid out in rows.
    for _ in range(2):
        for x in range(size):
            line[x] = 0.0
        ring[: 2 * radius + 1] = 0.0
        for y in range(size + radius):
            slot = y % (2 * radius + 1)
            for x in range(size):
                line[x] -= ring[slot, x]
                ring[slot, x] = maps[layer, y, x] if y < size else np.float32(0.0)
                line[x] += ring[slot, x]
            if y >= radius:
                for x in range(size):
                    maps[layer, y - radius, x] = line[x] * norm


@inline_kernel
def _measure_casters(
    points: Floats,
    meshes: int,
    flags: Indices,
    ranges: Indices,
    light: Floats,
    p: Floats,
    boxes: Floats,
    box: Floats,
) -> None:
    """Transform the casters of shadows to the light's axes, and find their extents.

    Args:
        points: world positions (N, 3).
        meshes: meshes in use.
        flags: of the meshes.
        ranges: first and last (excluded) vertex of each mesh (M, 2).
        light: the light array.
        p: (N, 3) to write: coordinates along the light's axes, the height last.
        boxes: (M, 4) to write: u0, u1, v0, v1 of each mesh; with u0 > u1 for one that casts no shadow.
        box: (8,) to write: u0, u1, v0, v1, x0, x1, y0, y1 of all of them.
    """
    for k in range(0, 8, 2):
        box[k], box[k + 1] = math.inf, -math.inf
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


@inline_kernel
def _place_key_map(
    p: Floats,
    meshes: int,
    flags: Indices,
    ranges: Indices,
    boxes: Floats,
    box: Floats,
    size: int,
    light: Floats,
    others: Floats,
) -> int:
    """Place the map of the key light around the casters.

    Args:
        p: coordinates along the light's axes, see `_measure_casters`; converted to texels.
        meshes: meshes in use.
        flags: of the meshes.
        ranges: first and last (excluded) vertex of each mesh (M, 2).
        boxes: see `_measure_casters`.
        box: see `_measure_casters`.
        size: texels along a side of the map.
        light: the light array; the map's place is written to it.
        others: see `cast_shadows`.

    Returns:
        Radius by which the shadows are to be blurred, texels.
    """
    soft = light[SOFTNESS]
    extent = max(box[1] - box[0], box[3] - box[2], 1e-6)
    # The margin that a shadow's border needs around the casters: two blurs of a radius reach two radii.
    texel = (extent + 4.0 * soft) / (size - 8)
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
    for k in range(4):
        light[MAP_BOX + k] = box[k] + (2.0 * soft + 2.0 * texel) * (1.0 if k & 1 else -1.0)
    return min(max(int(soft / texel + 0.5), 1), size // 8)


@inline_kernel
def _place_under_map(
    points: Floats,
    p: Floats,
    meshes: int,
    flags: Indices,
    ranges: Indices,
    box: Floats,
    size: int,
    height: float,
    light: Floats,
) -> int:
    """Place the map straight down around the casters.

    Args:
        points: world positions (N, 3).
        p: (N, 3) to write: coordinates in texels, and the height below the ground.
        meshes: meshes in use.
        flags: of the meshes.
        ranges: first and last (excluded) vertex of each mesh (M, 2).
        box: see `_measure_casters`.
        size: texels along a side of the map.
        height: of the ground.
        light: the light array; the map's place is written to it.

    Returns:
        Radius by which the shadows are to be blurred, texels.
    """
    wide = 1.5 * light[SOFTNESS]
    extent = max(box[5] - box[4], box[7] - box[6], 1e-6)
    texel = (extent + 4.0 * wide) / (size - 4)
    for k in range(4):
        light[UNDER_BOX + k] = box[4 + k] + (2.0 * wide + 2.0 * texel) * (1.0 if k & 1 else -1.0)
    light[UNDER_SCALE] = 1.0 / texel
    light[UNDER_X] = 0.5 * (box[4] + box[5]) - 0.5 * size * texel
    light[UNDER_Y] = 0.5 * (box[6] + box[7]) - 0.5 * size * texel
    for m in range(meshes):
        if flags[m] & CASTS:
            for i in range(ranges[m, 0], ranges[m, 1]):
                p[i, 0] = (points[i, 0] - light[UNDER_X]) / texel
                p[i, 1] = (points[i, 1] - light[UNDER_Y]) / texel
                p[i, 2] = height - points[i, 2]
    return min(max(int(wide / texel + 0.5), 1), size // 8)


@inline_kernel
def _darken_below(under_depth: Singles, soft: float, dark: Singles) -> None:
    """Write how much of the sky is blocked, which decreases with a caster's height, to the second layer of `dark`."""
    reach = 1.0 / max(4.0 * soft, 1e-6)
    for y in range(under_depth.shape[0]):
        for x in range(under_depth.shape[0]):
            value = under_depth[y, x]
            if value == -math.inf:
                dark[1, y, x] = 0.0
            else:
                fall = 1.0 + max(-value, np.float32(0.0)) * reach
                dark[1, y, x] = 1.0 / (fall * fall)


@kernel(
    "void(f8[:,::1], f8[:,::1], i4[:,::1], i4[::1], i8, i8, i4[::1], f8[:,::1], i4[:,::1], f8[::1], f8[::1],"
    " f4[:,::1], i4[:,::1], f4[:,:,::1], f4[:,::1], i4[:,::1], f8[:,::1])"
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
    dark: Singles,
    under_depth: Singles,
    under_mesh: Indices,
    others: Floats,
) -> None:
    """Draw the shadow maps.

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
        dark: (2, S, S) how much of the key light is blocked, blurred; and, in the first R x R texels of the second
            layer, how much of the sky is blocked close to the ground, blurred.
        under_depth: (R, R) scratch.
        under_mesh: (R, R) scratch.
        others: (M, 4) rectangle of the map in which another mesh can shadow this one: u0, u1, v0, v1.
    """
    size, under_size = map_depth.shape[0], under_depth.shape[0]
    boxes = np.empty((meshes, 4))
    box = np.empty(8)
    _measure_casters(points, meshes, flags, ranges, light, p, boxes, box)
    if not box[0] < box[1]:
        light[HAS_SHADOWS] = 0.0
        return
    light[HAS_SHADOWS] = 1.0

    radius = _place_key_map(p, meshes, flags, ranges, boxes, box, size, light, others)
    map_depth[:] = -math.inf
    map_mesh[:] = -1
    draw_flat(points, p, triangles, owner, count, flags, parameters, map_depth, map_mesh)
    if view[GROUND_SEEN] == 0.0:
        return

    line = np.empty(size)
    ring = np.empty((2 * (size // 8) + 1, size), dtype=np.float32)
    for y in range(size):
        for x in range(size):
            m = map_mesh[y, x]
            dark[0, y, x] = parameters[m, OPACITY] if m >= 0 else 0.0
    _blur(dark, 0, size, line, ring, radius)

    radius = _place_under_map(points, p, meshes, flags, ranges, box, under_size, view[GROUND_HEIGHT], light)
    under_depth[:] = -math.inf
    draw_flat(points, p, triangles, owner, count, flags, parameters, under_depth, under_mesh)
    _darken_below(under_depth, light[SOFTNESS], dark)
    _blur(dark, 1, under_size, line, ring, radius)
