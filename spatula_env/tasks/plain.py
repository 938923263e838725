"""Conversion of NumPy's numbers and arrays to Python's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def as_plain(value: Any) -> Any:
    """Convert numbers and sequences to Python's own types, which can be compared and written to a file.

    Args:
        value: NumPy scalars and arrays without axes become numbers, other arrays lists; the same applies to the content
            of mappings, lists and tuples. Anything else stays as it is.
    """
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {as_plain(name): as_plain(one) for name, one in value.items()}
    if type(value) in (list, tuple):
        return type(value)(as_plain(one) for one in value)
    return value


def as_recorded(value: Any) -> Any:
    """Like `as_plain`; in addition, members of enumerations become their names in lower case."""
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, Mapping):
        return {as_recorded(name): as_recorded(one) for name, one in value.items()}
    return as_plain(value)


def make_fields_plain(config: DataclassInstance) -> None:
    """Convert the values of a frozen dataclass by `as_plain`, from within its `__post_init__`."""
    for field in fields(config):
        object.__setattr__(config, field.name, as_plain(getattr(config, field.name)))
