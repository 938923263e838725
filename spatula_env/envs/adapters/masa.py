"""Labels for MASA-Safe-RL: a set of names of the conditions that hold in each step.

MASA-Safe-RL (`pip install masa-safe-rl`) need not be installed for this module. Interface: `LabelledEnv` and `LabelFn`
of masa.common, which derive labels from observations; here they are derived from info, where pressures are exact.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
from gymnasium.utils import RecordConstructorArgs

LABELS: Mapping[str, str] = {
    "success": "is_success",
    "within_tolerance": "within_tolerance",
    "contact": "force",
    "cost": "cost",
    "dose": "dose",
    "violation": "violation",
    "damage": "is_damaged",
}
"""The labels, and for each the entry of info that must not be zero: contact is any force, cost a force that grows too
fast or a pressure beyond what the goal requires, dose a pressure above 2.67 kPa, violation one above 4.0 kPa, damage
that the episode has exceeded `damage_limit` or another limit."""


def labels_of(info: Mapping[str, Any]) -> set[str]:
    """The labels in `LABELS` that hold.

    Args:
        info: Info of a reset or a step of one environment.
    """
    return {label for label, name in LABELS.items() if info[name]}


class LabelsWrapper(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Puts a set of labels into `info["labels"]`, and provides the `label_fn` that MASA asks environments for.

    Example:
        >>> import gymnasium as gym
        >>> import spatula_env
        >>> from spatula_env.envs.adapters.masa import LabelsWrapper
        >>> env = LabelsWrapper(gym.make("Spatula/Press-v0"))
        >>> _, info = env.reset(seed=0)
        >>> info["labels"]
        set()
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        """Wrap an environment of this package."""
        RecordConstructorArgs.__init__(self)
        gymnasium.Wrapper.__init__(self, env)
        self._labels: set[str] = set()

    def label_fn(self, observation: Any) -> set[str]:
        """The labels of the environment's last step; the observation is ignored."""
        return set(self._labels)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; see the environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._labels = labels_of(info)
        return observation, {**info, "labels": set(self._labels)}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment; see there."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._labels = labels_of(info)
        return observation, reward, terminated, truncated, {**info, "labels": set(self._labels)}
