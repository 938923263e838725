"""Numba's decorator with the settings and the types the package uses.

Every kernel is compiled for the signature written beside it when its module is imported, and kept in Numba's on-disk
cache, so that nothing is compiled in the middle of a simulation. `fastmath` stays off: the ray test relies on
IEEE arithmetic (see `spatula_env.contact.raycast`) and results must not depend on how the compiler regroups sums.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])


def kernel(*signatures: str) -> Callable[[Callable[..., object]], Callable[..., Any]]:
    """Compile a function ahead of time for the given Numba signatures.

    Args:
        *signatures: Numba signature strings, such as ``"f8(f8[::1], i4)"``.

    Returns:
        A decorator that keeps the function's Python type for the type checker.
    """
    return cast("Callable[[Function], Function]", numba.njit(list(signatures), cache=True, error_model="numpy"))


def inline_kernel(function: Function) -> Function:
    """Compile a small helper that only other kernels call; LLVM inlines it where that pays."""
    return cast("Function", numba.njit(cache=True, error_model="numpy")(function))
