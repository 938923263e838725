"""Pictures as parts of observations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from spatula_env.envs.pictures import EpisodePictures

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from spatula_env.arrays import IntArray
    from spatula_env.envs.episodes import Episodes, Pictures


def observed_pictures(episodes: Episodes) -> Pictures:
    """Make the function that draws the observed pictures of some episodes; see `Pictures`.

    Args:
        episodes: The episodes.
    """
    height, width = episodes.settings.observation.image_size
    pictures = EpisodePictures(episodes, width, height)

    def draw(worlds: IntArray) -> Mapping[str, NDArray[Any]]:
        images, depths = pictures.rgbd(worlds.tolist())
        return {"image": images, "depth": depths[..., None]}

    return draw
