"""The libraries of the extra `anatomy`, imported where they are used."""

from __future__ import annotations

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
        return import_module(name)
    except ImportError as error:
        library = name.partition(".")[0]
        raise ImportError(f"preparing an organ needs {library} here: {install_hint(extra)}") from error
