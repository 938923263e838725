"""Warnings about the contents of a scene."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

PACKAGE = str(Path(__file__).parent)


class SceneWarning(UserWarning):
    """Something in a scene is probably not as intended."""


def warn(message: str) -> None:
    """Warn about a scene; the warning points to the line outside this package that called it.

    Args:
        message: What is wrong.
    """
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_code.co_filename.startswith(PACKAGE):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, SceneWarning, stacklevel=level)
