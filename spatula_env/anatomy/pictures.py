"""A picture of an organ before and after its preparation."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.anatomy.libraries import load

if TYPE_CHECKING:
    from spatula_env.anatomy.topology import Surface
    from spatula_env.arrays import FloatArray, IndexArray
    from spatula_env.geometry.prepared import PreparedOrgan

MOST_DRAWN = 40_000
"""Most triangles that are drawn of the surface before; of more, every second or third and so on is left out, and the
others are drawn larger."""

VIEWS = ((12.0, -60.0, "before"), (12.0, -60.0, "after"), (12.0, 30.0, "after, from the right"))


def before_after(before: Surface, organ: PreparedOrgan, kind: str = "png") -> bytes:
    """Draw an organ before and after, with held nodes marked.

    Args:
        before: The surface as read, posed like the organ [m].
        organ: The organ.
        kind: Ending of the picture's file: "png", "svg" or "pdf".

    Returns:
        The content of the file.

    Raises:
        ImportError: If matplotlib is not installed.
    """
    figure = load("matplotlib.figure").Figure(figsize=(12.0, 4.4), layout="constrained")
    after = 1e3 * organ.unit_length * organ.vertices
    step = 1 + len(before.triangles) // MOST_DRAWN
    shown = {"before": _thinned(1e3 * before.vertices, before.triangles, step)}
    for index, (elevation, azimuth, title) in enumerate(VIEWS):
        vertices, triangles = shown.get(title, (after, organ.triangles))
        axes = figure.add_subplot(1, 3, index + 1, projection="3d")
        _draw(axes, vertices, triangles, after)
        if title not in shown and organ.held:
            axes.scatter(*after[list(organ.held)].T, s=6, color="tab:red", depthshade=False, label="held")
            axes.legend(loc="upper right")
        count = len(before.triangles) if title in shown else len(triangles)
        axes.set_title(f"{title}: {count:,} triangles")
        axes.view_init(elevation, azimuth)
    stream = io.BytesIO()
    figure.savefig(stream, format=kind, dpi=120)
    return stream.getvalue()


def _thinned(vertices: FloatArray, triangles: IndexArray, step: int) -> tuple[FloatArray, IndexArray]:
    """Each `step`-th triangle, larger around its middle so that all together cover the surface."""
    if step == 1:
        return vertices, triangles
    corners = vertices[triangles[::step]]
    middles = corners.mean(axis=1, keepdims=True)
    corners = middles + 1.3 * np.sqrt(step) * (corners - middles)
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)


def _draw(axes: Any, vertices: FloatArray, triangles: IndexArray, frame: FloatArray) -> None:
    """Draw triangles [mm], lit from the upper left, in a box around the points of a frame [mm]."""
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    light = 0.6 + 0.4 * normals @ np.array([-0.41, -0.61, 0.68])
    colours = np.clip(light, 0.0, 1.0)[:, None] * np.array([0.93, 0.66, 0.60])
    faces = load("mpl_toolkits.mplot3d.art3d").Poly3DCollection(corners, facecolors=colours)
    if len(triangles) < 6_000:
        faces.set_edgecolor((0.2, 0.1, 0.1, 0.5))
        faces.set_linewidth(0.3)
    axes.add_collection3d(faces)
    low, high = frame.min(axis=0), frame.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * float((high - low).max())
    for name, value in zip("xyz", middle.tolist(), strict=True):
        getattr(axes, f"set_{name}lim")(value - half, value + half)
        getattr(axes, f"set_{name}label")(f"{name} [mm]")
    axes.locator_params(nbins=4)
    axes.set_box_aspect((1.0, 1.0, 1.0))
