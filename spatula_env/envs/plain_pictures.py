"""Plain pictures of worlds, for agents: all worlds in one call, with no object for a world."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spatula_env.render.moment import Moments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.arrays import FloatArray, IntArray
    from spatula_env.envs.episodes import Episodes
    from spatula_env.render.plain_view import PlainView


class PlainPictures:
    """Draws the worlds of some episodes as a camera in the room sees them, in the plain style.

    The view is made for the first picture, so that it costs nothing if no picture is ever drawn.
    """

    def __init__(self, episodes: Episodes, width: int, height: int) -> None:
        """Store what to draw.

        Args:
            episodes: The episodes whose worlds are drawn.
            width: Width of a picture [pixels].
            height: Height of a picture [pixels].
        """
        self._episodes = episodes
        self._size = (width, height)
        self._view: PlainView | None = None

    def draw(self, worlds: IntArray, *, depth: bool = True) -> tuple[NDArray[np.uint8], NDArray[np.float32] | None]:
        """Draw some worlds (n,): organ with dyed patches, tools and ground.

        Args:
            worlds: The worlds.
            depth: Whether to return depth as well.

        Returns:
            Pictures (n, height, width, 3); and (n, height, width), if asked for, the distance along the optical axis of
            what is nearest in the middle of each pixel [m], or that of the camera's far plane where there is nothing.

        Raises:
            ValueError: If no episode has begun, or the size is not valid for a picture.
        """
        view = self.view
        pictures, depths = view.draw(self.moments(worlds), depth=depth, slots=worlds)
        if depths is not None:
            depths *= np.float32(self._episodes.workspace.length)
        return pictures, depths

    @property
    def view(self) -> PlainView:
        """The view, whose camera has the scene of all worlds in the picture."""
        if self._view is None:
            from spatula_env.render.plain_view import PlainView

            physics = self._episodes.worlds
            self._view = PlainView(physics.scene, physics.triangles, *self._size)
        return self._view

    def moments(self, worlds: IntArray) -> Moments:
        """The visible state of worlds (n,), in the frame that `EpisodePictures.moments` explains."""
        episodes = self._episodes
        situation, workspace = episodes.situation, episodes.workspace
        if situation is None:
            raise ValueError("there is nothing to draw before an episode has begun")
        return Moments(
            # All nodes together are large enough for a copy of them to cost time.
            nodes=situation.nodes if episodes.are_all(worlds) else situation.nodes[worlds],
            tool_positions=situation.tool_positions[worlds],
            tool_orientations=situation.tool_orientations[worlds],
            tool_scales=situation.tool_scale[worlds],
            ground_heights=self._ground_heights(worlds),
            patches=episodes.patches(worlds),
            origin=workspace.center,
            unit=1.0 / workspace.length,
        )

    def _ground_heights(self, worlds: IntArray) -> FloatArray | None:
        """Heights of the ground (n,) [u]; None if there is none."""
        episodes = self._episodes
        if episodes.scene.ground is None:
            return None
        lowest = np.zeros((len(worlds), 1, 3))
        lowest[:, 0, 2] = episodes.scene.ground.height
        heights: FloatArray = episodes.workspace.to_scene(episodes.frames.points_from_scene(lowest, worlds))[:, 0, 2]
        return heights
