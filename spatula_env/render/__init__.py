"""Pictures without a window: a small software rasteriser and what it draws.

`Renderer` draws `Mesh` and `Segments` seen by a `Camera`, on a `Ground`, as bytes and depth. Importing this package
does not load Numba: the kernels are compiled, or taken from Numba's cache, when `Renderer` is first asked for.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from spatula_env.render import palette
from spatula_env.render.camera import Camera
from spatula_env.render.palette import PRESSURE, SPEED, Color, ColorMap
from spatula_env.render.primitives import (
    BRUSHED_STEEL,
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
from spatula_env.render.shapes import arrow_mesh, box_mesh, disc_mesh, ring_mesh, sphere_mesh

if TYPE_CHECKING:
    from spatula_env.render.renderer import Renderer

__all__ = [
    "BRUSHED_STEEL",
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


def __getattr__(name: str) -> Any:
    if name == "Renderer":
        return import_module("spatula_env.render.renderer").Renderer
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
