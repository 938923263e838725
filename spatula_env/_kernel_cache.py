"""Numba's on-disk cache, told when what a kernel calls has changed.

Numba loads what it has compiled as long as the file of the kernel itself is as it was. What is compiled into it from
other files, the helpers that it calls and the constants that it names, may have changed since: whoever edits one file,
or pulls a newer version, would go on with what was there before, and no word of it. Here the code of all that a kernel
reaches is part of the stamp that the cache compares.
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
"""What the names of this package's modules begin with."""


class KernelCache(FunctionCache):
    """The cache of one kernel."""

    def __init__(self, function: Callable[..., object]) -> None:
        """Find what there is.

        Args:
            function: The kernel, as it is written.
        """
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._cache_file = IndexDataCacheFile(  # type: ignore[no-untyped-call]
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=(self._impl.locator.get_source_stamp(), fingerprint(function)),
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The code compiled for a signature; None if there is none, or none that can be read. See Numba."""
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        # What is damaged, after a power cut for example, is read as bytes of anything: it may raise whatever it likes.
        except Exception:
            with suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
            return None


def fingerprint(function: Callable[..., object]) -> str:
    """A digest of the code of a function and of all functions and constants of modules that it reaches by name.

    Args:
        function: As it is written, or compiled by Numba.

    Returns:
        The same in every process, as long as nothing of that changes.
    """
    parts: list[str] = []
    _add_value(function, parts, set())
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _add_value(value: Any, parts: list[str], seen: set[int]) -> None:
    """Add what is to be told of what a name stands for."""
    # Of a kernel, the function that was compiled; of an intrinsic, the one that writes its instructions.
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
        # A kernel takes the fields of a named tuple by their places.
        parts.append(f"{value.__qualname__}{value._fields}")
        _add_records(value.__annotations__, vars(sys.modules[value.__module__]), parts, seen)
    elif isinstance(value, ModuleType):
        parts.append(value.__name__)
    elif isinstance(value, type) and value.__module__.startswith(PACKAGE):
        # What instructions are written with.
        if id(value) not in seen:
            seen.add(id(value))
            for method in vars(value).values():
                if isinstance(method, FunctionType):
                    _add_value(method, parts, seen)
    else:
        # Types, intrinsics and functions of other libraries: their versions are Numba's business.
        parts.append(str(getattr(value, "__qualname__", type(value).__qualname__)))


def _add_records(annotations: dict[str, Any], names: dict[str, Any], parts: list[str], seen: set[int]) -> None:
    """Add what is to be told of the named tuples that arguments or fields are said to be."""
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
