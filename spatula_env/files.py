"""Files that are there whole or not at all."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

UNFINISHED = ".tmp"
"""In the names of files that are being written, which are hidden; their endings are those of the files."""


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Write a file in a ``with`` block: it is as it was before, or complete, whatever happens.

    Args:
        path: Of the file; its folder is made.

    Yields:
        Where to write it, with the same ending. At the end it takes the place of what is at `path`.

    Raises:
        OSError: If it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.stem}.{uuid.uuid4().hex}{UNFINISHED}{path.suffix}")
    try:
        yield unfinished
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file, all at once."""
    with whole_file(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file, all at once."""
    with whole_file(path) as unfinished:
        unfinished.write_bytes(content)
