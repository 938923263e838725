"""Drawing of a composition with OpenGL 3.3, in the current context."""

from __future__ import annotations

import ctypes
import math

import numpy as np
from numpy.typing import NDArray
from pyglet import gl
from pyglet.graphics.shader import Shader, ShaderProgram

from spatula_env.arrays import FloatArray
from spatula_env.render.aiming import WRAPS
from spatula_env.render.camera import Camera
from spatula_env.render.display_surface import vertex_normals
from spatula_env.render.primitives import Background, GroundPlane, Lighting, Mesh, perpendicular_axes
from spatula_env.render.scene_model import Composition
from spatula_env.render.shaders import FRAGMENT, SHADOW_FRAGMENT, VERTEX

Singles = NDArray[np.float32]

MAP_SIZE = 1024
"""Texels along a side of the shadow map."""

HIDDEN_OPACITY = 0.35
"""Opacity with which hidden parts of marks shine through."""

INPUTS = ("place", "normal", "color", "mark")
"""Inputs of the vertex shader, three numbers each."""


class GLPainter:
    """Owns shaders, buffers and the shadow map.

    All of it is freed with the context.
    """

    def __init__(self) -> None:
        """Compile the shaders."""
        vertex = Shader(VERTEX.lstrip(), "vertex")
        self._program = ShaderProgram(vertex, Shader(FRAGMENT.lstrip(), "fragment"))
        self._shadow_program = ShaderProgram(vertex, Shader(SHADOW_FRAGMENT.lstrip(), "fragment"))
        self._lighting, self._background = Lighting(), Background()
        self._buffer, self._arrays = gl.GLuint(), [gl.GLuint(), gl.GLuint()]
        gl.glGenBuffers(1, ctypes.byref(self._buffer))
        gl.glBindBuffer(gl.GL_ARRAY_BUFFER, self._buffer)
        for array, program in zip(self._arrays, (self._program, self._shadow_program), strict=True):
            gl.glGenVertexArrays(1, ctypes.byref(array))
            gl.glBindVertexArray(array)
            for row, name in enumerate(INPUTS):
                # The shadow program does not use all of them.
                if name in program.attributes:
                    location = program.attributes[name]["location"]
                    gl.glEnableVertexAttribArray(location)
                    gl.glVertexAttribPointer(
                        location, 3, gl.GL_FLOAT, gl.GL_FALSE, 4 * 3 * len(INPUTS), ctypes.c_void_p(4 * 3 * row)
                    )
        self._texture, self._target = gl.GLuint(), gl.GLuint()
        gl.glGenTextures(1, ctypes.byref(self._texture))
        gl.glBindTexture(gl.GL_TEXTURE_2D, self._texture)
        gl.glTexImage2D(
            gl.GL_TEXTURE_2D,
            0,
            gl.GL_DEPTH_COMPONENT24,
            MAP_SIZE,
            MAP_SIZE,
            0,
            gl.GL_DEPTH_COMPONENT,
            gl.GL_FLOAT,
            None,
        )
        for parameter, value in (
            (gl.GL_TEXTURE_MIN_FILTER, gl.GL_NEAREST),
            (gl.GL_TEXTURE_MAG_FILTER, gl.GL_NEAREST),
            (gl.GL_TEXTURE_WRAP_S, gl.GL_CLAMP_TO_EDGE),
            (gl.GL_TEXTURE_WRAP_T, gl.GL_CLAMP_TO_EDGE),
        ):
            gl.glTexParameteri(gl.GL_TEXTURE_2D, parameter, value)
        gl.glGenFramebuffers(1, ctypes.byref(self._target))
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self._target)
        gl.glFramebufferTexture2D(gl.GL_FRAMEBUFFER, gl.GL_DEPTH_ATTACHMENT, gl.GL_TEXTURE_2D, self._texture, 0)
        gl.glDrawBuffer(gl.GL_NONE)
        gl.glReadBuffer(gl.GL_NONE)
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, 0)

    def draw(self, composition: Composition, camera: Camera, width: int, height: int) -> None:
        """Draw into the window.

        Args:
            composition: What to draw.
            camera: The view.
            width: Width of the window [pixels].
            height: Height of the window [pixels].
        """
        drawn = composition.meshes + composition.marks
        ground = composition.ground
        blocks = [_corners(mesh) for mesh in drawn]
        extras = [_BACKDROP] if ground is None else [_BACKDROP, _ground_corners(ground)]
        starts = np.cumsum([0] + [len(block) for block in blocks + extras])
        data = np.concatenate(blocks + extras)
        gl.glBindBuffer(gl.GL_ARRAY_BUFFER, self._buffer)
        gl.glBufferData(gl.GL_ARRAY_BUFFER, data.nbytes, data.ctypes.data_as(ctypes.c_void_p), gl.GL_STREAM_DRAW)

        casters = [i for i, mesh in enumerate(drawn) if mesh.casts_shadow and len(blocks[i])]
        to_light = self._draw_shadows(casters, starts, blocks)

        gl.glViewport(0, 0, width, height)
        gl.glBindVertexArray(self._arrays[0])
        gl.glClearColor(1.0, 1.0, 1.0, 1.0)
        gl.glClear(gl.GL_COLOR_BUFFER_BIT | gl.GL_DEPTH_BUFFER_BIT)
        gl.glDisable(gl.GL_CULL_FACE)
        gl.glActiveTexture(gl.GL_TEXTURE0)
        gl.glBindTexture(gl.GL_TEXTURE_2D, self._texture)
        program, lighting = self._program, self._lighting
        program.use()
        plane = GroundPlane() if ground is None else ground
        for name, value in {
            "eye": camera.position,
            "key_direction": lighting.key_direction,
            "fill_direction": lighting.fill_direction,
            "strengths": (lighting.key, lighting.fill, lighting.ambient),
            "ground_height": plane.height if ground is not None else -1e6,
            "ground_grid": (*plane.center, plane.tile, plane.line_width),
            "ground_fade": (plane.fade_start, plane.fade_end),
            "ground_color": plane.color,
            "line_color": plane.second_color,
            "top_color": self._background.top,
            "bottom_color": self._background.bottom,
            "picture": (float(width), float(height)),
            "darkness": (lighting.shadow, plane.shadow),
            "to_light": _columns(to_light),
            "light_texel": 1.0 / MAP_SIZE,
            "opacity": 1.0,
        }.items():
            program[name] = value

        gl.glDisable(gl.GL_DEPTH_TEST)
        program["kind"] = 2
        program["to_clip"] = _columns(np.eye(4))
        first = len(blocks)
        gl.glDrawArrays(gl.GL_TRIANGLES, int(starts[first]), len(_BACKDROP))
        gl.glEnable(gl.GL_DEPTH_TEST)
        gl.glDepthFunc(gl.GL_LESS)
        program["to_clip"] = _columns(camera.projection_matrix(width / height) @ camera.view_matrix())
        if ground is not None and camera.position[2] > ground.height:
            program["kind"] = 1
            gl.glDrawArrays(gl.GL_TRIANGLES, int(starts[first + 1]), len(extras[1]))
        program["kind"] = 0
        for i, mesh in enumerate(drawn):
            self._draw_mesh(mesh, int(starts[i]), len(blocks[i]))
        # Hidden parts of the marks shine through.
        gl.glEnable(gl.GL_BLEND)
        gl.glBlendFunc(gl.GL_SRC_ALPHA, gl.GL_ONE_MINUS_SRC_ALPHA)
        gl.glDepthMask(gl.GL_FALSE)
        gl.glDepthFunc(gl.GL_GREATER)
        program["opacity"] = HIDDEN_OPACITY
        for i in range(len(composition.meshes), len(drawn)):
            self._draw_mesh(drawn[i], int(starts[i]), len(blocks[i]))
        gl.glDepthMask(gl.GL_TRUE)
        gl.glDisable(gl.GL_BLEND)
        program.stop()
        gl.glBindVertexArray(0)

    def _draw_mesh(self, mesh: Mesh, start: int, count: int) -> None:
        program, material = self._program, mesh.material
        program["wrap"] = tuple(reach * material.subsurface for reach in WRAPS)
        program["gloss"] = (material.specular, material.shininess, material.rim)
        textured = mesh.texture is not None
        program["finish"] = (
            material.metallic,
            material.grain if textured else 0.0,
            material.mottle if textured else 0.0,
        )
        gl.glDrawArrays(gl.GL_TRIANGLES, start, count)

    def _draw_shadows(self, casters: list[int], starts: NDArray[np.int64], blocks: list[Singles]) -> FloatArray:
        """Draw the shadow map of the key light; returns the matrix from the world to the map's clip space."""
        matrix = np.diag([0.0, 0.0, 0.0, 1.0])
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self._target)
        gl.glViewport(0, 0, MAP_SIZE, MAP_SIZE)
        gl.glClear(gl.GL_DEPTH_BUFFER_BIT)
        if casters:
            frame = np.stack(perpendicular_axes(self._lighting.key_direction))
            points = np.concatenate([blocks[i][:, :3] for i in casters]) @ frame.T
            low, high = points.min(axis=0), points.max(axis=0)
            half = 0.5 * float((high - low).max()) * 1.1 + 0.2
            middle = 0.5 * (low + high)
            # The depth range extends behind all casters, so that it includes the ground.
            matrix[:2, :3] = frame[:2] / half
            matrix[:2, 3] = -middle[:2] / half
            near, far = high[2] + 0.5, low[2] - 4.0 * half
            matrix[2, :3] = -2.0 * frame[2] / (near - far)
            matrix[2, 3] = (near + far) / (near - far)
            gl.glEnable(gl.GL_DEPTH_TEST)
            gl.glDepthFunc(gl.GL_LESS)
            gl.glBindVertexArray(self._arrays[1])
            self._shadow_program.use()
            self._shadow_program["to_clip"] = _columns(matrix)
            gl.glEnable(gl.GL_POLYGON_OFFSET_FILL)
            gl.glPolygonOffset(2.0, 4.0)
            for i in casters:
                gl.glDrawArrays(gl.GL_TRIANGLES, int(starts[i]), len(blocks[i]))
            gl.glDisable(gl.GL_POLYGON_OFFSET_FILL)
            self._shadow_program.stop()
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, 0)
        return matrix


