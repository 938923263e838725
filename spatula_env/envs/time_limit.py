"""The time limit of episodes, in seconds unless a number of steps is given."""

from __future__ import annotations

import sys
from typing import Any

import gymnasium

from spatula_env.geometry.checks import check_count


def steps_in(time: float | None, period: float) -> int | None:
    """How many control steps of a length [s] fill a time [s], one at least; None where there is no time."""
    return None if time is None else max(1, round(time / period))


def read_step_limit(value: Any) -> int | None:
    """After how many control steps episodes are cut: a number, or None or -1 for never.

    Raises:
        ValueError: If it is something else.
    """
    if value is None or value == -1:
        return None
    check_count(value, "max_episode_steps", 1)
    return int(value)


def told_in_steps(env: gymnasium.Env[Any, Any]) -> int | None:
    """What `gymnasium.make` was told as `max_episode_steps`, if it is making an environment just now.

    That argument does not reach environments: Gymnasium makes a `TimeLimit` of it, or nothing of -1. An environment
    that cuts its episodes itself has to know of it, or the shorter of two limits would hold. So it looks at what calls
    its constructor.

    Args:
        env: In its constructor.

    Returns:
        A number of steps, or -1 for never; None if it was told nothing, or nobody is making the environment so.
    """
    frame = sys._getframe(1)
    while frame is not None and frame.f_locals.get("self") is env:
        frame = frame.f_back  # type: ignore[assignment]
    if frame is None or frame.f_code is not gymnasium.make.__code__:
        return None
    told: int | None = frame.f_locals.get("max_episode_steps")
    return told
