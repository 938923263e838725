"""Feature extractors in front of a policy's layers: for pictures, point clouds and vectors.

Needs the extra "train".
"""

from __future__ import annotations

import math
from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv, VecTransposeImage
from torch import nn

PICTURES = ("image", "depth")
"""Entries of observations that are pictures (height, width, channels), possibly several stacked."""

POINTS = ("organ", "tool")
"""Entries of observations that are unordered points (P, 3), possibly several sets stacked."""

CHANNELS = 32
"""Number of channels of each convolutional layer."""

PICTURE_FEATURES, POINT_FEATURES = 128, 64
"""Number of features from all pictures together, and from each set of points."""


def policy_class(space: spaces.Space[Any]) -> str:
    """Stable-Baselines3's policy name for an observation space."""
    if isinstance(space, spaces.Dict):
        return "MultiInputPolicy"
    return "CnnPolicy" if is_image_space(space) else "MlpPolicy"


def policy_settings(space: spaces.Space[Any]) -> dict[str, Any]:
    """Arguments of that policy besides the layers that follow; empty without pictures or points."""
    if not has_pictures_or_points(space):
        return {}
    return {"features_extractor_class": ObservationExtractor, "normalize_images": False}


def has_pictures_or_points(space: spaces.Space[Any]) -> bool:
    """Whether an observation space has entries that are not vectors."""
    return isinstance(space, spaces.Dict) and any(name in space.spaces for name in (*PICTURES, *POINTS))


def keep_pictures(env: VecEnv) -> VecEnv:
    """Keep the channels of pictures last in an environment for Stable-Baselines3.

    Otherwise, Stable-Baselines3 moves the channels of some pictures to the front, by an outermost wrapper.
    """
    return VecTransposeImage(env, skip=True) if has_pictures_or_points(env.observation_space) else env


def vector_names(space: spaces.Dict) -> list[str]:
    """Names of the entries that are vectors, which running estimates may normalise."""
    return [name for name in space.spaces if name not in (*PICTURES, *POINTS)]


class ObservationExtractor(BaseFeaturesExtractor):
    """Features of a dictionary observation with pictures or points.

    Pictures of one or several stacked moments become the channels of a single picture, which passes four convolutional
    layers that each halve its edges, so that pictures of any size work (as in D. Yarats et al., "Image Augmentation Is
    All You Need", ICLR 2021, except for the strides). Points pass two layers individually, followed by a maximum over
    the points, so that their order does not matter (C. Qi et al., "PointNet", CVPR 2017). Vectors are used unchanged.
    """

    def __init__(self, observation_space: spaces.Dict) -> None:
        """Make the layers.

        Args:
            observation_space: Space of one world's observations, with pictures as the environments make them: channels
                last.
        """
        entries = observation_space.spaces
        self._pictures = [name for name in PICTURES if name in entries]
        self._points = [name for name in POINTS if name in entries]
        self._vectors = vector_names(observation_space)
        sizes = [math.prod(entries[name].shape or ()) for name in self._vectors]
        points = {name: _boxed(entries[name]) for name in self._points}
        moments = {name: math.prod(box.shape[:-2]) for name, box in points.items()}
        total = sum(sizes) + POINT_FEATURES * sum(moments.values()) + (PICTURE_FEATURES if self._pictures else 0)
        super().__init__(observation_space, total)
        # Scale metres, or values of 0 to 255, to numbers of about one.
        self._scales = {name: float(_boxed(entries[name]).high.max()) for name in (*self._pictures, *self._points)}
        self.of_points = nn.ModuleDict({name: _point_layers(box.shape[-1]) for name, box in points.items()})
        self.of_pictures: nn.Module = nn.Identity()
        if self._pictures:
            with torch.no_grad():
                sample = {name: torch.zeros((1, *(entries[name].shape or ()))) for name in self._pictures}
                picture = self._joined(sample)
                convolutions = _convolutions(picture.shape[1])
                size = convolutions(picture).shape[1]
            self.of_pictures = nn.Sequential(convolutions, nn.Linear(size, PICTURE_FEATURES), nn.ReLU())

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """(W, features) of the observations of W worlds."""
        found = [observations[name].flatten(start_dim=1) for name in self._vectors]
        for name in self._points:
            features = self.of_points[name](observations[name] / self._scales[name])
            found.append(features.max(dim=-2).values.flatten(start_dim=1))
        if self._pictures:
            found.append(self.of_pictures(self._joined(observations)))
        return torch.cat(found, dim=1)

    def _joined(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """(W, channels, height, width) all pictures stacked."""
        joined = []
        for name in self._pictures:
            picture = observations[name] / self._scales[name]
            # Move the channels to the front; stacked moments, if any, come after them.
            channels = picture.movedim(-1, 1)
            joined.append(channels.reshape(len(picture), -1, *picture.shape[-3:-1]))
        return torch.cat(joined, dim=1)


def _convolutions(channels: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for before in (channels, CHANNELS, CHANNELS, CHANNELS):
        layers += [nn.Conv2d(before, CHANNELS, kernel_size=3, stride=2, padding=1), nn.ReLU()]
    return nn.Sequential(*layers, nn.Flatten())


def _point_layers(size: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(size, POINT_FEATURES), nn.ReLU(), nn.Linear(POINT_FEATURES, POINT_FEATURES), nn.ReLU()
    )


def _boxed(space: spaces.Space[Any]) -> spaces.Box:
    assert isinstance(space, spaces.Box)
    return space
