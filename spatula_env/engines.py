"""Registry of engines, and the choice of one when none is named. Importing this module loads no engine."""

from __future__ import annotations

import platform
import sys
import warnings
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any

ENGINES: dict[str, str] = {
    "bullet": "spatula_env.sim.bullet:BulletEngine",
    "batch": "spatula_env.sim.batch_engine:BatchEngine",
    "tissue": "spatula_env.sim.tissue.engine:TissueEngine",
    "mujoco": "spatula_env.sim.mujoco.engine:MujocoEngine",
}
"""The engines that can integrate the organs, by name: module and class of a `sim.engine.Engine`. Like Gymnasium's
registry of environments, it grows by registration; see `register_engine`."""

OF_EXTRAS = ("mujoco",)
"""Engines that need an extra of the same name."""

DEFAULT = '"bullet" where PyBullet is installed, else "batch"'
"""Description, for messages and help texts, of the engine that is used when none is named."""

BULLET_DISTRIBUTIONS = ("pybullet", "pybullet-arm64")
"""Distributions that provide the module `pybullet`: the original, and a fork with wheels for more platforms."""


def register_engine(name: str, entry_point: str) -> None:
    """Register an engine, so that environments and simulations accept its name.

    Args:
        name: Value of the option `engine` that selects it.
        entry_point: Its class as "module:Class"; the module is imported when the engine is first used. The class is a
            `sim.engine.Engine`.

    Raises:
        ValueError: If `entry_point` is not of that form, or the name is that of another engine.
    """
    module, _, kind = entry_point.partition(":")
    if not (module and kind):
        raise ValueError(f"entry_point must be 'module:Class', got {entry_point!r}")
    if ENGINES.setdefault(name, entry_point) != entry_point:
        raise ValueError(f"name must be that of no other engine, but {name!r} is {ENGINES[name]!r}")


def load_engine(name: str) -> Any:
    """The class of an engine, from the registry."""
    module, _, kind = ENGINES[name].partition(":")
    return getattr(import_module(module), kind)


def choose_engine(engine: str | None = None, contact: str = "flags") -> str:
    """Choose the engine to use.

    Args:
        engine: Name of an engine; None: the default.
        contact: The method that resolves contact; "bullet" and "mujoco" need the engine of that name, which is then
            the default.

    Returns:
        Name of the engine.

    Raises:
        ValueError: If there is no such engine.
        ImportError: If PyBullet is asked for and is not installed; says what to install.
    """
    if engine is not None and engine not in ENGINES:
        raise ValueError(f"engine must be one of {list(ENGINES)}, got {engine!r}")
    if engine == "bullet":
        import_bullet("engine='bullet'")
    elif engine is None and contact == "bullet":
        import_bullet("contact='bullet'")
        return "bullet"
    elif engine is None and contact == "mujoco":
        return "mujoco"
    return default_engine() if engine is None else engine


@cache
def default_engine() -> str:
    """The engine that is used when none is named: "bullet" if PyBullet can be imported, else "batch".

    A warning is issued the first time that it is "batch".
    """
    if bullet_is_there():
        return "bullet"
    warnings.warn(
        "PyBullet is not installed, so environments and simulations use engine='batch', this package's own soft body, "
        f"unless told otherwise. {bullet_hint()}",
        UserWarning,
        stacklevel=2,
    )
    return "batch"


def is_installed(engine: str) -> bool:
    """Whether everything that an engine needs is installed; a module of an extra is looked for, not imported.

    Args:
        engine: Name of an engine.
    """
    if engine == "bullet":
        return bullet_is_there()
    return engine not in OF_EXTRAS or find_spec(engine) is not None


def bullet_is_there() -> bool:
    """Whether PyBullet can be imported, determined by importing it."""
    try:
        _load_bullet()
    except ImportError:
        return False
    return True


def _load_bullet() -> Any:
    """The module `pybullet`, without the line that it writes when it is first imported."""
    if "pybullet" not in sys.modules:
        import_module("spatula_env._bullet")
    return import_module("pybullet")


def import_bullet(wanted: str) -> Any:
    """The module `pybullet`.

    Args:
        wanted: What needs it, for the error.

    Raises:
        ImportError: If it is not installed; says what to install.
    """
    try:
        return _load_bullet()
    except ImportError as error:
        raise ImportError(
            f"{wanted} needs PyBullet, which cannot be imported ({error}). {bullet_hint()}", name="pybullet"
        ) from error


def bullet_hint() -> str:
    """How to install PyBullet here, as a sentence."""
    found = bullet_distribution()
    if found is None:
        return (
            f"There is no ready-made PyBullet for Python {sys.version_info[0]}.{sys.version_info[1]} on "
            f"{platform.system()} {platform.machine()}; engine='batch' needs none."
        )
    return f"To have it: pip install {found}"


def bullet_distribution(
    system: str | None = None, machine: str | None = None, version: tuple[int, int] | None = None
) -> str | None:
    """The distribution with a PyBullet wheel for a platform; the markers in pyproject.toml encode the same rules.

    Args:
        system: As `sys.platform`; by default that of this machine.
        machine: As `platform.machine()`; by default that of this machine.
        version: Version of CPython; by default that of this interpreter.

    Returns:
        Name of the distribution; None if there is no wheel.
    """
    system, machine = system or sys.platform, machine or platform.machine()
    version = version or sys.version_info[:2]
    if not (3, 10) <= version <= (3, 13):
        return None
    place = (system, machine)
    if place == ("linux", "x86_64"):
        return "pybullet" if version <= (3, 11) else "pybullet-arm64"
    universal = place == ("darwin", "x86_64") and version in ((3, 11), (3, 12))
    return "pybullet-arm64" if universal or place in (("darwin", "arm64"), ("win32", "AMD64")) else None


def bullet_version() -> tuple[str, str] | None:
    """Name and version of the distribution that provides PyBullet; None if none is installed."""
    # Importing this takes as long as everything else in this module.
    from importlib import metadata

    for name in BULLET_DISTRIBUTIONS:
        try:
            return name, metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return None
