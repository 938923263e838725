"""Shading: the light that a point of a surface sends to the eye."""

from __future__ import annotations

import math

from spatula_env._kernels import kernel
from spatula_env.render.layout import (
    AMBIENT,
    AXIS_U,
    AXIS_V,
    CLOSE,
    COLOR,
    DEPTH,
    EYE,
    FILL,
    FILL_DIRECTION,
    FOCAL,
    GRAIN,
    GROUND_HEIGHT,
    GROUND_SEEN,
    HAS_SHADOWS,
    KEY,
    KEY_DIRECTION,
    MAP_SCALE,
    MAP_U,
    MAP_V,
    MARK,
    METALLIC,
    MOTTLE,
    NORMAL,
    RAY,
    RAY_X,
    RAY_Y,
    RECEIVES,
    RIM,
    SCENE,
    SHADOW,
    SPECULAR,
    SQUARINGS,
    TEXTURED,
    UNLIT,
    UNWRAP,
    WRAP,
    Floats,
    Indices,
    Scene,
    Singles,
    inlined,
)

# Linear colours of the room.
_SKY = (0.98, 1.0, 1.04)
_BOUNCE = (0.52, 0.47, 0.45)
_KEY_COLOR = (1.0, 0.975, 0.94)
_FILL_COLOR = (0.86, 0.94, 1.0)


@inlined
def _lattice(x: int, y: int, z: int) -> float:
    """A pseudo-random number in -1..1 for each point with integer coordinates, by a multiplicative hash."""
    code = (x * 73856093) ^ (y * 19349663) ^ (z * 83492791)
    code = ((code ^ (code >> 13)) & 0xFFFFFFFF) * 1274126177
    return ((code >> 16) & 0xFFFF) * (2.0 / 65535.0) - 1.0


@inlined
def _streaks(coordinate: float, footprint: float) -> float:
    """Brush marks, in -1..1: three octaves of value noise, each faded out where a pixel is wider than its waves."""
    total = 0.0
    for octave in range(3):
        frequency = 14.0 if octave == 0 else (43.0 if octave == 1 else 131.0)
        weight = 1.0 - 1.5 * footprint * frequency
        if weight <= 0.0:
            break
        position = coordinate * frequency
        index = math.floor(position)
        part = position - index
        low, high = _lattice(index, 0, 0), _lattice(index + 1, 0, 0)
        total += min(weight, 1.0) * (low + (high - low) * part) * (0.5 if octave == 0 else 0.4)
    return total


@inlined
def _value_noise(x: float, y: float, z: float) -> float:
    """Smooth noise in -1..1: random numbers at whole coordinates, joined by cubics."""
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
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


@inlined
def _mottle(x: float, y: float, z: float, footprint: float) -> tuple[float, float]:
    """Patches of paler and redder tissue (-1..1), and vessels (0..1), which follow the zeros of a noise."""
    broad = _value_noise(0.55 * x + 7.3, 0.55 * y + 1.7, 0.55 * z + 4.1)
    fine = _value_noise(2.1 * x + 0.5 * broad, 2.1 * y + 9.2, 2.1 * z)
    ridge = abs(broad + 0.16 * fine)
    width = 0.030 + 0.9 * footprint
    vessel = max(1.0 - ridge / width, 0.0) * min(0.04 / width, 1.0)
    if vessel > 0.0:
        # The zeros of a noise form closed lines; a second noise breaks them into branches that taper.
        gate = _value_noise(0.9 * x + 3.9, 0.9 * y + 5.3, 0.9 * z + 8.8)
        vessel *= min(max(2.5 * gate + 0.1, 0.0), 1.0)
    return 0.6 * broad + 0.4 * fine, vessel


@inlined
def _room(up: float, towards_key: float, lit: float) -> float:
    """Brightness of the room that a metal mirrors: a pale floor, darker walls, a bright ceiling with a soft box."""
    box = min(max((towards_key - 0.55) * 2.5, 0.0), 1.0)
    around = 0.34 - 0.34 * max(up, -1.0) if up < 0.0 else 0.34 + 0.62 * min(up, 1.0)
    return around + 0.75 * lit * box * box * (3.0 - 2.0 * box)


