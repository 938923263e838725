"""The number of threads of compiled code."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any


@contextlib.contextmanager
def numba_threads(count: int) -> Iterator[None]:
    """Let compiled code use no more than a number of threads."""
    import numba

    before = numba.get_num_threads()
    # Of any type for mypy: Numba fills its configuration in when it is imported.
    configuration: Any = numba.config
    numba.set_num_threads(max(1, min(count, configuration.NUMBA_NUM_THREADS)))
    try:
        yield
    finally:
        numba.set_num_threads(before)
