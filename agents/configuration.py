"""Reading configurations: YAML files in `configs`, checked before anything is made of them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import yaml

import spatula_env  # noqa: F401 - registers the environments

ENVIRONMENT_KEYS = ("id", "kwargs")


def read_environment(path: str | os.PathLike[str]) -> tuple[str, dict[str, Any]]:
    """What a file says gymnasium.make should be called with.

    Args:
        path: A YAML file with `id`, and optionally `kwargs`.

    Returns:
        The id and the keyword arguments.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is not such a mapping; the message names the file, what it has and what is allowed.
    """
    file = Path(path)
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise ValueError(f"{file} is not YAML: {error}") from error
    if not isinstance(content, Mapping):
        raise ValueError(f"{file} must hold a mapping with the keys {list(ENVIRONMENT_KEYS)}, got {content!r}")
    unknown = [key for key in content if key not in ENVIRONMENT_KEYS]
    if unknown:
        raise ValueError(f"{file} has unknown keys {unknown}; allowed are {list(ENVIRONMENT_KEYS)}")
    name, kwargs = content.get("id"), content.get("kwargs") or {}
    if not isinstance(name, str):
        raise ValueError(f"{file} must name an environment's id, got {name!r}")
    if not isinstance(kwargs, Mapping) or not all(isinstance(key, str) for key in kwargs):
        raise ValueError(f"{file}: kwargs must be a mapping from names to values, got {kwargs!r}")
    return name, dict(kwargs)


def make_environment(path: str | os.PathLike[str], **overrides: Any) -> gymnasium.Env[Any, Any]:
    """Make the environment that a file describes.

    Args:
        path: See `read_environment`.
        **overrides: Keyword arguments that replace or add to the file's.

    Returns:
        The environment.
    """
    name, kwargs = read_environment(path)
    return gymnasium.make(name, **{**kwargs, **overrides})
