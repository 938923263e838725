"""What acts in an environment: experts, chance, trained policies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from agents.experts import ClampExpert, FissureExpert, PalpateExpert, PressExpert, RetractExpert
from agents.experts.base import Expert
from spatula_env.naming import same_environment
from spatula_env.policies import ExportedPolicy, pretrained_path, read_provenance

NAMES = ("expert", "random", "pretrained")
"""Policies that are known by name; any other is a path."""

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
"""Options of an environment that a policy depends on: what observations and actions mean."""


class Policy(Protocol):
    """Acts in many worlds at once."""

    def begin(self, seeds: Sequence[int]) -> None:
        """Get ready for new episodes in all worlds, seeded as their environments are."""

    def __call__(self, observation: Any) -> NDArray[np.float32]:
        """The actions (W, A) for the observations of W worlds."""


@dataclass(frozen=True)
class PolicySource:
    """How to make a policy, in any process.

    Attributes:
        make: Makes it for an environment.
        kwargs: What the environment must be made with for it.
        description: What it is, in a few words.
        provenance: Where it comes from, if that is known.
    """

    make: Callable[[Any], Policy]
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    description: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)


class ExpertPolicy:
    """A scripted expert, which needs nothing at the beginning of an episode."""

    def __init__(self, expert: Expert) -> None:
        """Let an expert act."""
        self.expert = expert

    def begin(self, seeds: Sequence[int]) -> None:
        """Nothing to do."""

    def __call__(self, observation: Any) -> NDArray[np.float32]:
        """See `Policy`."""
        return self.expert(observation)


class RandomPolicy:
    """Uniform actions, which depend on the seed of an episode only."""

    def __init__(self, space: gymnasium.spaces.Box) -> None:
        """Draw from a space."""
        self._space = space
        self._generators: list[np.random.Generator] = []

    def begin(self, seeds: Sequence[int]) -> None:
        """See `Policy`."""
        # Not the generators of the episodes, which draw goals from the same seeds.
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
    experts = {each.task: each for each in (ClampExpert, FissureExpert, PalpateExpert, PressExpert, RetractExpert)}
    definition = getattr(env.unwrapped, "definition", None)
    if definition is None or definition.name not in experts:
        raise ValueError(f"env must be of one of the tasks {sorted(experts)}, got {env}")
    return experts[definition.name](env)


def find_policy(name: str, env_id: str) -> PolicySource:
    """What a name on the command line means.

    Args:
        name: "expert", "random", "pretrained", or a path: of a run or one of its policies or checkpoints (a folder), or
            of exported weights (.npz).
        env_id: Of the environment.

    Raises:
        FileNotFoundError: If there is no such file, or no pretrained policy.
        ValueError: If it is not a policy, or one for another environment.
    """
    if name == "expert":
        return PolicySource(_make_expert_policy, description="scripted expert")
    if name == "random":
        return PolicySource(_make_random_policy, description="uniform actions")
    path = pretrained_path(env_id) if name == "pretrained" else Path(name)
    if not path.exists():
        known = ", ".join(NAMES)
        raise FileNotFoundError(f"policy must be one of {known} or the path of a run or of weights: no {path}")
    if path.suffix == ".npz":
        exported = ExportedPolicy.load(path)
        _check_env(exported.metadata.get("env_id", env_id), env_id, path)
        return PolicySource(
            _ExportedMaker(path), exported.metadata.get("env_kwargs", {}), f"exported weights {path.name}",
            read_provenance(path),
        )  # fmt: skip
    if not path.is_dir():
        raise ValueError(f"policy must be a folder or an .npz file, got {path}")
    from agents.saving import find_saved, read_saved_config

    folder = find_saved(path)
    config = read_saved_config(folder)
    _check_env(config.environment.id, env_id, path)
    return PolicySource(_SavedMaker(folder), interface_of(config.environment.kwargs), f"saved policy {folder}")


def interface_of(kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Those of an environment's options that a policy depends on."""
    return {name: value for name, value in kwargs.items() if name in INTERFACE}


def _check_env(trained: str, wanted: str, path: Path) -> None:
    if not same_environment(trained, wanted):
        raise ValueError(f"the policy {path} is for {trained}, not for {wanted}")


def _make_expert_policy(env: Any) -> Policy:
    return ExpertPolicy(make_expert(env))


def _make_random_policy(env: Any) -> Policy:
    return RandomPolicy(getattr(env, "single_action_space", env.action_space))


@dataclass(frozen=True)
class _ExportedMaker:
    """Makes a policy of exported weights; can be sent to other processes."""

    path: Path

    def __call__(self, env: Any) -> Policy:
        return ExportedPolicy.load(self.path).bound_to(env)


@dataclass(frozen=True)
class _SavedMaker:
    """Makes a policy of what training has saved; can be sent to other processes."""

    folder: Path

    def __call__(self, env: Any) -> Policy:
        from agents.saving import load_policy

        return load_policy(self.folder, env)
