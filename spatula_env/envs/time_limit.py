"""The time limit of episodes, in seconds unless a number of steps is given."""

from __future__ import annotations

import sys
from typing import Any

import gymnasium

from spatula_env.geometry.checks import check_count


def steps_in(time: float | None, period: float) -> int | None:
    """Number of control steps of a length [s] that fill a time [s], at least one; None if there is no time limit."""
    return None if time is None else max(1, round(time / period))


def read_step_limit(value: Any) -> int | None:
    """Convert a limit on the number of control steps: a number, or None or -1 for no limit.

    Raises:
        ValueError: If it is anything else.
    """
    if value is None or value == -1:
        return None
    check_count(value, "max_episode_steps", 1)
    return int(value)


def told_in_steps(env: gymnasium.Env[Any, Any]) -> int | None:
    """Find out which `max_episode_steps` was passed to `gymnasium.make`, if it is making an environment just now.

    That argument does not reach environments: Gymnasium makes a `TimeLimit` of it, or ignores it if it is -1. An
    environment that truncates its episodes itself has to know it, or the shorter of two limits would apply. So this
    function inspects the stack frame that calls the environment's constructor.

    Args:
        env: Environment that is being constructed.

    Returns:
        A number of steps, or -1 for no limit; None if nothing was passed, or `gymnasium.make` is not making it.
    """
    frame = sys._getframe(1)
    while frame is not None and frame.f_locals.get("self") is env:
        frame = frame.f_back  # type: ignore[assignment]
    if frame is None or frame.f_code is not gymnasium.make.__code__:
        return None
    told: int | None = frame.f_locals.get("max_episode_steps")
    return told
