"""PyBullet, imported without the line about its build that it writes to standard error.

It writes that line below Python, to the descriptor, in every process. What else is written meanwhile, by other threads
for instance, is passed on. As this is a module, Python sees to it that it happens once, whichever threads import it.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress

STANDARD_ERROR = 2
"""The descriptor."""

GREETING = b"pybullet build time: "
"""How the line begins."""


@contextmanager
def without_lines(beginning: bytes, descriptor: int = STANDARD_ERROR) -> Iterator[None]:
    """Leave lines out of what is written to a descriptor.

    Args:
        beginning: Of the lines that are left out.
        descriptor: Open or not; if not, nothing is done.
    """
    try:
        place = os.dup(descriptor)
    except OSError:
        # Closed: nothing is to be seen, nor to be left out.
        yield
        return
    try:
        caught = tempfile.TemporaryFile()
    except OSError:
        os.close(place)
        yield
        return
    with caught:
        _flush()
        os.dup2(caught.fileno(), descriptor)
        try:
            yield
        finally:
            _flush()
            os.dup2(place, descriptor)
            os.close(place)
            caught.seek(0)
            said = b"".join(line for line in caught if not line.startswith(beginning))
            # Whoever has read the other end may have gone.
            with suppress(OSError):
                while said:
                    said = said[os.write(descriptor, said) :]


def _flush() -> None:
    """Have what Python has buffered written to where it belongs."""
    if sys.stderr is not None:
        with suppress(OSError, ValueError):
            sys.stderr.flush()


with without_lines(GREETING):
    import pybullet

__all__ = ["pybullet"]
