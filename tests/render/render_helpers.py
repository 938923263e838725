"""Small scenes whose pictures can be computed by hand."""

from __future__ import annotations

import numpy as np

from spatula_env.render import UNLIT, Camera, Mesh

RED = (200 / 255, 30 / 255, 20 / 255)
BLUE = (20 / 255, 40 / 255, 220 / 255)
GREY = (128 / 255, 128 / 255, 128 / 255)


def ahead(**options) -> Camera:
    """At the origin, looking along +y, z up, 90 degrees: the picture's upper edge at depth d is at z = d."""
    return Camera((0, 0, 0), (0, 1, 0), vertical_field_of_view=90.0, **options)


def quad(corners, **options) -> Mesh:
    """Two unlit triangles with the front towards who sees the corners counter-clockwise."""
    options = {"material": UNLIT, "smooth": False, **options}
    return Mesh(np.array(corners, dtype=float), np.array([[0, 1, 2], [0, 2, 3]]), **options)


def wall(depth: float, left=-100.0, right=100.0, low=-100.0, high=100.0, **options) -> Mesh:
    """A rectangle across the view of `ahead`."""
    return quad([(left, depth, low), (right, depth, low), (right, depth, high), (left, depth, high)], **options)


def decode(value):
    value = np.asarray(value, dtype=float)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def encode(value):
    value = np.asarray(value, dtype=float)
    return np.where(value <= 0.0031308, value * 12.92, 1.055 * value ** (1 / 2.4) - 0.055)


def mix(*parts) -> np.ndarray:
    """Bytes of a mixture in linear light: (weight, colour) pairs."""
    return encode(sum(weight * decode(color) for weight, color in parts)) * 255


def is_color(picture, color, tolerance=0) -> np.ndarray:
    """Which pixels (H, W) have a colour, to `tolerance` steps of 255."""
    return (np.abs(picture.astype(int) - np.round(np.array(color) * 255)) <= tolerance).all(axis=-1)
