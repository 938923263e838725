"""Pictures without a window, by a small software rasteriser, and a window drawn with OpenGL.

`Renderer` draws `Mesh`es seen by a `Camera`, on a `GroundPlane`, as bytes and depth. `SceneView` draws a `Moment` of a
scene with it, and `Window` shows one. Importing this package loads neither Numba nor pyglet: kernels are compiled, or
taken from Numba's cache, when one of the three is first asked for.
"""

from __future__ import annotations

from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from spatula_env.render import palette
from spatula_env.render.camera import Camera
from spatula_env.render.moment import Moment
from spatula_env.render.palette import PRESSURE, SPEED, Color, ColorMap
from spatula_env.render.primitives import (
    BRUSHED_STEEL,
    MATTE,
    UNLIT,
    WET_TISSUE,
    Background,
    GroundPlane,
    Lighting,
    Material,
    Mesh,
)
from spatula_env.render.shapes import arrow_mesh, box_mesh, ring_mesh, sphere_mesh, tube_mesh

if TYPE_CHECKING:
    from spatula_env.render.renderer import Renderer
    from spatula_env.render.scene_view import SceneView
    from spatula_env.render.window import Window

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
    "GroundPlane",
    "Lighting",
    "Material",
    "Mesh",
    "Moment",
    "Renderer",
    "SceneView",
    "Window",
    "arrow_mesh",
    "box_mesh",
    "palette",
    "ring_mesh",
    "sphere_mesh",
    "tube_mesh",
]


_LATER = MappingProxyType({"Renderer": "renderer", "SceneView": "scene_view", "Window": "window"})


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(import_module(f"spatula_env.render.{_LATER[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
