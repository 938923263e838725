"""Arrays that cannot be written to."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray


def read_only(values: ArrayLike, dtype: DTypeLike = np.float64) -> NDArray[np.generic]:
    """Copy values into a contiguous array whose elements cannot be assigned.

    Shapes are shared between simulations, so a write through one of them would change the others.

    Args:
        values: Anything NumPy can turn into an array.
        dtype: Element type of the result.

    Returns:
        A C-contiguous copy that is not writeable, of the shape of ``values``.
    """
    array = np.array(values, dtype=dtype, order="C")
    array.setflags(write=False)
    return array
