"""A dataset on disk in Minari's format, written so that nothing that was written is ever lost.

Minari keeps all episodes in one HDF5 file, and a program that is killed while it writes to it can take all with it.
Here every episode is a file of its own, and ``main_data.hdf5`` holds external links to them, which HDF5 follows by
itself. Every file is written under another name, brought to the disk, and renamed: there is the old one or the new one
and nothing in between. The order is episode, links, metadata; a reader takes the number of episodes from the metadata.

Minari's own `DataCollector` needs JAX for no more than to append to lists, and stores pictures as JPEG by default; here
they are lossless.
"""

from __future__ import annotations

import copy
import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env import __version__
from spatula_env.data.episode import Episode
from spatula_env.data.layout import KEY, Layout

if TYPE_CHECKING:
    import gymnasium

MAIN_FILE = "main_data.hdf5"
METADATA_FILE = "metadata.json"
EPISODES = "episodes"
"""Folder with the episodes' files, beside the main file."""
COMPRESSION = 4
"""Of arrays of numbers, lossless."""
AUTHOR = "unknown"


class DatasetWriteError(OSError):
    """An episode could not be written; those before it are intact."""


class DatasetWriter:
    """Adds episodes to a dataset, which can be read at any time by ``minari.load_dataset``.

    One program at a time may write to a dataset.

    Attributes:
        dataset_id: By which `minari.load_dataset` finds it, as "spatula/press/human-v0".
        path: Its folder.
        total_episodes: How many episodes there are.
        total_steps: How many steps they have.
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
    ) -> None:
        """Make the dataset, or go on with it.

        Args:
            dataset_id: "namespace/name-v0"; the namespace may have several parts.
            env: What the episodes are of; its `spec` is stored, without its mode of rendering, so that Minari can make
                it again.
            root: Folder of all datasets; Minari's own by default, ``MINARI_DATASETS_PATH`` or ``~/.minari/datasets``.
            author: Who made it.
            description: What it is.
            algorithm_name: How it was made.
            author_email: Where to reach the author.
            code_permalink: Where the code is.
            layout: What the numbers are called; None takes it from `env`.

        Raises:
            ImportError: If Minari or h5py is missing.
            ValueError: If the id is malformed, or there is such a dataset of another environment.
            DatasetWriteError: If it cannot be written.
        """
        minari, _ = require_minari()
        from minari.dataset.minari_dataset import parse_dataset_id
        from minari.serialization import serialize_space

        parse_dataset_id(dataset_id)
        self.dataset_id = dataset_id
        self.path = dataset_folder(dataset_id, root)
        self.total_episodes = self.total_steps = 0
        self.last_seed: int | None = None
        data = self.path / "data"
        self._metadata_file, self._main_file = data / METADATA_FILE, data / MAIN_FILE
        if env.spec is None:
            raise ValueError("env must have a spec: make it with gymnasium.make")
        spaces = {
            "observation_space": serialize_space(env.observation_space),
            "action_space": serialize_space(env.action_space),
        }
        if self._metadata_file.exists():
            self._go_on(spaces)
            return
        self._metadata: dict[str, Any] = {
            "total_episodes": 0,
            "total_steps": 0,
            "data_format": "hdf5",
            "jpeg_encoding": False,
            **spaces,
            "env_spec": _without_pictures(env.spec).to_json(),
            "dataset_id": dataset_id,
            "algorithm_name": algorithm_name,
            "author": [author],
            "author_email": [author_email],
            "code_permalink": code_permalink,
            "description": description,
            "minari_version": minari.__version__,
            "requirements": [f"spatula-env=={__version__}"],
            "dataset_size": 0.0,
            KEY: (layout if layout is not None else Layout.of(env)).as_record(),
        }
        try:
            (data / EPISODES).mkdir(parents=True, exist_ok=True)
            self._register_namespaces(root)
            self._link(0)
            _write_file(self._metadata_file, json.dumps(self._metadata).encode())
        except OSError as error:
            raise self._error("dataset could not be made", error) from error

    def add(self, episode: Episode) -> int:
        """Add an episode. When this returns, it is on the disk.

        Args:
            episode: What to add.

        Returns:
            Its number.

        Raises:
            DatasetWriteError: If it could not be written, because the disk is full, for example. The dataset is as
                before, and can be added to later.
        """
        number = self.total_episodes
        file = self._main_file.parent / EPISODES / f"{number:06d}.hdf5"
        metadata = {
            **self._metadata,
            "total_episodes": number + 1,
            "total_steps": self.total_steps + len(episode),
            "last_seed": max((seed for seed in (self.last_seed, episode.seed) if seed is not None), default=None),
        }
        try:
            content = _episode_image(episode, number)
            metadata["dataset_size"] = round(self._metadata["dataset_size"] + len(content) / 1e6, 6)
            _write_file(file, content)
            self._link(number + 1)
            _write_file(self._metadata_file, json.dumps(metadata).encode())
        except OSError as error:
            raise self._error(f"episode {number} could not be written", error) from error
        self._metadata = metadata
        self.total_episodes, self.total_steps = number + 1, metadata["total_steps"]
        self.last_seed = metadata["last_seed"]
        return number

    def _go_on(self, spaces: Mapping[str, str]) -> None:
        self._metadata = json.loads(self._metadata_file.read_text())
        for name, value in spaces.items():
            if self._metadata[name] != value:
                raise ValueError(
                    f"dataset {self.dataset_id!r} has episodes with another {name.replace('_', ' ')}; take another "
                    f"name or delete {self.path}"
                )
        if self._metadata["total_episodes"] and not (self._main_file.parent / EPISODES / "000000.hdf5").exists():
            raise ValueError(f"dataset {self.dataset_id!r} was not written by this program; take another name")
        self.total_episodes = int(self._metadata["total_episodes"])
        self.total_steps = int(self._metadata["total_steps"])
        self.last_seed = self._metadata.get("last_seed")

    def _link(self, count: int) -> None:
        """Write the main file with links to so many episodes."""
        _, h5py = require_minari()
        with h5py.File("links", "w", driver="core", backing_store=False, track_order=True) as main:
            for number in range(count):
                main[f"episode_{number}"] = h5py.ExternalLink(f"{EPISODES}/{number:06d}.hdf5", "/")
            main.flush()
            content = main.id.get_file_image()
        _write_file(self._main_file, content)

    def _register_namespaces(self, root: str | Path | None) -> None:
        """Let Minari list the dataset: folders on the way to it are namespaces."""
        top = dataset_folder("", root)
        for folder in self.path.parents:
            if folder == top:
                break
            file = folder / "namespace_metadata.json"
            if not file.exists():
                _write_file(file, b"{}")

    def _error(self, what: str, error: OSError) -> DatasetWriteError:
        return DatasetWriteError(
            error.errno,
            f"{what}: {error.strerror or error}; the {self.total_episodes} episodes before are intact in {self.path}",
        )


def dataset_folder(dataset_id: str, root: str | Path | None = None) -> Path:
    """The folder of a dataset.

    Args:
        dataset_id: Its id.
        root: Folder of all datasets; Minari's own by default.
    """
    if root is None:
        root = os.environ.get("MINARI_DATASETS_PATH") or Path.home() / ".minari" / "datasets"
    return Path(root) / dataset_id


def read_layout(dataset_id: str, root: str | Path | None = None) -> Layout:
    """What a dataset's numbers are called; empty if it does not say.

    Args:
        dataset_id: Its id.
        root: Folder of all datasets; Minari's own by default.

    Raises:
        FileNotFoundError: If there is no such dataset.
    """
    file = dataset_folder(dataset_id, root) / "data" / METADATA_FILE
    return Layout.from_record(json.loads(file.read_text()).get(KEY))


def require_minari() -> tuple[ModuleType, ModuleType]:
    """Import Minari and h5py.

    Raises:
        ImportError: If one is missing; says what to install.
    """
    try:
        import h5py
        import minari
    except ImportError as error:
        raise ImportError("datasets need Minari and h5py: pip install 'spatula-env[data]'") from error
    return minari, h5py


def _without_pictures(spec: Any) -> Any:
    """A specification without the mode of rendering: whoever watched a recording, its environment opens no windows."""
    plain = copy.deepcopy(spec)
    plain.kwargs.pop("render_mode", None)
    return plain


def _episode_image(episode: Episode, number: int) -> bytes:
    """The bytes of an episode's file.

    Made in memory first: then only plain writes can fail, and those say why.
    """
    _, h5py = require_minari()
    with h5py.File("episode", "w", driver="core", backing_store=False) as file:
        file.attrs["id"] = number
        file.attrs["total_steps"] = len(episode)
        if episode.seed is not None:
            file.attrs["seed"] = episode.seed
        for name, value in (episode.options or {}).items():
            file.attrs[f"options/{name}"] = value
        file.attrs.update(episode.attributes)
        for name in ("observations", "actions", "rewards", "terminations", "truncations", "infos"):
            _put(file, name, getattr(episode, name))
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def _put(group: Any, name: str, value: Any) -> None:
    _, h5py = require_minari()
    # A slash in a name is a path to HDF5, and a group of groups to Minari. `info` has such keys.
    if isinstance(value, Mapping):
        inner = group.require_group(name)
        for key, each in value.items():
            _put(inner, key, each)
    elif isinstance(value, list):
        group.create_dataset(name, data=value, dtype=h5py.string_dtype(encoding="utf-8"))
    else:
        array = np.asarray(value)
        group.create_dataset(
            name, data=array, chunks=True, compression="gzip", compression_opts=COMPRESSION, shuffle=True
        )


def _write_file(path: Path, content: bytes) -> None:
    """Write a file: it has its old content or the new one, whatever happens."""
    new = path.with_name(f".{path.name}.new")
    try:
        with new.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    except BaseException:
        new.unlink(missing_ok=True)
        raise
    # The renaming itself has to get to the disk, too.
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
