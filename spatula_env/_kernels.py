"""Numba's decorator with the settings and the types the package uses.

Kernels are compiled for the signature written beside them when their module is imported, or when they are first called
where that is rare or before a simulation begins, and kept in Numba's on-disk cache. `fastmath` stays off: the ray test
relies on IEEE arithmetic (see `spatula_env.contact.raycast`) and results must not depend on how the compiler regroups
sums.
"""

from __future__ import annotations

import functools
import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar, cast

import numba
from numba import types

Function = TypeVar("Function", bound=Callable[..., object])

ARRAYS: dict[str, Any] = {
    "f8": types.float64[::1],
    "f8_2": types.float64[:, ::1],
    "f8_3": types.float64[:, :, ::1],
    "i4": types.int32[::1],
    "i4_2": types.int32[:, ::1],
    "i4_3": types.int32[:, :, ::1],
    "i8": types.int64[::1],
    "u1": types.uint8[::1],
    "b1": types.boolean[::1],
    "b1_2": types.boolean[:, ::1],
}
"""Types of C-contiguous arrays by element and number of dimensions."""


def kernel(*signatures: Any) -> Callable[[Callable[..., object]], Callable[..., Any]]:
    """Compile a function ahead of time for the given Numba signatures.

    Args:
        *signatures: Numba signatures, as strings such as ``"f8(f8[::1], i4)"`` or as objects.

    Returns:
        A decorator that keeps the function's Python type for the type checker.
    """
    return cast("Callable[[Function], Function]", numba.njit(list(signatures), cache=True, error_model="numpy"))


def kernel_on_demand(*signatures: Any) -> Callable[[Callable[..., object]], Callable[..., Any]]:
    """Compile a function for the given Numba signatures when it is first called, and only for those; see `kernel`.

    Args:
        *signatures: As of `kernel`.

    Returns:
        A decorator. What it gives is called from Python, not from other kernels.
    """

    def decorate(function: Callable[..., object]) -> Callable[..., Any]:
        compiled: list[Callable[..., Any]] = []

        @functools.wraps(function)
        def call(*arguments: Any) -> Any:
            if not compiled:
                with announce_compilation():
                    compiled.append(kernel(*signatures)(function))
            return compiled[0](*arguments)

        return call

    return decorate


def late_kernel(function: Function) -> Function:
    """Compile a function when it is first called: for what only some of those need who import its module."""
    return cast("Function", numba.njit(cache=True, error_model="numpy")(function))


def inline_kernel(function: Function) -> Function:
    """Compile a small helper that only other kernels call; LLVM inlines it where that pays."""
    return cast("Function", numba.njit(cache=True, error_model="numpy")(function))


PATIENCE = 2.0
"""What takes longer than this is not loaded from the cache but compiled [s]."""


_announced: ContextVar[bool] = ContextVar("announced", default=False)
"""Whether this is done within `announce_compilation` already."""


@contextmanager
def announce_compilation(what: str = "the contact model") -> Iterator[None]:
    """Say what the wait is for, if what is done in this context turns out to need compilation.

    Args:
        what: Whose kernels they are.
    """
    if _announced.get():
        yield
        return
    message = f"spatula_env is compiling {what}, once after installation. This can take half a minute."
    timer = threading.Timer(PATIENCE, logging.getLogger("spatula_env").warning, (message,))
    timer.daemon = True
    timer.start()
    token = _announced.set(True)
    try:
        yield
    finally:
        _announced.reset(token)
        timer.cancel()
