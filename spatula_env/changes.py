"""Changes of options and configurations, as given on a command line."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any


def with_changes(content: Mapping[str, Any], changes: Iterable[str]) -> dict[str, Any]:
    """A copy of a nested mapping with some values replaced.

    Args:
        content: Nested mappings; None stands for an empty one.
        changes: Each "key=value" or "key.sub=value", the value in YAML.

    Raises:
        ValueError: If a change is not of that form, or names a key below a value that is not a mapping.
    """
    import yaml

    result = dict(content)
    for change in changes:
        name, equals, text = change.partition("=")
        keys = name.strip().split(".")
        if not equals or not all(keys):
            raise ValueError(f"a change must be KEY=VALUE or KEY.SUB=VALUE, got {change!r}")
        try:
            value = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise ValueError(f"the value of {name.strip()} is not YAML: {text!r}") from error
        place = result
        for key in keys[:-1]:
            inner = place.get(key)
            if not isinstance(inner, Mapping | None):
                raise ValueError(f"there is no {name.strip()}: {key} has the value {inner!r}")
            place[key] = dict(inner or {})
            place = place[key]
        place[keys[-1]] = value
    return result
