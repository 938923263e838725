"""Atomic writing of files, where a file is there completely or not at all, and checks before the work that it takes."""

from __future__ import annotations

import hashlib
import tempfile
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


def checksum(path: Path) -> str:
    """SHA-256 of what a file holds, in hexadecimal digits.

    Raises:
        OSError: If it cannot be read.
    """
    return hashlib.sha256(path.read_bytes()).hexdigest()


def check_can_write(folder: Path) -> None:
    """Check that files can be created in a folder or, if it does not exist, in the one above that does.

    Nothing is left behind.

    Raises:
        OSError: If they cannot; says in which folder.
    """
    there = folder.absolute()
    while not there.exists():
        there = there.parent
    if not there.is_dir():
        raise NotADirectoryError(f"{folder} cannot be written to: {there} is no folder")
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        told = type(error)(f"{folder} cannot be written to: {reason} in {there}")
        # Set afterwards: as an argument it would be printed before the sentence, as "[Errno 13]".
        told.errno = error.errno
        raise told from error


def check_free(path: Path, overwrite: bool) -> None:
    """Check before any work that a file can be written without losing an existing one.

    Args:
        path: Path of the file.
        overwrite: Whether it may replace an existing file.

    Raises:
        FileExistsError: If the file exists and may not be replaced.
        IsADirectoryError: If it is a folder.
    """
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder")
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path} exists already: name another file, or replace it with --overwrite")
