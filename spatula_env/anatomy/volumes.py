"""The volume that an organ has lost on the way, given back.

Two steps take volume away where a surface bulges, as most of an organ's does. The blur of voxels moves it inwards by
the square of the blur's standard deviation over the radius of curvature. Chords between nodes that lie on the surface
are inside of it. Both losses are mended by moving all nodes along their normals by the same length, which keeps the
shape better than a scaling: a long organ would grow mostly at its ends. What a wrap adds by closing furrows stays.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spatula_env.anatomy.topology import Surface, angles, edge_lengths
from spatula_env.geometry.crossings import self_crossings
from spatula_env.geometry.surface import triangle_areas, triangle_normals

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray

FARTHEST = 0.25
"""Greatest offset, in median edges: a greater loss is not of the blur or of chords, but of the shape."""

THICKENED = 0.05
"""Greatest offset, as a part of the mean thickness, which is twice the volume by the area: what is thin would else be
thickened for what it has lost at its borders."""

NEAR = 1e-4
"""A volume is restored if what is missing is a smaller part of it."""

ROUNDS = 6
"""Most corrections of the offset."""

LOST_ANGLE = 2.0
"""The least angle may become smaller by this [deg]."""


def restored(surface: Surface, volume: float) -> Surface | None:
    """Move the nodes of a surface along their normals until it has a volume.

    Args:
        surface: Closed, wound outwards.
        volume: Wanted volume [m3].

    Returns:
        The surface with the volume; None if it has more already, or if that needs a large offset, makes the surface
        cross itself, or makes needles.
    """
    if float(surface.volumes.sum()) > volume * (1.0 + NEAR):
        return None
    vertices = surface.vertices
    for _ in range(ROUNDS):
        current = Surface(vertices, surface.triangles)
        missing = volume - float(current.volumes.sum())
        if abs(missing) <= NEAR * volume:
            break
        vertices = vertices + missing / current.area * _node_normals(current)
    moved = Surface(vertices, surface.triangles)
    farthest = float(np.linalg.norm(vertices - surface.vertices, axis=1).max())
    thickness = 2.0 * volume / surface.area
    edge = float(np.median(edge_lengths(surface.vertices, surface.triangles)))
    if farthest > min(FARTHEST * edge, THICKENED * thickness):
        return None
    if abs(float(moved.volumes.sum()) - volume) > NEAR * volume:
        return None
    before, after = (angles(each.vertices, each.triangles).min() for each in (surface, moved))
    if after < before - LOST_ANGLE or len(self_crossings(moved.vertices, moved.triangles)):
        return None
    return moved


def _node_normals(surface: Surface) -> FloatArray:
    """(V, 3) unit normals of the nodes, means of the triangles' weighted by their areas."""
    weighted = (
        triangle_normals(surface.vertices, surface.triangles)
        * triangle_areas(surface.vertices, surface.triangles)[:, None]
    )
    sums = np.zeros_like(surface.vertices)
    for corner in range(3):
        np.add.at(sums, surface.triangles[:, corner], weighted)
    normals: FloatArray = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-300)
    return normals
