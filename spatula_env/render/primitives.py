"""The primitives of a picture: meshes, the ground, the background and the light."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spatula_env.geometry.checks import check_not_negative
from spatula_env.geometry.transforms import as_vector3
from spatula_env.render.camera import Vector, to_vector
from spatula_env.render.palette import TISSUE, Color, to_color


def _points(value: ArrayLike, name: str) -> NDArray[np.float64]:
    array = np.ascontiguousarray(value, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must have the shape (N, 3), got {array.shape}")
    # A single number that is not finite makes the sum not finite.
    if not math.isfinite(float(array.sum())):
        raise ValueError(f"{name} must be finite")
    return array


def _colors(value: ArrayLike, count: int, name: str) -> NDArray[np.float64]:
    array = np.ascontiguousarray(value, dtype=np.float64)
    if array.shape != (count, 3):
        raise ValueError(f"{name} must have the shape ({count}, 3), got {array.shape}")
    if array.size and not (array.min() >= 0.0 and array.max() <= 1.0):
        raise ValueError(f"{name} must be in 0..1, got {array.min()}..{array.max()}")
    return array


def _check_unit(value: float, name: str) -> None:
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"{name} must be in 0..1, got {value}")


@dataclass(frozen=True)
class Material:
    """How a surface reflects light.

    Attributes:
        specular: strength of the mirror-like highlight, 0..1.
        shininess: sharpness of the highlight, the Blinn-Phong exponent, 1..4096; the nearest power of two is used.
        metallic: 0 (the surface has its own colour) to 1 (a metal, which mirrors the room in its colour).
        subsurface: 0..1, how far light bleeds around into the shaded side, red the furthest, as in flesh.
        rim: brightness that a grazing view adds, 0..1, as on a wet surface.
        grain: strength of brush marks along the x axis of the mesh's texture coordinates, 0..1.
        mottle: strength of patches and vessels in the mesh's texture coordinates, 0..1.
        unlit: show the plain colour, whatever the light.

    Raises:
        ValueError: if a number is out of its range.
    """

    specular: float = 0.08
    shininess: float = 32.0
    metallic: float = 0.0
    subsurface: float = 0.0
    rim: float = 0.05
    grain: float = 0.0
    mottle: float = 0.0
    unlit: bool = False

    def __post_init__(self) -> None:
        for name in ("specular", "metallic", "subsurface", "rim", "grain", "mottle"):
            _check_unit(getattr(self, name), name)
        if not 1.0 <= self.shininess <= 4096.0:
            raise ValueError(f"shininess must be in 1..4096, got {self.shininess}")


MATTE = Material()
"""Plastic with a weak highlight: arrows and markers."""
WET_TISSUE = Material(specular=0.55, shininess=256.0, subsurface=0.5, rim=0.22, mottle=0.6)
"""The organ's surface under a film of liquid."""
BRUSHED_STEEL = Material(specular=0.35, shininess=64.0, metallic=0.85, rim=0.10, grain=0.5)
"""A surgical instrument."""
UNLIT = Material(specular=0.0, rim=0.0, unlit=True)
"""The plain colour without light, for signs."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle surface with its colours.

    Triangles are wound counter-clockwise as seen from outside; that is their front.

    Attributes:
        vertices: u (V, 3).
        triangles: vertex indices (T, 3).
        color: of the whole surface.
        vertex_colors: (V, 3) in 0..1, instead of `color`.
        opacity: 1 opaque, 0 invisible. Below 1 the triangles are blended from back to front over opaque meshes.
        smooth: shade with vertex normals, area-weighted over the triangles around a vertex; else with one normal per
            triangle.
        two_sided: draw the backs of triangles too. Backs are also drawn if `back_color` is given, or with a
            `clip_plane` (unless `capped`), which exposes the inside.
        back_color: colour of the backs and of the cap; the front's colour if None.
        clip_plane: (point, normal): the part on the side of the normal is cut away, per pixel.
        capped: close the cut of a closed mesh with a flat section in `back_color`.
        rind: thickness of a paler layer along the border of the section, u; 0 shows none. Only with `capped`.
        material: of the surface.
        texture: (V, 3) position of each vertex in the body's own frame, u, so that the marks of a material stay on the
            body as it moves and deforms. Without it they are not drawn.
        refine: 0..2, how many times to split each triangle in four on a curved surface, for pictures only: outlines
            become round, and the surface leaves the flat triangles by a small fraction of their size. Needs `smooth`.
        casts_shadow: onto the ground and onto other meshes.
        receives_shadow: of other meshes.

    Raises:
        ValueError: if a shape, an index or a range is wrong or a number is not finite.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    color: Color = TISSUE
    vertex_colors: NDArray[np.float64] | None = None
    opacity: float = 1.0
    smooth: bool = True
    two_sided: bool = False
    back_color: Color | None = None
    clip_plane: tuple[Vector, Vector] | None = None
    capped: bool = False
    rind: float = 0.0
    material: Material = MATTE
    texture: NDArray[np.float64] | None = None
    refine: int = 0
    casts_shadow: bool = True
    receives_shadow: bool = True

    def __post_init__(self) -> None:
        vertices = _points(self.vertices, "vertices")
        triangles = np.asarray(self.triangles)
        if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
            raise ValueError(f"triangles must be integers of the shape (T, 3), got {triangles.dtype} {triangles.shape}")
        if len(triangles) and (triangles.min() < 0 or triangles.max() >= len(vertices)):
            raise ValueError(
                f"triangles must be indices in 0..{len(vertices) - 1}, got {triangles.min()}..{triangles.max()}"
            )
        _check_unit(self.opacity, "opacity")
        put = object.__setattr__
        put(self, "vertices", vertices)
        put(self, "triangles", np.ascontiguousarray(triangles, dtype=np.int32))
        put(self, "color", to_color(self.color))
        if self.vertex_colors is not None:
            put(self, "vertex_colors", _colors(self.vertex_colors, len(vertices), "vertex_colors"))
        if self.back_color is not None:
            put(self, "back_color", to_color(self.back_color, "back_color"))
        if self.clip_plane is not None:
            if len(self.clip_plane) != 2:
                raise ValueError(f"clip_plane must be (point, normal), got {self.clip_plane!r}")
            point = to_vector(self.clip_plane[0], "clip_plane point")
            normal = np.asarray(to_vector(self.clip_plane[1], "clip_plane normal"))
            length = float(np.linalg.norm(normal))
            if length < 1e-12:
                raise ValueError("clip_plane normal must not be zero")
            put(self, "clip_plane", (point, to_vector(normal / length, "clip_plane normal")))
        if self.capped and (self.clip_plane is None or self.opacity < 1.0):
            raise ValueError("capped needs a clip_plane and opacity 1")
        if not 0.0 <= self.rind < math.inf or (self.rind > 0.0 and not self.capped):
            raise ValueError(f"rind must be zero or more, and zero on a mesh that is not capped, got {self.rind}")
        if self.texture is not None:
            texture = _points(self.texture, "texture")
            if texture.shape != vertices.shape:
                raise ValueError(f"texture must have the shape {vertices.shape}, got {texture.shape}")
            put(self, "texture", texture)
        if self.refine not in (0, 1, 2) or (self.refine and not self.smooth):
            raise ValueError(f"refine must be 0, 1 or 2, and 0 on a mesh that is not smooth, got {self.refine}")

    def moved(self, vertices: ArrayLike) -> Mesh:
        """A copy of the mesh with its vertices at new positions, u (V, 3)."""
        return replace(self, vertices=_points(vertices, "vertices"))


@dataclass(frozen=True)
class GroundPlane:
    """The plane z = `height`, drawn without geometry; from below it is invisible.

    Attributes:
        height: u.
        style: "grid" (thin lines), "checker" or "plain".
        color: of the plane.
        second_color: of the lines or the other tiles.
        tile: distance of the lines, side of the tiles, u.
        line_width: of the grid's lines, u.
        center: the point (x, y) around which the plane is drawn, u.
        fade_start: distance from `center` at which the plane begins to fade into the background, u.
        fade_end: distance from `center` at which it is gone, u.
        shadow: darkness of shadows on it, 0..1.

    Raises:
        ValueError: if a number is out of its range.
    """

    height: float = 0.0
    style: Literal["grid", "checker", "plain"] = "grid"
    color: Color = (0.905, 0.915, 0.925)
    second_color: Color = (0.80, 0.82, 0.84)
    tile: float = 1.0
    line_width: float = 0.035
    center: tuple[float, float] = (0.0, 0.0)
    fade_start: float = 5.0
    fade_end: float = 22.0
    shadow: float = 0.75

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name in ("height", "tile", "line_width", "fade_start", "fade_end", "shadow"):
            put(self, name, float(getattr(self, name)))
        put(self, "color", to_color(self.color))
        put(self, "second_color", to_color(self.second_color, "second_color"))
        center = to_vector((*self.center, 0.0), "center (x, y, 0)")
        put(self, "center", center[:2])
        if self.style not in ("grid", "checker", "plain"):
            raise ValueError(f"style must be 'grid', 'checker' or 'plain', got {self.style!r}")
        if not math.isfinite(self.height):
            raise ValueError(f"height must be finite, got {self.height}")
        if not 0.0 < self.line_width < self.tile < math.inf:
            raise ValueError(
                f"line_width and tile must obey 0 < line_width < tile, got {self.line_width} and {self.tile}"
            )
        if not 0.0 <= self.fade_start < self.fade_end < math.inf:
            raise ValueError(
                f"fade_start and fade_end must obey 0 <= fade_start < fade_end, "
                f"got {self.fade_start} and {self.fade_end}"
            )
        _check_unit(self.shadow, "shadow")


@dataclass(frozen=True)
class Background:
    """The background: one colour at the top of the picture, blended to another at its bottom.

    Attributes:
        top: colour of the upper edge.
        bottom: colour of the lower edge.
    """

    top: Color = (0.835, 0.868, 0.905)
    bottom: Color = (0.965, 0.97, 0.975)

    def __post_init__(self) -> None:
        object.__setattr__(self, "top", to_color(self.top, "top"))
        object.__setattr__(self, "bottom", to_color(self.bottom, "bottom"))


@dataclass(frozen=True)
class Lighting:
    """One key light with shadows, one fill light without, and light from all around.

    Attributes:
        key_direction: towards the key light (3,), any length but zero, above the horizon.
        key: strength of the key light, 0 or more.
        fill_direction: towards the fill light (3,), any length but zero.
        fill: strength of the fill light, 0 or more.
        ambient: strength of the light from all around, 0 or more: a cool sky above, warm light off the floor.
        shadow: how much of the key light a shadow on a mesh takes away, 0..1.
        shadow_softness: half the width of a shadow's soft border on the ground, u.

    Raises:
        ValueError: if a number is out of its range.
    """

    key_direction: Vector = (-0.5, -0.6, 1.0)
    key: float = 0.85
    fill_direction: Vector = (0.9, -0.1, 0.25)
    fill: float = 0.16
    ambient: float = 0.38
    shadow: float = 0.7
    shadow_softness: float = 0.3

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name in ("key_direction", "fill_direction"):
            vector = np.asarray(to_vector(getattr(self, name), name))
            length = float(np.linalg.norm(vector))
            if length < 1e-12:
                raise ValueError(f"{name} must not be zero")
            put(self, name, to_vector(vector / length, name))
        if self.key_direction[2] < 0.1:
            raise ValueError(f"key_direction must be above the horizon, got {self.key_direction}")
        for name in ("key", "fill", "ambient", "shadow_softness"):
            check_not_negative(getattr(self, name), name)
        _check_unit(self.shadow, "shadow")


def perpendicular_axes(
    direction: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """A right-handed frame whose third unit vector points along `direction` (3,), which must not be zero."""
    third = as_vector3(direction, "direction")
    length = float(np.linalg.norm(third))
    if length < 1e-12:
        raise ValueError("direction must not be zero")
    third = third / length
    # The world axis with the greatest angle to the direction.
    helper = np.zeros(3)
    helper[int(np.argmin(np.abs(third)))] = 1.0
    first = np.cross(helper, third)
    first /= np.linalg.norm(first)
    return first, np.cross(third, first), third
