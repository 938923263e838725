"""Options that choose an episode's beginning, for `reset(options=...)`."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.geometry.checks import as_floats
from spatula_env.geometry.overlap import overlaps
from spatula_env.geometry.rotations import turn

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray, IntArray
    from spatula_env.envs.control import VelocityControl
    from spatula_env.envs.workspace import Workspace
    from spatula_env.tasks.base import Task
    from spatula_env.tasks.situation import Setting

START_OPTIONS = ("goal", "tool_position")
"""Parts of an episode's beginning that can be chosen."""

ROUNDING = 1e-6
"""Depth by which a tool may be in the organ or below the stop without an error, for single-precision rounding [m]."""


def own_options(options: Mapping[str, Any] | None, allowed: tuple[str, ...]) -> dict[str, Any]:
    """Select the options of a reset that belong to this package.

    Libraries pass options of their own to every environment; those are ignored, with a warning.

    Args:
        options: Options of `reset`.
        allowed: Names of the options of this package.

    Returns:
        Those of `options` that are allowed.

    Raises:
        ValueError: If a name looks like a misspelling of one of those allowed, or `options` is not a mapping.
    """
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise ValueError(f"options must be a mapping or None, got {options!r}")
    foreign = [name for name in options if name not in allowed]
    for name in foreign:
        near = difflib.get_close_matches(str(name), allowed, 1, cutoff=0.75)
        if near:
            raise ValueError(f"options has no {name!r}; did you mean {near[0]!r}?")
    if foreign:
        warnings.warn(
            f"options has no {', '.join(map(repr, foreign))}, which is ignored; there are {', '.join(allowed)}",
            UserWarning,
            stacklevel=4,
        )
    return {name: value for name, value in options.items() if name in allowed}


def chosen_starts(
    options: Mapping[str, Any], worlds: IntArray, count: int, task: Task, workspace: Workspace
) -> dict[str, FloatArray]:
    """Validate the chosen beginnings of episodes.

    Args:
        options: "goal" (G,) or (W, G), and "tool_position" (3,) or (W, 3) [m].
        worlds: (n,) worlds in which an episode is to begin; the rows of others are ignored.
        count: Number of worlds, W.
        task: Task that the goals belong to.
        workspace: Region in which tools can start.

    Returns:
        The given ones of the two, (n, G) and (n, 3).

    Raises:
        ValueError: If an option is malformed or out of its range.
    """
    chosen: dict[str, FloatArray] = {}
    for name, value in options.items():
        size = len(task.goal_names) if name == "goal" else 3
        try:
            array = as_floats(value)
        except ValueError:
            array = np.zeros(0)
        fits = array.shape in ((size,), (count, size))
        rows = np.broadcast_to(array, (count, size))[worlds] if fits else array
        if not fits or not np.isfinite(rows).all():
            each = f", or {count} times {size}" if count > 1 else ""
            raise ValueError(f"options[{name!r}] must be {size} finite numbers{each}, got {value!r}")
        chosen[name] = rows
    for goal in np.unique(chosen.get("goal", np.zeros((0, 1))), axis=0):
        task.check_goal(goal)
    low, high = workspace.low, workspace.high
    for position in chosen.get("tool_position", ()):
        if ((position < low) | (position > high)).any():
            raise ValueError(f"options['tool_position'] must lie in {low} to {high} m, got {position}")
    return chosen


def check_free(
    chosen: FloatArray,
    positions: FloatArray,
    orientations: FloatArray,
    tool_scale: FloatArray,
    settings: Sequence[Setting],
    control: VelocityControl,
    worlds: IntArray,
) -> None:
    """Check that tools begin outside the organ at rest, and above the stop above the ground.

    Args:
        chosen: (n, 3) `options["tool_position"]` of worlds (n,) [m].
        positions: (n, N, 3) resulting positions of the tools [m].
        orientations: (n, N, 4) orientations of the tools.
        tool_scale: (n,) factor on the tools' lengths.
        settings: (n,) settings with the organs.
        control: Control, which knows the stop.
        worlds: (n,) indices of the worlds, for messages.

    Raises:
        ValueError: If a tool does not.
    """
    heights = control.height_above_stop(positions, orientations, tool_scale)
    for row, world in enumerate(worlds.tolist()):
        got = f"got {chosen[row]} in world {world}"
        if heights[row] < -ROUNDING:
            raise ValueError(
                "options['tool_position'] must keep the tools above the stop above the ground, which their lowest "
                f"point would be {-heights[row]:.4f} m below; {got}"
            )
        setting = settings[row]
        for tool, position, orientation in zip(setting.tools, positions[row], orientations[row], strict=True):
            corners = turn(orientation, tool.vertices) + position
            if overlaps(setting.rest_nodes, setting.triangles, corners, tool.triangles, ROUNDING):
                raise ValueError(
                    "options['tool_position'] must keep the tools out of the organ at rest, which one of them "
                    f"overlaps; {got}"
                )
