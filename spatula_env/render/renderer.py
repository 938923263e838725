"""The renderer: owns the buffers, packs the scene, runs the kernels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spatula_env.render import background as backgrounds
from spatula_env.render import compose, rasterizer, shadows, vertices
from spatula_env.render import layout as k
from spatula_env.render.aiming import encoding_table, fill_light, fill_view, mesh_parameters
from spatula_env.render.camera import Camera
from spatula_env.render.palette import Color, linear_color, srgb_to_linear, to_color
from spatula_env.render.primitives import Background, GroundPlane, Lighting, Mesh

_STYLES = {"plain": 0.0, "grid": 1.0, "checker": 2.0}

_BAND = 16384
"""Samples in a band."""


class Renderer:
    """Draws triangle meshes and a ground plane on the processor, without a window or a graphics driver.

    The buffers are kept between pictures; the background with the ground is drawn once and kept while camera,
    background and ground stay equal. Equal input gives equal bytes. One renderer serves one thread.

    Args:
        width: of the picture, pixels, 1..8192.
        height: of the picture, pixels, 1..8192.
        supersample: samples along a pixel's side, 1..4. Visibility is computed for every sample, light once for every
            triangle in a pixel: 2 gives smooth edges at little cost.
        lighting: the lights.

    Raises:
        ValueError: if an argument is out of its range.
    """

    def __init__(self, width: int, height: int, supersample: int = 2, lighting: Lighting | None = None) -> None:
        for name, value, highest in (
            ("width", width, 8192),
            ("height", height, 8192),
            ("supersample", supersample, 4),
        ):
            if not 1 <= value <= highest or int(value) != value:
                raise ValueError(f"{name} must be an integer in 1..{highest}, got {value}")
        self.width = int(width)
        self.height = int(height)
        self.supersample = int(supersample)
        self.lighting = Lighting() if lighting is None else lighting

        self._background_light = np.zeros((self.height, self.width, 3), dtype=np.float32)
        self._background_bytes = np.zeros((self.height, self.width, 3), dtype=np.uint8)
        self._ground_weight = np.zeros((self.height, self.width), dtype=np.float32)
        # What the view array and the background were computed for.
        self._drawn: tuple[Camera, Background, GroundPlane | None, Lighting] | None = None

        # Samples exist for a band of rows at a time, few enough to stay in the processor's cache.
        columns = self.width * self.supersample
        band = min(max(_BAND // (columns * self.supersample), 1), self.height)
        samples = band * self.supersample * columns
        # The order of `layout.Band`.
        self._band: k.Band = (
            np.zeros(samples, dtype=np.float32),
            np.zeros(samples, dtype=np.int32),
            np.zeros(samples, dtype=np.float32),
            np.zeros(samples, dtype=np.int32),
            np.zeros((band * self.supersample, 2), dtype=np.int32),
            np.zeros((band * self.width, 3), dtype=np.float32),
            np.zeros((columns * self.supersample, 2), dtype=np.int32),
            np.zeros((columns * self.supersample, 3)),
        )

        # Shadows are soft, so a map much finer than the picture would be a waste.
        size = min(max(int(0.32 * max(self.width, self.height)), 40), 160)
        under_size = min(max(size // 2, 24), 72)
        self._map_depth = np.zeros((size, size), dtype=np.float32)
        self._map_mesh = np.zeros((size, size), dtype=np.int32)
        self._dark = np.zeros((2, size, size), dtype=np.float32)
        self._under_depth = np.zeros((under_size, under_size), dtype=np.float32)
        self._under_mesh = np.zeros((under_size, under_size), dtype=np.int32)

        self._view = np.zeros(k.VIEW)
        self._light = np.zeros(k.LIGHT)
        self._matrix = np.zeros((3, 4))
        self._tones = encoding_table()
        self._vertex_room = self._triangle_room = self._mesh_room = 0
        self._grow(1024, 2048, 16)

    def render(
        self,
        camera: Camera,
        meshes: Sequence[Mesh],
        *,
        ground: GroundPlane | None = None,
        background: Background | Color | None = None,
        out: NDArray[np.uint8] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw one picture.

        Args:
            camera: the view.
            meshes: surfaces.
            ground: the ground plane; None draws none.
            background: a gradient, or one colour; None is the default gradient.
            out: (H, W, 3) bytes, C-contiguous, to draw into; a new array if None.

        Returns:
            (H, W, 3) uint8, sRGB, the first row at the top.

        Raises:
            ValueError: if `out` does not fit, or a background colour is out of its range.
        """
        picture = self._output(out)
        self._draw(camera, meshes, ground, background, picture)
        return picture

    def render_rgbd(
        self,
        camera: Camera,
        meshes: Sequence[Mesh],
        *,
        ground: GroundPlane | None = None,
        background: Background | Color | None = None,
        out: NDArray[np.uint8] | None = None,
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Draw one picture and its depth.

        Args:
            camera: the view.
            meshes: surfaces.
            ground: the ground plane.
            background: as in `render`.
            out: as in `render`.

        Returns:
            The picture (H, W, 3), uint8, and the depth (H, W), float32, which is the distance along the optical axis in
            u, at the pixel's centre, of the nearest opaque thing in the pixel; the ground counts even where it has
            faded, and the depth is `camera.far` where there is nothing. Translucent meshes do not count.

        Raises:
            ValueError: as in `render`.
        """
        picture = self._output(out)
        depth = np.empty((self.height, self.width), dtype=np.float32)
        self._draw(camera, meshes, ground, background, picture, depth)
        return picture, depth

    # ------------------------------------------------------------------------------------------------- private

    def _output(self, out: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
        shape = (self.height, self.width, 3)
        if out is None:
            return np.empty(shape, dtype=np.uint8)
        if out.shape != shape or out.dtype != np.uint8 or not (out.flags.c_contiguous and out.flags.writeable):
            raise ValueError(
                f"out must be a writable C-contiguous uint8 array of the shape {shape}, got {out.dtype} {out.shape}"
            )
        return out

    def _grow(self, points: int, triangles: int, meshes: int) -> None:
        """Enlarge the buffers for a scene if needed; their contents are lost."""
        if points > self._vertex_room:
            self._vertex_room = room = max(points, 2 * self._vertex_room)
            self._points = np.zeros((room, 3))
            self._placed = np.zeros((room, 3))
            self._light_space = np.zeros((room, 3))
            self._normals = np.zeros((room, 3))
            self._colors = np.zeros((room, 3))
            self._texture = np.zeros((room, 3))
        if triangles > self._triangle_room:
            self._triangle_room = room = max(triangles, 2 * self._triangle_room)
            self._triangles = np.zeros((room, 3), dtype=np.int32)
            self._owner = np.zeros(room, dtype=np.int32)
            self._functions = np.zeros((room, k.FUNCTIONS))
            self._extents = np.zeros((room, 6), dtype=np.int32)
            self._limits = np.zeros((room, 5, 3))
        if meshes > self._mesh_room:
            self._mesh_room = room = max(meshes, 2 * self._mesh_room)
            self._flags = np.zeros(room, dtype=np.int32)
            self._parameters = np.zeros((room, k.PARAMETERS))
            self._ranges = np.zeros((room, 2), dtype=np.int32)
            self._others = np.zeros((room, 4))

    def _draw_background(self, background: Background, ground: GroundPlane | None) -> None:
        plane = GroundPlane() if ground is None else ground
        numbers = np.concatenate(
            [
                srgb_to_linear((background.top, background.bottom, plane.color, plane.second_color)).ravel(),
                (_STYLES[plane.style], plane.tile, plane.line_width, *plane.center),
                (plane.fade_start, plane.fade_end),
            ]
        )
        backgrounds.draw_background(
            self._view,
            numbers,
            self.width,
            self.height,
            self.supersample,
            self._tones,
            self._background_light,
            self._ground_weight,
            self._background_bytes,
        )

    def _pack_mesh(self, mesh: Mesh, m: int, vertex: int, triangle: int, floor: float) -> tuple[int, int]:
        """Copy a mesh into the buffers; returns the next free vertex and triangle."""
        vertex_end, triangle_end = vertex + len(mesh.vertices), triangle + len(mesh.triangles)
        self._points[vertex:vertex_end] = mesh.vertices
        np.add(mesh.triangles, np.int32(vertex), out=self._triangles[triangle:triangle_end])
        if mesh.vertex_colors is None:
            self._colors[vertex:vertex_end] = linear_color(mesh.color)
        else:
            vertices.to_linear(np.ascontiguousarray(mesh.vertex_colors), vertex, vertex_end, self._colors)

        material = mesh.material
        flags = 0
        if mesh.smooth:
            flags |= k.SMOOTH
        if mesh.smooth or mesh.rind > 0.0:
            vertices.vertex_normals(
                self._points, self._triangles, vertex, vertex_end, triangle, triangle_end, self._normals
            )
        if mesh.two_sided or mesh.back_color is not None or (mesh.clip_plane is not None and not mesh.capped):
            flags |= k.DRAW_BACK
        if material.unlit:
            flags |= k.UNLIT
        # An invisible mesh casts no shadow, and a mesh without triangles has no extent.
        if mesh.casts_shadow and mesh.opacity > 0.0 and len(mesh.triangles):
            flags |= k.CASTS
        if mesh.receives_shadow:
            flags |= k.RECEIVES
        if mesh.opacity < 1.0:
            flags |= k.TRANSLUCENT
        plane = (0.0, 0.0, 0.0, 0.0)
        if mesh.clip_plane is not None:
            flags |= k.CUT
            if mesh.capped:
                flags |= k.CAPPED
            point, normal = mesh.clip_plane
            plane = (*normal, sum(x * n for x, n in zip(point, normal, strict=True)))
        back = _section_color(mesh) if mesh.rind > 0.0 else mesh.back_color or mesh.color
        self._parameters[m] = mesh_parameters(material, mesh.opacity, back, plane)
        if mesh.texture is not None and (material.grain > 0.0 or material.mottle > 0.0):
            flags |= k.TEXTURED
            self._texture[vertex:vertex_end] = mesh.texture
        for _ in range(mesh.refine):
            split_end = triangle_end + 4 * (triangle_end - triangle)
            vertex_end = vertices.refine(
                self._triangles,
                triangle,
                triangle_end,
                self._triangles,
                triangle_end,
                vertex_end,
                floor,
                self._points,
                self._normals,
                self._colors,
                self._texture,
            )
            fine = self._triangles[triangle_end:split_end]
            triangle_end = triangle + len(fine)
            self._triangles[triangle:triangle_end] = fine
        self._owner[triangle:triangle_end] = m
        self._ranges[m] = vertex, vertex_end
        self._flags[m] = flags
        return vertex_end, triangle_end

    def _pack_core(self, mesh: Mesh, m: int, shell: int, vertex: int, triangle: int) -> tuple[int, int]:
        """Copy mesh `shell`, moved inwards by its rind, as mesh m; returns the next free vertex and triangle."""
        first, last = self._ranges[shell].tolist()
        vertex_end = vertex + last - first
        self._points[vertex:vertex_end] = self._points[first:last] - mesh.rind * self._normals[first:last]
        copied = self._triangles[:triangle][self._owner[:triangle] == shell]
        triangle_end = triangle + len(copied)
        self._triangles[triangle:triangle_end] = copied + np.int32(vertex - first)
        self._owner[triangle:triangle_end] = m
        self._ranges[m] = vertex, vertex_end
        self._parameters[m] = self._parameters[shell]
        self._parameters[m, k.BACK : k.BACK + 3] = linear_color(mesh.back_color or mesh.color)
        self._flags[m] = (self._flags[shell] & ~(k.CASTS | k.SMOOTH | k.DRAW_BACK)) | k.CORE
        return vertex_end, triangle_end

    def _draw(
        self,
        camera: Camera,
        meshes: Sequence[Mesh],
        ground: GroundPlane | None,
        background: Background | Color | None,
        picture: NDArray[np.uint8],
        depth: NDArray[np.float32] | None = None,
    ) -> None:
        self._see(camera, ground, background)
        packed = self._pack(meshes, -math.inf if ground is None else ground.height)
        self._cast_shadows(packed)
        rasterizer.prepare(
            self._points, self._placed, self._triangles, self._owner, packed.triangles,
            self._normals, self._colors, self._texture, self._flags, self._parameters, self._view,
            self.width * self.supersample, self.height * self.supersample,
            self._extents, self._limits, self._functions,
        )  # fmt: skip
        picture[:] = self._background_bytes
        compose.draw_picture(
            self.width, self.height, self.supersample, packed.triangles, self._matrix,
            self._translucent(packed), packed.sections(self._flags),
            self._extents, self._limits, self._tones, self._background_light, self._ground_weight,
            self._dark, len(self._under_depth), picture,
            np.zeros((0, 0), dtype=np.float32) if depth is None else depth,
            self._band, self._scene(),
        )  # fmt: skip

    def _see(self, camera: Camera, ground: GroundPlane | None, background: Background | Color | None) -> None:
        """Set up the view and draw the background, unless they are those of the previous picture."""
        if background is None:
            background = Background()
        elif not isinstance(background, Background):
            color = to_color(background, "background")
            background = Background(color, color)
        wanted = (camera, background, ground, self.lighting)
        if wanted != self._drawn:
            fill_view(self._view, self._matrix, camera, ground, (self.width, self.height), self.supersample)
            fill_light(self._light, self.lighting, ground)
            self._draw_background(background, ground)
            self._drawn = wanted

    def _pack(self, meshes: Sequence[Mesh], floor: float) -> _Packed:
        """Copy all meshes into the buffers; refinement puts no new vertex below the floor [u]."""
        rinds = [m for m, mesh in enumerate(meshes) if mesh.rind > 0.0]
        corners = triangles = 0
        for mesh in meshes:
            # Splitting adds 3 vertices per triangle, then 12 more; its input and its output need room at the same time.
            copies = 2 if mesh.rind > 0.0 else 1
            corners += copies * (len(mesh.vertices) + (0, 3, 15)[mesh.refine] * len(mesh.triangles))
            triangles += copies * (1, 5, 20)[mesh.refine] * len(mesh.triangles)
        count = len(meshes) + len(rinds)
        # After the triangles, there is one place for the section of each mesh.
        self._grow(corners, triangles + count, count)
        vertex = triangle = 0
        starts = []
        for m, mesh in enumerate(meshes):
            starts.append(triangle)
            vertex, triangle = self._pack_mesh(mesh, m, vertex, triangle, floor)
        for m, shell in enumerate(rinds, start=len(meshes)):
            starts.append(triangle)
            vertex, triangle = self._pack_core(meshes[shell], m, shell, vertex, triangle)
        vertices.place(self._points, 0, vertex, self._matrix, self._placed)
        self._owner[triangle : triangle + count] = np.arange(count)
        return _Packed(triangle, (*starts, triangle), (*(-1 for _ in meshes), *(triangle + shell for shell in rinds)))

    def _cast_shadows(self, packed: _Packed) -> None:
        shadows.cast_shadows(
            self._points, self._light_space, self._triangles, self._owner, packed.triangles, packed.meshes,
            self._flags, self._parameters, self._ranges, self._view, self._light,
            self._map_depth, self._map_mesh, self._dark, self._under_depth, self._under_mesh, self._others,
        )  # fmt: skip

    def _translucent(self, packed: _Packed) -> NDArray[np.int64]:
        """Translucent triangles, nearest first, by the mean depth of their corners."""
        if not np.any(self._flags[: packed.meshes] & k.TRANSLUCENT):
            return np.zeros(0, dtype=np.int64)
        order = np.flatnonzero(self._flags[self._owner[: packed.triangles]] & k.TRANSLUCENT)
        distance = self._placed[self._triangles[order], 2].sum(axis=1)
        return order[np.argsort(distance, kind="stable")]

    def _scene(self) -> k.Scene:
        """The arrays that shading reads."""
        return (
            self._functions,
            self._owner,
            self._flags,
            self._parameters,
            self._view,
            self._light,
            self._map_depth,
            self._map_mesh,
            self._others,
        )


@dataclass(frozen=True)
class _Packed:
    """The meshes in the buffers, followed by the cores: meshes with a rind, shrunk by its thickness.

    Attributes:
        triangles: Number of triangles in all.
        starts: First triangle of each mesh, and the end of the last.
        shells: For a core, the triangle that represents the section it is drawn on; -1 for other meshes.
    """

    triangles: int
    starts: tuple[int, ...]
    shells: tuple[int, ...]

    @property
    def meshes(self) -> int:
        """Number of meshes, cores included."""
        return len(self.shells)

    def sections(self, flags: k.Indices) -> NDArray[np.int64]:
        """The sections to draw (C, 5), as `compose.draw_picture` takes them; `flags` of the meshes."""
        rows = [
            (m, self.starts[m], self.starts[m + 1], self.triangles + m, self.shells[m])
            for m in np.flatnonzero(flags[: self.meshes] & k.CAPPED).tolist()
        ]
        return np.array(rows, dtype=np.int64).reshape(-1, 5)


def _section_color(mesh: Mesh) -> Color:
    """Colour of a section's rind: paler than both sides of the surface."""
    outer, inner = mesh.color, mesh.back_color or mesh.color
    red, green, blue = (0.60 * a + 0.10 * b + 0.30 for a, b in zip(outer, inner, strict=True))
    return (red, green, blue)
