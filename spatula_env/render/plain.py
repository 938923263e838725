"""Plain pictures of many worlds: kernels that draw them from arrays, with no object for a world.

A picture has one sample per pixel, in its middle, and no shadows, highlights or marks of a material. Light is computed
at the vertices, with the same lights as in `shading`, and interpolated over the triangles in display values. Ground and
background are the same from picture to picture and are only copied. Visibility is decided as in `rasterizer`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numba import types

from spatula_env._kernels import kernel
from spatula_env.contact.flags import fill_rotation
from spatula_env.contact.rigid import turn
from spatula_env.render.compose import GROUND_BEHIND, fill_slope
from spatula_env.render.layout import (
    DEPTH,
    EYE,
    FAR,
    GROUND_HEIGHT,
    GROUND_SEEN,
    NEAR,
    TONES,
    Bytes,
    Floats,
    Indices,
    Singles,
    inlined,
)
from spatula_env.render.rasterizer import bounds, collect_limits, edges, is_thin, span
from spatula_env.render.shading import body_light
from spatula_env.render.vertices import place, vertex_normals

if TYPE_CHECKING:
    from numpy.typing import NDArray

PLAIN_FUNCTIONS = 12
"""Columns of a triangle's functions: three of 1 / W, as in `layout`, and nine of its colour."""

SHADE = 3
"""First of the nine columns of a triangle's colour / W, in display values from 0 to 255."""


class Model(NamedTuple):
    """What all worlds and all pictures have in common: O vertices of organs, then Q of tools, three per triangle.

    Attributes:
        source: (O,) node that each vertex of the organs is.
        tool_vertices: (Q, 3) in the frames of their tools [u].
        tools: (Q,) tool that each of them belongs to.
        triangles: (T, 3) vertices, counter-clockwise from outside.
        colors: (R + 1, O + Q, 3) linear colours of the vertices without dye, and with each of R dyes.
        parameters: (2, PARAMETERS) of the organs and of the tools; see `layout`.
        viewing: (VIEW,) the view array; see `layout`. Numba takes the name "view" for a method.
        light: (LIGHT,) see `layout`.
        matrix: (3, 4) world to homogeneous pixel coordinates.
        tones: (TONES,) display value of each step of linear light.
    """

    source: Indices
    tool_vertices: Floats
    tools: Indices
    triangles: Indices
    colors: Floats
    parameters: Floats
    viewing: Floats
    light: Floats
    matrix: Floats
    tones: Bytes


class States(NamedTuple):
    """What n worlds look like now.

    Attributes:
        frame: (4,) origin of the frame of nodes and positions in the scene, and its unit [u].
        nodes: (n, V, 3) of the organs; numbers that are not finite count as zero.
        positions: (n, N, 3) of the tools.
        orientations: (n, N, 4) of the tools, quaternions xyzw.
        scales: (n,) factors on the lengths of the tools.
        dyes: (n, V) dye of each node, 0 for none.
        heights: (n,) of the ground [u].
        backdrops: (n,) picture of ground and background of each world.
    """

    frame: Floats
    nodes: Floats
    positions: Floats
    orientations: Floats
    scales: Floats
    dyes: Bytes
    heights: Floats
    backdrops: NDArray[np.int64]


def _type_of(kind: Any, *elements: str) -> Any:
    """Numba's type of a NamedTuple of C-contiguous arrays, by element and number of dimensions such as "f8 2"."""
    names = {"f8": types.float64, "f4": types.float32, "i4": types.int32, "i8": types.int64, "u1": types.uint8}
    arrays = [types.Array(names[element[:2]], int(element[2:]), "C") for element in elements]
    return types.NamedTuple(arrays, kind)  # type: ignore[no-untyped-call]


MODEL = _type_of(Model, "i4 1", "f8 2", "i4 1", "i4 2", "f8 3", "f8 2", "f8 1", "f8 1", "f8 2", "u1 1")
STATES = _type_of(States, "f8 1", "f8 3", "f8 3", "f8 3", "f8 1", "u1 2", "f8 1", "i8 1")


@kernel(types.void(types.int64, MODEL, STATES, types.float64[:, ::1]))
def place_bodies(world: int, model: Model, states: States, points: Floats) -> None:
    """Write the positions (O + Q, 3) of all vertices of a world."""
    nodes, positions, orientations = states.nodes[world], states.positions[world], states.orientations[world]
    scale, frame = states.scales[world], states.frame
    source, local, tools = model.source, model.tool_vertices, model.tools
    for i in range(len(source)):
        for k in range(3):
            value = nodes[source[i], k]
            points[i, k] = frame[k] + frame[3] * (value if math.isfinite(value) else 0.0)
    rotation, at, placed = np.empty(9), np.empty(3), -1
    for i in range(len(tools)):
        if tools[i] != placed:
            placed = tools[i]
            fill_rotation(orientations[placed], 1.0, rotation)
        for k in range(3):
            at[k] = scale * local[i, k]
        x, y, z = turn(rotation, at)
        row = len(source) + i
        points[row, 0] = frame[0] + frame[3] * positions[placed, 0] + x
        points[row, 1] = frame[1] + frame[3] * positions[placed, 1] + y
        points[row, 2] = frame[2] + frame[3] * positions[placed, 2] + z


