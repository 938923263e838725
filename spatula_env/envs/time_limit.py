"""When episodes are cut."""

from __future__ import annotations

from typing import Any

from spatula_env.geometry.checks import check_count


def read_step_limit(value: Any) -> int | None:
    """After how many control steps episodes are cut, in Gymnasium's words: a number, or None or -1 for never.

    Raises:
        ValueError: If it is something else.
    """
    if value is None or value == -1:
        return None
    check_count(value, "max_episode_steps", 1)
    return int(value)
