"""Shared helpers of the benchmarks: the machine's state, optional engines, the command line and the printed result."""

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

from spatula_env.engines import bullet_hint, bullet_is_there, bullet_version, is_installed
from spatula_env.files import check_can_write
from spatula_env.installing import install_hint

Name = TypeVar("Name", bound=str)


def machine() -> dict[str, Any]:
    """Hardware and versions that the figures were measured with."""
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "numba": version("numba"),
        "numpy": version("numpy"),
        **dict(filter(None, [bullet_version()])),
    }


def load_average() -> float | None:
    """Mean number of processes that run or wait for a core over the last minute; None where it is not available."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def resident_megabytes() -> float:
    """Resident memory of this process [MB]; 0 where it is not available, which is everywhere but on Linux."""
    file = Path("/proc/self/statm")
    if not file.exists():
        return 0.0
    return int(file.read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGESIZE") / 1e6


def output_file(text: str) -> Path:
    """Argument of the command line that names a file to be written; refused at once if it cannot be.

    Raises:
        argparse.ArgumentTypeError: If the file is a folder, or its folder is not there or cannot be written to.
    """
    file = Path(text)
    if file.is_dir():
        raise argparse.ArgumentTypeError(f"{text} is a folder, not a file")
    if not file.parent.is_dir():
        raise argparse.ArgumentTypeError(f"{text} cannot be written: there is no folder {file.parent}")
    try:
        check_can_write(file.parent)
    except OSError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return file


def installed(names: Iterable[Name]) -> list[Name]:
    """Engines or contact models to measure: leaves those out, with a message, that need what is not installed.

    Args:
        names: Names of engines or contact models.
    """
    found = []
    for name in names:
        if is_installed(name):
            found.append(name)
        else:
            hint = bullet_hint() if name == "bullet" else f"To have it: {install_hint(name)}"
            print(f"{name!r} is left out: it is not installed. {hint}", file=sys.stderr)
    return found


def require_bullet(benchmark: str) -> None:
    """Exit with a message if PyBullet is not installed; for benchmarks that have nothing to measure without it."""
    if not bullet_is_there():
        raise SystemExit(f"{benchmark} compares with PyBullet, which is not installed. {bullet_hint()}")


def parser(description: str) -> argparse.ArgumentParser:
    """Make a command-line parser with the options that all benchmarks have; interruptions then print one word."""
    sys.excepthook = _excepthook
    # Descriptions have tables and commands in them.
    made = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--json", action="store_true", help="print nothing but the JSON line")
    return made


def _excepthook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print one word, and no traceback, if a benchmark is interrupted."""
    if issubclass(kind, KeyboardInterrupt):
        print("interrupted", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


def finish(result: dict[str, Any]) -> None:
    """Print a result, with the machine it was measured on, as one line of JSON: the last line of a benchmark."""
    print(json.dumps({**result, "machine": machine()}))
