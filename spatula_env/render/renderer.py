"""The renderer: owns the buffers, packs the scene, runs the kernels."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from spatula_env.render.camera import Camera
from spatula_env.render.palette import Color, linear_to_srgb, srgb_to_linear, to_color
from spatula_env.render.primitives import Background, Ground, Lighting, Mesh, Segments, perpendicular_axes

_STYLES = {"plain": 0.0, "grid": 1.0, "checker": 2.0}


class Renderer:
    """Draws triangle meshes, lines and a ground plane on the processor, without a window or a graphics driver.

    The buffers are kept between pictures; the background with the ground is drawn once and kept while camera,
    background and ground stay equal. Equal input gives equal bytes. One renderer serves one thread.

    Args:
        width: of the picture, pixels, 1..8192.
        height: of the picture, pixels, 1..8192.
        supersample: samples along a pixel's side, 1..4. Visibility is found for every sample, light for every
            triangle in a pixel: 2 gives smooth edges at little cost.
        lighting: the lights.

    Raises:
        ValueError: if an argument is out of its range.
    """

    def __init__(
        self, width: int, height: int, supersample: int = 2, lighting: Lighting | None = None
    ) -> None:
        for name, value, highest in (
            ("width", width, 8192),
            ("height", height, 8192),
            ("supersample", supersample, 4),
        ):
            if not 1 <= value <= highest or int(value) != value:
                raise ValueError(f"{name} must be an integer in 1..{highest}, got {value}")
        # Compiling takes a while the first time: only those who draw wait for it.
        from spatula_env.render import rasterizer

        self._kernels = rasterizer
        self.width = int(width)
        self.height = int(height)
        self.supersample = int(supersample)
        self.lighting = Lighting() if lighting is None else lighting

        columns, lines = self.width * self.supersample, self.height * self.supersample
        self._depth = np.zeros(columns * lines, dtype=np.float32)
        self._background_depth = np.zeros(columns * lines, dtype=np.float32)
        self._shown = np.full(columns * lines, -1, dtype=np.int32)
        self._rows = np.zeros((lines, 2), dtype=np.int32)
        self._background_light = np.zeros((self.height, self.width, 3), dtype=np.float32)
        self._background_bytes = np.zeros((self.height, self.width, 3), dtype=np.uint8)
        self._ground_weight = np.zeros((self.height, self.width), dtype=np.float32)
        self._background_key: tuple[Camera, Background, Ground | None] | None = None
        # These three are needed for what is translucent and for caps only.
        self._left = np.zeros(0, dtype=np.float32)
        self._stamp = np.zeros(0, dtype=np.int32)
        self._total = np.zeros((0, 0, 0), dtype=np.float32)
        self._inside = np.zeros(0, dtype=np.int32)

        # Shadows are soft: a map much finer than the picture would be wasted.
        size = min(max(int(0.4 * max(self.width, self.height)), 40), 200)
        under_size = min(max(size // 2, 24), 72)
        self._map_depth = np.zeros((size, size), dtype=np.float32)
        self._map_mesh = np.zeros((size, size), dtype=np.int32)
        self._silhouette = np.zeros((size, size), dtype=np.float32)
        self._under_depth = np.zeros((under_size, under_size), dtype=np.float32)
        self._under_mesh = np.zeros((under_size, under_size), dtype=np.int32)
        self._under = np.zeros((under_size, under_size), dtype=np.float32)

        self._view = np.zeros(rasterizer.VIEW)
        self._light = np.zeros(rasterizer.LIGHT)
        self._matrix = np.zeros((3, 4))
        tones = linear_to_srgb(np.arange(rasterizer.TONES) / (rasterizer.TONES - 1))
        self._tones = np.round(tones * 255.0).astype(np.uint8)
        self._vertex_room = self._triangle_room = self._mesh_room = 0
        self._grow(1024, 2048, 16)

    def render(
        self,
        camera: Camera,
        meshes: Sequence[Mesh],
        segments: Sequence[Segments] = (),
        *,
        ground: Ground | None = None,
        background: Background | Color | None = None,
        out: NDArray[np.uint8] | None = None,
    ) -> NDArray[np.uint8]:
        """Draw one picture.

        Args:
            camera: the view.
            meshes: surfaces.
            segments: lines; they are hidden by what is in front of them.
            ground: the ground plane; None draws none.
            background: a gradient, or one colour; None is the default gradient.
            out: (H, W, 3) bytes, C-contiguous, to draw into; a new array if None.

        Returns:
            (H, W, 3) uint8, sRGB, the first row at the top.

        Raises:
            ValueError: if `out` does not fit, or a background colour is out of its range.
        """
        picture = self._output(out)
        self._draw(camera, meshes, segments, ground, background, picture)
        return picture

    def render_rgbd(
        self,
        camera: Camera,
        meshes: Sequence[Mesh],
        segments: Sequence[Segments] = (),
        *,
        ground: Ground | None = None,
        background: Background | Color | None = None,
        out: NDArray[np.uint8] | None = None,
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Draw one picture and its depth.

        Args:
            camera: the view.
            meshes: surfaces.
            segments: lines.
            ground: the ground plane.
            background: as in `render`.
            out: as in `render`.

        Returns:
            The picture (H, W, 3), uint8, and the depth (H, W), float32: distance along the optical axis in u, at the
            pixel's centre, of the nearest opaque thing in the pixel; the ground counts however far it has faded, and
            `camera.far` stands where there is nothing. Opaque lines count, what is translucent does not.

        Raises:
            ValueError: as in `render`.
        """
        picture = self._output(out)
        self._draw(camera, meshes, segments, ground, background, picture)
        depth = np.empty((self.height, self.width), dtype=np.float32)
        self._kernels.resolve_depth(
            self.width, self.height, self.supersample, self._depth, self._shown, self._owner, depth
        )
        return picture, depth

    # ------------------------------------------------------------------------------------------------- private

    def _output(self, out: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
        shape = (self.height, self.width, 3)
        if out is None:
            return np.empty(shape, dtype=np.uint8)
        if out.shape != shape or out.dtype != np.uint8 or not (out.flags.c_contiguous and out.flags.writeable):
            raise ValueError(
                f"out must be a writable C-contiguous uint8 array of the shape {shape}, "
                f"got {out.dtype} {out.shape}"
            )
        return out

    def _grow(self, vertices: int, triangles: int, meshes: int) -> None:
        """Make room for a scene; what the buffers held is not kept."""
        if vertices > self._vertex_room:
            self._vertex_room = room = max(vertices, 2 * self._vertex_room)
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
            self._barycentric = np.zeros((room, 9))
            self._keys = np.zeros(room)
            self._order = np.zeros(room, dtype=np.int64)
        if meshes > self._mesh_room:
            self._mesh_room = room = max(meshes, 2 * self._mesh_room)
            self._flags = np.zeros(room, dtype=np.int32)
            self._parameters = np.zeros((room, self._kernels.PARAMETERS))
            self._ranges = np.zeros((room, 2), dtype=np.int32)
            self._others = np.zeros((room, 4))

    def _aim(self, camera: Camera, ground: Ground | None) -> None:
        k, view = self._kernels, self._view
        axes = camera.axes()
        eye = np.asarray(camera.position)
        focal = 0.5 * self.height * self.supersample / math.tan(math.radians(camera.vertical_field_of_view) / 2.0)
        middle_x, middle_y = 0.5 * self.width * self.supersample, 0.5 * self.height * self.supersample
        right, up, forward = axes
        view[k.EYE : k.EYE + 3] = eye
        view[k.RAY_X : k.RAY_X + 3] = right / focal
        view[k.RAY_Y : k.RAY_Y + 3] = -up / focal
        view[k.RAY : k.RAY + 3] = forward - (middle_x * right - middle_y * up) / focal
        view[k.FOCAL] = focal
        view[k.NEAR], view[k.FAR] = camera.near, camera.far
        view[k.GROUND_SEEN] = float(ground is not None and eye[2] > ground.height)
        view[k.GROUND_HEIGHT] = 0.0 if ground is None else ground.height
        self._matrix[:, :3] = np.stack(
            [focal * right + middle_x * forward, middle_y * forward - focal * up, forward]
        )
        self._matrix[:, 3] = -self._matrix[:, :3] @ eye

        light, lighting = self._light, self.lighting
        first, second, third = perpendicular_axes(lighting.key_direction)
        light[k.KEY_DIRECTION : k.KEY_DIRECTION + 3] = third
        light[k.AXIS_U : k.AXIS_U + 3] = first
        light[k.AXIS_V : k.AXIS_V + 3] = second
        light[k.FILL_DIRECTION : k.FILL_DIRECTION + 3] = lighting.fill_direction
        light[k.KEY], light[k.FILL], light[k.AMBIENT] = lighting.key, lighting.fill, lighting.ambient
        light[k.SHADOW], light[k.SOFTNESS] = lighting.shadow, lighting.shadow_softness
        light[k.GROUND_SHADOW] = 0.0 if ground is None else ground.shadow

    def _draw_background(self, camera: Camera, background: Background, ground: Ground | None) -> None:
        """Draw the background, or take it away where the last picture covered it."""
        key = (camera, background, ground)
        columns = self.width * self.supersample
        if key == self._background_key:
            self._kernels.clear(
                self._rows,
                columns,
                self._background_depth,
                self._depth,
                self._shown,
                self._left,
                self._stamp,
                len(self._left) > 0,
            )
            return
        plane = Ground() if ground is None else ground
        numbers = np.concatenate(
            [
                srgb_to_linear((background.top, background.bottom, plane.color, plane.second_color)).ravel(),
                (_STYLES[plane.style], plane.tile, plane.line_width, *plane.center),
                (plane.fade_start, plane.fade_end),
            ]
        )
        self._kernels.draw_background(
            self._view,
            numbers,
            self.width,
            self.height,
            self.supersample,
            self._tones,
            self._background_light,
            self._ground_weight,
            self._background_bytes,
            self._background_depth,
        )
        self._depth[:] = self._background_depth
        self._shown[:] = -1
        self._left[:] = 1.0
        self._stamp[:] = -1
        self._rows[:, 0] = columns
        self._rows[:, 1] = 0
        self._background_key = key

    def _pack_mesh(self, mesh: Mesh, m: int, vertex: int, triangle: int) -> tuple[int, int]:
        """Copy a mesh into the buffers; returns the next free vertex and triangle."""
        k = self._kernels
        vertex_end, triangle_end = vertex + len(mesh.vertices), triangle + len(mesh.triangles)
        self._points[vertex:vertex_end] = mesh.vertices
        np.add(mesh.triangles, np.int32(vertex), out=self._triangles[triangle:triangle_end])
        if mesh.vertex_colors is None:
            self._colors[vertex:vertex_end] = srgb_to_linear(mesh.color)
        else:
            k.to_linear(np.ascontiguousarray(mesh.vertex_colors), vertex, vertex_end, self._colors)

        material = mesh.material
        flags = 0
        if mesh.smooth:
            flags |= k.SMOOTH
            k.vertex_normals(
                self._points, self._triangles, vertex, vertex_end, triangle, triangle_end, self._normals
            )
        if mesh.two_sided or mesh.back_color is not None or (mesh.clip_plane is not None and not mesh.capped):
            flags |= k.DRAW_BACK
        if material.unlit:
            flags |= k.UNLIT
        # What cannot be seen shadows nothing, and what shows no triangle has no extent.
        if mesh.casts_shadow and mesh.opacity > 0.0 and len(mesh.triangles):
            flags |= k.CASTS
        if mesh.receives_shadow:
            flags |= k.RECEIVES
        if mesh.opacity < 1.0:
            flags |= k.TRANSLUCENT
        row = self._parameters[m]
        row[k.OPACITY] = mesh.opacity
        row[k.BACK : k.BACK + 3] = srgb_to_linear(mesh.color if mesh.back_color is None else mesh.back_color)
        row[k.SPECULAR] = material.specular
        row[k.SHININESS] = round(math.log2(material.shininess))
        row[k.METALLIC] = material.metallic
        row[k.SUBSURFACE] = material.subsurface
        row[k.RIM] = material.rim
        if mesh.clip_plane is not None:
            flags |= k.CUT
            if mesh.capped:
                flags |= k.CAPPED
            point, normal = mesh.clip_plane
            row[k.PLANE : k.PLANE + 3] = normal
            row[k.PLANE + 3] = np.dot(point, normal)
        row[k.GRAIN], row[k.MOTTLE] = material.grain, material.mottle
        if mesh.texture is not None and (material.grain > 0.0 or material.mottle > 0.0):
            flags |= k.TEXTURED
            self._texture[vertex:vertex_end] = mesh.texture
        for _ in range(mesh.refine):
            split_end = triangle_end + 4 * (triangle_end - triangle)
            vertex_end = k.refine(
                self._triangles,
                triangle,
                triangle_end,
                self._triangles,
                triangle_end,
                vertex_end,
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

    def _pack_segments(self, lines: Segments, m: int, vertex: int, triangle: int) -> tuple[int, int]:
        """Turn lines into quadrilaterals in the buffers; returns the next free vertex and triangle."""
        k = self._kernels
        count = len(lines.starts)
        ends = []
        for points in (lines.starts, lines.ends):
            placed = np.empty_like(points)
            k.place(np.ascontiguousarray(points), 0, count, self._matrix, placed)
            ends.append(placed)
        pixels = lines.unit == "pixel"
        width = lines.width * (self.supersample if pixels else 1.0)
        vertex_end = k.widen_lines(*ends, width, pixels, self._view[k.FOCAL], self._placed, vertex)
        first = vertex + 4 * np.arange(count, dtype=np.int32)
        triangle_end = triangle + 2 * count
        for corner, (one, other) in enumerate(((0, 0), (1, 2), (2, 3))):
            self._triangles[triangle : triangle + count, corner] = first + one
            self._triangles[triangle + count : triangle_end, corner] = first + other
        self._owner[triangle:triangle_end] = m
        self._ranges[m] = vertex, vertex
        colors = lines.color if lines.colors is None else np.repeat(lines.colors, 4, axis=0)
        self._colors[vertex:vertex_end] = srgb_to_linear(colors)
        self._parameters[m, k.OPACITY] = lines.opacity
        self._flags[m] = k.LINE | k.DRAW_BACK | (k.TRANSLUCENT if lines.opacity < 1.0 else 0)
        return vertex_end, triangle_end

    def _draw(
        self,
        camera: Camera,
        meshes: Sequence[Mesh],
        segments: Sequence[Segments],
        ground: Ground | None,
        background: Background | Color | None,
        picture: NDArray[np.uint8],
    ) -> None:
        k = self._kernels
        if background is None:
            background = Background()
        elif not isinstance(background, Background):
            color = to_color(background, "background")
            background = Background(color, color)
        self._aim(camera, ground)
        self._draw_background(camera, background, ground)

        vertices = sum(4 * len(lines.starts) for lines in segments)
        triangles = sum(2 * len(lines.starts) for lines in segments)
        for mesh in meshes:
            # Splitting adds 3 vertices a triangle, then 12; its input and its output need room at once.
            vertices += len(mesh.vertices) + (0, 3, 15)[mesh.refine] * len(mesh.triangles)
            triangles += (1, 5, 20)[mesh.refine] * len(mesh.triangles)
        self._grow(vertices, triangles, len(meshes) + len(segments))
        vertex = triangle = 0
        starts = []
        for m, mesh in enumerate(meshes):
            starts.append(triangle)
            vertex, triangle = self._pack_mesh(mesh, m, vertex, triangle)
        k.place(self._points, 0, vertex, self._matrix, self._placed)
        for m, lines in enumerate(segments, start=len(meshes)):
            starts.append(triangle)
            vertex, triangle = self._pack_segments(lines, m, vertex, triangle)
        count = len(starts)
        starts.append(triangle)

        columns, lines_of_samples = self.width * self.supersample, self.height * self.supersample
        k.cast_shadows(
            self._points,
            self._light_space,
            self._triangles,
            self._owner,
            triangle,
            count,
            self._flags,
            self._parameters,
            self._ranges,
            self._view,
            self._light,
            self._map_depth,
            self._map_mesh,
            self._silhouette,
            self._under_depth,
            self._under_mesh,
            self._under,
            self._others,
        )
        k.draw_opaque(
            self._points,
            self._placed,
            self._triangles,
            self._owner,
            triangle,
            self._flags,
            self._parameters,
            self._view,
            columns,
            lines_of_samples,
            self._depth,
            self._shown,
            self._rows,
            self._barycentric,
        )
        for m in np.flatnonzero(self._flags[:count] & k.CAPPED).tolist():
            if not len(self._inside):
                self._inside = np.zeros(columns * lines_of_samples, dtype=np.int32)
            k.draw_cap(
                self._points,
                self._placed,
                self._triangles,
                starts[m],
                starts[m + 1],
                m,
                self._parameters,
                self._view,
                columns,
                lines_of_samples,
                self._depth,
                self._shown,
                self._rows,
                self._inside,
            )
        scene = (
            self._points,
            self._triangles,
            self._owner,
            self._barycentric,
            self._normals,
            self._colors,
            self._texture,
            self._flags,
            self._parameters,
            self._view,
            self._light,
            self._map_depth,
            self._map_mesh,
            self._others,
        )
        translucent = bool(np.any(self._flags[:count] & k.TRANSLUCENT))
        if translucent:
            if not len(self._left):
                self._left = np.ones(columns * lines_of_samples, dtype=np.float32)
                self._stamp = np.full(columns * lines_of_samples, -1, dtype=np.int32)
                self._total = np.zeros((self.height, self.width, 3), dtype=np.float32)
            ordered = k.sort_translucent(
                self._placed, self._triangles, self._owner, triangle, self._flags, self._keys, self._order
            )
            k.draw_translucent(
                self._order,
                ordered,
                self._placed,
                columns,
                lines_of_samples,
                self.supersample,
                self._depth,
                self._left,
                self._stamp,
                self._rows,
                self._total,
                *scene,
            )
        picture[:] = self._background_bytes
        k.resolve(
            self.width,
            self.height,
            self.supersample,
            self._matrix,
            self._tones,
            self._shown,
            self._left,
            self._rows,
            self._total,
            translucent,
            self._background_light,
            self._ground_weight,
            self._silhouette,
            self._under,
            picture,
            *scene,
        )
