"""Composition of a picture from samples: mixing, encoding, and the order of the kernels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spatula_env._kernels import inline_kernel, kernel
from spatula_env.render.ground_shadow import shadow_corners, shadow_part, shadow_row
from spatula_env.render.layout import (
    BAND,
    EYE,
    FAR,
    GROUND_HEIGHT,
    GROUND_SEEN,
    GROUND_SHADOW,
    HAS_SHADOWS,
    NEAR,
    RAY,
    RAY_X,
    RAY_Y,
    SCENE,
    TONES,
    Band,
    Bytes,
    Floats,
    Indices,
    Scene,
    Singles,
    inlined,
)
from spatula_env.render.rasterizer import draw_cap, draw_opaque
from spatula_env.render.shading import shade
from spatula_env.render.translucent import draw_translucent

# Fraction of each channel that a full shadow on the ground removes: a little blue is left, as from a sky.
_SHADOW_TINT = (1.0, 0.985, 0.955)

# Factor on the ground's 1 / W, which puts it slightly further away, so that things lying on it are seen.
GROUND_BEHIND = 1.0 - 1e-4


@inlined
def _touched_pixels(rows: Indices, row: int, supersample: int, stride: int) -> tuple[int, int]:
    """Range of pixels, the end excluded, in a band's row with touched samples; `rows` and `stride` count samples."""
    first, last = stride, 0
    for j in range(row * supersample, (row + 1) * supersample):
        first, last = min(first, rows[j, 0]), max(last, rows[j, 1])
    return first // supersample, (last + supersample - 1) // supersample