@inlined
def _interpolate(functions: Floats, t: int, column: int, x: float, y: float) -> tuple[float, float, float]:
    """Three shading functions of triangle t, from a column on, at sample coordinate (x, y)."""
    first = functions[t, column] * x + functions[t, column + 1] * y + functions[t, column + 2]
    second = functions[t, column + 3] * x + functions[t, column + 4] * y + functions[t, column + 5]
    third = functions[t, column + 6] * x + functions[t, column + 7] * y + functions[t, column + 8]
    return first, second, third


@inlined
def _add_light(total: Singles, pixel: int, weight: float, red: float, green: float, blue: float) -> None:
    """Add light to a pixel."""
    total[pixel, 0] += weight * red
    total[pixel, 1] += weight * green
    total[pixel, 2] += weight * blue


@inlined
def _fill_light(light: Floats, nx: float, ny: float, nz: float) -> float:
    """The fill light on a surface with the normal n: it reaches all around."""
    fill = 0.5 + 0.5 * (nx * light[FILL_DIRECTION] + ny * light[FILL_DIRECTION + 1] + nz * light[FILL_DIRECTION + 2])
    return float(light[FILL] * fill * fill)


@inlined
def _ambient_light(light: Floats, view: Floats, up: float, pz: float) -> float:
    """The ambient light at the height pz, where `up` is how much the surface faces up, from 0 to 1."""
    ambient = light[AMBIENT]
    if view[GROUND_SEEN] != 0.0:
        # Near the ground, a surface that faces down sees its own shadow.
        away = 1.0 + max(pz - view[GROUND_HEIGHT], 0.0) * light[CLOSE]
        ambient *= 1.0 - 0.65 * (1.0 - up) / (away * away)
    return float(ambient)


@inlined
def _marks(
    functions: Floats, parameters: Floats, t: int, m: int, x: float, y: float, w: float, footprint: float
) -> tuple[float, float, float]:
    """Marks of triangle t of mesh m at sample coordinate (x, y): brush marks, and patches and vessels as in `_mottle`.

    `w` is the depth there, and `footprint` the width of a sample.
    """
    u, v, s = _interpolate(functions, t, MARK, x, y)
    u, v, s = w * u, w * v, w * s
    streak = patch = vessel = 0.0
    if parameters[m, GRAIN] > 0.0:
        # The marks run along x on every face of a box.
        streak = parameters[m, GRAIN] * _streaks(v + s, footprint)
    if parameters[m, MOTTLE] > 0.0:
        patch, vessel = _mottle(u, v, s, footprint)
        patch *= parameters[m, MOTTLE]
        vessel *= parameters[m, MOTTLE]
    return streak, patch, vessel


@inlined
def _key_light_share(
    light: Floats,
    map_depth: Singles,
    map_mesh: Indices,
    others: Floats,
    m: int,
    px: float,
    py: float,
    pz: float,
) -> float:
    """Share of the key light that other meshes let through to the point p of mesh m, from 0 to 1.

    It is averaged over 4 x 4 texels with weights that fall to the sides.
    """
    size = map_depth.shape[0]
    u = light[AXIS_U] * px + light[AXIS_U + 1] * py + light[AXIS_U + 2] * pz
    v = light[AXIS_V] * px + light[AXIS_V + 1] * py + light[AXIS_V + 2] * pz
    u = (u - light[MAP_U]) * light[MAP_SCALE]
    v = (v - light[MAP_V]) * light[MAP_SCALE]
    dark = 0.0
    if u > others[m, 0] and u < others[m, 1] and v > others[m, 2] and v < others[m, 3]:
        i, j = int(u - 0.5) - 1, int(v - 0.5) - 1
        if i >= 0 and j >= 0 and i + 4 <= size and j + 4 <= size:
            fu, fv = u - 1.5 - i, v - 1.5 - j
            height = light[KEY_DIRECTION] * px + light[KEY_DIRECTION + 1] * py + light[KEY_DIRECTION + 2] * pz
            for b in range(4):
                part = 0.0
                for a in range(4):
                    other = map_mesh[j + b, i + a]
                    if other >= 0 and other != m and map_depth[j + b, i + a] > height:
                        part += (1.0 - fu) if a == 0 else (fu if a == 3 else 1.0)
                dark += part * ((1.0 - fv) if b == 0 else (fv if b == 3 else 1.0))
    return float(1.0 - light[SHADOW] * dark / 9.0)


