"""The libraries of the extra `anatomy`, imported where they are used."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from spatula_env.installing import install_hint


def load(name: str, extra: str = "anatomy") -> Any:
    """Import a module of a library that need not be installed.

    Args:
        name: The module, such as "skimage.measure".
        extra: The extra that brings it.

    Raises:
        ImportError: If it is not installed; the message says what to install.
    """
    try:
        with _interrupted_afterwards():
            return import_module(name)
    except ImportError as error:
        library = name.partition(".")[0]
        raise ImportError(f"preparing an organ needs {library} here: {install_hint(extra)}") from error


@contextmanager
def _interrupted_afterwards() -> Iterator[None]:
    """Let Ctrl-C wait for the end of a block: trimesh, for one, ignores all exceptions while it imports others.

    Only the main thread can handle signals; in other threads this does nothing.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    came: list[tuple[int, Any]] = []
    signal.signal(signal.SIGINT, lambda number, frame: came.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came:
        before(*came[0])