@inlined
def _is_one(shown: Indices, corner: int, supersample: int, stride: int) -> bool:
    """Whether all samples of the pixel whose first sample is `corner` show the same triangle, or all show none."""
    whole = shown[corner]
    if supersample == 2:
        return bool(
            shown[corner + 1] == whole and shown[corner + stride] == whole and shown[corner + stride + 1] == whole
        )
    same = True
    for k in range(1, supersample * supersample):
        same = same and shown[corner + k // supersample * stride + k % supersample] == whole
    return same


@inlined
def _split_pixel(
    px: int,
    py: int,
    pixel: int,
    corner: int,
    supersample: int,
    stride: int,
    share: float,
    translucent: bool,
    shown: Indices,
    left: Singles,
    group: Indices,
    group_left: Floats,
    waiting: int,
    jobs: Indices,
    places: Floats,
) -> tuple[int, float]:
    """Make a job of each triangle in a pixel, at the mean of the samples that show it.

    Args:
        px: column of the pixel.
        py: its row.
        pixel: its number in the band.
        corner: its first sample.
        supersample: samples along a pixel's side.
        stride: samples in a row.
        share: fraction of a pixel that a sample covers.
        translucent: whether there are translucent triangles.
        shown: see `layout.Band`.
        left: see `layout.Band`.
        group: scratch for each sample of a pixel.
        group_left: scratch for each sample of a pixel.
        waiting: number of jobs so far.
        jobs: written to.
        places: written to.

    Returns:
        The number of jobs, and the number of samples that show no triangle, each weighted by the light that comes
        through what is translucent.
    """
    samples = len(group)
    bare = 0.0
    for k in range(samples):
        group[k] = shown[corner + k // supersample * stride + k % supersample]
        group_left[k] = 1.0
        if translucent:
            group_left[k] = left[corner + k // supersample * stride + k % supersample]
        if group[k] == -1:
            bare += group_left[k]
    for k in range(samples):
        t = group[k]
        if t == -1:
            continue
        weight = mean_x = mean_y = 0.0
        members = 0
        for i in range(k, samples):
            if group[i] == t:
                weight += group_left[i]
                mean_x += i % supersample + 0.5
                mean_y += i // supersample + 0.5
                members += 1
                group[i] = -1
        jobs[waiting, 0] = t
        jobs[waiting, 1] = pixel
        places[waiting, 0] = px * supersample + mean_x / members
        places[waiting, 1] = py * supersample + mean_y / members
        places[waiting, 2] = weight * share
        waiting += 1
    return waiting, bare


@inlined
def _add_background(
    total: Singles, pixel: int, share: float, blocked: float, background: Singles, py: int, px: int
) -> None:
    """Add a share of the background in row py and column px, darkened by the blocked part of a shadow on the ground."""
    for k in range(3):
        total[pixel, k] += share * (1.0 - _SHADOW_TINT[k] * blocked) * background[py, px, k]


@inlined
def _encode_row(total: Singles, row: int, first: int, last: int, tones: Bytes, picture: Bytes, py: int) -> None:
    """Encode pixels of a row of the band, which is row py of the picture, and reset their light to zero."""
    for px in range(first, last):
        pixel = row * picture.shape[1] + px
        for k in range(3):
            level = total[pixel, k] * np.float32(TONES - 1) + np.float32(0.5)
            picture[py, px, k] = tones[min(max(int(level), 0), TONES - 1)]
            total[pixel, k] = 0.0


@kernel(
    "void(i8, i8, i8, i8, f8[:,::1], i8, f8[::1], u1[::1], b1, f4[:,:,::1], f4[:,::1], f4[:,:,::1], i8, u1[:,:,::1],"
    + BAND
    + ", "
    + SCENE
    + ")"
)
def resolve(
    first_row: int,
    last_row: int,
    width: int,
    supersample: int,
    corners: Floats,
    step: int,
    blocks: Floats,
    tones: Bytes,
    translucent: bool,
    background: Singles,
    ground_weight: Singles,
    dark: Singles,
    under_size: int,
    picture: Bytes,
    band: Band,
    scene: Scene,
) -> None:
    """Shade and mix the samples of a band's pixels and encode them, where the picture is not the bare background.

    Args:
        first_row: first row of pixels.
        last_row: end of the rows.
        width: pixels.
        supersample: samples along a pixel's side.
        corners: around the ground that may be in shadow, see `ground_shadow.shadow_corners`; all -1 if there is none.
        step: the ground's shadow is found at every `step`th pixel of a row.
        blocks: scratch (width + 2 step).
        tones: the encoding table.
        translucent: whether there are translucent triangles.
        background: linear colours (H, W, 3).
        ground_weight: how much of the ground each pixel shows (H, W).
        dark: see `shadows.cast_shadows`.
        under_size: texels in use along a side of the second layer of `dark`.
        picture: (H, W, 3), which holds the encoded background.
        band: see `layout`.
        scene: see `layout`.
    """
    _depth, shown, left, _inside, rows, total, jobs, places = band
    view, light = scene[4], scene[5]
    stride = width * supersample
    samples = supersample * supersample
    share = 1.0 / samples
    group = np.empty(samples, dtype=np.int32)
    group_left = np.empty(samples)
    for py in range(first_row, last_row):
        row = py - first_row
        first, last = _touched_pixels(rows, row, supersample, stride)
        dark_first, dark_last = shadow_row(corners, py, width)
        if dark_first < dark_last:
            first, last = min(first, dark_first), max(last, dark_last)
        shadow_part(view, light, dark, under_size, py, supersample, dark_first, dark_last, step, blocks)

        waiting = 0
        for px in range(first, last):
            pixel = row * width + px
            corner = row * supersample * stride + px * supersample
            bare = 0.0
            # By far the most frequent case is one triangle in all samples of a pixel.
            if translucent or not _is_one(shown, corner, supersample, stride):
                waiting, bare = _split_pixel(
                    px, py, pixel, corner, supersample, stride, share, translucent, shown, left, group, group_left,
                    waiting, jobs, places,
                )  # fmt: skip
            elif shown[corner] == -1:
                bare = float(samples)
            else:
                jobs[waiting, 0] = shown[corner]
                jobs[waiting, 1] = pixel
                places[waiting, 0] = (px + 0.5) * supersample
                places[waiting, 1] = (py + 0.5) * supersample
                places[waiting, 2] = 1.0
                waiting += 1
            if bare > 0.0:
                blocked = 0.0
                if dark_first <= px and px < dark_last:
                    blocked = blocks[px - dark_first] * ground_weight[py, px]
                _add_background(total, pixel, bare * share, blocked, background, py, px)
        shade(waiting, jobs, places, total, scene)
        _encode_row(total, row, first, last, tones, picture, py)


@kernel("void(i8, i8, i8, i8, f4[::1], i4[::1], i4[:,::1], f8[::1], i4[::1], f8[::1], f4[:,::1])")
def resolve_depth(
    first_row: int,
    last_row: int,
    width: int,
    supersample: int,
    depth: Singles,
    shown: Indices,
    rows: Indices,
    slope: Floats,
    owner: Indices,
    view: Floats,
    out: Singles,
) -> None:
    """Find the depth of each pixel of a band: of the mesh that is nearest in it, averaged over that mesh's samples.

    1 / W is linear over the picture, so its mean over a pixel that one plane fills is exact at the pixel's centre; and
    at a border between two objects, the result is never a depth between them, where there is nothing.

    Args:
        first_row: first row of pixels.
        last_row: end of the rows.
        width: pixels.
        supersample: samples along a pixel's side.
        depth: 1 / W of each sample of the band.
        shown: triangle of each sample of the band, -1 for none.
        rows: range of samples touched in each row of the band.
        slope: 1 / W of the ground is slope . (x, y, 1) at sample coordinate (x, y).
        owner: mesh of each triangle (T,).
        view: the view array.
        out: (H, W) to write.
    """
    stride = width * supersample
    nearest, farthest = 1.0 / view[NEAR], 1.0 / view[FAR]
    for py in range(first_row, last_row):
        y = (py + 0.5) * supersample
        for px in range(width):
            value = slope[0] * (px + 0.5) * supersample + slope[1] * y + slope[2]
            value = 0.0 if value > nearest else value
            out[py, px] = 1.0 / max(value, farthest)
        row = py - first_row
        first, last = _touched_pixels(rows, row, supersample, stride)
        for px in range(first, last):
            corner = row * supersample * stride + px * supersample
            highest = np.float32(0.0)
            mesh = -1
            for j in range(supersample):
                for i in range(supersample):
                    t = shown[corner + j * stride + i]
                    if t >= 0 and depth[corner + j * stride + i] > highest:
                        highest = depth[corner + j * stride + i]
                        mesh = owner[t]
            if mesh == -1:
                continue
            total, members = 0.0, 0
            for j in range(supersample):
                for i in range(supersample):
                    t = shown[corner + j * stride + i]
                    if t >= 0 and owner[t] == mesh:
                        total += depth[corner + j * stride + i]
                        members += 1
            out[py, px] = members / total


@inline_kernel
def _find_ground_shadow(
    view: Floats, light: Floats, matrix: Floats, supersample: int, width: int, height: int, corners: Floats
) -> None:
    """Write the corners (8, 2) around the ground that may be in shadow, pixels; all of them -1 if there is none."""
    if light[HAS_SHADOWS] == 0.0 or view[GROUND_SEEN] == 0.0 or not light[GROUND_SHADOW] > 0.0:
        corners[:] = -1.0
    elif not shadow_corners(view, light, matrix, supersample, corners):
        # A part of it is behind the eye: take the whole picture.
        for corner in range(8):
            corners[corner, 0] = width if corner & 3 == 1 or corner & 3 == 2 else 0.0
            corners[corner, 1] = height if corner & 2 else 0.0


@inlined
def fill_slope(view: Floats, slope: Floats) -> None:
    """Write the ground's 1 / W, which is slope . (x, y, 1) at sample coordinate (x, y); zeros if it is not seen."""
    slope[:] = 0.0
    if view[GROUND_SEEN] != 0.0:
        drop = view[GROUND_HEIGHT] - view[EYE + 2]
        slope[0], slope[1], slope[2] = view[RAY_X + 2] / drop, view[RAY_Y + 2] / drop, view[RAY + 2] / drop


@inlined
def _clear_band(
    top: int, bottom: int, stride: int, count: int, extents: Indices, slope: Floats, view: Floats, band: Band
) -> None:
    """Reset the rows of samples top..bottom to show only the ground; for its `slope`, see `resolve_depth`."""
    depth, shown, rows = band[0], band[1], band[4]
    nearest, farthest = 1.0 / view[NEAR], 1.0 / view[FAR]
    # Depth is needed only where triangles may be.
    first, last = stride, 0
    for t in range(count):
        if extents[t, 0] > 0 and extents[t, 3] < bottom and extents[t, 4] > top:
            first, last = min(first, extents[t, 1]), max(last, extents[t, 2])
    shown[:] = -1
    for y in range(top, bottom):
        start = slope[1] * (y + 0.5) + slope[2] + 0.5 * slope[0]
        row = (y - top) * stride
        for x in range(first, last):
            value = GROUND_BEHIND * (start + slope[0] * x)
            # Ground nearer than the near plane is not drawn.
            value = 0.0 if value > nearest else value
            depth[row + x] = max(value, farthest)
        rows[y - top, 0] = stride
        rows[y - top, 1] = 0


@kernel(
    "void(i8, i8, i8, i8, f8[:,::1], i8[::1], i8[:,::1], i4[:,::1], f8[:,:,::1], u1[::1], f4[:,:,::1],"
    " f4[:,::1], f4[:,:,::1], i8, u1[:,:,::1], f4[:,::1]," + BAND + ", " + SCENE + ")"
)
def draw_picture(
    width: int,
    height: int,
    supersample: int,
    count: int,
    matrix: Floats,
    order: NDArray[np.int64],
    caps: NDArray[np.int64],
    extents: Indices,
    limits: Floats,
    tones: Bytes,
    background: Singles,
    ground_weight: Singles,
    dark: Singles,
    under_size: int,
    picture: Bytes,
    depth_picture: Singles,
    band: Band,
    scene: Scene,
) -> None:
    """Draw everything over the background, band by band.

    Args:
        width: pixels.
        height: pixels.
        supersample: samples along a pixel's side.
        count: triangles in use.
        matrix: world to homogeneous sample coordinates (3, 4).
        order: translucent triangles, nearest first.
        caps: (C, 5) for each section: mesh, first triangle, end of the triangles, the triangle that represents it, and
            the one that it is drawn on or -1.
        extents: see `rasterizer.prepare`.
        limits: see `rasterizer.prepare`.
        tones: the encoding table.
        background: linear colours (H, W, 3).
        ground_weight: how much of the ground each pixel shows (H, W).
        dark: see `shadows.cast_shadows`.
        under_size: texels in use along a side of the second layer of `dark`.
        picture: (H, W, 3), which holds the encoded background.
        depth_picture: (H, W) to write, or without rows.
        band: see `layout`; the number of its rows is the height of a band.
        scene: see `layout`.
    """
    functions, owner, flags, parameters, view, light, _map_depth, _map_mesh, _others = scene
    depth, shown, left, inside, rows, total, jobs, places = band
    stride = width * supersample
    band_height = len(rows) // supersample
    corners = np.empty((8, 2))
    _find_ground_shadow(view, light, matrix, supersample, width, height, corners)
    # Shadows on the ground are soft: in a large picture they vary smoothly over a few pixels.
    step = 4 if height >= 300 else (2 if height >= 150 else 1)
    blocks = np.empty(width + 2 * step)
    slope = np.zeros(3)
    fill_slope(view, slope)
    for first_row in range(0, height, band_height):
        last_row = min(first_row + band_height, height)
        top, bottom = first_row * supersample, last_row * supersample
        _clear_band(top, bottom, stride, count, extents, slope, view, band)
        draw_opaque(top, bottom, stride, count, extents, limits, functions, owner, flags, depth, shown, rows)
        for c in range(len(caps)):
            draw_cap(
                top, bottom, stride, caps[c, 0], caps[c, 1], caps[c, 2], caps[c, 3], caps[c, 4],
                extents, limits, functions, parameters, view, inside, depth, shown, rows,
            )  # fmt: skip
        if len(order) > 0:
            left[:] = 1.0
            draw_translucent(
                top, bottom, stride, supersample, order, extents, limits, depth, left, rows, total, jobs, places, scene
            )
        if len(depth_picture) > 0:
            resolve_depth(
                first_row, last_row, width, supersample, depth, shown, rows, slope, owner, view, depth_picture
            )
        resolve(
            first_row, last_row, width, supersample, corners, step, blocks, tones, len(order) > 0, background,
            ground_weight, dark, under_size, picture, band, scene,
        )  # fmt: skip
