"""Checks of a dataset's metadata and index, which may come from an untrusted source."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from spatula_env.data.files import DatasetDamaged
from spatula_env.data.layout import KEY

Rules = Mapping[str, tuple[str, Callable[[Any], bool]]]
"""Rules for entries, by name: the allowed values in words, and a function that checks a value."""
LARGEST = 2**63 - 1
"""The greatest integer that HDF5 can store, and so the greatest seed."""
FORMATS = ("hdf5", "arrow")
"""Minari's data formats."""
ONE_VALUE = ("operator", "device", "engine", "author", "success")
"""Attributes of an episode that are counted and shown, and so must not be lists or mappings."""


def check_seed(seed: int | None) -> None:
    """Check that a dataset can store a seed.

    Raises:
        ValueError: If it cannot.
    """
    if seed is not None and not 0 <= int(seed) <= LARGEST:
        raise ValueError(f"seed must be from 0 to {LARGEST}, which a dataset can keep, got {seed!r}")


def read_json(content: str | bytes, what: str) -> Any:
    """Parse JSON.

    Args:
        content: The text.
        what: Where it is from, for the error.

    Raises:
        DatasetDamaged: If it is not JSON.
    """
    try:
        return json.loads(content)
    except (RecursionError, ValueError) as error:
        raise DatasetDamaged(f"{what} cannot be read: {error}") from error


def check_metadata(found: Any, file: Path) -> dict[str, Any]:
    """Check a dataset's metadata. All entries may be missing, except for the number of episodes.

    Args:
        found: The parsed JSON.
        file: Where it is from, for the error.

    Raises:
        DatasetDamaged: If it is not valid.
    """
    if not isinstance(found, dict) or "total_episodes" not in found:
        raise DatasetDamaged(f"{file} has no metadata of a dataset")
    _check(found, METADATA, str(file))
    if found.get(KEY) is not None:
        _check(found[KEY], OWN, f"{file}: {KEY}")
    return found


def check_line(found: Any, what: str, specs: int) -> dict[str, Any]:
    """Check the index's record of an episode.

    Args:
        found: The parsed JSON.
        what: Where it is from, for the error.
        specs: Number of specifications of environments in the dataset.

    Raises:
        DatasetDamaged: If it is not valid.
    """
    if not isinstance(found, dict) or set(found) != set(LINE):
        raise DatasetDamaged(f"{what} does not tell {', '.join(LINE)}, and nothing else, of an episode")
    _check(found, LINE, what)
    if found["spec"] >= specs:
        raise DatasetDamaged(f"{what}: spec must be below {specs}, got {found['spec']}")
    for name in ONE_VALUE:
        value = found["attributes"].get(name)
        if isinstance(value, list | Mapping):
            raise DatasetDamaged(f"{what}: {name} must be one value, got {_shown(value)}")
    return found


def check_spec(found: Any, what: str) -> dict[str, Any]:
    """Check the specification of an environment.

    Args:
        found: The parsed JSON.
        what: Where it is from, for the error.

    Raises:
        DatasetDamaged: If it is not valid.
    """
    if not isinstance(found, dict) or not {"id", "additional_wrappers"} <= found.keys():
        raise DatasetDamaged(f"{what} is no specification of an environment: {_shown(found)}")
    _check(found, SPEC, what)
    for each in found["additional_wrappers"]:
        if set(each) != set(WRAPPER):
            raise DatasetDamaged(f"{what} has a wrapper that does not tell {', '.join(WRAPPER)}: {_shown(each)}")
        _check(each, WRAPPER, f"{what}: a wrapper's")
    return found


def _check(found: Mapping[str, Any], rules: Rules, what: str) -> None:
    for name, (allowed, fits) in rules.items():
        if name in found and not fits(found[name]):
            raise DatasetDamaged(f"{what}: {name} must be {allowed}, got {_shown(found[name])}")


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 100 else f"{text[:100]} …"


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= LARGEST


def _is_number(value: Any) -> bool:
    # Values of an episode that has diverged are not finite.
    return isinstance(value, float) or (
        isinstance(value, int) and not isinstance(value, bool) and abs(value) <= LARGEST
    )


