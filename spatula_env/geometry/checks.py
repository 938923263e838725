"""Checks of plain numbers, shared by the shapes."""

from __future__ import annotations

import math

import numpy as np


def check_positive(value: float, name: str) -> None:
    """Check that a number is positive and finite.

    Args:
        value: The number.
        name: What to call it in the error message.

    Raises:
        ValueError: If it is not.
    """
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} must be positive and finite, got {value!r}")


def check_not_negative(value: float, name: str) -> None:
    """Check that a number is zero or more, and finite.

    Args:
        value: The number.
        name: What to call it in the error message.

    Raises:
        ValueError: If it is not.
    """
    if not (math.isfinite(value) and value >= 0.0):
        raise ValueError(f"{name} must be zero or more and finite, got {value!r}")


def check_count(value: int, name: str, least: int) -> None:
    """Check that a number is an integer, and not too small.

    Args:
        value: The number.
        name: What to call it in the error message.
        least: The smallest value allowed.

    Raises:
        ValueError: If it is not.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name} must be an integer of at least {least}, got {value!r}")
