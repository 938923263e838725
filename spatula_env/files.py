"""Atomic writing of files: a file is there completely or not at all."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

UNFINISHED = ".tmp"
"""Marks the hidden files that are still being written; in their names it stands before the ending of the final file."""


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Write a file atomically in a ``with`` block: whatever happens, it is complete or as it was before.

    Args:
        path: Path of the file; its folder is created if it does not exist.

    Yields:
        Temporary path to write to, with the same ending. At the end of the block it replaces the file at `path`.

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
    """Write a text file atomically."""
    with whole_file(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def write_bytes(path: Path, content: bytes) -> None:
    """Write a binary file atomically."""
    with whole_file(path) as unfinished:
        unfinished.write_bytes(content)
