"""The names that are needed to write a new task, in one place; docs/extending.md has an example."""

from __future__ import annotations

from spatula_env import scenes
from spatula_env.envs.levels import Level, hard_level, standard_level
from spatula_env.envs.observed_ranges import ObservedRanges
from spatula_env.envs.registering import register_task
from spatula_env.tasks.base import Evaluation, Memory, PartSpec, Task, closeness, sample_disc
from spatula_env.tasks.configuration import TaskConfig, Weights
from spatula_env.tasks.marks import Mark, Patch, Path, Points, Ring
from spatula_env.tasks.situation import Setting, Situation, Start

__all__ = [
    "Evaluation",
    "Level",
    "Mark",
    "Memory",
    "ObservedRanges",
    "PartSpec",
    "Patch",
    "Path",
    "Points",
    "Ring",
    "Setting",
    "Situation",
    "Start",
    "Task",
    "TaskConfig",
    "Weights",
    "closeness",
    "hard_level",
    "register_task",
    "sample_disc",
    "scenes",
    "standard_level",
]
