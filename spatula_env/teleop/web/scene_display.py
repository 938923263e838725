"""Organ, tools and goal in the page's 3D view."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spatula_env.geometry.rotations import multiply, turn
from spatula_env.render.display_surface import DisplaySurface, vertex_normals
from spatula_env.render.palette import HIGHEST_PRESSURE, PRESSURE, STEEL, TISSUE, Color
from spatula_env.render.primitives import perpendicular_axes
from spatula_env.render.scene_model import ROLE_COLORS, Composition, SceneModel
from spatula_env.render.viewpoints import viewpoint_toward
from spatula_env.tasks.marks import Patch, Path, Points, Ring
from spatula_env.teleop.device import FloatArray
from spatula_env.teleop.web.pressure_contours import LEVELS, pressure_contours, pressure_field

if TYPE_CHECKING:
    from spatula_env.envs.spatula_env import SpatulaEnv
    from spatula_env.render.moment import Moment
    from spatula_env.render.primitives import Mesh
    from spatula_env.render.viewpoints import Viewpoint
    from spatula_env.teleop.web.viewers import Viewers

LIFT = 0.006
"""Height of coloured pieces above the organ's surface [u]."""
PATCH_LIFT = 0.004
DYE = 0.85
"""Weight of the dye in the colour of a marked part."""
SHINING = 0.4
"""Opacity of goal marks where they are hidden by something."""
SEEN_THROUGH = 0.45
"""Opacity of a see-through organ."""
GIZMO_SIZE, ARC_SIZE = 0.9, 1.6
"""Size of the handles that drag the tool, and of those that turn it [u]."""
UPSIDE_DOWN = (0.0, 1.0, 0.0, 0.0)
"""An orientation that no tool has. viser sends only changed orientations, and pages keep that of an earlier tool."""
GROUND_SIZE = 400.0
"""Edge length of the ground [u]."""
GROUND: Color = (0.62, 0.66, 0.70)
ROOM_ABOVE = 0.2
"""Share of the workspace above the organ that the first view includes, besides the tools' starting positions."""

Drag = Callable[[FloatArray | None], None]
"""Takes the grip position (3,) to which the mouse drags [u], or the first tool's orientation (4,); None on release."""


class SceneDisplay:
    """Shows one environment; another environment needs another display.

    Everything is in the frame and unit of the scene, without the random placement of an episode.
    """

    def __init__(self, server: Any, viewers: Viewers, env: SpatulaEnv, on_drag: Drag, on_turn: Drag) -> None:
        """Build the scene.

        Args:
            server: viser's server.
            viewers: Aims the pages' cameras.
            env: Environment to show.
            on_drag: Called when the mouse drags the tool.
            on_turn: Called when the mouse turns the tool.
        """
        self._server, self._viewers, self._env = server, viewers, env
        self._on_drag, self._on_turn = on_drag, on_turn
        episodes = env._episodes
        scene, triangles = episodes.worlds.scene, episodes.worlds.triangles
        self._model = SceneModel(scene, triangles)
        nodes = np.concatenate([placed.vertices for placed in scene.organs])
        self._surface = DisplaySurface(nodes, triangles)
        self._count = len(nodes)
        self._contact_nodes = [(np.array(placed.tool.nodes), np.array(placed.tool.normals)) for placed in scene.tools]
        self._shapes = [(np.array(placed.tool.vertices), np.array(placed.tool.triangles)) for placed in scene.tools]
        # Point of the tool that the mouse has grabbed, and the grip's position at that time.
        self._grabbed: FloatArray | None = None
        self._held: FloatArray = np.zeros(3)
        self._on_gizmo = self._on_arc = False
        self._orientation: FloatArray = np.array([0.0, 0.0, 0.0, 1.0])
        self._turned_from = self._orientation
        self._grip = np.zeros(3)
        self._scale = 1.0
        self._patches: list[tuple[Patch, Any, NDArray[np.intp]]] = []
        self._signs: list[Any] = []
        self._ghosts: list[Any] = []
        self._arrows: list[Any] = []
        with server.atomic():
            server.scene.reset()
            self._light_up()
            height = float(nodes[:, 2].min()) if scene.ground is None else scene.ground.height
            self._lay_ground(height, 0.5 * (nodes.min(axis=0) + nodes.max(axis=0)))
            add = server.scene.add_mesh_simple
            self._organ = add("/organ", _single(self._surface.rest), self._surface.triangles, color=_bytes(TISSUE))
            nothing = np.zeros((3, 3), dtype=np.float32), np.zeros((1, 3), dtype=np.uint32)
            colors = PRESSURE(np.array(_middles(LEVELS)), 0.0, HIGHEST_PRESSURE)
            self._contours = [
                add(f"/pressure/{index}", *nothing, color=_bytes(color), cast_shadow=False, visible=False)
                for index, color in enumerate(colors)
            ]
            self._tools = [self._add_tool(index) for index in range(len(self._shapes))]
            self._gizmo = server.scene.add_transform_controls(
                "/grip", scale=GIZMO_SIZE, line_width=3.0, disable_rotations=True, depth_test=False, opacity=0.75
            )
            self._arcs = [self._add_arc(axis) for axis in env.control.layout.rotations]
        self._gizmo.on_update(self._gizmo_moved)
        self.begin(anew=True)

    def begin(self, *, anew: bool = False) -> None:
        """Begin an episode: bring its goal into view.

        Args:
            anew: Whether it is the first episode of this scene.
        """
        self._viewers.aim(*first_view(self._env), anew=anew)

    def set_gizmo(self, visible: bool) -> None:
        """Show or hide the handles that drag the tool along one axis and turn it."""
        for handle in (self._gizmo, *self._arcs):
            handle.visible = visible

    def set_see_through(self, wanted: bool) -> None:
        """Make the organ see-through, or opaque."""
        self._organ.opacity = SEEN_THROUGH if wanted else None

    def show(self, moment: Moment) -> None:
        """Show the state at a moment.

        Args:
            moment: State of the environment.
        """
        with self._server.atomic():
            self._show(moment)
        self._server.flush()

    def _show(self, moment: Moment) -> None:
        points = self._surface.place(np.asarray(moment.nodes))
        normals = vertex_normals(points, self._surface.triangles)
        self._organ.vertices = _single(points)
        positions = np.asarray(moment.tool_positions, dtype=np.float64)
        orientations = np.asarray(moment.tool_orientations, dtype=np.float64)
        self._place_tools(positions, orientations, moment.tool_scale)
        self._color(points, normals, moment, positions, orientations)
        composition = self._model.compose(replace(moment, pressures=None))
        self._point(composition)
        self._dye(points, normals, [mark for mark in moment.marks if isinstance(mark, Patch)])
        self._grip, self._orientation = positions.mean(axis=0), orientations[0]
        if not self._on_gizmo:
            self._gizmo.position = self._grip
        if not self._on_arc:
            for arc in self._arcs:
                arc.position, arc.wxyz = self._grip, (1.0, 0.0, 0.0, 0.0)

    # Parts of the scene.

    def _light_up(self) -> None:
        scene = self._server.scene
        scene.set_up_direction("+z")
        scene.configure_default_lights(enabled=False)
        scene.configure_environment_map("studio", environment_intensity=0.25)
        scene.add_light_directional(
            "/light/key", color=(255, 244, 230), intensity=1.05, cast_shadow=True, position=(-6.0, -4.0, 12.0)
        )
        scene.add_light_hemisphere(
            "/light/room", sky_color=(225, 235, 255), ground_color=(170, 150, 140), intensity=0.5
        )

    def _lay_ground(self, height: float, middle: FloatArray) -> None:
        scene = self._server.scene
        place = (float(middle[0]), float(middle[1]), height)
        half = 0.5 * GROUND_SIZE
        corners = np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])
        scene.add_mesh_simple(
            "/ground",
            _single(corners),
            np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32),
            color=_bytes(GROUND),
            position=(place[0], place[1], place[2] - 0.01),
            cast_shadow=False,
        )

    def _add_tool(self, index: int) -> Any:
        handle = self._server.scene.add_mesh_simple(
            f"/tool/{index}", *_flat(*self._shapes[index]), color=_bytes(STEEL), flat_shading=True, wxyz=UPSIDE_DOWN
        )
        handle.on_drag("left")(self._make_drag(level=False))
        handle.on_drag("left", modifier="shift")(self._make_drag(level=True))
        return handle

    def _place_tools(self, positions: FloatArray, orientations: FloatArray, scale: float) -> None:
        if scale != self._scale:
            self._scale = scale
            for handle, (vertices, triangles) in zip(self._tools, self._shapes, strict=True):
                handle.vertices = _flat(scale * vertices, triangles)[0]
        for handle, position, orientation in zip(self._tools, positions, orientations, strict=True):
            handle.position = position
            handle.wxyz = orientation[[3, 0, 1, 2]]

    def _color(
        self, points: FloatArray, normals: FloatArray, moment: Moment, positions: FloatArray, orientations: FloatArray
    ) -> None:
        """Colour the organ by the pressure on it."""
        field = np.zeros(len(points))
        for tool, pressures in enumerate(moment.pressures or ()):
            nodes, out = self._contact_nodes[tool]
            places = positions[tool] + turn(orientations[tool], moment.tool_scale * nodes)
            felt = pressure_field(points, normals, places, turn(orientations[tool], out), np.asarray(pressures))
            field = np.maximum(field, felt)
        pieces = pressure_contours(points, normals, self._surface.triangles, field, LIFT)
        for contour, piece in zip(self._contours, pieces, strict=True):
            _replace(contour, piece)

    def _point(self, composition: Composition) -> None:
        """Draw forces and goals."""
        arrows = composition.meshes[1 + len(self._tools) :]
        self._arrows = self._draw("/force", self._arrows, arrows)
        self._signs = self._draw("/goal", self._signs, composition.marks)
        # Draw the marks once more, for where they are hidden: the page's script draws these over everything.
        self._ghosts = self._draw("/through", self._ghosts, composition.marks, opacity=SHINING)

    def _draw(self, name: str, handles: list[Any], meshes: list[Mesh], opacity: float | None = None) -> list[Any]:
        add = self._server.scene.add_mesh_simple
        for index, mesh in enumerate(meshes):
            vertices, faces = _single(mesh.vertices), mesh.triangles.astype(np.uint32)
            if index == len(handles):
                color = _bytes(mesh.color)
                look: dict[str, Any] = {"color": color, "cast_shadow": False, "opacity": opacity}
                handles.append(add(f"{name}/{index}", vertices, faces, **look))
            else:
                _replace(handles[index], (vertices, faces))
        for handle in handles[len(meshes) :]:
            _replace(handle, None)
        return handles

    def _dye(self, points: FloatArray, normals: FloatArray, patches: list[Patch]) -> None:
        """Place the dyed patches of the organ that the task marks."""
        same = len(patches) == len(self._patches) and all(
            patch.role == before.role and np.array_equal(patch.nodes, before.nodes)
            for patch, (before, _, _) in zip(patches, self._patches, strict=True)
        )
        if not same:
            for _, handle, _ in self._patches:
                handle.remove()
            self._patches = [(patch, *self._add_patch(index, patch)) for index, patch in enumerate(patches)]
        for _, handle, used in self._patches:
            handle.vertices = _single(points[used] + PATCH_LIFT * normals[used])

    def _add_patch(self, index: int, patch: Patch) -> tuple[Any, NDArray[np.intp]]:
        inside = np.zeros((self._count, 1))
        inside[patch.nodes] = 1.0
        # Up to the midpoints of the edges that leave the patch, where they are split.
        share = self._surface.interpolate(inside)[:, 0]
        chosen = self._surface.triangles[(share[self._surface.triangles] > 0.499).all(axis=1)]
        if len(chosen) == 0:
            chosen = np.zeros((1, 3), dtype=np.int32)
        used, local = np.unique(chosen, return_inverse=True)
        color = _bytes(DYE * np.array(ROLE_COLORS[patch.role]) + (1.0 - DYE) * np.array(TISSUE))
        faces = local.reshape(-1, 3).astype(np.uint32)
        vertices = _single(self._surface.rest[used])
        add = self._server.scene.add_mesh_simple
        return add(f"/patch/{index}", vertices, faces, color=color, cast_shadow=False), used.astype(np.intp)

    def _add_arc(self, axis: str) -> Any:
        """Add a handle that turns the tool about an axis."""
        arc = self._server.scene.add_transform_controls(
            f"/turn/{axis}",
            scale=ARC_SIZE,
            line_width=4.0,
            # viser's arc about an axis lies in the plane of the other two axes.
            active_axes=tuple(each != axis for each in "xyz"),
            disable_axes=True,
            disable_sliders=True,
            depth_test=False,
            opacity=0.9,
            wxyz=UPSIDE_DOWN,
        )
        arc.on_update(self._arc_moved)
        return arc

    # Mouse callbacks, which viser's thread calls in order.

    def _make_drag(self, *, level: bool) -> Any:
        async def drag(event: Any) -> None:
            eye = np.asarray(event.client.camera.position)
            if event.phase == "start":
                self._grabbed = np.array(event.start_position)
                self._held = self._grip.copy()
            if self._grabbed is None:
                return
            if event.phase == "end":
                self._grabbed = None
                self._on_drag(None)
                return
            place = on_drag_plane(eye, np.asarray(event.end_position), self._grabbed, level=level)
            if place is not None:
                self._on_drag(self._held + place - self._grabbed)

        return drag

    async def _gizmo_moved(self, event: Any) -> None:
        self._on_gizmo = event.phase != "end"
        self._on_drag(np.asarray(event.target.position) if self._on_gizmo else None)

    async def _arc_moved(self, event: Any) -> None:
        if not self._on_arc:
            self._turned_from = self._orientation.copy()
        self._on_arc = event.phase != "end"
        turned = np.asarray(event.target.wxyz)[[1, 2, 3, 0]]
        self._on_turn(multiply(turned, self._turned_from) if self._on_arc else None)


def first_view(env: SpatulaEnv) -> tuple[FloatArray, Viewpoint]:
    """Points (P, 3) of the first view [u] and its viewpoint: organ, tools with the room above them, and the goal."""
    scene, workspace, moment = env._episodes.worlds.scene, env.workspace, env.moment
    nodes, triangles = np.asarray(moment.nodes), env._episodes.worlds.triangles
    viewpoint = replace(viewpoint_toward(scene, nodes, triangles, moment.marks), room=0.05)
    seen = [_points_of(mark) for mark in moment.marks if not isinstance(mark, Patch)]
    for placed in scene.organs:
        points = placed.vertices
        low, high = points[:, 2].min(), points[:, 2].max()
        seen.append(points[points[:, 2] >= low + viewpoint.base * (high - low)])
    top = float(workspace.to_scene(ROOM_ABOVE * workspace.high)[2])
    places, orientations = np.atleast_2d(moment.tool_positions), np.atleast_2d(moment.tool_orientations)
    # Of a long blade, include only the working part and the drag handles.
    highest = float(places[:, 2].mean()) + GIZMO_SIZE
    for tool, place, orientation in zip(scene.tools, places, orientations, strict=True):
        corners = turn(orientation, moment.tool_scale * np.asarray(tool.tool.vertices)) + place
        corners[:, 2] = np.minimum(corners[:, 2], max(highest, corners[:, 2].min()))
        seen += [corners, np.column_stack([corners[:, :2], np.full(len(corners), max(top, highest))])]
    return np.concatenate(seen), viewpoint


def _points_of(mark: Ring | Path | Points) -> FloatArray:
    if not isinstance(mark, Ring):
        return np.asarray(mark.points)
    side = mark.radius * np.stack(perpendicular_axes(mark.normal)[:2])
    return np.concatenate([mark.point + side, mark.point - side])


def on_drag_plane(eye: FloatArray, point: FloatArray, grabbed: FloatArray, *, level: bool) -> FloatArray | None:
    """Point to which a mouse drags what it has grabbed.

    Args:
        eye: (3,) position of the camera.
        point: (3,) any point on the line of sight through the mouse.
        grabbed: (3,) point that was grabbed.
        level: Whether to drag at constant height; otherwise in the upright plane that faces the camera.

    Returns:
        (3,) intersection of the line of sight with this plane; None if it is at infinity or behind the camera.
    """
    ray = point - eye
    normal = np.array([0.0, 0.0, 1.0]) if level else np.array([grabbed[0] - eye[0], grabbed[1] - eye[1], 0.0])
    toward = float(ray @ normal)
    size = float(np.linalg.norm(ray) * np.linalg.norm(normal))
    if not abs(toward) > 1e-3 * size:
        return None
    share = float((grabbed - eye) @ normal) / toward
    return eye + share * ray if share > 0.0 else None


def _replace(handle: Any, piece: tuple[Any, Any] | None) -> None:
    if piece is None:
        if handle.visible:
            handle.visible = False
        return
    handle.vertices, handle.faces = _single(piece[0]), piece[1].astype(np.uint32)
    if not handle.visible:
        handle.visible = True


def _single(points: FloatArray) -> Any:
    return np.ascontiguousarray(points, dtype=np.float32)


def _flat(vertices: FloatArray, triangles: Any) -> tuple[Any, Any]:
    """Give each triangle vertices of its own."""
    return _single(vertices[triangles].reshape(-1, 3)), np.arange(3 * len(triangles), dtype=np.uint32).reshape(-1, 3)


def _bytes(color: Any) -> tuple[int, int, int]:
    red, green, blue = (round(255.0 * float(value)) for value in color)
    return red, green, blue


def _middles(levels: tuple[float, ...]) -> list[float]:
    ends = [*levels[1:], HIGHEST_PRESSURE]
    return [0.5 * (low + high) for low, high in zip(levels, ends, strict=True)]
