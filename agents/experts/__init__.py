"""Scripted policies that solve the tasks from observations alone.

They demonstrate, and they show what is possible.
"""

from __future__ import annotations

from agents.experts.press import PressExpert

__all__ = ["PressExpert"]
