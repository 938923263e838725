"""Pictures of recorded states, drawn without physics."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spatula_env.data.episode import STATE
from spatula_env.data.layout import Layout
from spatula_env.render.moment import Moment

if TYPE_CHECKING:
    from spatula_env.scenes import Scene


def recorded_scene(layout: Layout) -> Scene:
    """The scene that a dataset was recorded in.

    Raises:
        ValueError: If the dataset does not say, or there is no such scene any more.
    """
    from spatula_env import scenes

    # Only scenes of this package: a file must not be able to name code that is then run.
    maker = getattr(scenes, layout.scene, None) if layout.scene in scenes.__all__ else None
    if not callable(maker):
        raise ValueError(f"the dataset must name a scene of spatula_env.scenes, got {layout.scene!r}")
    scene: Scene = maker()
    return scene


def scene_triangles(scene: Scene) -> NDArray[np.int32]:
    """(T, 3) triangles of all organs, with nodes in the recorded order."""
    starts = np.cumsum([0, *(len(placed.organ.vertices) for placed in scene.organs)])
    rows = [placed.organ.triangles + start for placed, start in zip(scene.organs, starts, strict=False)]
    return np.concatenate(rows).astype(np.int32)


def recorded_moments(episode: Any) -> Iterator[Moment]:
    """Iterate over the visible state, organ and tools, at the reset and after every step of an episode.

    Args:
        episode: An episode from Minari.

    Raises:
        ValueError: If it was recorded without states.
    """
    infos = episode.infos or {}
    if STATE not in infos:
        raise ValueError("the episode was recorded without states: there is nothing to draw")
    drawn = infos.get("randomization", {}).get("tool_size")
    scale = 1.0 if drawn is None else float(drawn[0])
    for nodes, tools in zip(infos[STATE]["nodes"], infos[STATE]["tools"], strict=True):
        yield Moment(nodes, tools[:, :3], tools[:, 3:], tool_scale=scale)


class StatePainter:
    """Draws recorded states.

    Attributes:
        size: (height, width) of the pictures.
    """

    def __init__(self, layout: Layout, height: int, width: int) -> None:
        """Make the recorded scene ready to be drawn.

        Args:
            layout: Layout of the dataset.
            height: Height of the pictures [pixels].
            width: Width of the pictures [pixels].

        Raises:
            ValueError: If the dataset does not say in which scene it was recorded.
        """
        from spatula_env.render.scene_view import SceneView

        self.size = (height, width)
        scene = recorded_scene(layout)
        self._view = SceneView(scene, scene_triangles(scene), width, height)

    def draw(self, moment: Moment) -> NDArray[np.uint8]:
        """The picture (height, width, 3) of a moment."""
        return np.array(self._view.draw(moment))
