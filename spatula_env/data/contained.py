"""Datasets that come from anywhere: that reading one reads nothing else.

HDF5 has several ways to show what is in another file as if it were its own: links, arrays that are stored elsewhere,
arrays that are put together from others. A copy of such a dataset would hold the files of whoever made the copy.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from spatula_env.data.files import DatasetDamaged, inside


def check_contained(data: Path, main_file: str, count: int) -> None:
    """Check that all that is read of a dataset is in its folder.

    Args:
        data: The folder "data" in that of the dataset.
        main_file: Name of the file with all episodes, or with links to them.
        count: How many episodes it has.

    Raises:
        DatasetDamaged: If not, or if it cannot be read.
    """
    import h5py

    check_no_links(data)
    file = data / main_file
    links = _check_file(file, links_to_files=True)
    targets = {data / link.filename for link in links.values() if isinstance(link, h5py.ExternalLink)}
    here = data.resolve()
    for target in sorted(targets):
        if not target.resolve().is_relative_to(here):
            raise DatasetDamaged(f"{file} has an episode that is no part of the dataset: {target}")
        # There are links to episodes that are yet to come.
        if target.is_file():
            _check_file(target)
    for number in range(count):
        link = links.get(f"episode_{number}")
        if link is None:
            raise DatasetDamaged(f"episode {number} is missing: it is not in {file}")
        # HDF5 would look for it in the current folder, too.
        if isinstance(link, h5py.ExternalLink) and not (data / link.filename).is_file():
            raise DatasetDamaged(f"episode {number} is missing: there is no {data / link.filename}")


def check_no_links(data: Path) -> None:
    """Check that there are no links in the folder of a dataset, and that it is none.

    Args:
        data: The folder "data" in that of the dataset.

    Raises:
        DatasetDamaged: If there is one.
    """
    inside(data.parent, data.name)
    for folder, folders, files in os.walk(data):
        for name in (*folders, *files):
            inside(Path(folder), name)


def _check_file(path: Path, *, links_to_files: bool = False) -> dict[str, Any]:
    """Check that an HDF5 file shows nothing of another one; what it has at the top may be links if that is allowed.

    Returns:
        What kind of link each name at the top is.
    """
    import h5py

    # These are called by HDF5, through which no error passes: what they return ends the visit.
    def linked(name: bytes, info: Any) -> str | None:
        top = links_to_files and b"/" not in name
        allowed = (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_EXTERNAL) if top else (h5py.h5l.TYPE_HARD,)
        return None if info.type in allowed else f"a link in place of {name.decode(errors='replace')!r}"

    def elsewhere(name: bytes, info: Any) -> str | None:
        if info.type != h5py.h5o.TYPE_DATASET:
            return None
        made = h5py.h5d.open(opened.id, name).get_create_plist()
        apart = made.get_layout() == h5py.h5d.VIRTUAL or made.get_external_count() > 0
        return f"{name.decode(errors='replace')!r} in another file" if apart else None

    try:
        with h5py.File(path, "r") as opened:
            found = opened.id.links.visit(linked, info=True) or h5py.h5o.visit(opened.id, elsewhere, info=True)
            links = {name: opened.get(name, getlink=True) for name in opened}
    except (OSError, KeyError, RuntimeError, SystemError, ValueError) as error:
        raise DatasetDamaged(f"{path} cannot be read: {error}") from error
    if found is not None:
        raise DatasetDamaged(f"{path} has {found}")
    return links
