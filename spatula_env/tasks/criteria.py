"""The criteria of a goal, one condition at a time, as a person is told them."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Criterion:
    """One of the conditions that make up a goal. A goal is fulfilled when all of them are.

    Attributes:
        name: What is measured, in a few words.
        unit: Of all its numbers: "m", "rad", "1", "N".
        present: What it is now.
        low: What it must not be below; minus infinity: there is no such limit.
        high: What it must not be above; infinity likewise.
        within: Whether the condition is fulfilled now, as the task judges it.
        note: What to say instead of `present` where that is no measurement; "" where it is.
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
        """Something that is to be `wanted`, give or take a tolerance."""
        within = abs(wanted - present) <= tolerance
        return Criterion(name, unit, present, wanted - tolerance, wanted + tolerance, within, note)

    @staticmethod
    def at_most(name: str, unit: str, present: float, limit: float, note: str = "") -> Criterion:
        """Something that is to be no more than a limit."""
        return Criterion(name, unit, present, -math.inf, limit, present <= limit, note)

    @staticmethod
    def at_least(name: str, unit: str, present: float, limit: float, note: str = "") -> Criterion:
        """Something that is to be no less than a limit."""
        return Criterion(name, unit, present, limit, math.inf, present >= limit, note)
