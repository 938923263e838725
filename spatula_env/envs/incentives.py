"""Payments at the ends of episodes, so that ending badly never pays, and ending by success loses nothing.

The end of an episode takes away what the rest of it would have paid. With positive rewards, an agent would then do best
to stay just short of success for ever; with negative ones, to damage the organ at once. Two rules prevent both:

- If success ends episodes, each step of the dense reward pays the task's reward minus that of the best step. This is
  zero at best, and zero is what a finished episode goes on to pay: success is worth as much as the best way of staying.
- An end by damage or by a tangle pays minus the cost of a whole episode in which nothing is achieved, or of
  `LEAST_HORIZON` steps if that is more, and nothing else.

The first holds for any discount, and whether or not the learner looks beyond the time limit. A learner that does, and
so expects to pay for 1 / (1 - discount) more steps, finds the second charge greater as long as that is no more steps
than are charged for.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from spatula_env.arrays import BoolArray, FloatArray
    from spatula_env.envs.settings import EnvSettings
    from spatula_env.tasks.base import Task


LIMITS = ("damage_limit", "pressure_limit", "strain_limit")
"""Options that let what an organ suffers end an episode."""

LEAST_HORIZON = 200
"""Least number of control steps that an end by damage or by a tangle costs: enough for discounts up to 0.995."""


class Incentives:
    """Rewards of steps if episodes may end early.

    Attributes:
        offset: Subtracted from the dense reward of each step to make it zero at best; zero if success does not end
            episodes, and for the sparse reward, which is zero at best anyway.
    """

    def __init__(self, settings: EnvSettings, task: Task) -> None:
        """Compute the payments.

        Args:
            settings: Kind of reward, and what ends an episode.
            task: Task, for the best reward of a step.

        Raises:
            ValueError: If damage or a tangle ends episodes, and no term of the dense reward has a positive weight.
        """
        sparse = settings.reward == "sparse"
        self.offset = task.best_reward if settings.terminate_on_success and not sparse else 0.0
        self._forfeit = 1.0 if sparse else task.best_reward
        self._ends_by_tangle = settings.terminate_on_tangle
        ending = ends_badly(settings)
        if ending and self._forfeit <= 0.0:
            raise ValueError(
                f"task.weights must have a positive one with {ending} and reward='dense', or an end that is not to "
                f"be would cost nothing; got {dict(task.weights)}"
            )

    def charge(self, horizon: int | None) -> float:
        """Cost of an end by damage or a tangle, zero or more, in an episode of a number of control steps."""
        return 0.0 if horizon is None else max(horizon, LEAST_HORIZON) * self._forfeit

    def pay(self, reward: FloatArray, badly: BoolArray, horizon: int | None) -> FloatArray:
        """Compute the reward of a step.

        Args:
            reward: (W,) task rewards.
            badly: (W,) whether the step ends the episode by damage or by a tangle.
            horizon: Number of control steps of an episode.

        Returns:
            (W,) rewards paid.
        """
        return np.where(badly, -self.charge(horizon), reward - self.offset)

    def charged(self, info: Any) -> BoolArray:
        """Tell in which of some steps the charge was paid.

        Args:
            info: Info of the steps: a mapping, of one step or of many, or a sequence of mappings of one step each.
                None, or info without entries on damage, means in none.

        Returns:
            (...) in the shape of `info`.
        """
        if info is None:
            return np.zeros((), dtype=np.bool_)
        if not isinstance(info, Mapping):
            return np.array([bool(self.charged(each)) for each in info], dtype=np.bool_)
        # Without a limit, "is_damaged" is never set.
        badly = np.asarray(info.get("is_damaged", False), dtype=np.bool_)
        return badly | (np.asarray(info.get("tangled", False), dtype=np.bool_) & self._ends_by_tangle)


def ends_badly(settings: EnvSettings) -> str:
    """Name of the option by which an episode can end badly; "" if there is none."""
    for name in LIMITS:
        if getattr(settings, name) is not None:
            return name
    return "terminate_on_tangle" if settings.terminate_on_tangle else ""


def check_horizon(settings: EnvSettings, *, limited: bool) -> None:
    """Check that there is a time limit if an end costs as much as a whole episode.

    Args:
        settings: What ends an episode.
        limited: Whether episodes are truncated.

    Raises:
        ValueError: If there is no time limit.
    """
    ending = ends_badly(settings)
    if ending and not limited:
        raise ValueError(
            f"episode_time must be a number with {ending}, got None: an end by damage or by a tangle costs what a "
            "whole episode does, and without a time limit nothing would be enough"
        )
