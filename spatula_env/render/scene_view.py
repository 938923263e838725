"""A scene as a picture: the organ with its contact pressure, the spatula, the force on it, and the goal."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spatula_env.render.camera import Camera, Vector
from spatula_env.render.palette import FORCE, GOAL, STEEL, TISSUE, TISSUE_INSIDE
from spatula_env.render.primitives import (
    BRUSHED_STEEL,
    WET_TISSUE,
    Ground,
    Mesh,
    Segments,
    perpendicular_axes,
)
from spatula_env.render.renderer import Renderer
from spatula_env.render.shapes import arrow_mesh, quaternion_matrix, ring_mesh

if TYPE_CHECKING:
    from spatula_env.scenes import Scene

FloatArray = NDArray[np.float64]

ARROW_LENGTH = 0.35
"""Length of a force's arrow [u/N]."""

LEAST_FORCE = 0.05
"""A smaller force is not drawn [N]."""

RING_RADIUS = 0.82
"""Of the rings that show a goal [u]; they reach around the spatula."""

HIDDEN_OPACITY = 0.6
"""With which the part of a ring that the organ hides shines through."""


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
    ) -> None:
        """Prepare the meshes.

        Args:
            scene: With one organ and one tool.
            triangles: (T, 3) of the organ.
            width: Of the picture [pixels].
            height: Of the picture [pixels].
            camera: The view; by default from the operator's side, from above, at the organ and the tool.

        Raises:
            ValueError: If the size is not that of a picture.
        """
        placed = scene.organs[0]
        self._renderer = Renderer(width, height)
        self._organ = Mesh(
            placed.vertices,
            triangles,
            color=TISSUE,
            material=WET_TISSUE,
            texture=placed.vertices,
            refine=1,
        )
        tool = scene.tools[0].tool
        self._tool_vertices = np.array(tool.vertices)
        self._tool = Mesh(
            self._tool_vertices,
            tool.triangles,
            color=STEEL,
            smooth=False,
            material=BRUSHED_STEEL,
            texture=self._tool_vertices,
        )
        low, high = placed.vertices.min(axis=0), placed.vertices.max(axis=0)
        middle = 0.5 * (low + high)
        self._ground = None
        if scene.ground is not None:
            self._ground = Ground(scene.ground.height, center=(float(middle[0]), float(middle[1])))
        self.camera = camera or _default_camera(low, high)

    def draw(
        self,
        nodes: FloatArray,
        tool_position: FloatArray,
        tool_orientation: FloatArray,
        *,
        force: FloatArray | None = None,
        targets: FloatArray | None = None,
        cut: tuple[Vector, Vector] | None = None,
        out: NDArray[np.uint8] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw one picture.

        Args:
            nodes: (V, 3) of the organ [u].
            tool_position: (3,) [u].
            tool_orientation: (4,) quaternion xyzw.
            force: (3,) on the tool [N]; drawn as an arrow that the tool is pushed by.
            targets: (K, 3) points of the goal, each drawn as a horizontal ring, with a line from each to the
                next [u]. What the organ hides of them shines through.
            cut: (point, normal): the organ is cut open, and its part on the side of the normal is taken away.
            out: (height, width, 3) bytes to draw into; a new array if None.

        Returns:
            (height, width, 3) uint8.
        """
        rotation = quaternion_matrix(tool_orientation)
        organ = self._organ.moved(nodes)
        if cut is not None:
            organ = replace(organ, clip_plane=cut, capped=True, back_color=TISSUE_INSIDE)
        meshes = [
            organ,
            self._tool.moved(np.asarray(tool_position) + self._tool_vertices @ rotation.T),
        ]
        if force is not None and float(np.linalg.norm(force)) > LEAST_FORCE:
            vector = ARROW_LENGTH * np.asarray(force)
            meshes.append(arrow_mesh(tool_position, vector, color=FORCE))
        if targets is None:
            return self._renderer.render(self.camera, meshes, ground=self._ground, out=out)
        points = np.asarray(targets, dtype=np.float64)
        meshes += [ring_mesh(p, RING_RADIUS, width=0.05, color=GOAL, casts_shadow=False) for p in points]
        lines = Segments.polyline(points, color=GOAL, width=2.0)
        picture, depth = self._renderer.render_rgbd(self.camera, meshes, [lines], ground=self._ground, out=out)
        self._show_hidden(picture, depth, points)
        return picture

    def _show_hidden(self, picture: NDArray[np.uint8], depth: NDArray[np.float32], points: FloatArray) -> None:
        """Draw what is hidden of the rings around some points (K, 3) over the picture, faintly and dashed."""
        height, width = depth.shape
        # Twelve dashes, and enough dots that they touch each other in a picture of this size.
        angle = np.linspace(0.0, 2.0 * np.pi, 4 * max(height, width))
        angle = angle[np.sin(12.0 * angle) > 0.0]
        first, second, _ = perpendicular_axes((0.0, 0.0, 1.0))
        circle = RING_RADIUS * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)
        pixels, distance = self.camera.project(points[:, None] + circle, width, height)
        seen = (pixels >= 0.0).all(axis=-1) & (pixels[..., 0] < width) & (pixels[..., 1] < height)
        column, row = pixels[seen].astype(np.intp).T
        hidden = distance[seen] > depth[row, column] + 0.1
        mask = np.zeros((height, width), dtype=np.bool_)
        mask[row[hidden], column[hidden]] = True
        mask[1:] |= mask[:-1].copy()
        mixed = (1.0 - HIDDEN_OPACITY) * picture[mask] + HIDDEN_OPACITY * 255.0 * np.array(GOAL)
        picture[mask] = np.round(mixed)


def _default_camera(low: FloatArray, high: FloatArray) -> Camera:
    """From the operator's side (-y), a little from the right and from above, at the organ's upper part."""
    size = float((high - low).max())
    middle = 0.5 * (low + high)
    target = (float(middle[0]), float(middle[1]), float(high[2] - 0.15 * size))
    return Camera.orbit(target, 1.9 * size, azimuth=-68.0, elevation=26.0, vertical_field_of_view=36.0)
