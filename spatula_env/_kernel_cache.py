"""Numba's on-disk cache, extended to notice changes in the code that a kernel calls.

Numba reuses compiled code as long as the file of the kernel itself is unchanged. What is compiled into the kernel from
other files, such as the helpers that it calls and the constants that it names, may have changed since: after an edit of
such a file, or an update of the package, the outdated code would silently be used. Here the code of everything that a
kernel reaches is part of the stamp that the cache compares.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from contextlib import suppress
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core.caching import FunctionCache, IndexDataCacheFile

PACKAGE = __name__.partition(".")[0] + "."
"""Prefix of the names of this package's modules."""


class KernelCache(FunctionCache):
    """The cache of one kernel."""

    def __init__(self, function: Callable[..., object]) -> None:
        """Open the cache of a kernel.

        Args:
            function: The kernel as a Python function, not compiled.
        """
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._cache_file = IndexDataCacheFile(  # type: ignore[no-untyped-call]
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=(self._impl.locator.get_source_stamp(), fingerprint(function)),
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The code compiled for a signature; None if there is none that can be read. Overrides Numba's method."""
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        # A file that is damaged, for example by a power cut, contains arbitrary bytes: reading may raise any exception.
        except Exception:
            with suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
            return None


def fingerprint(function: Callable[..., object]) -> str:
    """A digest of the code of a function and of all functions and module constants that it reaches by name.

    Args:
        function: A Python function, or one compiled by Numba.

    Returns:
        A hexadecimal string that is the same in every process as long as none of that code changes.
    """
    parts: list[str] = []
    _add_value(function, parts, set())
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _add_value(value: Any, parts: list[str], seen: set[int]) -> None:
    """Append to `parts` what identifies the value that a name stands for."""
    # For a kernel: the function that is compiled. For an intrinsic: the function that generates its instructions.
    function = getattr(value, "py_func", getattr(value, "_defn", value))
    if isinstance(function, FunctionType):
        if id(function) in seen:
            return
        seen.add(id(function))
        parts.append(f"{function.__module__}.{function.__qualname__}")
        _add_code(function.__code__, function.__globals__, parts, seen)
        _add_records(function.__annotations__, function.__globals__, parts, seen)
    elif isinstance(value, frozenset):
        parts.append(repr(sorted(value, key=repr)))
    elif isinstance(value, bool | int | float | str | tuple | None):
        parts.append(repr(value))
    elif isinstance(value, np.ndarray):
        parts.append(f"{value.dtype.str}{value.shape}{value.tobytes().hex()}")
    elif isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields"):
        # Compiled code accesses the fields of a named tuple by position.
        parts.append(f"{value.__qualname__}{value._fields}")
        _add_records(value.__annotations__, vars(sys.modules[value.__module__]), parts, seen)
    elif isinstance(value, ModuleType):
        parts.append(value.__name__)
    elif isinstance(value, type) and value.__module__.startswith(PACKAGE):
        # A class of this package that an intrinsic uses to generate its instructions.
        if id(value) not in seen:
            seen.add(id(value))
            for method in vars(value).values():
                if isinstance(method, FunctionType):
                    _add_value(method, parts, seen)
    else:
        # Types, intrinsics and functions of other libraries, by name: their versions are left to Numba.
        parts.append(str(getattr(value, "__qualname__", type(value).__qualname__)))


def _add_records(annotations: dict[str, Any], names: dict[str, Any], parts: list[str], seen: set[int]) -> None:
    """Append to `parts` what identifies the named tuples with which arguments or fields are annotated."""
    for annotation in annotations.values():
        value = names.get(getattr(annotation, "__forward_arg__", annotation))
        if hasattr(value, "_fields"):
            _add_value(value, parts, seen)


def _add_code(code: CodeType, names: dict[str, Any], parts: list[str], seen: set[int]) -> None:
    parts.append(code.co_code.hex())
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            _add_code(constant, names, parts, seen)
        else:
            _add_value(constant, parts, seen)
    for name in code.co_names:
        parts.append(name)
        if name in names:
            _add_value(names[name], parts, seen)
