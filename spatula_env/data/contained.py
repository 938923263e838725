"""Checks that reading a dataset, which may come from an untrusted source, reads nothing outside its folder.

HDF5 has several ways to present the contents of another file as its own: links, external storage of arrays, and virtual
arrays, which are assembled from others. A copy of such a dataset would contain files of the user who made the copy.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from spatula_env.data.files import DatasetDamaged, inside


def check_contained(data: Path, main_file: str, count: int) -> None:
    """Check that everything that is read of a dataset is in its folder, by going through all of its files.

    Args:
        data: The folder "data" in the dataset's folder.
        main_file: Name of the file with all episodes, or with links to them.
        count: Number of episodes.

    Raises:
        DatasetDamaged: If something is outside, or if the dataset cannot be read.
    """
    for file in check_main_file(data, main_file, count).values():
        check_episode_file(data, file)


def check_main_file(data: Path, main_file: str, count: int) -> dict[int, str]:
    """Check that nothing leads out of a dataset's folder. The contents of its episodes' files are not checked.

    Args:
        data: The folder "data" in the dataset's folder.
        main_file: Name of the file with all episodes, or with links to them.
        count: Number of episodes.

    Returns:
        The file of each episode, relative to `data`, by the episode's number; without those in the main file itself.

    Raises:
        DatasetDamaged: If something does, if an episode is missing, or if the main file cannot be read.
    """
    there = check_no_links(data)
    file = data / main_file
    names, links = _check_file(file, links_to_files=True)
    for target in links.values():
        if not _is_below(target):
            raise DatasetDamaged(f"{file} has an episode that is no part of the dataset: {data / target}")
    found = {}
    for number in range(count):
        name = f"episode_{number}"
        if name not in names:
            raise DatasetDamaged(f"episode {number} is missing: it is not in {file}")
        # There are links to episodes that do not exist yet; and HDF5 would search the current folder, too.
        if name in links:
            if os.path.normpath(links[name]) not in there:
                raise DatasetDamaged(f"episode {number} is missing: there is no {data / links[name]}")
            found[number] = links[name]
    return found


def check_episode_file(data: Path, name: str) -> None:
    """Check that a file of a dataset does not refer to another file.

    Args:
        data: The folder "data" in the dataset's folder.
        name: Path of the file, relative to `data`.

    Raises:
        DatasetDamaged: If it does, or cannot be read.
    """
    _check_file(inside(data, *Path(name).parts))


def check_no_links(data: Path) -> set[str]:
    """Check that there are no links in the folder of a dataset, and that it is not a link itself.

    Args:
        data: The folder "data" in the dataset's folder.

    Returns:
        The files that exist, relative to `data`.

    Raises:
        DatasetDamaged: If there is a link.
    """
    inside(data.parent, data.name)
    found: set[str] = set()
    for folder, folders, files in os.walk(data):
        for name in (*folders, *files):
            inside(Path(folder), name)
        below = os.path.relpath(folder, data)
        found.update(os.path.normpath(os.path.join(below, name)) for name in files)
    return found


def _is_below(name: str) -> bool:
    """Whether a relative path stays below its folder, on any operating system."""
    paths = (PurePosixPath(name), PureWindowsPath(name))
    return not any(path.drive or path.root or ".." in path.parts for path in paths)


def _check_file(path: Path, *, links_to_files: bool = False) -> tuple[set[str], Mapping[str, str]]:
    """Check that an HDF5 file does not refer to another; with `links_to_files`, top-level entries may be links.

    Returns:
        The names at the top level, and the target files of those that are links.
    """
    import h5py

    names: set[str] = set()
    external: list[bytes] = []

    # HDF5 calls these functions and does not propagate exceptions: a value that they return ends the visit.
    def linked(name: bytes, info: Any) -> str | None:
        if b"/" not in name:
            names.add(os.fsdecode(name))
            if links_to_files and info.type == h5py.h5l.TYPE_EXTERNAL:
                external.append(name)
                return None
        return None if info.type == h5py.h5l.TYPE_HARD else f"a link in place of {name.decode(errors='replace')!r}"

    def elsewhere(name: bytes, info: Any) -> str | None:
        if info.type != h5py.h5o.TYPE_DATASET:
            return None
        made = h5py.h5d.open(opened.id, name).get_create_plist()
        apart = made.get_layout() == h5py.h5d.VIRTUAL or made.get_external_count() > 0
        return f"{name.decode(errors='replace')!r} in another file" if apart else None

    try:
        with h5py.File(path, "r") as opened:
            found = opened.id.links.visit(linked, info=True) or h5py.h5o.visit(opened.id, elsewhere, info=True)
            links = {os.fsdecode(name): os.fsdecode(opened.id.links.get_val(name)[0]) for name in external}
    except (OSError, KeyError, RuntimeError, SystemError, ValueError) as error:
        raise DatasetDamaged(f"{path} cannot be read: {error}") from error
    if found is not None:
        raise DatasetDamaged(f"{path} has {found}")
    return names, links
