"""Feature extractors in front of a policy's layers: for pictures, for points, and for vectors.

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
"""Entries of observations that are pictures (height, width, channels), or several of them, one after the other."""

POINTS = ("organ", "tool")
"""Entries that are points (P, 3) in no order that means anything, or several such sets, one after the other."""

CHANNELS = 32
"""Of each layer of convolutions."""

PICTURE_FEATURES, POINT_FEATURES = 128, 64
"""Numbers that are made of all pictures, and of each set of points."""


def policy_class(space: spaces.Space[Any]) -> str:
    """Stable-Baselines3's name of the policy that takes observations of a space."""
    if isinstance(space, spaces.Dict):
        return "MultiInputPolicy"
    return "CnnPolicy" if is_image_space(space) else "MlpPolicy"


def policy_settings(space: spaces.Space[Any]) -> dict[str, Any]:
    """What such a policy is made with, beside the layers that follow: something where there are pictures or points."""
    if not has_pictures_or_points(space):
        return {}
    return {"features_extractor_class": ObservationExtractor, "normalize_images": False}


def has_pictures_or_points(space: spaces.Space[Any]) -> bool:
    """Whether observations of a space have parts that are no vectors."""
    return isinstance(space, spaces.Dict) and any(name in space.spaces for name in (*PICTURES, *POINTS))


def keep_pictures(env: VecEnv) -> VecEnv:
    """An environment of Stable-Baselines3 whose pictures stay as they are, channels last.

    Left to itself Stable-Baselines3 puts the channels of some pictures first, by a wrapper around all others.
    """
    return VecTransposeImage(env, skip=True) if has_pictures_or_points(env.observation_space) else env


def vector_names(space: spaces.Dict) -> list[str]:
    """The entries that are vectors, which running estimates may normalise."""
    return [name for name in space.spaces if name not in (*PICTURES, *POINTS)]


class ObservationExtractor(BaseFeaturesExtractor):
    """Features of a dictionary with pictures or points.

    Pictures of one moment, and of several moments that are shown at once, are the channels of one picture, which goes
    through four layers of convolutions that each halve its edges, so that pictures of any size will do (as in D. Yarats
    et al., "Image Augmentation Is All You Need", ICLR 2021, but for the strides). Points go through two layers each
    by itself, of which the greatest numbers are kept, so that their order does not matter (C. Qi et al., "PointNet",
    CVPR 2017). Vectors are taken as they are.
    """

    def __init__(self, observation_space: spaces.Dict) -> None:
        """Make the layers.

        Args:
            observation_space: Of one world, with pictures as the environments make them: channels last.
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
        # What is in meters, or in 0 to 255, becomes a number of about one.
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
        """(W, channels, height, width) of all pictures."""
        joined = []
        for name in self._pictures:
            picture = observations[name] / self._scales[name]
            # Channels first, and after them the moments if there are several.
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
