"""Tasks: goals, reward terms and success criteria.

A task is independent of physics engines and of Gymnasium. It reads a `Situation`, arrays in SI units whose first axis
counts worlds, and returns an `Evaluation` of the same form, so that single and vector environments share it.
"""

from __future__ import annotations

from spatula_env.tasks.base import Evaluation, Memory, PartSpec, Task
from spatula_env.tasks.clamp import ClampConfig, ClampTask, ClampWeights
from spatula_env.tasks.configuration import TaskConfig, Weights
from spatula_env.tasks.fissure import FissureConfig, FissureTask, FissureWeights
from spatula_env.tasks.marks import Mark, Patch, Path, Points, Ring
from spatula_env.tasks.palpate import PalpateConfig, PalpateTask, PalpateWeights
from spatula_env.tasks.press import PressConfig, PressTask, PressWeights
from spatula_env.tasks.retract import RetractConfig, RetractTask, RetractWeights
from spatula_env.tasks.situation import Setting, Situation, Start, ToolShape

__all__ = [
    "ClampConfig",
    "ClampTask",
    "ClampWeights",
    "Evaluation",
    "FissureConfig",
    "FissureTask",
    "FissureWeights",
    "Mark",
    "Memory",
    "PalpateConfig",
    "PalpateTask",
    "PalpateWeights",
    "PartSpec",
    "Patch",
    "Path",
    "Points",
    "PressConfig",
    "PressTask",
    "PressWeights",
    "RetractConfig",
    "RetractTask",
    "RetractWeights",
    "Ring",
    "Setting",
    "Situation",
    "Start",
    "Task",
    "TaskConfig",
    "ToolShape",
    "Weights",
]
