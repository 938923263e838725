"""Warnings about what a scene is made of."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

PACKAGE = str(Path(__file__).parent)


class SceneWarning(UserWarning):
    """Something in a scene is likely not to be as it is meant."""


def warn(message: str) -> None:
    """Warn of a scene, as from where this package was called.

    Args:
        message: What is amiss.
    """
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_code.co_filename.startswith(PACKAGE):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, SceneWarning, stacklevel=level)
