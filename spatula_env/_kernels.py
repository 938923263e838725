"""Numba's decorator with the settings and the types the package uses.

Kernels are compiled for the signature written beside them when their module is imported, or when they are first called
where that is rare or before a simulation begins, and kept in Numba's on-disk cache. `fastmath` stays off: the ray test
relies on IEEE arithmetic (see `spatula_env.contact.raycast`) and results must not depend on how the compiler regroups
sums.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba import types
from numba.core import event

from spatula_env._compilation import COMPILE, Announcer, find_cache

Function = TypeVar("Function", bound=Callable[..., object])

CACHE = find_cache()
"""Where compiled kernels are kept."""

event.register(COMPILE, Announcer(CACHE))  # type: ignore[no-untyped-call]

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
    return cast("Callable[[Function], Function]", numba.njit(list(signatures), cache=CACHE.kept, error_model="numpy"))


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
                compiled.append(kernel(*signatures)(function))
            return compiled[0](*arguments)

        return call

    return decorate


def late_kernel(function: Function) -> Function:
    """Compile a function when it is first called: for what only some of those need who import its module."""
    return cast("Function", numba.njit(cache=CACHE.kept, error_model="numpy")(function))


def inline_kernel(function: Function) -> Function:
    """Compile a small helper that only other kernels call; LLVM inlines it where that pays."""
    return cast("Function", numba.njit(cache=CACHE.kept, error_model="numpy")(function))
