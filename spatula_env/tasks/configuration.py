"""Configurations of tasks, validated when read from a file or from arguments."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeVar, cast

from spatula_env.geometry.checks import as_pair, check_finite, check_not_negative, check_positive
from spatula_env.tasks.plain import as_plain, make_fields_plain

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Config = TypeVar("Config")


class Weights:
    """Base of the frozen dataclasses that hold the reward weights, one finite number per reward term.

    Attributes:
        hold: Weight of being within tolerance, 0 or 1.
        action: Weight of the squared length of the action.
    """

    hold: float
    action: float

    def __post_init__(self) -> None:
        """Check the weights."""
        make_fields_plain(cast("DataclassInstance", self))
        for name, value in vars(self).items():
            check_finite(value, f"weights.{name}")


class TaskConfig:
    """Base of the frozen dataclasses that configure tasks. Subclasses check themselves with its methods.

    Attributes:
        hold_time: Time for which the goal must be held without interruption for success [s].
        start_height_range: Least and greatest height of the tools' lowest point above the organ's top at the start [m].
        weights: Weights of the reward terms; a mapping may hold only some of them, the others get their defaults.
        loading_limit: Rate at which the force on a tool may grow without causing a cost [N/s].
        cost_budget: Greatest cost of an episode with which success counts as safe [s].
    """

    loading_limit: float = math.inf
    cost_budget: float = math.inf
    hold_time: float
    start_height_range: tuple[float, float]
    weights: Weights

    def _check_not_negative(self, *names: str) -> None:
        """Check that the fields with these names are zero or more."""
        for name in names:
            check_not_negative(self._plain(name), name)

    def _check_positive(self, *names: str) -> None:
        """Check that the fields with these names are above zero."""
        for name in names:
            check_positive(self._plain(name), name)

    def _read_ranges(self, *names: str, not_negative: bool = False) -> None:
        """Convert the fields with these names to two numbers in ascending order; lists are accepted."""
        for name in names:
            ends = check_range(getattr(self, name), name)
            if not_negative and ends[0] < 0.0:
                raise ValueError(f"{name} must not be negative, got {ends}")
            object.__setattr__(self, name, ends)

    def _plain(self, name: str) -> Any:
        """Value of a field, converted from NumPy's types to Python's own."""
        value = as_plain(getattr(self, name))
        object.__setattr__(self, name, value)
        return value

    def _read_weights(self, kind: type[Weights]) -> None:
        """Convert the field `weights` from a mapping of names to weights."""
        object.__setattr__(self, "weights", config_from_mapping(kind, self.weights, "weights"))


def config_from_mapping(kind: type[Config], values: Mapping[str, Any] | Config | None, name: str) -> Config:
    """Make a configuration from values that may come from a file or over the network.

    Args:
        kind: The dataclass to make.
        values: Its fields by name, or the configuration itself, or None for the defaults.
        name: Name of the argument in error messages.

    Returns:
        The configuration.

    Raises:
        ValueError: If a field does not exist, or `values` has another type.
    """
    if values is None:
        return kind()
    if isinstance(values, kind):
        return values
    if not isinstance(values, Mapping):
        raise ValueError(f"{name} must be a mapping or a {kind.__name__}, got {values!r}")
    allowed = sorted(field.name for field in fields(cast("type[DataclassInstance]", kind)))
    unknown = sorted(str(key) for key in values if key not in allowed)
    if unknown:
        raise ValueError(f"{name} has no {', '.join(unknown)}; allowed are {', '.join(allowed)}")
    return kind(**as_plain(values))


def check_range(value: Any, name: str) -> tuple[float, float]:
    """Convert to two finite numbers in ascending order, as a tuple of floats.

    Raises:
        ValueError: If `value` is anything else.
    """
    low, high = as_pair(value, name, "(least, greatest)")
    if low > high:
        raise ValueError(f"{name} must be two finite numbers in ascending order, got {value!r}")
    return low, high
