"""Checks of plain numbers and booleans, shared by shapes, scenes and the options of environments.

Booleans, strings and lists do not count as numbers, nor numbers as booleans. The errors give the name of the argument,
the values that are allowed, and the value that was given.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Kind = TypeVar("Kind")


def is_number(value: Any) -> bool:
    """Whether a value is a finite real number: of Python, of NumPy, or a NumPy array without axes."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer that no float can hold
        return False


def check_finite(value: Any, name: str) -> None:
    """Check that something is a finite number.

    Args:
        value: What came.
        name: What to call it in the error message.

    Raises:
        ValueError: If it is not.
    """
    if not is_number(value):
        raise ValueError(f"{name} must be finite and a number, got {value!r}")


def check_positive(value: Any, name: str, *, or_none: bool = False) -> None:
    """Check that something is a number, positive and finite.

    Args:
        value: What came.
        name: What to call it in the error message.
        or_none: Whether None is allowed too.

    Raises:
        ValueError: If it is not.
    """
    if value is None and or_none:
        return
    if not (is_number(value) and value > 0.0):
        raise ValueError(f"{name} must be positive and finite{', or None' * or_none}, got {value!r}")


def check_not_negative(value: Any, name: str, *, or_none: bool = False) -> None:
    """Check that something is a number of zero or more, and finite.

    Args:
        value: What came.
        name: What to call it in the error message.
        or_none: Whether None is allowed too.

    Raises:
        ValueError: If it is not.
    """
    if value is None and or_none:
        return
    if not (is_number(value) and value >= 0.0):
        raise ValueError(f"{name} must be {'None, or ' * or_none}zero or more and finite, got {value!r}")


def check_count(value: Any, name: str, least: int, most: int | None = None) -> None:
    """Check that something is an integer, and neither too small nor too great.

    Args:
        value: What came.
        name: What to call it in the error message.
        least: The smallest value allowed.
        most: The greatest value allowed; None: there is no such limit.

    Raises:
        ValueError: If it is not.
    """
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < least or (most is not None and value > most):
        wanted = f"of at least {least}" + ("" if most is None else f" and at most {most}")
        raise ValueError(f"{name} must be an integer {wanted}, got {value!r}")


def check_boolean(value: Any, name: str) -> None:
    """Check that something is True or False, and not what Python takes for either.

    Args:
        value: What came.
        name: What to call it in the error message.

    Raises:
        ValueError: If it is not.
    """
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} must be True or False, got {value!r}")


def check_kind(value: Any, name: str, kind: type, *, or_none: bool = False) -> None:
    """Check that something is of a class of this package.

    Args:
        value: What came.
        name: What to call it in the error message.
        kind: The class.
        or_none: Whether None is allowed too.

    Raises:
        TypeError: If it is not.
    """
    if not (isinstance(value, kind) or (value is None and or_none)):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise TypeError(f"{name} must be {article} {kind.__name__}{' or None' * or_none}, got {value!r}")


def as_tuple_of(value: Any, name: str, kind: type[Kind]) -> tuple[Kind, ...]:
    """A tuple of objects of a class of this package, from any sequence of them.

    Args:
        value: What came.
        name: What to call it in the error message.
        kind: The class.

    Raises:
        TypeError: If it is no sequence, or one of its elements is something else.
    """
    if not isinstance(value, Sequence) or isinstance(value, str | bytes):
        raise TypeError(f"{name} must be a sequence of {kind.__name__}, got {value!r}")
    for index, one in enumerate(value):
        check_kind(one, f"{name}[{index}]", kind)
    return tuple(value)


def as_seed(value: Any) -> int | None:
    """A seed of random numbers, as Python's integer.

    Args:
        value: What came: anything that Python takes for an integer, or None.

    Raises:
        ValueError: If it is something else, or negative.
    """
    if value is None:
        return None
    try:
        seed = operator.index(value)
    except TypeError:
        raise ValueError(f"seed must be an integer or None, got {value!r}") from None
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {value!r}")
    return seed


def as_pair(value: Any, name: str, wanted: str) -> tuple[float, float]:
    """Two finite numbers, from a list, a tuple or an array of them.

    Args:
        value: What came.
        name: What to call it in the error message.
        wanted: What the two are, for the message.

    Raises:
        ValueError: If it is anything else.
    """
    if isinstance(value, list | tuple | np.ndarray) and np.shape(value) == (2,) and all(map(is_number, value)):
        return float(value[0]), float(value[1])
    raise ValueError(f"{name} must be two numbers {wanted}, both finite, got {value!r}")


def as_floats(value: Any) -> NDArray[np.float64]:
    """An array of real numbers, of its own memory.

    Args:
        value: What NumPy makes an array of. Booleans, strings and complex numbers are no real numbers.

    Raises:
        ValueError: If it is something else.
    """
    try:
        array = np.asarray(value)
        if array.dtype.kind in "iuf":
            return np.array(array, dtype=np.float64)
        if array.dtype.kind == "O" and not any(isinstance(one, str | bytes | bool | np.bool_) for one in array.flat):
            return np.array(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"must be real numbers, got {value!r}") from error
    raise ValueError(f"must be real numbers, got {value!r}")