@kernel(types.void(types.int64, MODEL, STATES, *[types.float64[:, ::1]] * 2, types.float64[::1], types.float64[:, ::1]))
def light_vertices(
    world: int, model: Model, states: States, points: Floats, normals: Floats, view: Floats, shades: Floats
) -> None:
    """Write the display values (O + Q, 3), from 0 to 255, of all vertices of a world in the light.

    Args:
        world: The world.
        model: The model.
        states: The states.
        points: (O + Q, 3) positions.
        normals: (O + Q, 3) of unit length.
        view: (VIEW,) with the height of this world's ground.
        shades: (O + Q, 3) to write.
    """
    dyes = states.dyes[world]
    source, colors, parameters, light, tones = model.source, model.colors, model.parameters, model.light, model.tones
    for i in range(len(points)):
        dye, m = 0, 1
        if i < len(source):
            dye, m = dyes[source[i]], 0
        vx, vy, vz = view[EYE] - points[i, 0], view[EYE + 1] - points[i, 1], view[EYE + 2] - points[i, 2]
        scale = 1.0 / math.sqrt(max(vx * vx + vy * vy + vz * vz, 1e-300))
        normal = (normals[i, 0], normals[i, 1], normals[i, 2])
        eye = (scale * vx, scale * vy, scale * vz)
        lights = body_light(light, view, parameters, m, normal, eye, points[i, 2], 1.0, 0.0)
        for k in range(3):
            level = colors[dye, i, k] * lights[k]
            shades[i, k] = tones[int(min(max(level, 0.0), 1.0) * (TONES - 1) + 0.5)]


@inlined
def _fill_plain(t: int, edge: Floats, det: float, a: int, b: int, c: int, shades: Floats, functions: Floats) -> None:
    """Write the functions of triangle t with the corners a, b, c: 1 / W, and colour / W."""
    inverse = 1.0 / det
    for j in range(3):
        ea, eb, ec = edge[0, j] * inverse, edge[1, j] * inverse, edge[2, j] * inverse
        functions[t, DEPTH + j] = ea + eb + ec
        for k in range(3):
            functions[t, SHADE + 3 * k + j] = ea * shades[a, k] + eb * shades[b, k] + ec * shades[c, k]


@kernel("void(f8[:,::1], i4[:,::1], f8[:,::1], f8, i8, i8, f8[:,::1], f4[::1], i4[::1])")
def draw_triangles(
    p: Floats,
    triangles: Indices,
    shades: Floats,
    near: float,
    width: int,
    height: int,
    functions: Floats,
    depth: Singles,
    shown: Indices,
) -> None:
    """Find the nearest front of a triangle in every pixel, and write the functions of the triangles.

    Args:
        p: (P, 3) homogeneous pixel coordinates of the vertices.
        triangles: (T, 3).
        shades: (P, 3) display values of the vertices.
        near: Depth below which nothing is drawn [u].
        width: Pixels in a row.
        height: Rows of pixels.
        functions: (T, PLAIN_FUNCTIONS) to write, of those that may be visible.
        depth: (H W,) 1 / W of each pixel, larger is nearer; starts with that of the ground.
        shown: (H W,) triangle of each pixel; starts at -1 for none.
    """
    edge, limits = np.empty((3, 3)), np.empty((1, 5, 3))
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        wa, wb, wc = p[a, 2], p[b, 2], p[c, 2]
        if max(wa, wb, wc) < near:
            continue
        det = edges(p, a, b, c, edge)
        # Fronts have a negative determinant: y points down in the picture.
        if det > 0.0 or is_thin(p, a, b, c, det):
            continue
        x0, x1, y0, y1 = bounds(p, a, b, c, near, width, height)
        if x0 >= x1 or y0 >= y1:
            continue
        count = collect_limits(edge, det, near, min(wa, wb, wc) < near, False, 0.0, 0.0, 0.0, limits, 0)
        _fill_plain(t, edge, det, a, b, c, shades, functions)
        za, zb, zc = functions[t, DEPTH], functions[t, DEPTH + 1], functions[t, DEPTH + 2]
        for y in range(y0, y1):
            low, high = span(y, x0, x1, limits, 0, count)
            start = zb * (y + 0.5) + zc + 0.5 * za
            row = y * width
            for x in range(low, high):
                value = np.float32(start + za * x)
                if value > depth[row + x]:
                    depth[row + x] = value
                    shown[row + x] = t


