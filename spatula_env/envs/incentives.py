"""What the ends of episodes pay, so that no end is worth more than going on, and success is worth all that staying is.

An end takes away what the rest of the episode would have paid. Where rewards are positive, an agent then does best to
stay short of success for ever; where they are negative, to damage the organ at once. Two rules keep that from paying,
whatever the learner's discount, and whether or not it thinks beyond the time limit:

- Where success ends an episode, each step of the dense reward pays what it falls short of the best step by. That is
  zero at best, and zero is what an episode that is over goes on to pay: success is worth what the best of stays is.
- An end by damage or by a tangle pays what a whole episode costs in which nothing is achieved, and nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from spatula_env.arrays import BoolArray, FloatArray
    from spatula_env.envs.settings import EnvSettings
    from spatula_env.tasks.base import Task


class Incentives:
    """What steps pay in which episodes may end.

    Attributes:
        offset: What is taken from the dense reward of each step, so that it is zero at best; zero where success does
            not end episodes, and in the sparse reward, which is zero at best anyway.
    """

    def __init__(self, settings: EnvSettings, task: Task) -> None:
        """Weigh the ends.

        Args:
            settings: Which reward there is, and what ends an episode.
            task: For the best reward of a step.

        Raises:
            ValueError: If damage or a tangle ends episodes, and no term of the dense reward can be gained.
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
        """What an end by damage or a tangle costs, zero or more, in an episode of so many control steps."""
        return 0.0 if horizon is None else horizon * self._forfeit

    def pay(self, reward: FloatArray, badly: BoolArray, horizon: int | None) -> FloatArray:
        """What a step pays.

        Args:
            reward: (W,) of what was reached in it.
            badly: (W,) whether it ends the episode by damage or by a tangle.
            horizon: Control steps of an episode.

        Returns:
            (W,).
        """
        return np.where(badly, -self.charge(horizon), reward - self.offset)

    def charged(self, info: Any) -> BoolArray:
        """In which of some steps the charge was paid.

        Args:
            info: What the environment told in them: a mapping, of one step or of many at once, or a sequence of
                mappings of one each. None, or without what tells of damage: in none.

        Returns:
            (...) as `info` has it.
        """
        if info is None:
            return np.zeros((), dtype=np.bool_)
        if not isinstance(info, Mapping):
            return np.array([bool(self.charged(each)) for each in info], dtype=np.bool_)
        # Without a limit nothing is ever told to be damaged.
        badly = np.asarray(info.get("is_damaged", False), dtype=np.bool_)
        return badly | (np.asarray(info.get("tangled", False), dtype=np.bool_) & self._ends_by_tangle)


def ends_badly(settings: EnvSettings) -> str:
    """By which option an episode can end that is not to end so; "" if by none."""
    if settings.damage_limit is not None:
        return "damage_limit"
    return "terminate_on_tangle" if settings.terminate_on_tangle else ""


def check_horizon(settings: EnvSettings, *, limited: bool) -> None:
    """Check that there is a time limit where an end costs what an episode does.

    Args:
        settings: What ends an episode.
        limited: Whether episodes are cut.

    Raises:
        ValueError: If there is none.
    """
    ending = ends_badly(settings)
    if ending and not limited:
        raise ValueError(
            f"episode_time must be a number with {ending}, got None: an end by damage or by a tangle costs what a "
            "whole episode does, and without a time limit nothing would be enough"
        )
