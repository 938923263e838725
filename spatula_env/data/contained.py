"""Datasets that come from anywhere: that reading one reads nothing else.

HDF5 has several ways to show what is in another file as if it were its own: links, arrays that are stored elsewhere,
arrays that are put together from others. A copy of such a dataset would hold the files of whoever made the copy.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from spatula_env.data.files import DatasetDamaged, inside


def check_contained(data: Path, main_file: str, count: int) -> None:
    """Check that all that is read of a dataset is in its folder, by going through all of it.

    Args:
        data: The folder "data" in that of the dataset.
        main_file: Name of the file with all episodes, or with links to them.
        count: How many episodes it has.

    Raises:
        DatasetDamaged: If not, or if it cannot be read.
    """
    for file in check_main_file(data, main_file, count).values():
        check_episode_file(data, file)


def check_main_file(data: Path, main_file: str, count: int) -> dict[int, str]:
    """Check that nothing leads out of the folder of a dataset, leaving aside what is in the files of its episodes.

    Args:
        data: The folder "data" in that of the dataset.
        main_file: Name of the file with all episodes, or with links to them.
        count: How many episodes it has.

    Returns:
        The file of each episode, from `data`, by the episode's number; those in the main file itself are left out.

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
        # There are links to episodes that are yet to come; and HDF5 would look for files in the current folder, too.
        if name in links:
            if os.path.normpath(links[name]) not in there:
                raise DatasetDamaged(f"episode {number} is missing: there is no {data / links[name]}")
            found[number] = links[name]
    return found


def check_episode_file(data: Path, name: str) -> None:
    """Check that a file of a dataset shows nothing of another one.

    Args:
        data: The folder "data" in that of the dataset.
        name: Of the file, from there.

    Raises:
        DatasetDamaged: If it does, or cannot be read.
    """
    _check_file(inside(data, *Path(name).parts))


def check_no_links(data: Path) -> set[str]:
    """Check that there are no links in the folder of a dataset, and that it is none.

    Args:
        data: The folder "data" in that of the dataset.

    Returns:
        The files that there are, from `data`.

    Raises:
        DatasetDamaged: If there is one.
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
    """Whether a path leads from a folder to what is in it, whichever system reads it."""
    paths = (PurePosixPath(name), PureWindowsPath(name))
    return not any(path.drive or path.root or ".." in path.parts for path in paths)


def _check_file(path: Path, *, links_to_files: bool = False) -> tuple[set[str], Mapping[str, str]]:
    """Check that an HDF5 file shows nothing of another one; what it has at the top may be links if that is allowed.

    Returns:
        The names at the top, and the files that those lead to which are links.
    """
    import h5py

    names: set[str] = set()
    external: list[bytes] = []

    # These are called by HDF5, through which no error passes: what they return ends the visit.
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
