"""Scripted policies that solve the tasks from observations alone.

They demonstrate, and they show what is possible.
"""

from __future__ import annotations

from agents.experts.clamp import ClampExpert
from agents.experts.fissure import FissureExpert
from agents.experts.palpate import PalpateExpert
from agents.experts.press import PressExpert
from agents.experts.retract import RetractExpert

__all__ = ["ClampExpert", "FissureExpert", "PalpateExpert", "PressExpert", "RetractExpert"]
