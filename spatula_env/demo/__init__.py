"""The demonstration: three contact models side by side, in numbers and pictures, and an episode of a task.

`python -m spatula_env.demo.figures` draws the pictures of the documentation; the command `spatula demo` does
everything.
"""

from __future__ import annotations

from importlib.util import find_spec

from spatula_env.installing import install_hint

EXTRA_PACKAGES = ("PIL", "rich")
"""What the extra "demo" installs."""


def require_extra() -> None:
    """Check that the extra "demo" is installed.

    Raises:
        ImportError: If it is not; the message says how to install it.
    """
    missing = [name for name in EXTRA_PACKAGES if find_spec(name) is None]
    if missing:
        raise ImportError(f"the demonstration needs {' and '.join(missing)}: {install_hint('demo')}", name=missing[0])
