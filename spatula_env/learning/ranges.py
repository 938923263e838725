"""Value ranges for the fields of configurations, given in annotations and checked on construction.

Example:
    >>> from dataclasses import dataclass
    >>> from spatula_env.learning.ranges import Checked, Count
    >>> @dataclass(frozen=True)
    ... class Training(Checked):
    ...     epochs: Count = 10
    >>> Training(epochs=0)
    Traceback (most recent call last):
    ValueError: epochs must be 1 or more, got 0
"""

from __future__ import annotations

import math
import typing
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar


@dataclass(frozen=True)
class Rule:
    """A condition on a value besides its type.

    Attributes:
        words: The condition in words, for error messages.
        allows: Tells whether a value meets it.
    """

    words: str
    allows: Callable[[Any], bool]


def one_of(allowed: Iterable[str]) -> Rule:
    """Rule that a text is one of the given ones."""
    names = list(allowed)
    return Rule(f"one of {names}", lambda value: value in names)


Count = Annotated[int, Rule("1 or more", lambda value: value >= 1)]
Natural = Annotated[int, Rule("0 or more", lambda value: value >= 0)]
Positive = Annotated[float, Rule("positive and finite", lambda value: 0.0 < value < math.inf)]
NotNegative = Annotated[float, Rule("a number from 0 on", lambda value: 0.0 <= value < math.inf)]
Share = Annotated[float, Rule("in [0, 1]", lambda value: 0.0 <= value <= 1.0)]


class Checked:
    """Base of dataclasses whose fields are checked on construction.

    Attributes:
        section: Key of such a configuration in a file, for error messages.
    """

    section: ClassVar[str] = ""

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ValueError: If a value is not allowed; the message names it and what is allowed.
        """
        where = f"{self.section}." if self.section else ""
        for name, kind in typing.get_type_hints(type(self), include_extras=True).items():
            if typing.get_origin(kind) is not ClassVar:
                _check(kind, getattr(self, name), where + name)


def _check(kind: Any, value: Any, name: str) -> None:
    """Check a value, and its items, by the rules in an annotation."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        for rule in kind.__metadata__:
            if isinstance(rule, Rule) and not rule.allows(value):
                raise ValueError(f"{name} must be {rule.words}, got {value!r}")
    elif origin is tuple:
        for item in value:
            _check(inner[0], item, name)
    elif value is not None and type(None) in inner:
        for each in inner:
            _check(each, value, name)
