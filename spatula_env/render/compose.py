"""From samples to a picture: the background, what is translucent, and mixing and encoding."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from spatula_env._kernels import kernel
from spatula_env.render.layout import (
    AXIS_U,
    AXIS_V,
    DEPTH,
    EYE,
    FAR,
    GROUND_HEIGHT,
    GROUND_SEEN,
    GROUND_SHADOW,
    HAS_SHADOWS,
    KEY_DIRECTION,
    LINE,
    MAP_BOX,
    MAP_SCALE,
    MAP_U,
    MAP_V,
    NEAR,
    OPACITY,
    RAY,
    RAY_X,
    RAY_Y,
    SCENE,
    TONES,
    UNDER_BOX,
    UNDER_SCALE,
    UNDER_X,
    UNDER_Y,
    Bytes,
    Floats,
    Indices,
    Scene,
    Singles,
    inlined,
)
from spatula_env.render.rasterizer import draw_cap, draw_opaque, span
from spatula_env.render.shading import shade

# Shadows on the ground take this much of each channel: a little blue is left, as from a sky.
_SHADOW_TINT = (1.0, 0.985, 0.955)

# What lies on the ground is seen: the ground counts as this little further away.
_GROUND_BEHIND = 1.0 - 1e-4


@kernel(
    "void(i8, i8, i8, i8, i8[::1], i4[:,::1], f8[:,:,::1], f4[::1], f4[::1], i4[::1], i4[:,::1], f4[:,::1],"
    " i4[:,::1], f8[:,::1]," + SCENE + ")"
)
def draw_translucent(
    top: int,
    bottom: int,
    width: int,
    supersample: int,
    order: NDArray[np.int64],
    extents: Indices,
    limits: Floats,
    depth: Singles,
    left: Singles,
    stamp: Indices,
    rows: Indices,
    total: Singles,
    jobs: Indices,
    places: Floats,
    scene: Scene,
) -> None:
    """Add the translucent triangles to a band, nearest first.

    Args:
        top: first row of samples, that of a pixel.
        bottom: end of the rows, that of a pixel.
        width: samples in a row.
        supersample: samples along a pixel's side.
        order: triangles, nearest first.
        extents: see `rasterizer.prepare`.
        limits: see `rasterizer.prepare`.
        depth: 1 / W of what is opaque in the band's samples.
        left: part of the light from behind that still comes through each sample, starts at 1.
        stamp: last line object that covered each sample.
        rows: range of samples touched in each row, widened here.
        total: light of the band's pixels, added to.
        jobs: scratch for `shading.shade`, with more rows than a row has pixels.
        places: scratch for `shading.shade`.
        scene: see `layout`.
    """
    functions, owner, flags, parameters, _view, _light, _map_depth, _map_mesh, _others = scene
    spans = np.empty((supersample, 2), dtype=np.int64)
    share = 1.0 / (supersample * supersample)
    pixels = width // supersample
    waiting = 0
    for k in range(len(order)):
        t = order[k]
        n = extents[t, 0]
        y0, y1 = max(extents[t, 3], top), min(extents[t, 4], bottom)
        if n == 0 or y0 >= y1:
            continue
        m = owner[t]
        za, zb, zc = functions[t, DEPTH], functions[t, DEPTH + 1], functions[t, DEPTH + 2]
        alpha = parameters[m, OPACITY]
        line = flags[m] & LINE != 0
        for py in range((y0 - top) // supersample, (y1 - 1 - top) // supersample + 1):
            first, last = width, 0
            for j in range(supersample):
                row = py * supersample + j
                low, high = span(top + row, extents[t, 1], extents[t, 2], limits, t, n)
                spans[j, 0], spans[j, 1] = low, high
                if low < high:
                    rows[row, 0] = min(rows[row, 0], low)
                    rows[row, 1] = max(rows[row, 1], high)
                    first, last = min(first, low), max(last, high)
            if first >= last:
                continue
            for px in range(first // supersample, (last - 1) // supersample + 1):
                weight = mean_x = mean_y = 0.0
                for j in range(supersample):
                    row = py * supersample + j
                    y = top + row
                    start = zb * (y + 0.5) + zc + 0.5 * za
                    row *= width
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
                    jobs[waiting, 0] = t
                    jobs[waiting, 1] = py * pixels + px
                    places[waiting, 0] = mean_x / weight
                    places[waiting, 1] = mean_y / weight
                    places[waiting, 2] = weight * share
                    waiting += 1
            if waiting + pixels > len(jobs):
                shade(
                    waiting,
                    jobs,
                    places,
                    total,
                    scene,
                )
                waiting = 0
    shade(
        waiting,
        jobs,
        places,
        total,
        scene,
    )


# ------------------------------------------------------------------------------------- background and result


@inlined
def _encode(value: float, tones: Bytes) -> int:
    return int(tones[int(min(max(value, 0.0), 1.0) * (TONES - 1) + 0.5)])


@inlined
def _stripes(position: float, footprint: float, tile: float, line: float) -> float:
    """Part of the interval of length `footprint` around `position` that lines at the multiples of `tile` cover."""
    low = (position - 0.5 * footprint + 0.5 * line) / tile
    high = (position + 0.5 * footprint + 0.5 * line) / tile
    part = line / tile
    low_whole, high_whole = math.floor(low), math.floor(high)
    covered = (high_whole - low_whole) * part + min(high - high_whole, part) - min(low - low_whole, part)
    return covered * tile / footprint


@kernel("void(f8[::1], f8[::1], i8, i8, i8, u1[::1], f4[:,:,::1], f4[:,::1], u1[:,:,::1])")
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


@inlined
def _shadow_corners(view: Floats, light: Floats, matrix: Floats, supersample: int, corners: Floats) -> bool:
    """Pixels (8, 2) around the ground that may be in shadow; False if a corner is behind the near plane.

    The first four go around what the key light's shadow can reach, the others around what lies under things.
    """
    ahead = True
    for corner in range(8):
        i = 1 if corner & 3 == 1 or corner & 3 == 2 else 0
        j = 1 if corner & 3 >= 2 else 0
        z = view[GROUND_HEIGHT]
        if corner < 4:
            u, v = light[MAP_BOX + i], light[MAP_BOX + 2 + j]
            part = (z - u * light[AXIS_U + 2] - v * light[AXIS_V + 2]) / light[KEY_DIRECTION + 2]
            x = u * light[AXIS_U] + v * light[AXIS_V] + part * light[KEY_DIRECTION]
            y = u * light[AXIS_U + 1] + v * light[AXIS_V + 1] + part * light[KEY_DIRECTION + 1]
        else:
            x, y = light[UNDER_BOX + i], light[UNDER_BOX + 2 + j]
        w = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
        ahead = ahead and w >= view[NEAR]
        for k in range(2):
            corners[corner, k] = matrix[k, 0] * x + matrix[k, 1] * y + matrix[k, 2] * z + matrix[k, 3]
            corners[corner, k] /= w * supersample
    return ahead


@inlined
def _shadow_row(corners: Floats, py: int, width: int) -> tuple[int, int]:
    """Pixels of row py, the end excluded, that the two quadrilaterals touch."""
    low, high = math.inf, -math.inf
    for corner in range(8):
        after = (corner & 4) | ((corner + 1) & 3)
        x0, y0, x1, y1 = corners[corner, 0], corners[corner, 1], corners[after, 0], corners[after, 1]
        if y0 > y1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        if y1 < py or y0 > py + 1.0:
            continue
        # The part of this side between the upper and the lower edge of the row.
        if y0 < py:
            x0 += (x1 - x0) * (py - y0) / (y1 - y0)
            y0 = py
        if y1 > py + 1.0:
            x1 = x0 + (x1 - x0) * (py + 1.0 - y0) / (y1 - y0)
        low, high = min(low, x0, x1), max(high, x0, x1)
    if not low < high:
        return width, 0
    return int(min(max(low, 0.0), float(width))), int(min(max(high + 1.0, 0.0), float(width)))


@kernel(
    "void(i8, i8, i8, i8, f8[:,::1], i8, f8[::1], u1[::1], i4[::1], f4[::1], i4[:,::1], b1, f4[:,:,::1],"
    " f4[:,::1], f4[:,:,::1], i8, u1[:,:,::1], f4[:,::1], i4[:,::1], f8[:,::1]," + SCENE + ")"
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
    shown: Indices,
    left: Singles,
    rows: Indices,
    translucent: bool,
    background: Singles,
    ground_weight: Singles,
    dark: Singles,
    under_size: int,
    picture: Bytes,
    total: Singles,
    jobs: Indices,
    places: Floats,
    scene: Scene,
) -> None:
    """Shade, mix the samples of each pixel of a band, and encode, where the picture is not the bare background.

    Args:
        first_row: first row of pixels.
        last_row: end of the rows.
        width: pixels.
        supersample: samples along a pixel's side.
        corners: around the ground that may be in shadow, see `_shadow_corners`; without rows if none may.
        step: the ground's shadow is found at every `step`th pixel of a row.
        blocks: scratch (width + 2 step).
        tones: the encoding table.
        shown: triangle of each sample of the band, -1 for none.
        left: part of the light that comes through what is translucent, for each sample of the band.
        rows: range of samples touched in each row of the band.
        translucent: whether anything is.
        background: linear colours (H, W, 3).
        ground_weight: how much of the ground each pixel shows (H, W).
        dark: see `shadows.cast_shadows`.
        under_size: texels in use along a side of the second layer of `dark`.
        picture: (H, W, 3), which holds the encoded background.
        total: light of the translucent triangles in the band's pixels; set to zero again.
        jobs: scratch for `shading.shade`, as many rows as a row has samples.
        places: scratch for `shading.shade`.
        scene: see `layout`.
    """
    _functions, _owner, _flags, _parameters, view, light, _map_depth, _map_mesh, _others = scene
    stride = width * supersample
    samples = supersample * supersample
    share = 1.0 / samples
    group = np.empty(samples, dtype=np.int32)
    group_left = np.empty(samples)
    drop = view[GROUND_HEIGHT] - view[EYE + 2]
    gz = view[GROUND_HEIGHT]
    for py in range(first_row, last_row):
        row = py - first_row
        first, last = stride, 0
        for j in range(supersample):
            first = min(first, rows[row * supersample + j, 0])
            last = max(last, rows[row * supersample + j, 1])
        first, last = first // supersample, (last + supersample - 1) // supersample
        dark_first, dark_last = _shadow_row(corners, py, width)
        if dark_first < dark_last:
            first, last = min(first, dark_first), max(last, dark_last)

        # How much light the ground lacks: found at every `step`th pixel, and in a straight line between.
        node = dark_first
        while node < dark_last + step:
            x, y = (node + 0.5) * supersample, (py + 0.5) * supersample
            slope = view[RAY + 2] + x * view[RAY_X + 2] + y * view[RAY_Y + 2]
            through = 1.0
            if slope < 0.0:
                w = drop / slope
                gx = view[EYE] + w * (view[RAY] + x * view[RAY_X] + y * view[RAY_Y])
                gy = view[EYE + 1] + w * (view[RAY + 1] + x * view[RAY_X + 1] + y * view[RAY_Y + 1])
                for layer in range(2):
                    if layer == 0:
                        u = light[AXIS_U] * gx + light[AXIS_U + 1] * gy + light[AXIS_U + 2] * gz
                        v = light[AXIS_V] * gx + light[AXIS_V + 1] * gy + light[AXIS_V + 2] * gz
                        u = (u - light[MAP_U]) * light[MAP_SCALE] - 0.5
                        v = (v - light[MAP_V]) * light[MAP_SCALE] - 0.5
                        size, strength = dark.shape[1], 0.52
                    else:
                        u = (gx - light[UNDER_X]) * light[UNDER_SCALE] - 0.5
                        v = (gy - light[UNDER_Y]) * light[UNDER_SCALE] - 0.5
                        size, strength = under_size, 0.66
                    if u >= 0.0 and v >= 0.0 and u < size - 1 and v < size - 1:
                        i, j = int(u), int(v)
                        fu, fv = u - i, v - j
                        top = dark[layer, j, i] + fu * (dark[layer, j, i + 1] - dark[layer, j, i])
                        low = dark[layer, j + 1, i]
                        low += fu * (dark[layer, j + 1, i + 1] - low)
                        through *= 1.0 - strength * light[GROUND_SHADOW] * (top + fv * (low - top))
            place = node - dark_first
            blocks[place] = 1.0 - through
            if place > 0:
                for i in range(1, step):
                    blocks[place - i] = blocks[place] + (blocks[place - step] - blocks[place]) * i / step
            node += step

        waiting = 0
        for px in range(first, last):
            pixel = row * width + px
            # One triangle in all samples of a pixel is by far the most frequent.
            corner = row * supersample * stride + px * supersample
            whole = shown[corner]
            same = not translucent
            if supersample == 2:
                same = (
                    same
                    and shown[corner + 1] == whole
                    and shown[corner + stride] == whole
                    and shown[corner + stride + 1] == whole
                )
            else:
                for k in range(1, samples):
                    same = same and shown[corner + k // supersample * stride + k % supersample] == whole
            bare = 0.0
            if same:
                if whole == -1:
                    bare = float(samples)
                else:
                    jobs[waiting, 0] = whole
                    jobs[waiting, 1] = pixel
                    places[waiting, 0] = (px + 0.5) * supersample
                    places[waiting, 1] = (py + 0.5) * supersample
                    places[waiting, 2] = 1.0
                    waiting += 1
            else:
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
            if bare > 0.0:
                mix_red = mix_green = mix_blue = bare * share
                if dark_first <= px and px < dark_last:
                    blocked = blocks[px - dark_first] * ground_weight[py, px]
                    mix_red *= 1.0 - _SHADOW_TINT[0] * blocked
                    mix_green *= 1.0 - _SHADOW_TINT[1] * blocked
                    mix_blue *= 1.0 - _SHADOW_TINT[2] * blocked
                total[pixel, 0] += mix_red * background[py, px, 0]
                total[pixel, 1] += mix_green * background[py, px, 1]
                total[pixel, 2] += mix_blue * background[py, px, 2]
        shade(
            waiting,
            jobs,
            places,
            total,
            scene,
        )

        for px in range(first, last):
            pixel = row * width + px
            for k in range(3):
                level = total[pixel, k] * np.float32(TONES - 1) + np.float32(0.5)
                picture[py, px, k] = tones[min(max(int(level), 0), TONES - 1)]
                total[pixel, k] = 0.0


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
    """Depth of each pixel of a band: of the mesh that is nearest in it, averaged over that mesh's samples.

    1 / W is linear over the picture, so its mean over a pixel that one plane fills is exact at the pixel's centre; and
    no depth between two objects comes out at a border, where nothing is.

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
        row = (py - first_row) * supersample
        first, last = stride, 0
        for j in range(supersample):
            first, last = min(first, rows[row + j, 0]), max(last, rows[row + j, 1])
        for px in range(first // supersample, (last + supersample - 1) // supersample):
            corner = row * stride + px * supersample
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


@kernel(
    "void(i8, i8, i8, i8, f8[:,::1], i8[::1], i8[:,::1], i4[:,::1], f8[:,:,::1], u1[::1], f4[:,:,::1],"
    " f4[:,::1], f4[:,:,::1], i8, f4[::1], i4[::1], f4[::1], i4[::1], i4[::1], i4[:,::1], f4[:,::1],"
    " i4[:,::1], f8[:,::1], u1[:,:,::1], f4[:,::1]," + SCENE + ")"
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
    depth: Singles,
    shown: Indices,
    left: Singles,
    stamp: Indices,
    inside: Indices,
    rows: Indices,
    total: Singles,
    jobs: Indices,
    places: Floats,
    picture: Bytes,
    depth_picture: Singles,
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
        caps: (C, 5) of each section: mesh, first triangle, end of the triangles, the triangle that stands for it,
            and the one it is drawn on or -1.
        extents: see `rasterizer.prepare`.
        limits: see `rasterizer.prepare`.
        tones: the encoding table.
        background: linear colours (H, W, 3).
        ground_weight: how much of the ground each pixel shows (H, W).
        dark: see `shadows.cast_shadows`.
        under_size: texels in use along a side of the second layer of `dark`.
        depth: scratch for each sample of a band.
        shown: the same.
        left: the same.
        stamp: the same.
        inside: the same, all zero.
        rows: scratch for each row of samples of a band: its length is the height of a band.
        total: scratch for each pixel of a band, all zero.
        jobs: scratch for `shading.shade`, as many rows as a row has samples.
        places: scratch for `shading.shade`.
        picture: (H, W, 3), which holds the encoded background.
        depth_picture: (H, W) to write, or without rows.
        scene: see `layout`.
    """
    functions, owner, flags, parameters, view, light, _map_depth, _map_mesh, _others = scene
    stride = width * supersample
    band = len(rows) // supersample
    corners = np.empty((8, 2))
    if light[HAS_SHADOWS] != 0.0 and view[GROUND_SEEN] != 0.0 and light[GROUND_SHADOW] > 0.0:
        if not _shadow_corners(view, light, matrix, supersample, corners):
            # Part of it is behind the eye: look everywhere.
            for corner in range(8):
                corners[corner, 0] = width if corner & 3 == 1 or corner & 3 == 2 else 0.0
                corners[corner, 1] = height if corner & 2 else 0.0
    else:
        corners[:] = -1.0
    # Shadows on the ground are soft: in a large picture they are smooth over a few pixels.
    step = 4 if height >= 300 else (2 if height >= 150 else 1)
    blocks = np.empty(width + 2 * step)
    nearest, farthest = 1.0 / view[NEAR], 1.0 / view[FAR]
    # 1 / W of the ground, which is linear over the picture.
    slope = np.zeros(3)
    if view[GROUND_SEEN] != 0.0:
        drop = view[GROUND_HEIGHT] - view[EYE + 2]
        slope[0], slope[1], slope[2] = view[RAY_X + 2] / drop, view[RAY_Y + 2] / drop, view[RAY + 2] / drop
    for first_row in range(0, height, band):
        last_row = min(first_row + band, height)
        top, bottom = first_row * supersample, last_row * supersample
        # Depth is needed where triangles may be.
        first, last = stride, 0
        for t in range(count):
            if extents[t, 0] > 0 and extents[t, 3] < bottom and extents[t, 4] > top:
                first, last = min(first, extents[t, 1]), max(last, extents[t, 2])
        shown[:] = -1
        for y in range(top, bottom):
            start = slope[1] * (y + 0.5) + slope[2] + 0.5 * slope[0]
            row = (y - top) * stride
            for x in range(first, last):
                value = _GROUND_BEHIND * (start + slope[0] * x)
                # Ground nearer than the near plane is not there.
                value = 0.0 if value > nearest else value
                depth[row + x] = max(value, farthest)
            rows[y - top, 0] = stride
            rows[y - top, 1] = 0
        draw_opaque(top, bottom, stride, count, extents, limits, functions, owner, flags, depth, shown, rows)
        for c in range(len(caps)):
            draw_cap(
                top,
                bottom,
                stride,
                caps[c, 0],
                caps[c, 1],
                caps[c, 2],
                caps[c, 3],
                caps[c, 4],
                extents,
                limits,
                functions,
                parameters,
                view,
                inside,
                depth,
                shown,
                rows,
            )
        if len(order) > 0:
            left[:] = 1.0
            stamp[:] = -1
            draw_translucent(
                top,
                bottom,
                stride,
                supersample,
                order,
                extents,
                limits,
                depth,
                left,
                stamp,
                rows,
                total,
                jobs,
                places,
                scene,
            )
        if len(depth_picture) > 0:
            resolve_depth(
                first_row, last_row, width, supersample, depth, shown, rows, slope, owner, view, depth_picture
            )
        resolve(
            first_row,
            last_row,
            width,
            supersample,
            corners,
            step,
            blocks,
            tones,
            shown,
            left,
            rows,
            len(order) > 0,
            background,
            ground_weight,
            dark,
            under_size,
            picture,
            total,
            jobs,
            places,
            scene,
        )
