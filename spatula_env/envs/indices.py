"""Validation of indices, and conversion of masks to indices."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from spatula_env.arrays import IntArray


def indices_below(count: int, value: Any) -> IntArray | None:
    """Indices (n,) of at least one of `count` items; they may be repeated.

    Args:
        count: Number of items.
        value: One index, several of them, or a mask of `count` booleans.

    Returns:
        The indices; None if `value` is anything else, is empty, or has an index outside 0 to `count` - 1.
    """
    try:
        array = np.atleast_1d(np.asarray(value))
    except ValueError:  # ragged
        return None
    if array.dtype == np.bool_ and array.shape == (count,):
        array = np.flatnonzero(array)
    if array.ndim != 1 or array.dtype.kind not in "iu" or not len(array) or array.min() < 0 or array.max() >= count:
        return None
    return array.astype(np.int64)
