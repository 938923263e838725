"""Plain pictures of a scene in many worlds at once, as learners use them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numba
import numpy as np
from numpy.typing import NDArray

from spatula_env.render import layout as k
from spatula_env.render import plain
from spatula_env.render.aiming import encoding_table, fill_light, fill_view, mesh_parameters
from spatula_env.render.palette import linear_color, srgb_to_linear
from spatula_env.render.primitives import BRUSHED_STEEL, WET_TISSUE, Lighting
from spatula_env.render.renderer import Renderer
from spatula_env.render.scene_model import SceneModel
from spatula_env.render.viewpoints import default_camera
from spatula_env.tasks.marks import ROLES
from spatula_env.threads import share_out

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray
    from spatula_env.render.camera import Camera
    from spatula_env.render.moment import Moments
    from spatula_env.scenes import Scene

PIECES = 8
"""Pieces of work for each thread: worlds cost different amounts of time."""


class PlainView:
    """Draws one scene in many worlds at once, picture after picture, seen by one camera; one sample per pixel.

    Each picture is the same, to the last bit, whichever worlds are drawn together and with however many threads.

    Attributes:
        camera: The view, which stays as it is.
        scene: The scene with organs and tools.
        triangles: (T, 3) of all organs.
    """

    def __init__(
        self,
        scene: Scene,
        triangles: NDArray[np.int32],
        width: int = 84,
        height: int = 84,
        camera: Camera | None = None,
    ) -> None:
        """Prepare what does not change between pictures.

        Args:
            scene: The scene with organs and tools.
            triangles: (T, 3) of all organs.
            width: Width of a picture [pixels].
            height: Height of a picture [pixels].
            camera: The view; by default one that suits the kind of scene (see `default_camera`).

        Raises:
            ValueError: If the width or the height is not allowed.
        """
        self.scene, self.triangles = scene, triangles
        # Ground and background are those of pictures in the full style, without anything on them.
        self._renderer = Renderer(width, height, supersample=1)
        self.camera = camera or default_camera(scene, width / height)
        scene_model = SceneModel(scene, triangles, levels=0)
        self._ground = scene_model.ground
        self._nodes, self._tools = sum(len(placed.vertices) for placed in scene.organs), len(scene.tools)
        self._model = self._prepare(scene_model)
        self._backdrops = self._blank(0)
        self._heights: FloatArray = np.zeros(0)

    def draw(
        self,
        moments: Moments,
        *,
        depth: bool = False,
        slots: NDArray[np.int64] | None = None,
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32] | None]:
        """Draw n worlds.

        Args:
            moments: Their states.
            depth: Whether to return depth as well.
            slots: (n,) a number for each world, by which the picture of its ground is kept while its height stays the
                same; None for 0 to n - 1.

        Returns:
            Pictures (n, height, width, 3); and (n, height, width), if asked for, the distance along the optical axis of
            what is nearest in the middle of each pixel, `camera.far` where there is nothing [u].

        Raises:
            ValueError: If an array has a wrong shape, or there is no such role of patches.
        """
        states = self._states(moments, slots)
        count, size = len(states.nodes), (self._renderer.height, self._renderer.width)
        pictures = np.empty((count, *size, 3), dtype=np.uint8)
        depths = np.empty((count if depth else 0, *size), dtype=np.float32)
        threads = min(numba.get_num_threads(), count)
        pieces = 1 if threads <= 1 else min(count, PIECES * threads)
        ends = np.linspace(0, count, pieces + 1).round().astype(int).tolist()
        model, backdrops = self._model, self._backdrops

        def work(piece: int) -> None:
            plain.draw_worlds(ends[piece], ends[piece + 1], model, backdrops, states, pictures, depths)

        share_out(work, pieces, threads)
        return pictures, depths if depth else None

    def _prepare(self, scene_model: SceneModel) -> plain.Model:
        """The arrays that all pictures share."""
        surface, meshes = scene_model.surface, scene_model.tools
        # Tools are flat-shaded: each of their triangles has vertices of its own.
        corners = [np.asarray(mesh.vertices)[mesh.triangles].reshape(-1, 3) for mesh in meshes]
        count = len(surface.source)
        tool_triangles = count + np.arange(sum(map(len, corners)), dtype=np.int32).reshape(-1, 3)
        colors = [scene_model.tissue, *(scene_model.dyed(role) for role in ROLES)]
        steel = np.concatenate(
            [np.tile(linear_color(mesh.color), (len(of), 1)) for mesh, of in zip(meshes, corners, strict=True)]
        )
        view, light, matrix = np.zeros(k.VIEW), np.zeros(k.LIGHT), np.zeros((3, 4))
        fill_view(view, matrix, self.camera, self._ground, (self._renderer.width, self._renderer.height), 1)
        fill_light(light, Lighting(), self._ground)
        return plain.Model(
            source=surface.source.astype(np.int32),
            tool_vertices=np.concatenate(corners),
            tools=np.repeat(np.arange(len(meshes), dtype=np.int32), [len(of) for of in corners]),
            triangles=np.concatenate([surface.triangles, tool_triangles.astype(np.int32)]),
            colors=np.stack([np.concatenate([srgb_to_linear(tissue), steel]) for tissue in colors]),
            parameters=np.array([mesh_parameters(WET_TISSUE), mesh_parameters(BRUSHED_STEEL)]),
            viewing=view,
            light=light,
            matrix=matrix,
            tones=encoding_table(),
        )

    def _states(self, moments: Moments, slots: NDArray[np.int64] | None) -> plain.States:
        """The worlds' states as kernels take them; draws the ground where it has not been drawn before."""
        nodes = _own(moments.nodes)
        count = len(nodes)
        scales = np.ones(count) if moments.tool_scales is None else moments.tool_scales
        level = 0.0 if self._ground is None else self._ground.height
        heights = np.full(count, level) if moments.ground_heights is None else moments.ground_heights
        shapes = {
            "nodes": (nodes, (count, self._nodes, 3)),
            "tool_positions": (moments.tool_positions, (count, self._tools, 3)),
            "tool_orientations": (moments.tool_orientations, (count, self._tools, 4)),
            "tool_scales": (scales, (count,)),
            "ground_heights": (heights, (count,)),
            **{f"patches[{role!r}]": (inside, (count, self._nodes)) for role, inside in moments.patches.items()},
        }
        for name, (values, shape) in shapes.items():
            if np.shape(values) != shape:
                raise ValueError(f"{name} must have the shape {shape}, got {np.shape(values)}")
        dyes = np.zeros((count, self._nodes), dtype=np.uint8)
        for role, inside in moments.patches.items():
            if role not in ROLES:
                raise ValueError(f"patches must be of the roles {list(ROLES)}, got {role!r}")
            dyes[inside] = 1 + ROLES.index(role)
        heights = _own(heights)
        return plain.States(
            frame=np.array([*moments.origin, moments.unit]),
            nodes=nodes,
            positions=_own(moments.tool_positions),
            orientations=_own(moments.tool_orientations),
            scales=_own(scales),
            dyes=dyes,
            heights=heights,
            backdrops=self._backdrops_at(heights, np.arange(count) if slots is None else slots),
        )

    def _backdrops_at(self, heights: FloatArray, slots: NDArray[np.int64]) -> NDArray[np.int64]:
        """The backdrops (n,) with the ground at some heights (n,) [u].

        Where all grounds have one height there is one backdrop, else one for each slot.
        """
        if self._ground is None:
            heights = np.zeros(len(heights))
        if not len(heights):
            return np.zeros(0, dtype=np.int64)
        if len(self._heights) <= 1 and (heights == heights[0]).all():
            if not len(self._heights) or self._heights[0] != heights[0]:
                self._backdrops, self._heights = self._blank(1), np.full(1, np.nan)
                self._draw_backdrop(0, float(heights[0]))
            return np.zeros(len(heights), dtype=np.int64)
        room = int(slots.max()) + 1
        if len(self._heights) < room:
            self._backdrops, self._heights = self._blank(room), np.full(room, np.nan)
        for slot, height in zip(slots.tolist(), heights.tolist(), strict=True):
            if self._heights[slot] != height:
                self._draw_backdrop(slot, height)
        return np.require(slots, np.int64, ["C", "W"])

    def _blank(self, count: int) -> NDArray[np.uint8]:
        return np.zeros((count, self._renderer.height, self._renderer.width, 3), dtype=np.uint8)

    def _draw_backdrop(self, index: int, height: float) -> None:
        ground = None if self._ground is None else replace(self._ground, height=height)
        self._renderer.render(self.camera, [], ground=ground, out=self._backdrops[index])
        self._heights[index] = height


def _own(values: FloatArray) -> FloatArray:
    """Values as kernels take them: C-contiguous and writable; the same array if it is so already."""
    return np.require(values, np.float64, ["C", "W"])
