"""Atomic writing of a dataset's files, and locks that are released when the program that holds them ends."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from spatula_env.installing import install_hint

WRITE_LOCK = ".lock"
"""Name of the lock file in a dataset's folder that is held while something is added to the dataset."""
RECORDING_LOCK = ".recording.lock"
"""Name of the lock file in a dataset's folder that is held as long as a program records into the dataset."""
NEW = ".new"
"""Ending of files that are being written; their names begin with a dot."""
PATIENCE = 60.0
"""How long a writer waits for another one [s]."""


JUNCTION = 0xA0000003
"""Reparse tag of a junction, which is a link to a folder on Windows."""


class DatasetDamaged(ValueError):
    """A part of a dataset is missing or cannot be read; the message says which."""


class DatasetBusy(OSError):
    """Another program is recording into a dataset."""


def inside(folder: Path, *names: str) -> Path:
    """The path of something in a dataset's folder, checked to have no links, as datasets may come from anywhere.

    Args:
        folder: Folder of the dataset; it is not checked itself.
        *names: Names of the folders below it and, last, of the file or folder itself, which need not exist.

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
    """Write a file atomically: whatever happens, it has the old or the new content. A link of that name is replaced."""
    new = path.with_name(f".{path.name}.{os.getpid()}{NEW}")
    # If there is a link of this name, it must not be written through.
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
    """Remove files that killed programs have left unfinished in a folder; the write lock must be held."""
    for path in folder.glob(f".*{NEW}"):
        # A file that cannot be removed does no harm.
        with suppress(OSError):
            path.unlink()


def append_to_file(path: Path, start: int, content: bytes) -> None:
    """Write at an offset in a file and cut off the rest; what is before the offset is unchanged.

    Args:
        path: Path of the file; it is created if it does not exist.
        start: The offset [bytes].
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
    """Flush a renaming in a folder to the disk, where the system can. Windows has no such call, and needs none."""
    if os.name == "nt":
        return
    # The renaming itself is done and visible to programs, so an error here must not look as if it had failed.
    with suppress(OSError):
        opened = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(opened)
        finally:
            os.close(opened)


@contextmanager
def write_lock(folder: Path) -> Iterator[None]:
    """Hold the exclusive right to write to a dataset during a ``with`` block.

    The system releases the lock of a program that ends, however it ends.

    Args:
        folder: Folder of the dataset.

    Raises:
        TimeoutError: If another program writes for a minute.
    """
    filelock = require_filelock()
    try:
        with filelock.FileLock(folder / WRITE_LOCK, timeout=PATIENCE):
            yield
    except filelock.Timeout as error:
        raise TimeoutError(f"another program has been writing to {folder} for {PATIENCE:.0f} s") from error


@contextmanager
def recording_lock(folder: Path, dataset_id: str) -> Iterator[None]:
    """Hold the exclusive right to record into a dataset: two programs at a time would use the same seeds.

    Args:
        folder: Folder of the dataset; it is created if it does not exist, and then removed if it stays empty.
        dataset_id: Its id, for the error.

    Raises:
        DatasetBusy: If another program records into it.
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
    """Remove a folder that contains only locks, and the folders above it, up to `top`, that were made for it."""
    try:
        for name in (RECORDING_LOCK, WRITE_LOCK):
            (folder / name).unlink(missing_ok=True)
        while True:
            folder.rmdir()
            if folder == top:
                break
            folder = folder.parent
    except OSError:
        # The folder is not empty, or the system does not remove files that are open. A folder that stays does no harm.
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
