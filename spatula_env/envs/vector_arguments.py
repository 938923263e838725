"""What callers of vector environments say: which worlds, which seeds, what happens at an episode's end."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.vector import AutoresetMode

from spatula_env.envs.start_options import START_OPTIONS, own_options

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.tasks.situation import IntArray

AUTORESET_MODES = tuple(mode.name.lower() for mode in AutoresetMode)
"""Names of what can happen when an episode has ended."""


def as_autoreset_mode(value: str | AutoresetMode) -> AutoresetMode:
    """An autoreset mode from its name, from Gymnasium's value for it, or from itself.

    Raises:
        ValueError: If it is none.
    """
    for mode in AutoresetMode:
        if value in (mode, mode.name.lower(), mode.value):
            return mode
    raise ValueError(f"autoreset_mode must be one of {list(AUTORESET_MODES)} or an AutoresetMode, got {value!r}")


def read_mask(options: Mapping[str, Any] | None, count: int) -> tuple[IntArray, dict[str, Any]]:
    """In which of `count` worlds episodes are to begin (n,), and what is chosen of the beginning.

    Raises:
        ValueError: If an option is misspelt, or "reset_mask" is no mask.
    """
    rest = own_options(options, (*START_OPTIONS, "reset_mask"))
    mask = rest.pop("reset_mask", None)
    if mask is None:
        return np.arange(count), rest
    array = np.asarray(mask)
    if array.dtype != np.bool_ or array.shape != (count,) or not array.any():
        raise ValueError(f"options['reset_mask'] must be {count} booleans of which one is true at least, got {mask!r}")
    return np.flatnonzero(array), rest


def read_seeds(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """The seed of each of `count` worlds.

    Raises:
        ValueError: If they are no seeds, or not as many.
    """
    if seed is None:
        return [None] * count
    try:
        if not isinstance(seed, Sequence | np.ndarray):
            first = operator.index(seed)
            seeds: list[int | None] = [first + world for world in range(count)]
        else:
            seeds = [None if one is None else operator.index(one) for one in seed]
    except TypeError:
        raise ValueError(f"seed must be an integer, a sequence of them, or None, got {seed!r}") from None
    if len(seeds) != count:
        raise ValueError(f"seed must be an integer or a sequence of {count}, got {len(seeds)}")
    if any(one is not None and one < 0 for one in seeds):
        raise ValueError(f"seed must not be negative, got {seed!r}")
    return seeds


def read_worlds(worlds: ArrayLike | None, count: int) -> IntArray:
    """Indices (n,) of worlds that are named by indices or by a mask (W,); all W of them by default.

    Raises:
        ValueError: If there are no such worlds, or one is named twice.
    """
    if worlds is None:
        return np.arange(count)
    array = np.atleast_1d(np.asarray(worlds))
    if array.dtype == np.bool_ and array.shape == (count,):
        array = np.flatnonzero(array)
    distinct = array.ndim == 1 and array.dtype.kind in "iu" and len(set(array.tolist())) == len(array) > 0
    if not distinct or array.min() < 0 or array.max() >= count:
        raise ValueError(f"worlds must be different indices from 0 to {count - 1} or {count} booleans, got {worlds!r}")
    return array.astype(np.int64)
