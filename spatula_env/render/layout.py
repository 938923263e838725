"""Layout of the arrays that the renderer passes to its kernels.

The kernels are compiled with these numbers as constants.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

Function = TypeVar("Function", bound=Callable[..., object])
Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Indices = NDArray[np.int32]
Bytes = NDArray[np.uint8]
Scene = tuple[Floats, Indices, Indices, Floats, Floats, Floats, Singles, Indices, Floats]
"""The arrays that shading reads and that all kernels after `rasterizer.prepare` pass on:

- shading functions of the triangles (T, FUNCTIONS);
- mesh of each triangle (T,);
- flags of the meshes (M,);
- parameters of the meshes (M, PARAMETERS);
- the view array (VIEW,);
- the light array (LIGHT,);
- the map of the key light, `map_depth` (S, S), `map_mesh` (S, S) and `others` (M, 4): see `shadows.cast_shadows`.
"""

SCENE = "Tuple((f8[:,::1], i4[::1], i4[::1], f8[:,::1], f8[::1], f8[::1], f4[:,::1], i4[:,::1], f8[:,::1]))"
"""Numba's type of a `Scene`."""

Band = tuple[Singles, Indices, Singles, Indices, Indices, Singles, Indices, Floats]
"""Scratch for a band of rows of the picture:

- `depth`, 1 / W of each sample;
- `shown`, the triangle of each sample, -1 for none;
- `left`, the part of the light that comes through what is translucent, for each sample;
- `inside`, which of a section's samples are inside; all zero between calls;
- `rows`, the range of samples touched in each row of samples (R, 2);
- `total`, linear light of each pixel (P, 3); all zero between calls;
- `jobs` (J, 2) and `places` (J, 3), see `shading.shade`, as many rows as `supersample` rows have samples.
"""

BAND = "Tuple((f4[::1], i4[::1], f4[::1], i4[::1], i4[:,::1], f4[:,::1], i4[:,::1], f8[:,::1]))"
"""Numba's type of a `Band`."""

# Bits of a mesh's flags.
SMOOTH = 1
DRAW_BACK = 2
CUT = 4
UNLIT = 8
CAPPED = 16
CASTS = 32
RECEIVES = 64
TEXTURED = 128
TRANSLUCENT = 256
CORE = 512  # not shown: what a section's rind leaves of the mesh

# Columns of a mesh's parameters.
OPACITY = 0
BACK = 1  # to 3: linear colour of the backs
PLANE = 4  # to 7: normal and offset; normal . x > offset is cut away
SPECULAR = 8
SQUARINGS = 9  # the highlight's exponent is 2 to this power
METALLIC = 10
WRAP = 11  # to 13: how far each channel of the key light reaches around
UNWRAP = 14  # to 16: 1 / (1 + wrap)
RIM = 17
GRAIN = 18
MOTTLE = 19
PARAMETERS = 20

# Columns of a triangle's shading functions: each three numbers c for c . (x, y, 1), (x, y) the sample coordinate.
DEPTH = 0  # 1 / W
NORMAL = 3  # normal, times a positive number; towards the eye
COLOR = 12  # linear colour / W
MARK = 21  # texture coordinate / W
FUNCTIONS = 30

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
AXIS_U = 12  # the light's map: u = (U . x - MAP_U) * MAP_SCALE, in texels
AXIS_V = 15
MAP_U = 18
MAP_V = 19
MAP_SCALE = 20
UNDER_X = 21  # the map straight down: (x - UNDER_X) * UNDER_SCALE
UNDER_Y = 22
UNDER_SCALE = 23
HAS_SHADOWS = 24
CLOSE = 25  # 1 / the height at which the ground's own shadow fades
MAP_BOX = 26  # to 29: what may be dark in the light's map: u0, u1, v0, v1
UNDER_BOX = 30  # to 33: what may be dark in the map straight down: x0, x1, y0, y1
LIGHT = 34

TONES = 8192
"""Steps of linear light in the encoding table: fine enough that every 8-bit value comes back as itself."""


def inlined(function: Function) -> Function:
    """Inline a helper into its callers, always: a call with this many arrays costs more than the work it does."""
    return cast("Function", njit(error_model="numpy", inline="always")(function))
