"""What is asked of the agent: goals, reward terms and success.

A task knows no physics engine and no Gymnasium. It reads a `Situation`, arrays in SI units whose first axis
counts worlds, and answers with an `Evaluation` of the same kind, so that one environment and many at once
share it.
"""

from __future__ import annotations

from spatula_env.tasks.base import Evaluation, Setting, Situation, Start, Task
from spatula_env.tasks.press import PressConfig, PressTask, PressWeights

__all__ = [
    "Evaluation",
    "PressConfig",
    "PressTask",
    "PressWeights",
    "Setting",
    "Situation",
    "Start",
    "Task",
]
