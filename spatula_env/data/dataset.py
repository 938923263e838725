"""A dataset on disk in Minari's format, written so that no episode is ever lost once it has been written.

Minari keeps all episodes in one HDF5 file, and a program that is killed while it writes to it can destroy all of them.
Here every episode is a file of its own, and ``main_data.hdf5`` holds external links to them, which HDF5 follows by
itself. Every file is written under another name, flushed to the disk, and renamed: at any time, either the old or the
new file is there. The order is episode, links, index, metadata; a reader takes the number of episodes from the
metadata. There are more links than episodes, so that they need not be rewritten for each.

Any number of programs may write to a dataset: an episode is added under a lock.

Minari's own `DataCollector` needs JAX only to append to lists, and stores pictures as JPEG by default; here they are
lossless, see `pictures`.
"""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from spatula_env import __version__
from spatula_env.data.encoding import episode_image
from spatula_env.data.episode import Episode
from spatula_env.data.files import append_to_file, inside, remove_unfinished, write_file, write_lock
from spatula_env.data.index import (
    EPISODES,
    INDEX_FILE,
    LENGTH,
    MAIN_FILE,
    METADATA_FILE,
    SPECS,
    EpisodeEntry,
    build_index,
    episode_file,
    read_metadata,
)
from spatula_env.data.layout import KEY, Layout
from spatula_env.data.origin import Origin
from spatula_env.data.pictures import ENCODED, can_be_encoded, reads_plain_pictures
from spatula_env.files import check_can_write
from spatula_env.installing import install_hint

if TYPE_CHECKING:
    import gymnasium

LINKS = "links"
"""Key of the number of links in the metadata."""
FIRST_LINKS = 64
"""Number of links at first; it is doubled when they are used up."""
AUTHOR = "unknown"
NAME = re.compile(r"(?P<namespace>[-\w]+(/[-\w]+)*/)?[-\w]+-v\d+")


class DatasetWriteError(OSError):
    """An episode could not be written; those before it are intact."""


