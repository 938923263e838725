"""Files that are there whole or not at all, and locks that end with the program that holds them."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from spatula_env.installing import install_hint

WRITE_LOCK = ".lock"
"""Held while something is added to a dataset; the name of a file in its folder."""
RECORDING_LOCK = ".recording.lock"
"""Held as long as somebody records into a dataset; likewise."""
NEW = ".new"
"""How files that are being written end; their names begin with a dot."""
PATIENCE = 60.0
"""How long a writer waits for another one [s]."""


JUNCTION = 0xA0000003
"""By which Windows marks a link of its own to a folder."""


class DatasetDamaged(ValueError):
    """Something of a dataset is missing or cannot be read; the message says what."""


class DatasetBusy(OSError):
    """Another program is recording into a dataset."""


def inside(folder: Path, *names: str) -> Path:
    """The path of something in the folder of a dataset, which may come from anywhere: no links are followed there.

    Args:
        folder: Of the dataset; itself not looked at.
        *names: Of the folders below it, and at last of what is meant, whether it is there or not.

    Raises:
        DatasetDamaged: If one of them is a link, or neither a file nor a folder.
    """
    path = folder
    for name in names:
        path = path / name
        try:
            found = path.lstat()
        except (FileNotFoundError, NotADirectoryError):
            continue
        if stat.S_ISLNK(found.st_mode) or getattr(found, "st_reparse_tag", 0) == JUNCTION:
            raise DatasetDamaged(f"{path} is a link; all of a dataset must be in its own folder")
        if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
            raise DatasetDamaged(f"{path} is neither a file nor a folder")
    return path


def write_file(path: Path, content: bytes) -> None:
    """Write a file: it has its old content or the new one, whatever happens. A link of that name is replaced."""
    new = path.with_name(f".{path.name}.{os.getpid()}{NEW}")
    # Whatever somebody has put there, a link for instance, is not written through.
    new.unlink(missing_ok=True)
    try:
        with new.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    except BaseException:
        new.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def remove_unfinished(folder: Path) -> None:
    """Remove what programs have left in a folder that were killed while they wrote files; nobody else may be at it."""
    for path in folder.glob(f".*{NEW}"):
        # It does no harm if it stays.
        with suppress(OSError):
            path.unlink()


def append_to_file(path: Path, start: int, content: bytes) -> None:
    """Write at a place in a file, of which nothing is left beyond what is written; what is before stays as it is.

    Args:
        path: Of the file; made if it is not there.
        start: Where [bytes].
        content: What to write.

    Raises:
        DatasetDamaged: If it is a link.
        OSError: If it cannot be written.
    """
    inside(path.parent, path.name)
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    with os.fdopen(os.open(path, flags, 0o666), "r+b") as file:
        file.truncate(start)
        file.seek(start)
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Bring a renaming in a folder to the disk, where the system can. Windows has no such call, and needs none."""
    if os.name == "nt":
        return
    # The renaming itself is done, and programs see it: it must not seem to have failed.
    with suppress(OSError):
        opened = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(opened)
        finally:
            os.close(opened)


def check_can_write(folder: Path) -> None:
    """Check that files can be made in a folder, or in the one in which it would have to be made. Nothing is left.

    Raises:
        OSError: If not; says which folder it is.
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
        # Not given above, where it would come before the sentence, as "[Errno 13]".
        told.errno = error.errno
        raise told from error


@contextmanager
def write_lock(folder: Path) -> Iterator[None]:
    """Be the only one that writes to a dataset, for as long as a ``with`` block lasts.

    The system takes the lock from a program that ends, however it ends.

    Args:
        folder: Of the dataset.

    Raises:
        TimeoutError: If somebody else writes for a minute.
    """
    filelock = require_filelock()
    try:
        with filelock.FileLock(folder / WRITE_LOCK, timeout=PATIENCE):
            yield
    except filelock.Timeout as error:
        raise TimeoutError(f"another program has been writing to {folder} for {PATIENCE:.0f} s") from error


@contextmanager
def recording_lock(folder: Path, dataset_id: str) -> Iterator[None]:
    """Be the only one that records into a dataset: two at a time would do the same seeds.

    Args:
        folder: Of the dataset; made if it is not there, and then removed if nothing has come into it.
        dataset_id: Its id, for the error.

    Raises:
        DatasetBusy: If somebody else records into it.
    """
    filelock = require_filelock()
    top = folder
    while not top.parent.exists():
        top = top.parent
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    lock = filelock.FileLock(folder / RECORDING_LOCK, timeout=0)
    try:
        lock.acquire()
    except filelock.Timeout as error:
        raise DatasetBusy(
            f"another program is recording into {dataset_id!r}: wait until it has ended, or record into another "
            "dataset and join them (spatula datasets merge)"
        ) from error
    try:
        yield
    finally:
        if made and not (folder / "data").exists():
            _remove_empty(folder, top)
        lock.release()


def _remove_empty(folder: Path, top: Path) -> None:
    """Remove a folder in which there is no more than locks, and those above it that were made for it."""
    try:
        for name in (RECORDING_LOCK, WRITE_LOCK):
            (folder / name).unlink(missing_ok=True)
        while True:
            folder.rmdir()
            if folder == top:
                break
            folder = folder.parent
    except OSError:
        # Somebody has put something there, or the system does not remove what is open. It does no harm.
        pass


def require_filelock() -> Any:
    """Import filelock.

    Raises:
        ImportError: If it is missing; says what to install.
    """
    try:
        import filelock
    except ImportError as error:
        raise ImportError(f"writing datasets needs filelock: {install_hint('data')}") from error
    return filelock
