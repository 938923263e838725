"""The background, and the ground plane in front of it."""

from __future__ import annotations

import math

from spatula_env._kernels import kernel
from spatula_env.render.layout import (
    EYE,
    GROUND_HEIGHT,
    GROUND_SEEN,
    RAY,
    RAY_X,
    RAY_Y,
    TONES,
    Bytes,
    Floats,
    Singles,
    inlined,
)


@inlined
def _encode(value: float, tones: Bytes) -> int:
    return int(tones[int(min(max(value, 0.0), 1.0) * (TONES - 1) + 0.5)])


@inlined
def _stripes(position: float, footprint: float, tile: float, line: float) -> float:
    """Share of the interval of length `footprint` around `position` that lines at multiples of `tile` cover."""
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
    """Draw the background with the ground; the result stays valid as long as camera, background and ground do.

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
