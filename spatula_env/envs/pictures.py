"""Pictures of worlds, for people and for agents that use images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spatula_env.render.moment import Moment
from spatula_env.tasks.marks import Mark, Patch, Path, Points, Ring

if TYPE_CHECKING:
    from spatula_env.envs.episodes import Episodes
    from spatula_env.envs.workspace import Workspace
    from spatula_env.render.scene_view import SceneView
    from spatula_env.render.window import Window


class EpisodePictures:
    """Draws the worlds of some episodes in sequence, with one view.

    Views are created on the first picture, so that they cost nothing if no picture is ever drawn.
    """

    def __init__(self, episodes: Episodes, width: int, height: int, frames_per_second: float = 20.0) -> None:
        """Store what to draw.

        Args:
            episodes: The episodes whose worlds are drawn.
            width: Width of a picture [pixels].
            height: Height of a picture [pixels].
            frames_per_second: Greatest frame rate of `show`.
        """
        self._episodes = episodes
        self._size = (width, height)
        self._frames_per_second = frames_per_second
        self._view: SceneView | None = None
        self._sensor: SceneView | None = None
        self._window: Window | None = None

    def draw(self) -> tuple[NDArray[np.uint8], ...]:
        """W pictures (height, width, 3): organ and pressure, tools and the forces on them, and the goal.

        Raises:
            ValueError: If the size is not valid for a picture.
        """
        if self._view is None:
            self._view = self._make_view()
        view = self._view
        return tuple(view.draw(moment) for moment in self.moments())

    def rgbd(self, worlds: Iterable[int] | None = None) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Images of a camera in the room: without arrows, pressure colours and goal, but with a marked patch.

        Args:
            worlds: (n,) worlds to draw; None for all.

        Returns:
            Pictures (n, height, width, 3) and their depth (n, height, width): the distance along the optical axis of
            the nearest surface in each pixel [m], or that of the camera's far plane where there is none.

        Raises:
            ValueError: If the size is not valid for a picture.
        """
        if self._sensor is None:
            # In small pictures, a mesh finer than that of the physics costs time and makes no visible difference.
            self._sensor = self._make_view(levels=0 if max(self._size) <= 160 else None)
        chosen = np.arange(self._episodes.count) if worlds is None else np.fromiter(worlds, dtype=np.int64)
        width, height = self._size
        pictures = np.empty((len(chosen), height, width, 3), dtype=np.uint8)
        depths = np.empty((len(chosen), height, width), dtype=np.float32)
        moments = self.moments(chosen, physical=True)
        for picture, depth, moment in zip(pictures, depths, moments, strict=True):
            _, depth[:] = self._sensor.draw_rgbd(moment, out=picture)
        depths *= np.float32(self._episodes.workspace.length)
        return pictures, depths

    def show(self, world: int = 0) -> None:
        """Show one world in a window, and wait until it is time for the next picture.

        Returns at once if the user has closed the window.

        Args:
            world: Index of the world.

        Raises:
            ImportError: If the packages for windows are not installed.
            RuntimeError: If there is no display to open a window on.
        """
        if self._window is None:
            from spatula_env.render.window import Window

            worlds = self._episodes.worlds
            self._window = Window(
                worlds.scene, worlds.triangles, *self._size, frames_per_second=self._frames_per_second
            )
        if not self._window.closed:
            (moment,) = self.moments([world])
            self._window.show(moment)

    @property
    def closed(self) -> bool:
        """Whether a window was opened and has been closed, by the user or the program."""
        return self._window is not None and self._window.closed

    def close(self) -> None:
        """Close the window, if there is one. Closing twice is allowed."""
        if self._window is not None:
            self._window.close()

    def _make_view(self, levels: int | None = None) -> SceneView:
        from spatula_env.render.scene_view import SceneView

        worlds = self._episodes.worlds
        return SceneView(worlds.scene, worlds.triangles, *self._size, levels=levels)

    def moments(self, chosen: Iterable[int] | None = None, *, physical: bool = False) -> Iterator[Moment]:
        """The visible state of each world; only physical objects if `physical`.

        The camera stands in the room and not on the organ, so that pictures show differences between worlds in the
        organ's place, size and pose. Therefore everything is converted to the workspace frame, and from there to the
        scene without such differences.
        """
        episodes = self._episodes
        situation, workspace, ground = episodes.situation, episodes.workspace, episodes.scene.ground
        if situation is None:
            raise ValueError("there is nothing to draw before an episode has begun")
        pressures = episodes.pressures
        height = None
        for world in range(episodes.count) if chosen is None else chosen:
            marks = episodes.marks(world)
            if physical:
                marks = tuple(mark for mark in marks if isinstance(mark, Patch))
            if ground is not None:
                lowest = episodes.frames.points_from_scene(np.array([[[0.0, 0.0, ground.height]]]), np.array([world]))
                height = float(workspace.to_scene(lowest[0, 0])[2])
            yield Moment(
                # Where physics has diverged, only the tools can be shown.
                nodes=workspace.to_scene(np.nan_to_num(situation.nodes[world], nan=0.0, posinf=0.0, neginf=0.0)),
                tool_positions=workspace.to_scene(situation.tool_positions[world]),
                tool_orientations=situation.tool_orientations[world],
                forces=None if physical else situation.contact_forces[world],
                pressures=None if physical else [of_tool[world] for of_tool in pressures],
                marks=tuple(in_scene(mark, workspace) for mark in marks),
                tool_scale=float(situation.tool_scale[world]),
                ground_height=height,
            )


def as_frame_rate(frequency: float) -> int | float:
    """Frame rate for a control frequency [Hz]: an int if it is integral, as most libraries expect."""
    return int(frequency) if frequency == int(frequency) else float(frequency)


def in_scene(mark: Mark, workspace: Workspace) -> Mark:
    """Convert a mark to the frame and unit of the scene."""
    if isinstance(mark, Ring):
        return replace(mark, point=workspace.to_scene(mark.point), radius=mark.radius / workspace.length)
    if isinstance(mark, Path | Points):
        return replace(mark, points=workspace.to_scene(mark.points))
    return mark
