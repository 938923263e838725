"""Wrappers that a dataset may name: a dataset may come from anywhere, and gives them their arguments."""

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
"""Gymnasium's that write nothing and call nothing that they are told to."""
OWN = (
    "spatula_env.envs.adapters.masa:LabelsWrapper",
    "spatula_env.envs.adapters.safety_gymnasium:SafetyGymnasiumWrapper",
)
"""This package's."""
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
"""Gymnasium's that change neither observations nor actions, nor their spaces."""
NEUTRAL_OWN = (*OWN, "spatula_env.teleop.wrapper:FalconTeleop")
"""This package's likewise. In teleoperation actions are the operator's, but of the same kind."""

Wrapper = type[gymnasium.Wrapper[Any, Any, Any, Any]]


def allowed_wrapper(entry_point: str, named: Sequence[Wrapper] = ()) -> str:
    """What makes a wrapper that a dataset names.

    Args:
        entry_point: As the dataset has it, "module:class".
        named: Those that the caller allows.

    Returns:
        The same, as the module itself calls it. It is a module of Gymnasium, of this package, or of `named`.

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
    """Whether a wrapper that a dataset names is known to leave observations, actions and their spaces as they are.

    Args:
        entry_point: As the dataset has it, "module:class"; nothing is imported.
    """
    # By what it is made by: its name is only said.
    name = entry_point.partition(":")[2]
    return (is_of_gymnasium(entry_point) and name in NEUTRAL) or entry_point in NEUTRAL_OWN


def import_wrapper(name: str) -> Wrapper:
    """The wrapper that the user names.

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
    # Older versions do not have all.
    return [getattr(wrappers, name) for name in HARMLESS if hasattr(wrappers, name)]


def _entry_point(wrapper: Wrapper) -> str:
    return f"{wrapper.__module__}:{wrapper.__qualname__}"
