"""Where compiled kernels are cached, and what is logged while they are compiled.

Numba caches compiled code beside the source, or else in the user's cache, and raises an error if neither can be
written, as in a container that another user runs. A cache should help but not be required: in that case kernels are
cached in a folder for temporary files, and if that cannot be written either, they are not cached.
"""

from __future__ import annotations

import logging
import os
import stat
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
from numba.core import event
from numba.core.caching import FunctionCache

COMPILE = "numba:compile"
"""Numba's event that starts when a kernel is compiled, but not when it is loaded from the cache."""

VARIABLE = "NUMBA_CACHE_DIR"
"""The environment variable that names another folder for the cache."""

PARTS = {
    "contact": "the contact model",
    "sim": "the simulation",
    "tasks": "what tasks measure",
    "render": "what draws pictures",
}
"""Names of the parts of the package in the message about compilation, by subpackage."""


@dataclass(frozen=True)
class Cache:
    """Where compiled kernels are kept.

    Attributes:
        kept: Whether they are kept at all.
        folder: A folder for temporary files, used in place of Numba's own locations; None if those can be used or if
            nothing is kept.
    """

    kept: bool
    folder: Path | None = None

    @property
    def told(self) -> str:
        """How often kernels are compiled, as a phrase for a message."""
        if not self.kept:
            return (
                "in every process anew, as no folder for compiled code can be written; set the environment variable "
                f"{VARIABLE} to one that can"
            )
        if self.folder is not None:
            return (
                f"once for as long as {self.folder} is there, as neither the package's folder nor the user's cache can "
                f"be written; set the environment variable {VARIABLE} to a folder that lasts"
            )
        return "once after installation"


def find_cache() -> Cache:
    """Find a writable folder for compiled kernels, and make Numba use it."""
    if _is_kept():
        return Cache(kept=True)
    folder = _temporary_folder()
    if folder is not None:
        settings: Any = numba.config
        before, settings.CACHE_DIR = settings.CACHE_DIR, str(folder)
        if _is_kept():
            return Cache(kept=True, folder=folder)
        settings.CACHE_DIR = before
    return Cache(kept=False)


def _is_kept() -> bool:
    """Whether Numba finds a writable folder for its cache."""
    try:
        FunctionCache(_is_kept)  # type: ignore[no-untyped-call]
    except RuntimeError:
        return False
    return True


def _temporary_folder() -> Path | None:
    """A folder that only this user can write, because code loaded from it is executed; None if there is none."""
    user = os.getuid() if hasattr(os, "getuid") else "user"
    folder = Path(tempfile.gettempdir(), f"spatula_env-kernels-{user}")
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    if not stat.S_ISDIR(found.st_mode):
        return None
    if hasattr(os, "getuid") and (found.st_uid != os.getuid() or found.st_mode & 0o022):
        return None
    return folder


def _module_of(event: Any) -> str:
    """Name of the module whose function an event is about; Numba also compiles functions of no module."""
    return str(getattr(event.data["dispatcher"].py_func, "__module__", None))


class Announcer(event.Listener):
    """Logs that kernels are being compiled, once per process for each part of the package."""

    def __init__(self, cache: Cache) -> None:
        """Create a listener that has announced nothing yet.

        Args:
            cache: Where kernels are kept.
        """
        self._cache = cache
        self._told: set[str] = set()

    def on_start(self, event: Any) -> None:
        """Called by Numba when it begins to compile a function."""
        package, _, rest = _module_of(event).partition(".")
        part = rest.partition(".")[0]
        if package != "spatula_env" or part in self._told:
            return
        self._told.add(part)
        logging.getLogger("spatula_env").warning(
            "spatula_env is compiling %s, %s. This can take a minute; `spatula compile` compiles all of it beforehand.",
            PARTS.get(part, "kernels"),
            self._cache.told,
        )

    def on_end(self, event: Any) -> None:
        """Called by Numba when it has compiled a function."""


class Counter(event.Listener):
    """Counts the functions of this package that are compiled.

    Attributes:
        count: Number of functions so far.
    """

    def __init__(self) -> None:
        self.count = 0

    def on_start(self, event: Any) -> None:
        """Called by Numba when it begins to compile a function."""
        if _module_of(event).partition(".")[0] == "spatula_env":
            self.count += 1

    def on_end(self, event: Any) -> None:
        """Called by Numba when it has compiled a function."""
