"""Viewpoints and cameras for a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import FloatArray
from spatula_env.geometry.blocks import FissuredBlock, RidgedBlock
from spatula_env.render.camera import Camera
from spatula_env.render.shapes import quaternion_matrix
from spatula_env.tasks.marks import Patch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from spatula_env.scenes import Scene
    from spatula_env.tasks.marks import Mark


FIELD_OF_VIEW = 32.0
"""The angle between the upper and the lower edge of the picture [degrees]."""


@dataclass(frozen=True)
class Viewpoint:
    """A direction of view, and what must be in the picture.

    Attributes:
        azimuth: See `Camera.orbit` [degrees].
        elevation: See `Camera.orbit` [degrees].
        base: Fraction of the organ's height above which the organ must be in the picture; 0 for all of it.
        lift: Height above their start up to which the tools must be in the picture too [u].
        room: Margin around what must be visible, as a fraction of the picture.
    """

    azimuth: float
    elevation: float
    base: float = 0.0
    lift: float = 0.0
    room: float = 0.04


GENERAL = Viewpoint(azimuth=-68.0, elevation=34.0, base=0.62, room=0.03)
"""From the operator's side (-y), a little from the right and from above, at the organ's upper part."""

INTO_FISSURE = Viewpoint(azimuth=25.0, elevation=66.0, base=0.2)
"""Roughly along the fissure, from whose direction the azimuth is measured, and down into it."""

BESIDE_RIDGE = Viewpoint(azimuth=24.0, elevation=22.0, lift=0.8)
"""Roughly along a ridge between two jaws, from whose direction the azimuth is measured, with room to lift it."""

ALONG_RIDGE = Viewpoint(azimuth=10.0, elevation=32.0, base=0.4)
"""Along a ridge that is pushed aside."""

STEEP = 0.5
"""A part of the organ whose normal has a horizontal share above this is visible from its side only."""
ASIDE = 38.0
"""Greatest angle by which a viewpoint is turned towards such a part [degrees]. It is not seen straight on, because the
tool that works there would hide it."""

HEADROOM = 0.9
"""Parts of a tool higher above the organs than this, such as the handle of a long blade, need not be in the picture
[u]."""


def viewpoint_of(scene: Scene) -> Viewpoint:
    """The viewpoint that suits a scene's first organ, whatever its orientation."""
    placed = scene.organs[0]
    if isinstance(placed.organ, FissuredBlock):
        viewpoint = INTO_FISSURE
    elif isinstance(placed.organ, RidgedBlock):
        viewpoint = BESIDE_RIDGE if len(scene.tools) > 1 else ALONG_RIDGE
    else:
        return GENERAL
    # Both shapes are mirror-symmetric: of the four equivalent directions, take the one closest to the operator's.
    x, y, _ = quaternion_matrix(placed.orientation)[:, 0]
    turn = math.degrees(math.atan2(y, x))
    choices = [turn + half + side * viewpoint.azimuth for half in (0.0, 180.0) for side in (-1.0, 1.0)]
    azimuth = min(choices, key=lambda angle: abs((angle - GENERAL.azimuth + 180.0) % 360.0 - 180.0))
    return replace(viewpoint, azimuth=(azimuth + 180.0) % 360.0 - 180.0)


def viewpoint_toward(scene: Scene, nodes: FloatArray, triangles: NDArray[np.int32], marks: Sequence[Mark]) -> Viewpoint:
    """The viewpoint that suits a scene and a goal: on the side of the organ's part that the task is about.

    Args:
        scene: The scene.
        nodes: (V, 3) of the organ [u].
        triangles: (T, 3) of the organ, counter-clockwise from outside.
        marks: Marks that show the goal.
    """
    viewpoint = viewpoint_of(scene)
    inside = np.zeros(len(nodes), dtype=np.bool_)
    for mark in marks:
        if isinstance(mark, Patch) and mark.role == "target":
            inside[mark.nodes] = True
    first, second, third = (nodes[corner] for corner in triangles[inside[triangles].all(axis=1)].T)
    out = np.cross(second - first, third - first).sum(axis=0)
    if not np.hypot(out[0], out[1]) > STEEP * np.linalg.norm(out):
        return viewpoint
    beside = math.degrees(math.atan2(out[1], out[0])) - viewpoint.azimuth
    beside = (beside + 180.0) % 360.0 - 180.0
    return replace(viewpoint, azimuth=viewpoint.azimuth + min(max(beside, -ASIDE), ASIDE))


def default_camera(scene: Scene, aspect: float = 1.0) -> Camera:
    """A camera that has the organs and the tools of a scene in the picture.

    Args:
        scene: The scene.
        aspect: Width of the picture over its height.
    """
    viewpoint = viewpoint_of(scene)
    seen = []
    for placed in scene.organs:
        points = placed.vertices
        low, high = points[:, 2].min(), points[:, 2].max()
        seen.append(points[points[:, 2] >= low + viewpoint.base * (high - low)])
    highest = max(float(points[:, 2].max()) for points in seen) + HEADROOM
    for tool in scene.tools:
        corners = tool.tool.vertices @ quaternion_matrix(tool.orientation).T + tool.position
        corners[:, 2] = np.minimum(corners[:, 2], max(highest, corners[:, 2].min()))
        seen += [corners, corners + np.array([0.0, 0.0, viewpoint.lift])]
    return fit_camera(np.concatenate(seen), viewpoint, aspect)


def fit_camera(points: FloatArray, viewpoint: Viewpoint, aspect: float = 1.0) -> Camera:
    """The closest camera in the viewpoint's direction that has all points (P, 3) in a picture of an aspect ratio."""
    turn, rise = math.radians(viewpoint.azimuth), math.radians(viewpoint.elevation)
    backward = np.array([math.cos(rise) * math.cos(turn), math.cos(rise) * math.sin(turn), math.sin(rise)])
    right = np.array([-math.sin(turn), math.cos(turn), 0.0])
    up = np.cross(backward, right)
    local = points @ np.stack([right, up, backward]).T
    reach = math.tan(math.radians(0.5 * FIELD_OF_VIEW)) * (1.0 - 2.0 * viewpoint.room) * np.array([aspect, 1.0])
    # On each of the two axes, the eye is midway between the planes that just touch the points on either side.
    sums = (local[:, :2] + reach * local[:, 2:]).max(axis=0), (local[:, :2] - reach * local[:, 2:]).min(axis=0)
    middle = 0.5 * (sums[0] + sums[1])
    distance = float((0.5 * (sums[0] - sums[1]) / reach).max())
    eye = middle[0] * right + middle[1] * up + distance * backward
    focus = float(np.median(local[:, 2]))
    target = eye - (distance - focus) * backward
    return Camera(
        (float(eye[0]), float(eye[1]), float(eye[2])),
        (float(target[0]), float(target[1]), float(target[2])),
        vertical_field_of_view=FIELD_OF_VIEW,
    )
