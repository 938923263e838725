"""Numba's decorator with the settings and the types the package uses.

Kernels are compiled, or loaded from Numba's on-disk cache, when they are first needed, each for the signatures given to
its decorator: a process pays only for the few that it calls. `fastmath` stays off: the ray test relies on IEEE
arithmetic (see `spatula_env.contact.raycast`), and results must not depend on how the compiler regroups sums.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import numba
from numba import types
from numba.core import event

from spatula_env._compilation import COMPILE, Announcer, find_cache
from spatula_env._kernel_cache import KernelCache

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
    "i8_2": types.int64[:, ::1],
    "u1": types.uint8[::1],
    "b1": types.boolean[::1],
    "b1_2": types.boolean[:, ::1],
}
"""Types of C-contiguous arrays by element and number of dimensions."""


class Kernel:
    """A function that Numba compiles when it is first needed: called, or compiled into another kernel that calls it.

    Attributes:
        py_func: The Python function; Numba's dispatchers have an attribute of the same name.
        counts: Whether references to arrays are counted, which a function that creates arrays requires.
    """

    def __init__(
        self, function: Callable[..., object], signatures: Sequence[Any], nogil: bool, counts: bool = True
    ) -> None:
        """Wrap a function without compiling it yet.

        Args:
            function: The function to compile.
            signatures: Signatures to compile it for; without any, it is compiled for those with which it is called.
            nogil: Whether other Python threads may run meanwhile.
            counts: Whether references to arrays are counted, which a function that creates arrays requires.
        """
        functools.update_wrapper(self, function)
        self.py_func = function
        self._signatures = list(signatures)
        self._nogil, self.counts = nogil, counts

    @functools.cached_property
    def dispatcher(self) -> Any:
        """Numba's dispatcher, compiled for the signatures."""
        # The last option is in Numba's list of them, but not in its stubs.
        options: dict[str, Any] = {"error_model": "numpy", "nogil": self._nogil, "_nrt": self.counts}
        made: Any = numba.njit(**options)(self.py_func)
        if CACHE.kept:
            made._cache = KernelCache(self.py_func)
        for signature in self._signatures:
            made.compile(signature)
        if self._signatures:
            made.disable_compile()
        return made

    def compile(self) -> None:
        """Compile the kernel now, unless that has been done or it has no signatures."""
        if self._signatures:
            _ = self.dispatcher

    @property
    def _numba_type_(self) -> Any:
        # Numba asks for this where another kernel refers to this one.
        return types.Dispatcher(self.dispatcher)

    def __call__(self, *arguments: Any) -> Any:
        """Call the compiled function."""
        return self.dispatcher(*arguments)


def kernel(*signatures: Any, nogil: bool = False) -> Callable[[Callable[..., object]], Callable[..., Any]]:
    """Compile a function for the given Numba signatures, and only for those.

    Args:
        *signatures: Numba signatures, as strings such as ``"f8(f8[::1], i4)"`` or as objects. Without any, the function
            is compiled for those with which it is called: this is for helpers, which LLVM inlines where that pays, and
            for functions in several precisions, of which a process needs only one.
        nogil: Whether other Python threads may run meanwhile.

    Returns:
        A decorator that makes a `Kernel`.
    """
    return lambda function: Kernel(function, signatures, nogil)


def inline_kernel(function: Function) -> Function:
    """Compile a small helper that only other kernels call, for the types with which they call it."""
    return cast("Function", Kernel(function, (), nogil=False))


def array_kernel(function: Function) -> Function:
    """Compile a small helper that other kernels call, which neither creates arrays nor takes them out of structures.

    References to its array arguments are not counted: counting is atomic, and in a helper that is called for every pair
    of features it took a third of the total time.
    """
    return cast("Function", Kernel(function, (), nogil=False, counts=False))
