"""Import of MuJoCo, which the extra ``mujoco`` installs."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from spatula_env.installing import install_hint

OLDEST = 4
"""Least major version of MuJoCo. Earlier ones give a flex twice Lamé's first parameter (its changelog, 4.0.0)."""


def import_mujoco() -> Any:
    """The module `mujoco`.

    Raises:
        ImportError: If it is not installed or too old; says what to install.
    """
    wanted = f"engine='mujoco' needs MuJoCo {OLDEST}.0 or later, which needs Python 3.11 or later"
    try:
        module = import_module("mujoco")
    except ImportError as error:
        raise ImportError(
            f"{wanted}; it cannot be imported ({error}). To have it: {install_hint('mujoco')}", name="mujoco"
        ) from error
    if int(module.__version__.partition(".")[0]) < OLDEST:
        raise ImportError(
            f"{wanted}; version {module.__version__} is installed. To have it: {install_hint('mujoco')}", name="mujoco"
        )
    return module
