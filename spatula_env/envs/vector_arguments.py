"""Validation of the arguments of vector environments: worlds, seeds, autoreset modes."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.vector import AutoresetMode

from spatula_env.envs.indices import indices_below
from spatula_env.envs.start_options import START_OPTIONS, own_options

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.arrays import IntArray

AUTORESET_MODES = tuple(mode.name.lower() for mode in AutoresetMode)
"""Names of the autoreset modes."""


def as_autoreset_mode(value: str | AutoresetMode) -> AutoresetMode:
    """Convert to an autoreset mode, from its name, from Gymnasium's value for it, or from itself.

    Raises:
        ValueError: If it is none of these.
    """
    if isinstance(value, str):
        for mode in AutoresetMode:
            if value in (mode.name.lower(), mode.value):
                return mode
    if isinstance(value, AutoresetMode):
        return value
    raise ValueError(f"autoreset_mode must be one of {list(AUTORESET_MODES)} or an AutoresetMode, got {value!r}")


def read_mask(options: Mapping[str, Any] | None, count: int) -> tuple[IntArray, dict[str, Any]]:
    """Worlds (n,) of `count` in which episodes are to begin, and the remaining options.

    Raises:
        ValueError: If an option is misspelt, or "reset_mask" is not a mask.
    """
    rest = own_options(options, (*START_OPTIONS, "reset_mask"))
    mask = rest.pop("reset_mask", None)
    if mask is None:
        return np.arange(count), rest
    try:
        array = np.asarray(mask)
    except ValueError:  # ragged
        array = np.empty(0)
    if array.dtype != np.bool_ or array.shape != (count,) or not array.any():
        raise ValueError(f"options['reset_mask'] must be {count} booleans of which one is true at least, got {mask!r}")
    return np.flatnonzero(array), rest


def read_seeds(seed: int | Sequence[int | None] | None, count: int, worlds: IntArray) -> dict[int, int | None]:
    """Seeds of some of `count` worlds (n,), by world; those of others are ignored.

    Raises:
        ValueError: If they are not seeds, or not as many as there are worlds.
    """
    if seed is None:
        return dict.fromkeys(worlds.tolist())
    try:
        if isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str):
            if len(seed) != count:
                raise ValueError(f"seed must be an integer or a sequence of {count}, got {len(seed)} seeds")
            chosen = [seed[world] for world in worlds.tolist()]
            seeds = [None if one is None else operator.index(one) for one in chosen]
        else:
            first = operator.index(seed)
            if first < 0:
                raise ValueError(f"seed must not be negative, got {seed!r}")
            seeds = [first + world for world in worlds.tolist()]
    except TypeError:
        raise ValueError(f"seed must be an integer, a sequence of them, or None, got {seed!r}") from None
    if any(one is not None and one < 0 for one in seeds):
        raise ValueError(f"seed must not be negative, got {seed!r}")
    return dict(zip(worlds.tolist(), seeds, strict=True))


def read_worlds(worlds: ArrayLike | None, count: int) -> IntArray:
    """Indices (n,) of worlds from indices or a mask (W,); all W of them by default.

    Raises:
        ValueError: If a world does not exist, or is given twice.
    """
    if worlds is None:
        return np.arange(count)
    chosen = indices_below(count, worlds)
    if chosen is None or len(set(chosen.tolist())) != len(chosen):
        raise ValueError(f"worlds must be different indices from 0 to {count - 1} or {count} booleans, got {worlds!r}")
    return chosen
