"""What differs from episode to episode besides the goal and the start."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from spatula_env.tasks.base import check_range

Ranges = Mapping[str, tuple[float, float]]
"""Least and greatest value of each thing that is drawn at random, uniformly, in each episode."""

NEUTRAL: Mapping[str, float] = MappingProxyType(
    {
        "stiffness": 1.0,
        "friction": 1.0,
        "organ_size": 1.0,
        "organ_x": 0.0,
        "organ_y": 0.0,
        "organ_yaw": 0.0,
        "tool_size": 1.0,
        "sensor_noise": 0.0,
        "action_delay": 0.0,
    }
)
"""What can be drawn at random, and what each is where it is not.

- stiffness: factor on the organ's stiffness and its density. In Bullet's soft body the two cannot be told apart: links
  have one stiffness, and what they resist with grows with the masses at their ends.
- friction: factor on the coefficients between tools and organ.
- organ_size: factor on the organ's lengths, about the middle of its top; its material stays the same.
- organ_x, organ_y: shift of the organ in the workspace [m].
- organ_yaw: turn of the organ about the vertical [rad].
- tool_size: factor on the tools' lengths.
- sensor_noise: replaces `observation.noise`.
- action_delay: after how many control steps an action is carried out, a whole number.
"""

LEAST: Mapping[str, float] = MappingProxyType(
    {
        "stiffness": 0.05,
        "friction": 0.0,
        "organ_size": 0.5,
        "organ_x": -0.02,
        "organ_y": -0.02,
        "organ_yaw": -np.pi,
        "tool_size": 0.5,
        "sensor_noise": 0.0,
        "action_delay": 0.0,
    }
)
"""Least values allowed."""

GREATEST: Mapping[str, float] = MappingProxyType(
    {
        "stiffness": 20.0,
        "friction": 10.0,
        "organ_size": 2.0,
        "organ_x": 0.02,
        "organ_y": 0.02,
        "organ_yaw": np.pi,
        "tool_size": 2.0,
        "sensor_noise": 100.0,
        "action_delay": 20.0,
    }
)
"""Greatest values allowed."""

DEFAULT_RANGES: Ranges = MappingProxyType(
    {
        "stiffness": (0.7, 1.4),
        "friction": (0.5, 1.5),
        "organ_size": (0.95, 1.05),
        "organ_x": (-0.004, 0.004),
        "organ_y": (-0.004, 0.004),
        "tool_size": (0.95, 1.05),
        "sensor_noise": (0.0, 1.0),
        "action_delay": (0.0, 1.0),
    }
)
"""Of `randomization="default"` where a task does not say otherwise."""


def read_ranges(value: Any, default: Ranges) -> dict[str, tuple[float, float]]:
    """What the option `randomization` means.

    Args:
        value: "none", "default", or a mapping from names to two numbers, or to one that does not vary.
        default: Of "default".

    Returns:
        The range of each thing that is drawn.

    Raises:
        ValueError: If it is something else, there is no such thing, or a range is out of what is allowed.
    """
    if isinstance(value, str) and value in ("none", "default"):
        return dict(default) if value == "default" else {}
    if not isinstance(value, Mapping):
        raise ValueError(f"randomization must be 'none', 'default' or a mapping, got {value!r}")
    unknown = sorted(str(name) for name in value if name not in NEUTRAL)
    if unknown:
        raise ValueError(f"randomization has no {', '.join(unknown)}; allowed are {', '.join(sorted(NEUTRAL))}")
    ranges: dict[str, tuple[float, float]] = {}
    for name, given in value.items():
        pair = (given, given) if isinstance(given, int | float) else given
        low, high = check_range(pair, f"randomization.{name}")
        if low < LEAST[name] or high > GREATEST[name]:
            raise ValueError(f"randomization.{name} must lie in {LEAST[name]:g} to {GREATEST[name]:g}, got {given!r}")
        if name == "action_delay" and (low != round(low) or high != round(high)):
            raise ValueError(f"randomization.action_delay must be whole numbers, got {given!r}")
        ranges[name] = (low, high)
    return ranges


def draw(ranges: Ranges, generator: np.random.Generator) -> dict[str, float]:
    """Draw everything once: all that can be drawn, by name."""
    values = dict(NEUTRAL)
    for name, (low, high) in ranges.items():
        if name == "action_delay":
            values[name] = float(generator.integers(int(low), int(high) + 1))
        else:
            values[name] = float(generator.uniform(low, high))
    return values
