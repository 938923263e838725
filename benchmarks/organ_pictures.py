"""A picture of pressed organs: a panel for each surface and engine, with the spatula at the end of its way."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.pictures import new_figure

if TYPE_CHECKING:
    from benchmarks.presses import Pressed
    from spatula_env.arrays import FloatArray

COLUMNS = 6
"""Panels in a row; an even number keeps both engines of a surface side by side."""

ORGAN, TOOL = (0.93, 0.66, 0.60), (0.45, 0.55, 0.70)

LIGHT = (-0.41, -0.61, 0.68)
"""Direction to the light."""

ELEVATION, ASIDE = 25.0, 30.0
"""Angle above the horizontal, and aside of the surface's normal, from which the organs are looked at [deg]."""


def draw_pressed(table: Mapping[str, Mapping[str, Pressed]], path: Path) -> None:
    """Draw the organs after their first press.

    Args:
        table: The presses, by surface and engine; those without a picture are left out.
        path: File of the picture.
    """
    collection = import_module("mpl_toolkits.mplot3d.art3d").Poly3DCollection
    panels = [
        (f"{name}, {engine}", pressed.picture)
        for name, engines in table.items()
        for engine, pressed in engines.items()
        if pressed.picture is not None
    ]
    rows = max(1, math.ceil(len(panels) / COLUMNS))
    figure = new_figure(2.2 * COLUMNS, 2.3 * rows)
    for index, (title, drawn) in enumerate(panels):
        nodes, corners = drawn.nodes, drawn.corners
        axes: Any = figure.add_subplot(rows, COLUMNS, index + 1, projection="3d")
        azimuth = _azimuth(drawn.normal)
        organ, tool = (_seen(shapes, azimuth) for shapes in (nodes[drawn.triangles], corners[drawn.faces]))
        # One collection: what hides what is then decided triangle by triangle.
        shapes, colours = np.concatenate([organ, tool]), np.concatenate([_shaded(organ, ORGAN), _shaded(tool, TOOL)])
        axes.add_collection3d(collection(shapes, facecolors=colours, edgecolors="#40202040", linewidths=0.15))
        low, high = (reduce(np.vstack([nodes, corners]), axis=0) for reduce in (np.min, np.max))
        middle, half = 0.5 * (low + high), 0.42 * float((high - low).max())
        for axis, value in zip("xyz", middle.tolist(), strict=True):
            getattr(axes, f"set_{axis}lim")(value - half, value + half)
        axes.set_box_aspect((1.0, 1.0, 1.0))
        axes.set_proj_type("ortho")
        axes.view_init(ELEVATION, azimuth)
        axes.set_axis_off()
        axes.set_title(title, fontsize=8)
    figure.savefig(path)


def _azimuth(normal: FloatArray) -> float:
    """From where the place is seen: from the side to which the surface looks [deg]."""
    return math.degrees(math.atan2(normal[1], normal[0])) + ASIDE


def _seen(shapes: FloatArray, azimuth: float) -> FloatArray:
    """Those of the triangles (T, 3, 3) of closed surfaces whose outside is seen from where the picture is taken."""
    around, up = math.radians(azimuth), math.radians(ELEVATION)
    towards = np.array([math.cos(up) * math.cos(around), math.cos(up) * math.sin(around), math.sin(up)])
    return shapes[_normals(shapes) @ towards > 0.0]


def _shaded(shapes: FloatArray, colour: tuple[float, float, float]) -> FloatArray:
    """(T, 3) colours of triangles (T, 3, 3), lit from the upper left."""
    light = np.clip(0.6 + 0.4 * _normals(shapes) @ np.array(LIGHT), 0.0, 1.0)
    shaded: FloatArray = light[:, None] * np.array(colour)
    return shaded


def _normals(shapes: FloatArray) -> FloatArray:
    """(T, 3) unit normals of triangles (T, 3, 3)."""
    normals = np.cross(shapes[:, 1] - shapes[:, 0], shapes[:, 2] - shapes[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return np.asarray(normals)
