"""Code that must run in an interpreter that has imported nothing yet."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import spatula_env

ROOT = Path(spatula_env.__file__).parents[1]


def run_code(code: str) -> str:
    """Run code in a fresh interpreter, and return what it prints."""
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout
