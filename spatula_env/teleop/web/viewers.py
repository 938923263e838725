"""Per-page settings of all open pages: camera, and dark or light colours."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.render.viewpoints import Viewpoint, fit_camera
from spatula_env.teleop.device import FloatArray
from spatula_env.teleop.web.panel import Panel, theme

if TYPE_CHECKING:
    from spatula_env.render.camera import Camera

NEAR, FAR = 0.1, 200.0
"""Near and far plane of the camera [u]."""
FOG = (1.3, 4.0)
"""Distances at which the ground begins to fade and at which it has vanished, relative to the distance from the camera
to the farthest thing to be seen: nothing to be seen fades."""
LIGHT_SKY, DARK_SKY = (255, 255, 255), (20, 20, 20)
"""Colours to which the ground fades: viser's backgrounds."""
LEAST_ASPECT, GREATEST_ASPECT = 0.4, 2.5
"""Range of aspect ratios of a page in which everything is guaranteed to be in view."""
ASPECT = 1.25
"""Aspect ratio of a view before the page has reported it."""
SETTLING = 0.5
"""If a page's camera still differs this long after it was set, its user has moved it [s]."""
DARK = "Dark colours"
"""Label of the switch, which the page's script clicks if the system uses dark colours."""


@dataclass
class _Viewer:
    client: Any
    dark: bool = False
    moved: bool = False
    aspect: float = ASPECT
    given: Camera | None = None
    when: float = -math.inf


class Viewers:
    """All open pages. All methods may be called from any thread."""

    def __init__(self, server: Any, panel: Panel) -> None:
        """Handle the pages that are open and those that will be opened.

        Args:
            server: viser's server.
            panel: Panel that gets a switch for dark colours, which each page has for itself.
        """
        self._server, self._panel = server, panel
        self._lock = threading.RLock()
        self._viewers: dict[int, _Viewer] = {}
        self._points: FloatArray | None = None
        self._viewpoint: Viewpoint | None = None
        server.on_client_connect(self._welcome)
        server.on_client_disconnect(self._leave)

    def aim(self, points: FloatArray, viewpoint: Viewpoint, *, anew: bool = False) -> None:
        """Set the first view.

        Pages whose users have moved the camera keep their view.

        points: (P, 3) points to be seen [u].
            points: (P, 3) what is to be seen [u].
            viewpoint: Direction to look from.
            anew: Whether to set it on all pages, because the scene is a new one.
        """
        with self._lock:
            self._points, self._viewpoint = points, viewpoint
            camera = fit_camera(points, viewpoint, ASPECT)
            first = self._server.initial_camera
            first.position, first.look_at, first.up = camera.position, camera.target, camera.up
            first.fov, first.near, first.far = math.radians(camera.vertical_field_of_view), NEAR, FAR
            if anew:
                self._server.scene.configure_fog(*_fog(camera, points), color=LIGHT_SKY)
            for viewer in self._viewers.values():
                if anew or not viewer.moved:
                    self._look(viewer)
                else:
                    self._color(viewer)

    def look(self, client: Any) -> None:
        """Return to the first view on one page.

        Args:
            client: viser's client.
        """
        with self._lock:
            viewer = self._viewers.get(client.client_id)
            if viewer is not None:
                self._look(viewer)

    # The following are called in viser's thread.

    async def _welcome(self, client: Any) -> None:
        with self._lock:
            viewer = self._viewers[client.client_id] = _Viewer(client)
            with self._panel.view:
                switch = client.gui.add_checkbox(DARK, False)
            self._look(viewer)

        async def switched(_: Any) -> None:
            with self._lock:
                viewer.dark = bool(switch.value)
                theme(client.gui, dark=viewer.dark)
                self._color(viewer)

        async def moved(camera: Any) -> None:
            self._moved(viewer, camera)

        switch.on_update(switched)
        client.camera.on_update(moved)

    async def _leave(self, client: Any) -> None:
        with self._lock:
            self._viewers.pop(client.client_id, None)

    def _moved(self, viewer: _Viewer, camera: Any) -> None:
        with self._lock:
            given = viewer.given
            if given is None or viewer.moved:
                return
            if abs(_aspect(camera) - viewer.aspect) > 0.01 * viewer.aspect:
                # The size has changed, for example because a panel was opened: fit everything into the view again.
                self._look(viewer)
                return
            away = 1e-2 * math.dist(given.position, given.target)
            elsewhere = max(math.dist(camera.position, given.position), math.dist(camera.look_at, given.target)) > away
            viewer.moved = elsewhere and time.monotonic() > viewer.when + SETTLING

    def _look(self, viewer: _Viewer) -> None:
        if self._points is None or self._viewpoint is None:
            return
        handle = viewer.client.camera
        viewer.aspect = _aspect(handle)
        aspect = min(max(viewer.aspect, LEAST_ASPECT), GREATEST_ASPECT)
        viewer.given = camera = fit_camera(self._points, self._viewpoint, aspect)
        viewer.moved, viewer.when = False, time.monotonic()
        with viewer.client.atomic():
            # In this order: viser refuses an up direction parallel to the view, which a user who looks down may have.
            handle.position, handle.look_at = camera.position, camera.target
            handle.up_direction, handle.fov = camera.up, math.radians(camera.vertical_field_of_view)
        self._color(viewer)

    def _color(self, viewer: _Viewer) -> None:
        if viewer.given is not None and self._points is not None:
            near, far = _fog(viewer.given, self._points)
            viewer.client.scene.configure_fog(near, far, color=DARK_SKY if viewer.dark else LIGHT_SKY)


def _fog(camera: Camera, points: FloatArray) -> tuple[float, float]:
    away = float(np.linalg.norm(points - camera.position, axis=1).max())
    return FOG[0] * away, FOG[1] * away


def _aspect(camera: Any) -> float:
    """Width over height of a page's view."""
    width, height = float(camera.image_width), float(camera.image_height)
    return width / height if width > 0.0 and height > 0.0 and np.isfinite(width / height) else ASPECT
