"""`find_policy`: finds a policy by its name, or by the path of a trained one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spatula_env.definitions import FIRST, present_options
from spatula_env.learning.policies import (
    ExpertPolicy,
    Policy,
    PolicySource,
    RandomPolicy,
    interface_of,
    make_expert,
    make_proportional,
)
from spatula_env.learning.saving import definition_of, find_saved, load_policy, read_saved_config
from spatula_env.naming import same_environment
from spatula_env.policies import ExportedPolicy, pretrained_path, read_provenance

NAMES = ("expert", "proportional", "random", "pretrained")
"""Policies that have a name; any other name is a path."""


def find_policy(name: str, env_id: str) -> PolicySource:
    """Find the policy that a name on the command line stands for.

    Args:
        name: "expert", "proportional", "random", "pretrained", or a path: of a run, of one of its policies or
            checkpoints (a folder), or of exported weights (.npz).
        env_id: Id of the environment.

    Raises:
        FileNotFoundError: If there is no such file, or no pretrained policy.
        ValueError: If it is not a policy, or is one for another environment.
    """
    if name == "expert":
        return PolicySource(_make_expert_policy, description="scripted expert")
    if name == "proportional":
        return PolicySource(_make_proportional_policy, description="proportional controller")
    if name == "random":
        return PolicySource(_make_random_policy, description="uniform actions")
    path = pretrained_path(env_id) if name == "pretrained" else Path(name)
    if not path.exists():
        known = ", ".join(NAMES)
        raise FileNotFoundError(f"policy must be one of {known} or the path of a run or of weights: no {path}")
    if path.suffix == ".npz":
        exported = ExportedPolicy.load(path)
        _check_env(exported.metadata.get("env_id", env_id), env_id, path)
        number = exported.metadata.get("definition", FIRST)
        return PolicySource(
            _ExportedMaker(path),
            present_options(env_id, number, exported.metadata.get("env_kwargs", {})),
            f"exported weights {path.name}",
            read_provenance(path),
        )
    if not path.is_dir():
        raise ValueError(f"policy must be a folder or an .npz file, got {path}")
    folder = find_saved(path)
    config = read_saved_config(folder)
    _check_env(config.environment.id, env_id, path)
    kwargs = present_options(env_id, definition_of(folder), interface_of(env_id, config.environment.kwargs))
    return PolicySource(_SavedMaker(folder), kwargs, f"saved policy {folder}")


def _check_env(trained: str, wanted: str, path: Path) -> None:
    if not same_environment(trained, wanted):
        raise ValueError(f"the policy {path} is for {trained}, not for {wanted}")


def _make_expert_policy(env: Any) -> Policy:
    return ExpertPolicy(make_expert(env))


def _make_proportional_policy(env: Any) -> Policy:
    return ExpertPolicy(make_proportional(env))


def _make_random_policy(env: Any) -> Policy:
    return RandomPolicy(getattr(env, "single_action_space", env.action_space))


@dataclass(frozen=True)
class _ExportedMaker:
    """Makes a policy from exported weights; picklable for other processes."""

    path: Path

    def __call__(self, env: Any) -> Policy:
        return ExportedPolicy.load(self.path).bound_to(env)


@dataclass(frozen=True)
class _SavedMaker:
    """Makes a policy from the files of a training run; picklable for other processes."""

    folder: Path

    def __call__(self, env: Any) -> Policy:
        return load_policy(self.folder, env)
