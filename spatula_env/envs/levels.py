"""Levels of difficulty: for each, what the options of an environment are by default."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from spatula_env.pressure_limits import HARMFUL_PRESSURE

LEVELS = ("easy", "standard", "hard")
"""Levels, from the easiest on."""

SPLITS = ("train", "test")
"""Organs that are drawn for training, and organs that are held out from it."""

HARD_RANGES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "stiffness": (0.5, 2.0),
        "friction": (0.4, 1.8),
        "organ_size": (0.93, 1.07),
        "organ_x": (-0.006, 0.006),
        "organ_y": (-0.006, 0.006),
        "tool_size": (0.93, 1.07),
        "sensor_noise": (0.5, 1.5),
        "action_delay": (0.0, 0.05),
        "breathing": (0.0, 0.002),
        "pulse": (0.0, 0.0003),
    }
)
"""What the level "hard" draws. The stiffness spans what the regions of the human brain do, whose shear moduli are from
0.4 to 1.3 kPa (`Material.brain`)."""

HELD_OUT: Mapping[str, tuple[float, float]] = MappingProxyType({"stiffness": (0.35, 0.5), "organ_size": (1.07, 1.12)})
"""What the split "test" draws instead: organs softer and larger than any of the other split, at every level. Much
stiffer ones cannot be moved within the tools' greatest forces."""


@dataclass(frozen=True)
class Level:
    """A level of a task.

    Attributes:
        options: Defaults of the environment's options at this level, by name.
        ranges: What `randomization="default"` draws at this level; None for the ranges of the `Definition`.
        held_out: Ranges that replace these, or are added, in the split "test".
        material_options: Defaults that replace `options` with engines that tell strains, whose organs have a material.
    """

    options: Mapping[str, Any] = field(default_factory=dict)
    ranges: Mapping[str, tuple[float, float]] | None = None
    held_out: Mapping[str, tuple[float, float]] = field(default_factory=lambda: dict(HELD_OUT))
    material_options: Mapping[str, Any] = field(default_factory=dict)


def standard_level(**options: Any) -> Level:
    """Make a level that draws the task's default ranges.

    Args:
        **options: Further defaults of options.
    """
    return Level(options={"randomization": "default", **options})


def hard_level(
    ranges: Mapping[str, tuple[float, float]] = HARD_RANGES, *, strain_limit: float | None = None, **options: Any
) -> Level:
    """Make a level that draws more, in which agents see what sensors tell and a harmful pressure ends the episode.

    Args:
        ranges: What is drawn.
        strain_limit: Limit with engines that tell strains, instead of that of the pressure. Under a rigid rim, the
            pressure on a material grows without bound as its mesh becomes finer; the strain hardly does.
        **options: Further defaults of options.
    """
    below = {"randomization": "default", "observation": {"parts": "sensors"}, "pressure_limit": HARMFUL_PRESSURE}
    on_material = {"pressure_limit": None, "strain_limit": strain_limit}
    return Level(options={**below, **options}, ranges=ranges, material_options=on_material)


def default_levels() -> dict[str, Level]:
    """Levels of a task that says nothing else."""
    return {"easy": Level(), "standard": standard_level(), "hard": hard_level()}


def merged(defaults: Mapping[str, Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """Options, completed by defaults; fields of options that are mappings are completed one by one."""
    values = {**defaults, **options}
    for name in ("task", "observation"):
        below, above = defaults.get(name), options.get(name)
        if isinstance(below, Mapping) and (above is None or isinstance(above, Mapping)):
            values[name] = {**below, **(above or {})}
    return values