@inlined
def _highlight(n_l: float, n_v: float, l_v: float, squarings: int) -> float:
    """A mirror-like highlight after Blinn and Phong, from the cosines between normal, light and view.

    The half vector of two unit vectors has the length sqrt(2 + 2 l . v). The exponent is 2 to the power of
    `squarings`. A wide sheen lies under the sharp highlight, as from a film of liquid that is not quite even.
    """
    shine = (n_l + n_v) / math.sqrt(max(2.0 + 2.0 * l_v, 1e-12))
    sheen = 0.0
    for k in range(squarings):
        shine *= shine
        if k == squarings - 4:
            sheen = shine
    return shine + 0.10 * sheen


@inlined
def body_light(
    light: Floats,
    view: Floats,
    parameters: Floats,
    m: int,
    normal: tuple[float, float, float],
    eye: tuple[float, float, float],
    height: float,
    lit: float,
    streak: float,
) -> tuple[float, float, float]:
    """Light that a surface with the material of mesh m sends back, for each channel of its colour.

    Args:
        light: the light array.
        view: the view array.
        parameters: of the meshes (M, PARAMETERS).
        m: the mesh.
        normal: of the surface, of unit length.
        eye: unit vector towards the eye.
        height: z of the point.
        lit: share of the key light that reaches it, 0..1.
        streak: brightness of brush marks, see `_streaks`.
    """
    nx, ny, nz = normal
    vx, vy, vz = eye
    lx, ly, lz = light[KEY_DIRECTION], light[KEY_DIRECTION + 1], light[KEY_DIRECTION + 2]
    n_l = nx * lx + ny * ly + nz * lz
    key = light[KEY] * lit
    # In flesh, light bleeds across the border into the shaded side.
    key_red = key * max(n_l + parameters[m, WRAP], 0.0) * parameters[m, UNWRAP]
    key_green = key * max(n_l + parameters[m, WRAP + 1], 0.0) * parameters[m, UNWRAP + 1]
    key_blue = key * max(n_l + parameters[m, WRAP + 2], 0.0) * parameters[m, UNWRAP + 2]
    fill = _fill_light(light, nx, ny, nz)
    up = 0.5 + 0.5 * nz
    ambient = _ambient_light(light, view, up, height)
    sky_red = ambient * (_BOUNCE[0] + up * (_SKY[0] - _BOUNCE[0]))
    sky_green = ambient * (_BOUNCE[1] + up * (_SKY[1] - _BOUNCE[1]))
    sky_blue = ambient * (_BOUNCE[2] + up * (_SKY[2] - _BOUNCE[2]))
    metal = parameters[m, METALLIC]
    if metal > 0.0:
        n_v = nx * vx + ny * vy + nz * vz
        l_v = lx * vx + ly * vy + lz * vz
        room = _room(2.0 * n_v * nz - vz + 0.35 * streak, 2.0 * n_v * n_l - l_v + 0.25 * streak, lit)
        room *= 2.0 * ambient * (1.0 + 0.35 * streak)
        key_red *= 1.0 - 0.75 * metal
        key_green *= 1.0 - 0.75 * metal
        key_blue *= 1.0 - 0.75 * metal
        sky_red += metal * (room - sky_red)
        sky_green += metal * (room - sky_green)
        sky_blue += metal * (room * 1.02 - sky_blue)
    return (
        _KEY_COLOR[0] * key_red + _FILL_COLOR[0] * fill + sky_red,
        _KEY_COLOR[1] * key_green + _FILL_COLOR[1] * fill + sky_green,
        _KEY_COLOR[2] * key_blue + _FILL_COLOR[2] * fill + sky_blue,
    )