def read_picture(width: int, height: int) -> NDArray[np.uint8]:
    """Read the window's back buffer: (height, width, 3), the first row at the top."""
    data = np.empty((height, width, 3), dtype=np.uint8)
    gl.glPixelStorei(gl.GL_PACK_ALIGNMENT, 1)
    gl.glReadPixels(0, 0, width, height, gl.GL_RGB, gl.GL_UNSIGNED_BYTE, data.ctypes.data_as(ctypes.c_void_p))
    return data[::-1].copy()


def _corners(mesh: Mesh) -> Singles:
    """(3 T, 12) position, normal, colour and texture coordinates of the corners of all triangles."""
    flat = mesh.triangles.reshape(-1)
    data = np.zeros((len(flat), 3 * len(INPUTS)), dtype=np.float32)
    if not len(flat):
        return data
    data[:, 0:3] = mesh.vertices[flat]
    if mesh.smooth:
        data[:, 3:6] = vertex_normals(mesh.vertices, mesh.triangles)[flat]
    else:
        a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
        data[:, 3:6] = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    data[:, 6:9] = mesh.color if mesh.vertex_colors is None else mesh.vertex_colors[flat]
    if mesh.texture is not None:
        data[:, 9:12] = mesh.texture[flat]
    return data


def _ground_corners(ground: GroundPlane) -> Singles:
    """(6, 12) corners of a square that covers the visible ground."""
    x, y = ground.center
    far = ground.fade_end * math.sqrt(2.0)
    around = [(x - far, y - far), (x + far, y - far), (x + far, y + far), (x - far, y + far)]
    data = np.zeros((6, 3 * len(INPUTS)), dtype=np.float32)
    data[:, :3] = [(*around[k], ground.height) for k in (0, 1, 2, 0, 2, 3)]
    return data


def _backdrop() -> Singles:
    data = np.zeros((3, 3 * len(INPUTS)), dtype=np.float32)
    data[:, :2] = [(-1.0, -1.0), (3.0, -1.0), (-1.0, 3.0)]
    data.flags.writeable = False
    return data


_BACKDROP = _backdrop()
"""Corners of one triangle that covers the picture."""


def _columns(matrix: FloatArray) -> tuple[float, ...]:
    """The entries of a matrix (4, 4), column by column, as OpenGL takes them."""
    return tuple(np.asarray(matrix, dtype=np.float64).T.ravel().tolist())
