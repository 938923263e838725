"""Drawing of translucent triangles, from front to back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spatula_env._kernels import kernel
from spatula_env.render.layout import DEPTH, OPACITY, SCENE, Floats, Indices, Scene, Singles
from spatula_env.render.rasterizer import span
from spatula_env.render.shading import shade


@kernel(
    "void(i8, i8, i8, i8, i8[::1], i4[:,::1], f8[:,:,::1], f4[::1], f4[::1], i4[:,::1], f4[:,::1],"
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
    rows: Indices,
    total: Singles,
    jobs: Indices,
    places: Floats,
    scene: Scene,
) -> None:
    """Add the translucent triangles to a band, nearest first.

    Args:
        top: first row of samples, at the beginning of a row of pixels.
        bottom: end of the rows, at the end of a row of pixels.
        width: samples in a row.
        supersample: samples along a pixel's side.
        order: triangles, nearest first.
        extents: see `rasterizer.prepare`.
        limits: see `rasterizer.prepare`.
        depth: 1 / W of opaque triangles in the band's samples.
        left: part of the light from behind that still comes through each sample, starts at 1.
        rows: range of samples touched in each row, widened here.
        total: light of the band's pixels, added to.
        jobs: scratch for `shading.shade`, with more rows than a row has pixels.
        places: scratch for `shading.shade`.
        scene: see `layout`.
    """
    functions, owner, _flags, parameters, _view, _light, _map_depth, _map_mesh, _others = scene
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
                        if np.float32(start + za * x) <= depth[row + x]:
                            continue
                        part = left[row + x] * alpha
                        left[row + x] -= part
                        weight += part
                        mean_x += part * (x + 0.5)
                        mean_y += part * (y + 0.5)
                if weight > 0.0:
                    jobs[waiting, 0] = t
                    jobs[waiting, 1] = py * pixels + px
                    places[waiting, 0] = mean_x / weight
                    places[waiting, 1] = mean_y / weight
                    places[waiting, 2] = weight * share
                    waiting += 1
            if waiting + pixels > len(jobs):
                shade(waiting, jobs, places, total, scene)
                waiting = 0
    shade(waiting, jobs, places, total, scene)