@kernel("void(i8, i4[:,::1], f8[:,::1], f4[:,::1]," + SCENE + ")")
def shade(
    count: int,
    jobs: Indices,
    places: Floats,
    total: Singles,
    scene: Scene,
) -> None:
    """Add the light that triangles send to the eye.

    Everything it calls is inlined: Numba counts references for every array that a call passes on, and inside this loop
    that costs more than the arithmetic.

    Args:
        count: number of jobs.
        jobs: (J, 2) triangle and pixel.
        places: (J, 3) sample coordinate x and y, which lies on the triangle, and the weight of the result.
        total: (P, 3) linear light of the pixels, added to.
        scene: see `layout`.
    """
    functions, owner, flags, parameters, view, light, map_depth, map_mesh, others = scene
    lx, ly, lz = light[KEY_DIRECTION], light[KEY_DIRECTION + 1], light[KEY_DIRECTION + 2]
    has_shadows = light[HAS_SHADOWS] != 0.0
    for job in range(count):
        t = jobs[job, 0]
        pixel = jobs[job, 1]
        x, y, weight = places[job, 0], places[job, 1], places[job, 2]
        m = owner[t]
        kind = flags[m]
        w = 1.0 / (functions[t, DEPTH] * x + functions[t, DEPTH + 1] * y + functions[t, DEPTH + 2])
        red, green, blue = _interpolate(functions, t, COLOR, x, y)
        red, green, blue = w * red, w * green, w * blue
        if kind & UNLIT:
            _add_light(total, pixel, weight, red, green, blue)
            continue

        streak = 0.0
        if kind & TEXTURED:
            streak, patch, vessel = _marks(functions, parameters, t, m, x, y, w, w / view[FOCAL])
            red *= (1.0 + 0.22 * patch) * (1.0 - 0.30 * vessel)
            green *= (1.0 + 0.45 * patch) * (1.0 - 0.68 * vessel)
            blue *= (1.0 + 0.40 * patch) * (1.0 - 0.58 * vessel)

        # The point p, the unit normal n and the unit vector v to the eye.
        vx = view[RAY] + x * view[RAY_X] + y * view[RAY_Y]
        vy = view[RAY + 1] + x * view[RAY_X + 1] + y * view[RAY_Y + 1]
        vz = view[RAY + 2] + x * view[RAY_X + 2] + y * view[RAY_Y + 2]
        px, py, pz = view[EYE] + w * vx, view[EYE + 1] + w * vy, view[EYE + 2] + w * vz
        scale = -1.0 / math.sqrt(vx * vx + vy * vy + vz * vz)
        vx, vy, vz = scale * vx, scale * vy, scale * vz
        nx, ny, nz = _interpolate(functions, t, NORMAL, x, y)
        scale = 1.0 / math.sqrt(max(nx * nx + ny * ny + nz * nz, 1e-300))
        nx, ny, nz = scale * nx, scale * ny, scale * nz
        n_l = nx * lx + ny * ly + nz * lz
        n_v = nx * vx + ny * vy + nz * vz
        grazing = 1.0 - min(max(n_v, 0.0), 1.0)
        fresnel = grazing * grazing
        fresnel = fresnel * fresnel * grazing

        lit = 1.0
        if has_shadows and kind & RECEIVES:
            lit = _key_light_share(light, map_depth, map_mesh, others, m, px, py, pz)
        light_red, light_green, light_blue = body_light(
            light, view, parameters, m, (nx, ny, nz), (vx, vy, vz), pz, lit, streak
        )
        key = light[KEY] * lit
        up = 0.5 + 0.5 * nz
        ambient = _ambient_light(light, view, up, pz)
        l_v = lx * vx + ly * vy + lz * vz
        shine = 0.0
        if parameters[m, SPECULAR] > 0.0 and n_l > 0.0:
            shine = parameters[m, SPECULAR] * key * _highlight(n_l, n_v, l_v, int(parameters[m, SQUARINGS]))
            shine *= (0.6 + 0.4 * fresnel) * min(4.0 * n_l, 1.0)
        edge = parameters[m, RIM] * fresnel * ambient * (0.7 + 1.3 * up)

        # Values brighter than white are clipped before samples are mixed: otherwise a highlight's border is jagged.
        red = red * light_red + _KEY_COLOR[0] * shine + edge
        green = green * light_green + (_KEY_COLOR[1] * shine + edge)
        blue = blue * light_blue + (_KEY_COLOR[2] * shine + edge)
        _add_light(total, pixel, weight, min(red, 1.0), min(green, 1.0), min(blue, 1.0))