class DatasetWriter:
    """Adds episodes to a dataset, which can be read at any time by ``minari.load_dataset``.

    Several programs may write to a dataset; each adds its episodes after those that are there.

    Attributes:
        dataset_id: Id by which `minari.load_dataset` finds it, as "spatula/press/human-v0".
        path: Its folder.
        total_episodes: Number of episodes, as of the last `add`.
        total_steps: Number of steps in all episodes.
        last_seed: The greatest seed of an episode; None if none has one.
    """

    def __init__(
        self,
        dataset_id: str,
        env: gymnasium.Env[Any, Any],
        *,
        root: str | Path | None = None,
        author: str = AUTHOR,
        description: str = "",
        algorithm_name: str = "teleoperation",
        author_email: str = AUTHOR,
        code_permalink: str = "",
        layout: Layout | None = None,
        several_settings: bool = False,
        path: Path | None = None,
    ) -> None:
        """Create the dataset, or open an existing one to add to it.

        Args:
            dataset_id: "namespace/name-v0"; the namespace may have several parts.
            env: Environment of the episodes; its `spec` is stored, so that the environment can be made again.
            root: Folder of all datasets; Minari's own by default, ``MINARI_DATASETS_PATH`` or ``~/.minari/datasets``.
            author: Author of the episodes; stored with each of them.
            description: Description of the dataset.
            algorithm_name: How the episodes were made.
            author_email: The author's address.
            code_permalink: Where the code is.
            layout: Names of the numbers; None takes them from `env`.
            several_settings: Whether `env` may have other options than the existing episodes. Each episode then keeps
                its own.
            path: The dataset's folder, if it is not the one that follows from the id.

        Raises:
            ImportError: If Minari, h5py or filelock is missing.
            ValueError: If the id is malformed, there is such a dataset of another environment or with other options,
                or `env` has a specification, or pictures, that cannot be stored.
            DatasetDamaged: If there is a link in its folder, or its metadata cannot be read.
            DatasetWriteError: If it cannot be written.
        """
        minari, _ = require_minari()
        check_dataset_id(dataset_id)
        self.dataset_id = dataset_id
        self.path = dataset_folder(dataset_id, root) if path is None else path
        self.total_episodes = self.total_steps = 0
        self.last_seed: int | None = None
        self._author = author
        self._data = self.path / "data"
        self._metadata_file, self._main_file = self._data / METADATA_FILE, self._data / MAIN_FILE
        origin = Origin.of(env, layout)
        self._spec = origin.spec.to_json()
        self._spaces = {"observations": env.observation_space, "actions": env.action_space}
        _check_own(self.path)
        if self._metadata_file.exists():
            origin.check(read_metadata(self._data), dataset_id, self.path, several_settings=several_settings)
        encodes = check_pictures(env)
        try:
            # Checked before anything is created.
            check_can_write(self._data / EPISODES)
            (self._data / EPISODES).mkdir(parents=True, exist_ok=True)
            with write_lock(self.path):
                for folder in (self._data, self._data / EPISODES):
                    remove_unfinished(folder)
                if not self._metadata_file.exists():
                    if path is None:
                        register_namespaces(dataset_id, root)
                    self._link(FIRST_LINKS)
                    append_to_file(self._data / INDEX_FILE, 0, b"")
                    own = {**origin.layout.as_record(), SPECS: [self._spec], LINKS: FIRST_LINKS, LENGTH: 0}
                    self._store(
                        {
                            "total_episodes": 0,
                            "total_steps": 0,
                            "data_format": "hdf5",
                            ENCODED: encodes,
                            **origin.spaces,
                            "env_spec": self._spec,
                            "dataset_id": dataset_id,
                            "algorithm_name": algorithm_name,
                            "author": [author],
                            "author_email": [author_email],
                            "code_permalink": code_permalink,
                            "description": description,
                            "minari_version": minari.__version__,
                            "requirements": [f"spatula-env=={__version__}"],
                            "dataset_size": 0.0,
                            KEY: own,
                        }
                    )
                self._take(read_metadata(self._data))
        except OSError as error:
            raise self._error("dataset could not be made", error) from error

    def add(self, episode: Episode) -> int:
        """Add an episode. When this returns, it is on the disk.

        Args:
            episode: The episode.

        Returns:
            Its number.

        Raises:
            DatasetDamaged: If there is a link in the dataset's folder.
            DatasetWriteError: If it could not be written, because the disk is full, for example. The dataset is
                unchanged, and can be added to later.
        """
        _check_own(self.path)
        try:
            with write_lock(self.path):
                # Another program may have added episodes.
                self._take(self._with_index(read_metadata(self._data)))
                return self._add(episode)
        except OSError as error:
            raise self._error(f"episode {self.total_episodes} could not be written", error) from error

    def _add(self, episode: Episode) -> int:
        number, metadata = self.total_episodes, dict(self._metadata)
        own = dict(metadata[KEY])
        own[SPECS], spec = _with(own[SPECS], self._spec)
        author = str(episode.attributes.get("author", self._author))
        # The author in an empty dataset is the one who created it, and need not be the author of an episode.
        metadata["author"], _ = _with(metadata.get("author", []) if number else [], author)
        known = replace(episode, attributes={**episode.attributes, "author": author, "spec": spec})
        content = episode_image(known, number, self._spaces if metadata.get(ENCODED) else {})
        write_file(episode_file(self._data, number), content)
        if number >= own[LINKS]:
            own[LINKS] = max(FIRST_LINKS, 2 * number)
            self._link(own[LINKS])
        line = EpisodeEntry.of(known, spec, len(content)).as_line()
        append_to_file(self._data / INDEX_FILE, own[LENGTH], line)
        own[LENGTH] += len(line)
        seeds = [seed for seed in (self.last_seed, episode.seed) if seed is not None]
        self._store(
            {
                **metadata,
                "total_episodes": number + 1,
                "total_steps": self.total_steps + len(episode),
                "last_seed": max(seeds, default=None),
                "dataset_size": round((metadata.get("dataset_size") or 0.0) + len(content) / 1e6, 6),
                KEY: own,
            }
        )
        return number

    def _store(self, metadata: dict[str, Any]) -> None:
        """Write the metadata, which makes everything that was written before a valid part of the dataset."""
        write_file(self._metadata_file, json.dumps(metadata).encode())
        self._take(metadata)

    def _take(self, metadata: dict[str, Any]) -> None:
        """Update the attributes from metadata."""
        self._metadata = metadata
        self.total_episodes = int(metadata["total_episodes"])
        self.total_steps = int(metadata.get("total_steps", 0))
        self.last_seed = metadata.get("last_seed")

    def _with_index(self, metadata: dict[str, Any]) -> dict[str, Any]:
        """Build the index of a dataset if an older version wrote it without one; returns the updated metadata."""
        own = dict(metadata.get(KEY) or {})
        if LENGTH in own:
            return metadata
        content = b"".join(entry.as_line() for entry in build_index(self._data, metadata["total_episodes"]))
        append_to_file(self._data / INDEX_FILE, 0, content)
        own |= {SPECS: [metadata["env_spec"]], LINKS: int(metadata["total_episodes"]), LENGTH: len(content)}
        return {**metadata, KEY: own}

    def _link(self, count: int) -> None:
        """Write the main file with links to `count` episodes."""
        _, h5py = require_minari()
        with h5py.File("links", "w", driver="core", backing_store=False, track_order=True) as main:
            for number in range(count):
                main[f"episode_{number}"] = h5py.ExternalLink(f"{EPISODES}/{number:06d}.hdf5", "/")
            main.flush()
            content = main.id.get_file_image()
        write_file(self._main_file, content)

    def _error(self, what: str, error: OSError) -> DatasetWriteError:
        return DatasetWriteError(
            error.errno,
            f"{what}: {error.strerror or error}; the {self.total_episodes} episodes before are intact in {self.path}",
        )


