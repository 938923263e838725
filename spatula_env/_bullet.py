"""PyBullet, imported without the line about its build time that it writes to standard error.

PyBullet writes that line below Python, directly to the file descriptor, in every process. Anything else that is written
meanwhile, for instance by other threads, is passed on. Because this is a module, Python performs the import only once,
whichever threads request it.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress

STANDARD_ERROR = 2
"""File descriptor of standard error."""

GREETING = b"pybullet build time: "
"""Beginning of the line that is left out."""


@contextmanager
def without_lines(beginning: bytes, descriptor: int = STANDARD_ERROR) -> Iterator[None]:
    """Filter lines out of what is written to a file descriptor.

    Args:
        beginning: Lines that begin with this are left out.
        descriptor: The file descriptor; if it is not open, nothing is done.
    """
    try:
        place = os.dup(descriptor)
    except OSError:
        # The descriptor is closed: there is no output to filter.
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
            # The reader at the other end of a pipe may have gone.
            with suppress(OSError):
                while said:
                    said = said[os.write(descriptor, said) :]


def _flush() -> None:
    """Flush Python's buffered standard error to the present target of the descriptor."""
    if sys.stderr is not None:
        with suppress(OSError, ValueError):
            sys.stderr.flush()


with without_lines(GREETING):
    import pybullet

__all__ = ["pybullet"]
