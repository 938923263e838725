"""Pictures of the worlds that episodes run in."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from spatula_env.envs.episodes import Episodes
    from spatula_env.render.scene_view import SceneView


class EpisodePictures:
    """Draws the worlds of some episodes, one after the other, with one view."""

    def __init__(self, episodes: Episodes, width: int, height: int) -> None:
        """Remember what to draw; meshes are prepared when the first picture is drawn.

        Args:
            episodes: Whose worlds.
            width: Of a picture [pixels].
            height: Of a picture [pixels].
        """
        self._episodes = episodes
        self._size = (width, height)
        self._view: SceneView | None = None

    def draw(self) -> tuple[NDArray[np.uint8], ...]:
        """W pictures (height, width, 3): the organ, the tool, the force on it, and the goal.

        Raises:
            ValueError: If the size is not that of a picture.
        """
        episodes = self._episodes
        worlds = episodes.worlds
        if self._view is None:
            from spatula_env.render.scene_view import SceneView

            self._view = SceneView(worlds.scene, worlds.triangles, *self._size)
        view = self._view
        organs, positions, orientations = worlds.nodes, worlds.tool_positions[:, 0], worlds.tool_orientations[:, 0]
        return tuple(
            view.draw(
                # Where physics has diverged there is nothing to see but the tool.
                np.nan_to_num(nodes, nan=0.0, posinf=0.0, neginf=0.0),
                position,
                orientation,
                force=force,
                targets=episodes.workspace.to_scene(episodes.task.target_points(goal)),
            )
            for nodes, position, orientation, force, goal in zip(
                organs, positions, orientations, episodes.forces, episodes.goals, strict=True
            )
        )