@inlined
def _copy(source: Bytes, target: Bytes) -> None:
    """Copy bytes one by one, which LLVM makes fifty times as fast as an assignment of pictures."""
    for i in range(len(target)):
        target[i] = source[i]


@inlined
def _clear(view: Floats, slope: Floats, width: int, height: int, depth: Singles, shown: Indices) -> None:
    """Reset pixels to show only the ground: 1 / W, slightly further away than it is, and no triangle."""
    fill_slope(view, slope)
    nearest, farthest = 1.0 / view[NEAR], 1.0 / view[FAR]
    for y in range(height):
        start = GROUND_BEHIND * (slope[1] * (y + 0.5) + slope[2] + 0.5 * slope[0])
        for x in range(width):
            value = start + GROUND_BEHIND * slope[0] * x
            # Ground nearer than the near plane is not drawn.
            value = 0.0 if value > nearest else value
            depth[y * width + x] = max(value, farthest)
            shown[y * width + x] = -1


@kernel("void(i8, f8, f8[:,::1], f4[::1], i4[::1], u1[:,:,::1], f4[:,::1])")
def resolve_plain(
    width: int, far: float, functions: Floats, depth: Singles, shown: Indices, picture: Bytes, depth_picture: Singles
) -> None:
    """Write the colour of every pixel that shows a triangle, and the depth of all.

    Args:
        width: Pixels in a row.
        far: Depth of what shows nothing [u].
        functions: See `draw_triangles`.
        depth: See `draw_triangles`.
        shown: See `draw_triangles`.
        picture: (H, W, 3) to write over.
        depth_picture: (H, W) to write [u], or without rows.
    """
    deep = len(depth_picture) > 0
    for y in range(len(picture)):
        middle = y + 0.5
        for x in range(width):
            t = shown[y * width + x]
            if t >= 0:
                w = 1.0 / depth[y * width + x]
                for k in range(3):
                    i = SHADE + 3 * k
                    value = functions[t, i] * (x + 0.5) + functions[t, i + 1] * middle + functions[t, i + 2]
                    picture[y, x, k] = int(min(max(w * value + 0.5, 0.0), 255.0))
                if deep:
                    depth_picture[y, x] = w
            elif deep:
                depth_picture[y, x] = min(GROUND_BEHIND / depth[y * width + x], far)


@kernel(
    types.void(
        types.int64,
        types.int64,
        MODEL,
        types.uint8[:, :, :, ::1],
        STATES,
        types.uint8[:, :, :, ::1],
        types.float32[:, :, ::1],
    ),
    nogil=True,
)
def draw_worlds(
    first: int, last: int, model: Model, backdrops: Bytes, states: States, pictures: Bytes, depths: Singles
) -> None:
    """Draw the worlds first..last. Each is drawn on its own, so that it does not matter which are drawn together.

    Args:
        first: First world.
        last: End of the worlds.
        model: What all worlds have in common.
        backdrops: (B, H, W, 3) pictures of ground and background.
        states: The states of n worlds.
        pictures: (n, H, W, 3) to write.
        depths: (n, H, W) to write, along the optical axis [u]; or (0, H, W).
    """
    height, width = pictures.shape[1], pictures.shape[2]
    triangles, view, slope = model.triangles, model.viewing.copy(), np.empty(3)
    count = len(model.source) + len(model.tools)
    points, placed = np.empty((count, 3)), np.empty((count, 3))
    normals, shades = np.empty((count, 3)), np.empty((count, 3))
    functions = np.empty((len(triangles), PLAIN_FUNCTIONS))
    depth, shown = np.empty(height * width, np.float32), np.empty(height * width, np.int32)
    nothing = np.empty((0, width), np.float32)
    for world in range(first, last):
        view[GROUND_HEIGHT] = states.heights[world]
        view[GROUND_SEEN] = model.viewing[GROUND_SEEN] if view[EYE + 2] > view[GROUND_HEIGHT] else 0.0
        place_bodies(world, model, states, points)
        place(points, 0, count, model.matrix, placed)
        vertex_normals(points, triangles, 0, count, 0, len(triangles), normals)
        light_vertices(world, model, states, points, normals, view, shades)
        _clear(view, slope, width, height, depth, shown)
        draw_triangles(placed, triangles, shades, view[NEAR], width, height, functions, depth, shown)
        _copy(backdrops[states.backdrops[world]].reshape(-1), pictures[world].reshape(-1))
        deep = nothing
        if len(depths) > 0:
            deep = depths[world]
        resolve_plain(width, view[FAR], functions, depth, shown, pictures[world], deep)
