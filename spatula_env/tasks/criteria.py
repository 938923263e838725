"""The criteria of a goal, one condition at a time, for display to a person."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Criterion:
    """One of the conditions that make up a goal. A goal is fulfilled when all of them are.

    Attributes:
        name: Measured quantity, in a few words.
        unit: Unit of all numbers: "m", "rad", "1", "N".
        present: Present value.
        low: Lower limit; minus infinity for none.
        high: Upper limit; infinity for none.
        within: Whether the condition is fulfilled now, as the task judges it.
        note: Text to show instead of `present` if that is not a measurement; "" otherwise.
    """

    name: str
    unit: str
    present: float
    low: float
    high: float
    within: bool
    note: str = ""

    @staticmethod
    def near(name: str, unit: str, present: float, wanted: float, tolerance: float, note: str = "") -> Criterion:
        """Criterion for a value that has to equal `wanted` within a tolerance."""
        within = abs(wanted - present) <= tolerance
        return Criterion(name, unit, present, wanted - tolerance, wanted + tolerance, within, note)

    @staticmethod
    def at_most(name: str, unit: str, present: float, limit: float, note: str = "") -> Criterion:
        """Criterion for a value that must not exceed a limit."""
        return Criterion(name, unit, present, -math.inf, limit, present <= limit, note)

    @staticmethod
    def at_least(name: str, unit: str, present: float, limit: float, note: str = "") -> Criterion:
        """Criterion for a value that must not be below a limit."""
        return Criterion(name, unit, present, limit, math.inf, present >= limit, note)
