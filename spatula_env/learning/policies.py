"""The interface of policies, and policies without training: experts and random actions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spatula_env.definitions import level_options
from spatula_env.envs.levels import merged
from spatula_env.envs.observed_ranges import ALL_PARTS
from spatula_env.learning.experts import (
    ClampExpert,
    FissureExpert,
    PalpateExpert,
    PressExpert,
    RetractExpert,
    proportional,
)
from spatula_env.learning.experts.base import Expert

INTERFACE = (
    "obs_mode",
    "control",
    "reward",
    "observation",
    "max_speed",
    "max_rotation_rate",
    "max_jaw_speed",
    "control_frequency",
)
"""Options of an environment that a policy depends on, because they define observations and actions."""


class Policy(Protocol):
    """A policy that acts in many worlds at once."""

    def begin(self, seeds: Sequence[int]) -> None:
        """Prepare for new episodes in all worlds, with the seeds of their environments."""

    def __call__(self, observation: Any) -> NDArray[np.float32]:
        """The actions (W, A) for the observations of W worlds."""


@dataclass(frozen=True)
class PolicySource:
    """How to make a policy, in any process.

    Attributes:
        make: Makes the policy for an environment.
        kwargs: Arguments with which the environment has to be made for it.
        description: Short description of the policy.
        provenance: Origin of the policy, if it is known.
    """

    make: Callable[[Any], Policy]
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    description: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)


class ExpertPolicy:
    """A scripted expert; it keeps no state between steps."""

    def __init__(self, expert: Expert) -> None:
        """Wrap an expert."""
        self.expert = expert

    def begin(self, seeds: Sequence[int]) -> None:
        """Nothing to do."""

    def __call__(self, observation: Any) -> NDArray[np.float32]:
        """See `Policy`."""
        return self.expert(observation)


class RandomPolicy:
    """Uniformly random actions that depend only on the seed of an episode."""

    def __init__(self, space: gymnasium.spaces.Box) -> None:
        """Draw actions from a space."""
        self._space = space
        self._generators: list[np.random.Generator] = []

    def begin(self, seeds: Sequence[int]) -> None:
        """See `Policy`."""
        # Derived seeds, because the environments draw their goals from the seeds themselves.
        self._generators = [np.random.default_rng([seed, 1]) for seed in seeds]

    def __call__(self, observation: Any) -> NDArray[np.float32]:
        """See `Policy`."""
        low, high = self._space.low, self._space.high
        return np.stack([generator.uniform(low, high) for generator in self._generators]).astype(np.float32)


def make_expert(env: Any) -> Expert:
    """The scripted expert of an environment's task.

    Args:
        env: For one agent or for many, wrapped or not.

    Raises:
        ValueError: If the environment is not one of this package.
    """
    return _of_its_task(env, (ClampExpert, FissureExpert, PalpateExpert, PressExpert, RetractExpert))


def make_proportional(env: Any) -> Expert:
    """The proportional controller of an environment's task, for comparison.

    Args:
        env: For one agent or for many, wrapped or not.

    Raises:
        ValueError: If the environment is not one of this package.
    """
    return _of_its_task(
        env,
        (
            proportional.ProportionalClamp,
            proportional.ProportionalFissure,
            proportional.ProportionalPalpate,
            proportional.ProportionalPress,
            proportional.ProportionalRetract,
        ),
    )


def _of_its_task(env: Any, scripted: Sequence[type[Expert]]) -> Expert:
    """The one of some scripted policies that is made for an environment's task."""
    known = {each.task: each for each in scripted}
    definition = getattr(env.unwrapped, "definition", None)
    if definition is None or definition.name not in known:
        raise ValueError(f"env must be of one of the tasks {sorted(known)}, got {env}")
    return known[definition.name](env)


def interface_of(env_id: str, kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Select the environment options that a policy depends on, those among them that its level implies.

    Args:
        env_id: Id of the environment.
        kwargs: Options with which it is made.
    """
    if "level" in kwargs:
        kwargs = merged(level_options(env_id, kwargs["level"]), kwargs)
    # With the goal interface, the progress of holding is observed only if success ends episodes.
    names = (*INTERFACE, "terminate_on_success") if kwargs.get("reward") == "sparse" else INTERFACE
    return {name: value for name, value in kwargs.items() if name in names}


def with_all_parts(env_id: str, kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Options of an environment for a policy that reads all parts of observations, or says which it reads.

    Scripted policies read all, and so do agents that were trained where a level showed all. What another agent reads is
    among the options that it depends on; see `interface_of`.

    Args:
        env_id: Id of the environment.
        kwargs: The options; where they choose no parts, and their level shows fewer, all are chosen.
    """
    implied = merged(level_options(env_id, kwargs.get("level", "easy")), kwargs).get("observation")
    chosen = kwargs.get("observation")
    if not isinstance(implied, Mapping) or implied.get("parts", ALL_PARTS) == ALL_PARTS:
        return dict(kwargs)
    if isinstance(chosen, Mapping) and "parts" in chosen:
        return dict(kwargs)
    return {**kwargs, "observation": {**(chosen or {}), "parts": ALL_PARTS}}


def judged_options(env_id: str, kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Options with which a policy is evaluated while it learns: those that it depends on, at the level it learns at.

    Args:
        env_id: Id of the environment.
        kwargs: Options of the environment in which it learns.
    """
    judged = interface_of(env_id, kwargs)
    if "level" in kwargs:
        judged["level"] = kwargs["level"]
    return judged
