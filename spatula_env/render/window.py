"""A window that shows an episode; the view can be turned with the mouse."""

from __future__ import annotations

import sys
import time
import weakref
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spatula_env.installing import install_hint
from spatula_env.render.camera import Camera
from spatula_env.render.moment import Moment
from spatula_env.render.orbit import Orbit
from spatula_env.render.scene_model import Composition, SceneModel
from spatula_env.render.viewpoints import default_camera

if TYPE_CHECKING:
    from spatula_env.scenes import Scene

DEGREES_PER_PIXEL = 0.35
"""Angle by which the scene turns for each pixel that the mouse is dragged [degrees]."""

PATIENCE = 1.0 / 60.0
"""Longest time between two checks of mouse and keyboard [s]."""


class Window:
    """Shows one scene, moment after moment, in an OpenGL window.

    Drag with the left button to turn, with the right or the middle one to shift, scroll to move closer; R goes back to
    the first view, Escape closes the window. Once the user has closed it, showing a moment returns at once.
    """

    def __init__(
        self,
        scene: Scene,
        triangles: NDArray[np.int32],
        width: int = 640,
        height: int = 640,
        *,
        frames_per_second: float | None = 20.0,
        camera: Camera | None = None,
        title: str = "spatula_env",
        visible: bool = True,
    ) -> None:
        """Open the window.

        Args:
            scene: The scene with organs and tools.
            triangles: (T, 3) of all organs.
            width: Width of the picture [pixels].
            height: Height of the picture [pixels].
            frames_per_second: Greatest number of moments shown per second; None: no limit.
            camera: The first view; by default one that suits the kind of scene.
            title: Title of the window.
            visible: Whether the window is visible from the start.

        Raises:
            ImportError: If pyglet is not installed.
            RuntimeError: If there is no display, or no OpenGL 3.3 on it.
        """
        self._window, painter = _open(width, height, title, visible)
        # If an environment is garbage-collected without being closed, its window is closed too. At the end of the
        # program the system closes it.
        self._finish = weakref.finalize(self, self._window.close)
        self._finish.atexit = False
        self._painter = painter()
        self._model = SceneModel(scene, triangles)
        self._orbit = Orbit(camera or default_camera(scene, width / height))
        self._period = 0.0 if frames_per_second is None else 1.0 / frames_per_second
        self._last = -np.inf
        self._composition: Composition | None = None
        self._leaving = self._stale = False
        self._closed = False
        self._window.push_handlers(
            on_close=self._on_close,
            on_key_press=self._on_key_press,
            on_mouse_drag=self._on_mouse_drag,
            on_mouse_scroll=self._on_mouse_scroll,
            on_resize=self._on_change,
            on_expose=self._on_change,
        )

    @property
    def closed(self) -> bool:
        """Whether the window is closed, by the user or by the program."""
        return self._closed

    @property
    def camera(self) -> Camera:
        """The view."""
        return self._orbit.camera

    def show(self, moment: Moment) -> None:
        """Show a moment, and return when it is time for the next one; meanwhile the scene can be turned.

        Does nothing if the window is closed.

        Args:
            moment: The state to show.

        Raises:
            ValueError: If an array has a wrong shape.
        """
        if self._closed:
            return
        self._composition = self._model.compose(moment)
        self._draw()
        while True:
            self._listen()
            left = self._last + self._period - time.perf_counter()
            if self._closed or left <= 0.0:
                break
            time.sleep(min(left, PATIENCE))
        self._last = time.perf_counter()

    def listen(self) -> None:
        """Process mouse and keyboard events without waiting. Does nothing if the window is closed."""
        if not self._closed:
            self._listen()

    def picture(self) -> NDArray[np.uint8]:
        """What the window shows: (height, width, 3).

        Raises:
            RuntimeError: If the window is closed, or nothing has been shown yet.
        """
        if self._closed or self._composition is None:
            raise RuntimeError("there is no picture: the window is closed, or nothing has been shown")
        from spatula_env.render.gl_painter import read_picture

        self._draw(flip=False)
        return read_picture(*self._window.get_framebuffer_size())

    def close(self) -> None:
        """Close the window. Closing twice is allowed."""
        if not self._closed:
            self._closed = True
            self._finish()

    def _draw(self, *, flip: bool = True) -> None:
        assert self._composition is not None
        self._window.switch_to()
        self._painter.draw(self._composition, self.camera, *self._window.get_framebuffer_size())
        self._stale = False
        if flip:
            self._window.flip()

    def _listen(self) -> None:
        self._window.switch_to()
        self._window.dispatch_events()
        if self._leaving:
            # Closed only now, not while its events are being dispatched.
            self.close()
        elif self._stale and self._composition is not None:
            self._draw()

    # ------------------------------------------------------------------------------------------------ events
    # A handler that returns True keeps pyglet's default handler from being called.

    def _on_close(self) -> bool:
        self._leaving = True
        return True

    def _on_key_press(self, symbol: int, modifiers: int) -> bool:
        from pyglet.window import key

        if symbol == key.ESCAPE:
            self._leaving = True
        elif symbol == key.R:
            self._orbit.reset()
            self._stale = True
        return True

    def _on_mouse_drag(self, x: float, y: float, right: float, up: float, buttons: int, modifiers: int) -> bool:
        from pyglet.window import mouse

        if buttons & mouse.LEFT:
            self._orbit.turn(DEGREES_PER_PIXEL * right, DEGREES_PER_PIXEL * up)
        else:
            height = self._window.height
            self._orbit.shift(right / height, up / height)
        self._stale = True
        return True

    def _on_mouse_scroll(self, x: float, y: float, sideways: float, steps: float) -> bool:
        self._orbit.move(steps)
        self._stale = True
        return True

    def _on_change(self, *size: int) -> bool:
        self._stale = True
        return True


def _open(width: int, height: int, title: str, visible: bool) -> tuple[Any, Any]:
    """Open a pyglet window and make its context current; returns the window and the class that draws in it."""
    try:
        import pyglet
    except ImportError as error:
        raise ImportError(f"a window needs pyglet: {install_hint('window')}") from error
    if "pyglet.gl" not in sys.modules:
        # Checking for errors after every call takes longer than the calls themselves.
        pyglet.options.debug_gl = False
    try:
        from pyglet.gl import Config
        from pyglet.window import NoSuchConfigException
        from pyglet.window import Window as Pane

        make_config: Any = Config
        options: dict[str, Any] = {"caption": title, "resizable": True, "vsync": False, "visible": visible}
        version: dict[str, Any] = {"major_version": 3, "minor_version": 3, "double_buffer": True, "depth_size": 24}
        try:
            smooth = make_config(sample_buffers=1, samples=4, **version)
            pane = Pane(width, height, config=smooth, **options)
        except NoSuchConfigException:
            pane = Pane(width, height, config=make_config(**version), **options)
    except Exception as error:
        raise RuntimeError(
            "no window with OpenGL 3.3 could be opened: a display is needed (on Linux the variable DISPLAY names it; "
            "without a screen, run under `xvfb-run`), or use render_mode='rgb_array', which needs none; "
            f"pyglet said: {type(error).__name__}: {error}"
        ) from error
    pane.switch_to()
    from spatula_env.render.gl_painter import GLPainter

    return pane, GLPainter
