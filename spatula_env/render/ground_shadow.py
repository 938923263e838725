"""Shadows on the ground: where in a picture they may be, and how dark they are."""

from __future__ import annotations

import math

from spatula_env.render.layout import (
    AXIS_U,
    AXIS_V,
    EYE,
    GROUND_HEIGHT,
    GROUND_SHADOW,
    KEY_DIRECTION,
    MAP_BOX,
    MAP_SCALE,
    MAP_U,
    MAP_V,
    NEAR,
    RAY,
    RAY_X,
    RAY_Y,
    UNDER_BOX,
    UNDER_SCALE,
    UNDER_X,
    UNDER_Y,
    Floats,
    Singles,
    inlined,
)


@inlined
def shadow_corners(view: Floats, light: Floats, matrix: Floats, supersample: int, corners: Floats) -> bool:
    """Find corners (8, 2) in pixels around ground that may be in shadow; False if one is behind the near plane.

    The first four are around the reach of the key light's shadow, the others around the area under things.
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
def shadow_row(corners: Floats, py: int, width: int) -> tuple[int, int]:
    """Range of pixels of row py, the end excluded, that the two quadrilaterals touch."""
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


@inlined
def shadow_part(
    view: Floats,
    light: Floats,
    dark: Singles,
    under_size: int,
    py: int,
    supersample: int,
    first: int,
    last: int,
    step: int,
    blocks: Floats,
) -> None:
    """Write the share of light, from 0 to 1, that the ground lacks in pixels first..last of row py to `blocks`.

    It is computed at every `step`th pixel and interpolated linearly in between. `dark` and `under_size` are those of
    `shadows.cast_shadows`.
    """
    gz = view[GROUND_HEIGHT]
    drop = gz - view[EYE + 2]
    node = first
    while node < last + step:
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
        place = node - first
        blocks[place] = 1.0 - through
        if place > 0:
            for i in range(1, step):
                blocks[place - i] = blocks[place] + (blocks[place - step] - blocks[place]) * i / step
        node += step
