"""Scripted policies that solve the tasks from observations alone.

They provide demonstrations, and show what is possible.
"""

from __future__ import annotations

from spatula_env.learning.experts.clamp import ClampExpert
from spatula_env.learning.experts.fissure import FissureExpert
from spatula_env.learning.experts.palpate import PalpateExpert
from spatula_env.learning.experts.press import PressExpert
from spatula_env.learning.experts.retract import RetractExpert

__all__ = ["ClampExpert", "FissureExpert", "PalpateExpert", "PressExpert", "RetractExpert"]
