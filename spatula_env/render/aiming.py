"""The arrays of numbers that kernels read for a camera, for lights, and for a material."""

from __future__ import annotations

import math

import numpy as np

from spatula_env.render import layout as k
from spatula_env.render.camera import Camera
from spatula_env.render.palette import Color, linear_color, linear_to_srgb
from spatula_env.render.primitives import GroundPlane, Lighting, Material, perpendicular_axes

_ASIDE = (1.4142e-7, 1.7321e-7)
"""Offset of the middle of the picture, across and down, in samples. Without it a vertex at a round position would fall
exactly on a sample, and where many edges end in a sample, rounding would assign it to two triangles or to none."""

WRAPS = (0.50, 0.22, 0.16)
"""How far red, green and blue light bleeds into the shaded side in flesh, as a cosine: red is absorbed least."""


def fill_view(
    view: k.Floats,
    matrix: k.Floats,
    camera: Camera,
    ground: GroundPlane | None,
    size: tuple[int, int],
    supersample: int,
) -> None:
    """Write the view array and the matrix of a camera.

    Args:
        view: (VIEW,) to write; see `layout`.
        matrix: (3, 4) to write: world to homogeneous sample coordinates.
        camera: The camera.
        ground: The ground plane, or None.
        size: (width, height) of the picture [pixels].
        supersample: Samples along a pixel's side.
    """
    width, height = size
    axes = camera.axes()
    eye = np.asarray(camera.position)
    focal = 0.5 * height * supersample / math.tan(math.radians(camera.vertical_field_of_view) / 2.0)
    middle_x = 0.5 * width * supersample + _ASIDE[0]
    middle_y = 0.5 * height * supersample + _ASIDE[1]
    right, up, forward = axes
    view[k.EYE : k.EYE + 3] = eye
    view[k.RAY_X : k.RAY_X + 3] = right / focal
    view[k.RAY_Y : k.RAY_Y + 3] = -up / focal
    view[k.RAY : k.RAY + 3] = forward - (middle_x * right - middle_y * up) / focal
    view[k.FOCAL] = focal
    view[k.NEAR], view[k.FAR] = camera.near, camera.far
    view[k.GROUND_SEEN] = float(ground is not None and eye[2] > ground.height)
    view[k.GROUND_HEIGHT] = 0.0 if ground is None else ground.height
    matrix[:, :3] = np.stack([focal * right + middle_x * forward, middle_y * forward - focal * up, forward])
    matrix[:, 3] = -matrix[:, :3] @ eye


def fill_light(light: k.Floats, lighting: Lighting, ground: GroundPlane | None) -> None:
    """Write the light array (LIGHT,), but for the numbers of the shadows' maps; see `layout`."""
    first, second, third = perpendicular_axes(lighting.key_direction)
    light[k.KEY_DIRECTION : k.KEY_DIRECTION + 3] = third
    light[k.AXIS_U : k.AXIS_U + 3] = first
    light[k.AXIS_V : k.AXIS_V + 3] = second
    light[k.FILL_DIRECTION : k.FILL_DIRECTION + 3] = lighting.fill_direction
    light[k.KEY], light[k.FILL], light[k.AMBIENT] = lighting.key, lighting.fill, lighting.ambient
    light[k.SHADOW], light[k.SOFTNESS] = lighting.shadow, lighting.shadow_softness
    light[k.CLOSE] = 0.25 / max(lighting.shadow_softness, 1e-6)
    light[k.GROUND_SHADOW] = 0.0 if ground is None else ground.shadow


def mesh_parameters(
    material: Material,
    opacity: float = 1.0,
    back: Color = (0.0, 0.0, 0.0),
    plane: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
) -> tuple[float, ...]:
    """A mesh's row of parameters, as the columns in `layout` say.

    Args:
        material: Its material.
        opacity: 0..1.
        back: Colour of its backs.
        plane: Normal and offset of the plane that cuts it; zeros for none.
    """
    wraps = [reach * material.subsurface for reach in WRAPS]
    return (
        opacity,
        *linear_color(back),
        *plane,
        material.specular,
        round(math.log2(material.shininess)),
        material.metallic,
        *wraps,
        *(1.0 / (1.0 + wrap) for wrap in wraps),
        material.rim,
        material.grain,
        material.mottle,
    )


def encoding_table() -> k.Bytes:
    """Display value of each step of linear light (TONES,)."""
    tones = linear_to_srgb(np.arange(k.TONES) / (k.TONES - 1))
    return np.round(tones * 255.0).astype(np.uint8)
