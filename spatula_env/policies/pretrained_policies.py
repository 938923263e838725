"""Pretrained policies: their files and their provenance."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium

from spatula_env.policies.exported import ExportedPolicy

PRETRAINED = Path(__file__).parent / "pretrained"
"""Folder of the policies: one file for each task, with its provenance beside it."""

ALGORITHM_NAMES: Mapping[str, str] = MappingProxyType(
    {
        "ppo": "proximal policy optimisation",
        "sac": "soft actor-critic",
        "tqc": "truncated quantile critics",
        "sac_her": "soft actor-critic with hindsight replay",
    }
)
"""Full names of the algorithms, by their short names in configurations."""


def pretrained_path(env_id: str) -> Path:
    """Path of the pretrained policy for an environment, whether or not it exists.

    Args:
        env_id: Id of the environment, such as "Spatula/Press-v0".

    Returns:
        Path of the file.

    Raises:
        gymnasium.error.Error: If no such environment is registered.
    """
    name = gymnasium.spec(env_id).id.partition("/")[2].rpartition("-v")[0]
    return PRETRAINED / f"{name.lower()}.npz"


def load_pretrained(env_id: str) -> ExportedPolicy:
    """Load the pretrained policy for an environment; `bound_to` then prepares it for one.

    Args:
        env_id: Id of the environment.

    Raises:
        FileNotFoundError: If there is no pretrained policy.
        gymnasium.error.Error: If no such environment is registered.
    """
    path = pretrained_path(env_id)
    if not path.exists():
        raise FileNotFoundError(f"env_id must be that of an environment with a pretrained policy, got {env_id!r}")
    return ExportedPolicy.load(path)


def read_provenance(path: Path) -> dict[str, Any]:
    """Read the metadata in the file beside exported weights; empty if there is no such file.

    Args:
        path: Path of the weights, .npz.

    Raises:
        ValueError: If the file holds something else.
    """
    file = path.with_suffix(".json")
    if not file.exists():
        return {}
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (RecursionError, ValueError) as error:
        raise ValueError(f"{file} cannot be read: {error}") from error
    if not isinstance(found, dict):
        raise ValueError(f"{file} must hold a mapping, got {str(found)[:100]!r}")
    return found


def describe_provenance(provenance: Mapping[str, Any]) -> str:
    """Describe in a few words how a policy was obtained.

    Args:
        provenance: Metadata from `read_provenance`.

    Returns:
        A text such as "soft actor-critic, 25 600 steps" or "clone of 50 demonstrations".
    """
    steps = int(provenance.get("steps", 0))
    if steps == 0:
        count = provenance.get("demonstrations", {}).get("episodes")
        return "unknown origin" if count is None else f"clone of {count} demonstrations"
    config = provenance.get("config", {})
    algorithm = ALGORITHM_NAMES.get(config.get("algorithm", ""), "unknown algorithm")
    described = f"{algorithm}, {format(steps, ',').replace(',', ' ')} steps"
    shown = config.get("demonstrations", 0)
    return f"{described}, {shown} demonstrations" if shown else described
