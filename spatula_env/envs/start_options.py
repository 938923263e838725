"""Options of an episode's beginning, for `reset(options=...)`."""

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
"""What of an episode's beginning can be chosen."""

ROUNDING = 1e-6
"""By how much a tool may be in the organ, or below the stop above the ground, all the same: single precision [m]."""


def own_options(options: Mapping[str, Any] | None, allowed: tuple[str, ...]) -> dict[str, Any]:
    """The options of a reset that are meant for this package.

    Libraries pass options of their own to every environment; those are ignored, with a warning.

    Args:
        options: Of `reset`.
        allowed: Names of those that there are.

    Returns:
        Those of `options` that are allowed.

    Raises:
        ValueError: If a name looks like one of those allowed, but misspelt, or `options` is no mapping.
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
    """Check what is chosen of an episode's beginning.

    Args:
        options: "goal" (G,) or (W, G), and "tool_position" (3,) or (W, 3) [m].
        worlds: (n,) those in which an episode is to begin; the rows of others are not looked at.
        count: W.
        task: Whose goals they are.
        workspace: Where tools can start.

    Returns:
        What there is of the two, (n, G) and (n, 3).

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
        positions: (n, N, 3) where their tools are then [m].
        orientations: (n, N, 4) how they are turned.
        tool_scale: (n,) how large they are.
        settings: (n,) where the organs are.
        control: Which knows the stop.
        worlds: (n,).

    Raises:
        ValueError: If one does not.
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
