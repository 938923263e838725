"""Pictures without a window: a small software rasteriser and what it draws.

`Renderer` draws `Mesh` and `Segments` seen by a `Camera`, on a `Ground`, as bytes and depth. The kernels are compiled
when the first renderer is made; importing this package does not load Numba.
"""

from spatula_env.render import palette
from spatula_env.render.camera import Camera
from spatula_env.render.palette import PRESSURE, SPEED, Color, ColorMap
from spatula_env.render.primitives import (
    BRUSHED_STEEL,
    CUT_TISSUE,
    MATTE,
    UNLIT,
    WET_TISSUE,
    Background,
    Ground,
    Lighting,
    Material,
    Mesh,
    Segments,
)
from spatula_env.render.renderer import Renderer
from spatula_env.render.shapes import arrow_mesh, box_mesh, disc_mesh, ring_mesh, sphere_mesh

__all__ = [
    "BRUSHED_STEEL",
    "CUT_TISSUE",
    "MATTE",
    "PRESSURE",
    "SPEED",
    "UNLIT",
    "WET_TISSUE",
    "Background",
    "Camera",
    "Color",
    "ColorMap",
    "Ground",
    "Lighting",
    "Material",
    "Mesh",
    "Renderer",
    "Segments",
    "arrow_mesh",
    "box_mesh",
    "disc_mesh",
    "palette",
    "ring_mesh",
    "sphere_mesh",
]