def _is_texts(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_text, value))


def _is_numbers(value: Any) -> bool:
    return isinstance(value, list) and all(_is_number(each) and math.isfinite(each) for each in value)


def _is_mapping(value: Any) -> bool:
    return isinstance(value, dict)


def _or_none(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: value is None or fits(value)


_TEXT = ("text", _is_text)
_TEXTS = ("a list of texts", _is_texts)
_COUNT = (f"an integer from 0 to {LARGEST}", _is_count)
_COUNT_OR_NONE = (f"null or an integer from 0 to {LARGEST}", _or_none(_is_count))
_NUMBERS = ("a list of numbers", _is_numbers)
_BOOL = ("true or false", lambda value: isinstance(value, bool))
_NAMES = ("text, or a list of texts", lambda value: _is_text(value) or _is_texts(value))
_MAPPING = ("a mapping", _is_mapping)
_TEXT_OR_NONE = ("null or text", _or_none(_is_text))
METADATA: Rules = MappingProxyType(
    {
        "total_episodes": _COUNT,
        "total_steps": _COUNT,
        "last_seed": _COUNT_OR_NONE,
        "data_format": (f"one of {', '.join(FORMATS)}", lambda value: value in FORMATS),
        "jpeg_encoding": _BOOL,
        "observation_space": _TEXT,
        "action_space": _TEXT,
        "env_spec": _TEXT,
        "dataset_id": _TEXT,
        "algorithm_name": _TEXT_OR_NONE,
        "author": ("null, text, or a list of texts", _or_none(_NAMES[1])),
        "author_email": ("null, text, or a list of texts", _or_none(_NAMES[1])),
        "code_permalink": _TEXT_OR_NONE,
        "description": _TEXT_OR_NONE,
        "minari_version": _TEXT,
        "requirements": ("null or a list of texts", _or_none(_is_texts)),
        "dataset_size": ("null or a number", _or_none(lambda value: _is_numbers([value]))),
        KEY: ("null or a mapping", _or_none(_is_mapping)),
    }
)
OWN: Rules = MappingProxyType(
    {
        "observation_names": (
            "a mapping of lists of texts",
            lambda value: _is_mapping(value) and all(map(_is_texts, value.values())),
        ),
        "action_names": _TEXTS,
        "control_frequency": (
            "null or a positive number",
            _or_none(lambda value: _is_numbers([value]) and value > 0),
        ),
        "task": _TEXT,
        "scene": _TEXT,
        "lerobot_names": (
            "a mapping of texts",
            lambda value: _is_mapping(value) and all(map(_is_text, value.values())),
        ),
        "workspace_low": _NUMBERS,
        "workspace_high": _NUMBERS,
        "env_specs": ("a list of texts, not empty", lambda value: _is_texts(value) and value != []),
        "links": _COUNT,
        "index_bytes": _COUNT,
    }
)
LINE: Rules = MappingProxyType(
    {
        "steps": _COUNT,
        "total_reward": ("a number", _is_number),
        "peak_force": ("null or a number", _or_none(_is_number)),
        "seed": _COUNT_OR_NONE,
        "spec": _COUNT,
        "size": _COUNT,
        "attributes": _MAPPING,
    }
)
SPEC: Rules = MappingProxyType(
    {
        "id": _TEXT,
        "entry_point": _TEXT_OR_NONE,
        "vector_entry_point": _TEXT_OR_NONE,
        "reward_threshold": ("null or a number", _or_none(_is_number)),
        "nondeterministic": _BOOL,
        "max_episode_steps": (
            "null, -1, or an integer above 0",
            _or_none(lambda value: value == -1 or (_is_count(value) and value > 0)),
        ),
        "order_enforce": _BOOL,
        "disable_env_checker": _BOOL,
        "kwargs": _MAPPING,
        "additional_wrappers": (
            "a list of mappings",
            lambda value: isinstance(value, list) and all(map(_is_mapping, value)),
        ),
    }
)
WRAPPER: Rules = MappingProxyType(
    {"name": _TEXT, "entry_point": _TEXT, "kwargs": ("null or a mapping", _or_none(_is_mapping))}
)
