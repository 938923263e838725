"""Limits the number of threads of compiled code."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any


@contextlib.contextmanager
def numba_threads(count: int) -> Iterator[None]:
    """Limit compiled code to a number of threads in this context."""
    import numba

    before = numba.get_num_threads()
    # Annotated as Any for mypy, as Numba fills its configuration at import.
    configuration: Any = numba.config
    numba.set_num_threads(max(1, min(count, configuration.NUMBA_NUM_THREADS)))
    try:
        yield
    finally:
        numba.set_num_threads(before)
