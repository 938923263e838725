"""Checks of arguments that select worlds, or give numbers for them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry.checks import as_floats

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.arrays import BoolArray, FloatArray, IntArray

GREATEST_SPEED = 1e4
"""Greatest speed of a tool along an axis [u/s], and of its rotation [rad/s]: 200 m/s in the preset scenes."""


def world_indices(worlds: ArrayLike | None, count: int, *, once: bool = False) -> IntArray:
    """Indices of selected worlds.

    Args:
        worlds: (n,) indices, or (count,) a mask; None: all.
        count: Number of worlds.
        once: Whether each may be named only once, because they are written to.

    Raises:
        ValueError: If there are no such worlds, or, with `once`, one is named twice.
    """
    if worlds is None:
        return np.arange(count)
    array = np.asarray(worlds)
    if array.dtype == np.bool_ and array.shape == (count,):
        return np.flatnonzero(array)
    if array.size == 0:
        return np.zeros(0, dtype=np.int64)
    allowed = f"indices in 0..{count - 1} or a mask of shape ({count},)"
    if array.ndim != 1 or not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"worlds must be {allowed}, got {worlds!r}")
    if array.min() < 0 or array.max() >= count:
        raise ValueError(f"worlds must be {allowed}, got {array.tolist()}")
    if once and len(np.unique(array)) < len(array):
        raise ValueError(f"worlds must be named once each, got {array.tolist()}")
    return array.astype(np.int64)


def one_each(value: ArrayLike, name: str, worlds: IntArray) -> FloatArray:
    """(n,) a finite number for each of some worlds, from a single number or one for each."""
    array = np.asarray(value, dtype=np.float64)
    if array.shape not in ((), (len(worlds),)):
        raise ValueError(f"{name} must be a number or have shape ({len(worlds)},), got {array.shape}")
    array = np.broadcast_to(array, (len(worlds),))
    refuse(~np.isfinite(array), worlds, name, "finite", array)
    return array


def rows_of(value: ArrayLike, name: str, shape: tuple[int, ...], worlds: IntArray) -> FloatArray:
    """Finite numbers of a shape, a row for each of some worlds; an array of its own."""
    try:
        array = np.ascontiguousarray(as_floats(value))
    except ValueError as error:
        raise ValueError(f"{name} must be numbers of shape {shape}, got {value!r}") from error
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    bad = ~np.isfinite(array).reshape(len(array), -1).all(axis=1)
    if bad.any():
        raise ValueError(f"{name} must be finite, in world {worlds[int(np.argmax(bad))]} they are not")
    return array


def check_speeds(array: FloatArray, name: str, unit: str) -> None:
    """Check that velocities (..., 3) are such that a step takes no more than a moment.

    Args:
        array: The velocities, finite.
        name: Name of the argument.
        unit: Unit of the velocities.

    Raises:
        ValueError: If a component is greater than `GREATEST_SPEED`.
    """
    fastest = float(np.abs(array).max(initial=0.0))
    if fastest > GREATEST_SPEED:
        raise ValueError(
            f"{name} must be at most {GREATEST_SPEED:g} {unit} along each axis, got {fastest:g}: contact is looked for "
            f"each time a tool has moved by half its thickness"
        )


def refuse(bad: BoolArray, worlds: IntArray, name: str, allowed: str, values: FloatArray | None = None) -> None:
    """Raise a ValueError that names the first world with a bad value, if there is one."""
    if bad.any():
        first = int(np.argmax(bad))
        got = "" if values is None else f", got {values[first]:g}"
        raise ValueError(f"{name} must be {allowed}, in world {worlds[first]} it is not{got}")
