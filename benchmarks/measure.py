"""What the benchmarks share: timing, and how a result is printed."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from spatula_env.engines import bullet_hint, bullet_is_there, bullet_version

Name = TypeVar("Name", bound=str)


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "numba": version("numba"),
        "numpy": version("numpy"),
        **dict(filter(None, [bullet_version()])),
    }


def load_average() -> float | None:
    """How many processes want a core, over the last minute; None where the system does not tell."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def resident_megabytes() -> float:
    """What this process holds in memory [MB]; 0 where the system does not tell, as only Linux does."""
    file = Path("/proc/self/statm")
    if not file.exists():
        return 0.0
    return int(file.read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGESIZE") / 1e6


def without_bullet(names: Iterable[Name]) -> list[Name]:
    """Engines or contact models to measure. Bullet is left out where PyBullet is not installed, and that is said.

    Args:
        names: Of engines or contact models, "bullet" among them.
    """
    wanted = list(names)
    if "bullet" not in wanted or bullet_is_there():
        return wanted
    print(f"PyBullet is not installed: 'bullet' is left out. {bullet_hint()}", file=sys.stderr)
    return [name for name in wanted if name != "bullet"]


def require_bullet(benchmark: str) -> None:
    """End a benchmark that has nothing to measure where PyBullet is not installed."""
    if not bullet_is_there():
        raise SystemExit(f"{benchmark} compares with PyBullet, which is not installed. {bullet_hint()}")


def parser(description: str) -> argparse.ArgumentParser:
    """A command line with the options that all benchmarks have."""
    sys.excepthook = _excepthook
    made = argparse.ArgumentParser(description=description)
    made.add_argument("--json", action="store_true", help="print nothing but the JSON line")
    return made


def _excepthook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Say in a word that a benchmark was interrupted."""
    if issubclass(kind, KeyboardInterrupt):
        print("interrupted", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


def finish(result: dict[str, Any]) -> None:
    """Print a result as the last line."""
    print(json.dumps({**result, "machine": machine()}))