def register_namespaces(dataset_id: str, root: str | Path | None = None) -> None:
    """Let Minari list a dataset, by marking the folders on the way to it as namespaces.

    Args:
        dataset_id: Its id.
        root: Folder of all datasets; Minari's own by default.
    """
    top = dataset_folder("", root)
    for folder in dataset_folder(dataset_id, root).parents:
        if folder == top:
            break
        file = folder / "namespace_metadata.json"
        if not file.exists():
            write_file(file, b"{}")


def check_target(dataset_id: str, env: gymnasium.Env[Any, Any], root: str | Path | None = None) -> None:
    """Check that episodes of an environment can be added to a dataset, existing or not. Nothing is created.

    Args:
        dataset_id: Its id.
        env: The environment of the episodes.
        root: Folder of all datasets; Minari's own by default.

    Raises:
        ImportError: As by `DatasetWriter`.
        ValueError: As by `DatasetWriter`.
        OSError: If it cannot be written.
    """
    require_minari()
    check_dataset_id(dataset_id)
    origin = Origin.of(env)
    check_pictures(env)
    folder = dataset_folder(dataset_id, root)
    _check_own(folder)
    if (folder / "data" / METADATA_FILE).exists():
        origin.check(read_metadata(folder / "data"), dataset_id, folder)
    check_can_write(folder / "data" / EPISODES)


def check_pictures(env: gymnasium.Env[Any, Any]) -> bool:
    """Whether the pictures of an environment are stored encoded.

    Raises:
        ValueError: If they cannot be encoded, and the installed Minari reads no others.
    """
    if can_be_encoded(env.observation_space, env.action_space):
        return True
    if not reads_plain_pictures():
        raise ValueError(
            "pictures must have 2 to 4 channels, or no axis for channels: those of "
            f"{env.observation_space} are read by Minari 0.5.4 only, which needs Python 3.11"
        )
    return False


def check_dataset_id(dataset_id: str) -> None:
    """Check that Minari accepts a dataset's name.

    Raises:
        ValueError: If it does not; suggests a name that it accepts.
    """
    found = NAME.fullmatch(dataset_id)
    # Minari does not accept a namespace of one letter.
    if found is not None and len(found["namespace"] or "...") > 2:
        return
    words, version = re.fullmatch(r"(.*?)(-v\d+)?", dataset_id.strip("/ "), re.DOTALL).groups()  # type: ignore[union-attr]
    parts = [re.sub(r"[^-\w]+", "_", part).strip("_") for part in words.split("/")]
    *spaces, name = [part for part in parts if part] or ["my_data"]
    reason = ""
    if len("/".join(spaces)) == 1:
        reason, spaces = "; a NAMESPACE of one letter is none to Minari", []
    better = "/".join([*spaces, name]) + (version or "-v0")
    raise ValueError(
        f"dataset must be named as NAME-v0 or NAMESPACE/NAME-v0, of letters, digits, - and _{reason}, "
        f"got {dataset_id!r}: say {better!r}"
    )


def dataset_folder(dataset_id: str, root: str | Path | None = None) -> Path:
    """The folder of a dataset, to read it or to write it.

    Args:
        dataset_id: Its id; "" for the folder of all datasets.
        root: Folder of all datasets; Minari's own by default.

    Raises:
        ValueError: If Minari does not accept the name, or the folder is a link to a place outside `root`.
    """
    if root is None:
        root = os.environ.get("MINARI_DATASETS_PATH") or Path.home() / ".minari" / "datasets"
    top = Path(root)
    if not dataset_id:
        return top
    check_dataset_id(dataset_id)
    folder = top / dataset_id
    if not folder.resolve().is_relative_to(top.resolve()):
        raise ValueError(
            f"dataset {dataset_id!r} is a link out of {top}, to {folder.resolve()}; name that folder's root"
        )
    return folder


def read_layout(dataset_id: str, root: str | Path | None = None) -> Layout:
    """The layout of a dataset's numbers; empty if the dataset has none.

    Args:
        dataset_id: Its id.
        root: Folder of all datasets; Minari's own by default.

    Raises:
        FileNotFoundError: If there is no such dataset.
    """
    return Layout.from_record(read_metadata(dataset_folder(dataset_id, root) / "data").get(KEY))


def require_minari() -> tuple[ModuleType, ModuleType]:
    """Import Minari and h5py.

    Raises:
        ImportError: If one is missing; says what to install.
    """
    try:
        import h5py
        import minari
    except ImportError as error:
        raise ImportError(f"datasets need Minari and h5py: {install_hint('data')}") from error
    return minari, h5py


def _check_own(folder: Path) -> None:
    """Check that no link in a dataset's folder would lead what is written to a place outside."""
    inside(folder, "data", EPISODES)
    for name in (METADATA_FILE, MAIN_FILE, INDEX_FILE):
        inside(folder, "data", name)


def _with(values: list[str], value: str) -> tuple[list[str], int]:
    """The list with the value in it, appended if it was missing, and the value's index."""
    found = values if value in values else [*values, value]
    return found, found.index(value)
