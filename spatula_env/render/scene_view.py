"""Pictures of a scene: the organs with their contact pressure, the tools, the forces on them, and the goal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import FloatArray
from spatula_env.render.camera import Camera, Vector
from spatula_env.render.moment import Moment
from spatula_env.render.palette import GOAL
from spatula_env.render.renderer import Renderer
from spatula_env.render.scene_model import Composition, SceneModel
from spatula_env.render.viewpoints import default_camera

if TYPE_CHECKING:
    from spatula_env.scenes import Scene


HIDDEN_OPACITY = 0.6
"""Opacity with which hidden parts of marks shine through."""

DASH = 0.2
"""Length of the dashes that hidden parts of marks are drawn with, and of the gaps between them [u]."""


class SceneView:
    """Draws one scene, picture after picture, seen by one camera.

    Attributes:
        camera: The view; may be replaced.
    """

    def __init__(
        self,
        scene: Scene,
        triangles: NDArray[np.int32],
        width: int = 480,
        height: int = 480,
        camera: Camera | None = None,
        *,
        supersample: int = 2,
        levels: int | None = None,
    ) -> None:
        """Prepare the meshes.

        Args:
            scene: The scene with organs and tools.
            triangles: (T, 3) of all organs.
            width: Width of the picture [pixels].
            height: Height of the picture [pixels].
            camera: The view; by default one that suits the kind of scene (see `default_camera`).
            supersample: Samples along a pixel's side; see `Renderer`.
            levels: How finely the organs are drawn; see `SceneModel`.

        Raises:
            ValueError: If the width, the height or the number of samples is not allowed.
        """
        self._renderer = Renderer(width, height, supersample)
        self._model = SceneModel(scene, triangles, levels)
        self.camera = camera or default_camera(scene, width / height)

    def draw(
        self, moment: Moment, cut: tuple[Vector, Vector] | None = None, out: NDArray[np.uint8] | None = None
    ) -> NDArray[np.uint8]:
        """Draw one picture. Hidden parts of marks shine through.

        Args:
            moment: The state to draw.
            cut: (point, normal): organs are cut open, and their part on the side of the normal is removed.
            out: (height, width, 3) bytes to draw into; a new array if None.

        Returns:
            (height, width, 3) uint8.

        Raises:
            ValueError: If an array has a wrong shape.
        """
        composition = self._model.compose(moment, cut)
        if not composition.curves:
            meshes = composition.meshes + composition.marks
            return self._renderer.render(self.camera, meshes, ground=composition.ground, out=out)
        picture, depth = self._render_rgbd(composition, out)
        for curve in composition.curves:
            self._show_hidden(picture, depth, curve)
        return picture

    def draw_rgbd(
        self, moment: Moment, out: NDArray[np.uint8] | None = None
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Draw one picture and its depth.

        Args:
            moment: The state to draw. Arrows and marks, except for patches, have a depth of their own.
            out: As in `draw`.

        Returns:
            The picture (height, width, 3) uint8, and the distance (height, width) float32 along the optical axis of
            what is nearest in each pixel [u]; `camera.far` where there is nothing.

        Raises:
            ValueError: If an array has a wrong shape.
        """
        return self._render_rgbd(self._model.compose(moment), out)

    def _render_rgbd(
        self, composition: Composition, out: NDArray[np.uint8] | None
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        meshes = composition.meshes + composition.marks
        return self._renderer.render_rgbd(self.camera, meshes, ground=composition.ground, out=out)

    def _show_hidden(self, picture: NDArray[np.uint8], depth: NDArray[np.float32], curve: FloatArray) -> None:
        """Draw the hidden parts of a curve (K, 3) over the picture, faintly and dashed."""
        height, width = depth.shape
        steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        if not along[-1] > 0.0:
            return
        # Dots close enough to touch each other in a picture of this size.
        dots = np.linspace(0.0, along[-1], 4 * max(height, width))
        points = np.stack([np.interp(dots, along, curve[:, k]) for k in range(3)], axis=1)
        dashes = round(along[-1] / (2.0 * DASH))
        if dashes > 3:
            points = points[np.sin(2.0 * np.pi * dashes * dots / along[-1]) > 0.0]
        pixels, distance = self.camera.project(points, width, height)
        seen = (pixels >= 0.0).all(axis=-1) & (pixels[..., 0] < width) & (pixels[..., 1] < height)
        column, row = pixels[seen].astype(np.intp).T
        hidden = distance[seen] > depth[row, column] + 0.1
        mask = np.zeros((height, width), dtype=np.bool_)
        mask[row[hidden], column[hidden]] = True
        mask[1:] |= mask[:-1].copy()
        mixed = (1.0 - HIDDEN_OPACITY) * picture[mask] + HIDDEN_OPACITY * 255.0 * np.array(GOAL)
        picture[mask] = np.round(mixed)
