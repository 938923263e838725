"""Pictures as parts of observations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from spatula_env.envs.pictures import EpisodePictures
from spatula_env.envs.plain_pictures import PlainPictures

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
    settings, depth = episodes.settings.observation, episodes.observation_builder.needs_depth
    height, width = settings.image_size
    plain = PlainPictures(episodes, width, height)
    full = EpisodePictures(episodes, width, height)

    def draw(worlds: IntArray) -> Mapping[str, NDArray[Any]]:
        if settings.picture_style == "plain":
            images, depths = plain.draw(worlds, depth=depth)
        else:
            images, depths = full.rgbd(worlds.tolist())
        return {"image": images} if depths is None else {"image": images, "depth": depths[..., None]}

    return draw
