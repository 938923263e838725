"""Wrappers that a dataset may name: a dataset may come from an untrusted source, and gives them their arguments."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

import gymnasium
from gymnasium import wrappers

HARMLESS = (
    "AddRenderObservation",
    "AddWhiteNoise",
    "AtariPreprocessing",
    "Autoreset",
    "ClipAction",
    "ClipReward",
    "DelayObservation",
    "DiscretizeAction",
    "DiscretizeObservation",
    "DtypeObservation",
    "FilterObservation",
    "FlattenObservation",
    "FrameStackObservation",
    "GrayscaleObservation",
    "MaxAndSkipObservation",
    "NormalizeObservation",
    "NormalizeReward",
    "ObstructView",
    "OrderEnforcing",
    "PassiveEnvChecker",
    "RecordEpisodeStatistics",
    "RenderCollection",
    "RepeatAction",
    "RescaleAction",
    "RescaleObservation",
    "ReshapeObservation",
    "ResizeObservation",
    "StickyAction",
    "TimeAwareObservation",
    "TimeLimit",
)
"""Gymnasium's wrappers that write nothing, and call nothing that their arguments name."""
OWN = (
    "spatula_env.envs.adapters.masa:LabelsWrapper",
    "spatula_env.envs.adapters.safety_gymnasium:SafetyGymnasiumWrapper",
)
"""This package's wrappers that a dataset may name."""
NEUTRAL = (
    "Autoreset",
    "ClipReward",
    "HumanRendering",
    "NormalizeReward",
    "OrderEnforcing",
    "PassiveEnvChecker",
    "RecordEpisodeStatistics",
    "RecordVideo",
    "RenderCollection",
    "TimeLimit",
    "TransformReward",
)
"""Gymnasium's wrappers that change neither observations nor actions, nor their spaces."""
NEUTRAL_OWN = (*OWN, "spatula_env.teleop.wrapper:FalconTeleop")
"""This package's wrappers of that kind. In teleoperation the actions are the operator's, but of the same kind."""

Wrapper = type[gymnasium.Wrapper[Any, Any, Any, Any]]


def allowed_wrapper(entry_point: str, named: Sequence[Wrapper] = ()) -> str:
    """The entry point of a wrapper that a dataset names, if it is allowed.

    Args:
        entry_point: Entry point in the dataset, "module:class".
        named: Wrappers that the caller allows.

    Returns:
        The entry point with the class's own module, which is of Gymnasium, of this package, or of `named`.

    Raises:
        ValueError: If it is not allowed; says how to allow it.
    """
    known = {_entry_point(found): found for found in (*_gymnasium_wrappers(), *named)}
    module, _, name = entry_point.partition(":")
    short = getattr(wrappers, name) if module == "gymnasium.wrappers" and name in HARMLESS else None
    found = short if short is not None else known.get(entry_point)
    if found is not None:
        return _entry_point(found)
    if entry_point in OWN:
        return entry_point
    raise ValueError(
        f"the dataset was recorded in the wrapper {entry_point!r}, which may do anything with the arguments that the "
        "dataset gives it. If you trust the dataset, allow it: replay(..., wrappers=[THE_CLASS]), or --wrapper "
        f"{entry_point} on the command line"
    )


def is_of_gymnasium(entry_point: str) -> bool:
    """Whether a wrapper that a dataset names is one of Gymnasium's own; nothing is imported."""
    return entry_point.partition(":")[0].partition(".")[0] == "gymnasium"


def is_neutral(entry_point: str) -> bool:
    """Whether a wrapper that a dataset names is known to leave observations, actions and their spaces unchanged.

    Args:
        entry_point: Entry point in the dataset, "module:class"; nothing is imported.
    """
    # Identified by the entry point, because the name may be anything.
    name = entry_point.partition(":")[2]
    return (is_of_gymnasium(entry_point) and name in NEUTRAL) or entry_point in NEUTRAL_OWN


def import_wrapper(name: str) -> Wrapper:
    """Import a wrapper that the user names.

    Args:
        name: "module:class".

    Raises:
        ImportError: If the module cannot be imported.
        ValueError: If there is no such wrapper in it.
    """
    module, _, inner = name.partition(":")
    found: Any = None
    if module and inner:
        found = getattr(importlib.import_module(module), inner, None)
    if not (isinstance(found, type) and issubclass(found, gymnasium.Wrapper)):
        raise ValueError(f"a wrapper must be MODULE:CLASS, of a gymnasium.Wrapper, got {name!r}")
    return found


def _gymnasium_wrappers() -> list[Wrapper]:
    # Older versions of Gymnasium do not have all of them.
    return [getattr(wrappers, name) for name in HARMLESS if hasattr(wrappers, name)]


def _entry_point(wrapper: Wrapper) -> str:
    return f"{wrapper.__module__}:{wrapper.__qualname__}"
