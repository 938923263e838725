"""The index of a dataset: a record of each episode, so that listing them opens no episode.

The file has a line of JSON for each episode. The dataset's metadata say how long it is: anything beyond that was
written by a program that was killed; it is ignored, and overwritten by the next line.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from spatula_env.data.checking import check_line, check_metadata, read_json
from spatula_env.data.contained import check_contained, check_main_file, check_no_links
from spatula_env.data.episode import Episode
from spatula_env.data.files import DatasetDamaged, inside
from spatula_env.data.layout import KEY
from spatula_env.data.specs import spec_from_json

INDEX_FILE = "index.jsonl"
METADATA_FILE = "metadata.json"
MAIN_FILE = "main_data.hdf5"
EPISODES = "episodes"
"""Folder with the episodes' files, beside the main file."""
SPECS = "env_specs"
"""Key of the specifications of the episodes' environments in the metadata."""
LENGTH = "index_bytes"
"""Key of the length of the index in the metadata."""
OWN_ATTRIBUTES = ("id", "seed", "total_steps", "options", "spec")
"""Attributes in an episode's file that are not part of `Episode.attributes`: they follow from where the episode is."""
PEAK_FORCE = "episode_peak_force"


@dataclass(frozen=True)
class EpisodeEntry:
    """The index's record of an episode.

    Attributes:
        steps: Number of steps.
        total_reward: Sum of its rewards.
        peak_force: Greatest force on a tool [N]; None if that was not recorded.
        seed: Seed of its reset; None if that is not known.
        spec: Index of its environment's specification in the dataset.
        size: Size of its file [bytes].
        attributes: ``operator``, ``device``, ``success``, ``author`` …
    """

    steps: int
    total_reward: float
    peak_force: float | None
    seed: int | None
    spec: int
    size: int
    attributes: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, episode: Episode, spec: int, size: int) -> EpisodeEntry:
        """Make the record of an episode that is about to be added."""
        peaks = episode.infos.get(PEAK_FORCE)
        return cls(
            steps=len(episode),
            total_reward=float(episode.rewards.sum()),
            peak_force=None if peaks is None or isinstance(peaks, list | Mapping) else _finite(np.ravel(peaks)[-1]),
            seed=None if episode.seed is None else int(episode.seed),
            spec=spec,
            size=size,
            attributes={name: plain(each) for name, each in episode.attributes.items() if name not in OWN_ATTRIBUTES},
        )

    def as_line(self) -> bytes:
        """The record as a line of the index."""
        return json.dumps(vars(self), default=repr).encode() + b"\n"


def read_metadata(data: Path) -> dict[str, Any]:
    """Read and check the metadata of a dataset.

    Args:
        data: The folder "data" in the dataset's folder.

    Raises:
        FileNotFoundError: If there is no dataset.
        DatasetDamaged: If they cannot be read.
    """
    file = inside(data.parent, data.name, METADATA_FILE)
    try:
        content = file.read_bytes()
    except FileNotFoundError:
        raise
    except OSError as error:
        raise DatasetDamaged(f"{file} cannot be read: {error}") from error
    return check_metadata(read_json(content, str(file)), file)


def check_harmless(data: Path) -> dict[int, str]:
    """Check that Minari can open a dataset without making an environment that it names or reading files outside it.

    Args:
        data: The folder "data" in the dataset's folder.

    Returns:
        Files of episodes that have not been checked inside, by the episodes' numbers; see `check_main_file`.

    Raises:
        FileNotFoundError: If there is no dataset.
        DatasetDamaged: If it cannot.
    """
    from minari.serialization import deserialize_space

    metadata = read_metadata(data)
    for name in ("observation_space", "action_space"):
        # Otherwise Minari makes the environment to get its spaces, and so imports whatever the dataset names.
        if not isinstance(metadata.get(name), str):
            raise DatasetDamaged(f"{data / METADATA_FILE} has no {name}")
        try:
            deserialize_space(metadata[name])
        # Gymnasium and Minari may raise any exception.
        except Exception as error:
            raise DatasetDamaged(f"{data / METADATA_FILE} has an {name} that is none: {error}") from error
    for text in {metadata.get("env_spec"), *(metadata.get(KEY) or {}).get(SPECS, [])} - {None}:
        spec_from_json(text)
    if metadata.get("data_format", "hdf5") == "hdf5" and (data / MAIN_FILE).is_file():
        return check_main_file(data, MAIN_FILE, metadata["total_episodes"])
    check_no_links(data)
    return {}


def read_index(data: Path, metadata: Mapping[str, Any] | None = None) -> list[EpisodeEntry]:
    """Read the records of all episodes. For a dataset without an index, they are made from the episodes.

    Args:
        data: The folder "data" in the dataset's folder.
        metadata: Its metadata; None reads them.

    Raises:
        FileNotFoundError: If there is no dataset.
        DatasetDamaged: If an episode is missing or cannot be read, or the index is not complete.
    """
    told = read_metadata(data) if metadata is None else metadata
    length = (told.get(KEY) or {}).get(LENGTH)
    if length is None:
        return build_index(data, told["total_episodes"], count_specs(told))
    file = inside(data.parent, data.name, INDEX_FILE)
    try:
        lines = file.read_bytes()[:length].splitlines()
    except OSError as error:
        raise DatasetDamaged(f"{file} cannot be read: {error}") from error
    specs = count_specs(told)
    entries = [
        EpisodeEntry(**check_line(read_json(line, f"{file}, line {number}"), f"{file}, line {number}", specs))
        for number, line in enumerate(lines, start=1)
    ]
    if len(entries) != told["total_episodes"]:
        raise DatasetDamaged(f"{file} has {len(entries)} episodes, there are to be {told['total_episodes']}")
    return entries


def count_specs(metadata: Mapping[str, Any]) -> int:
    """Number of specifications of environments in a dataset.

    Args:
        metadata: Metadata of the dataset.
    """
    return len((metadata.get(KEY) or {}).get(SPECS, [None]))


def check_files(data: Path, entries: Sequence[EpisodeEntry]) -> None:
    """Check that all files of a dataset exist, with the sizes with which they were written.

    Args:
        data: The folder "data" in the dataset's folder.
        entries: Its index.

    Raises:
        DatasetDamaged: If one is missing or has another size.
    """
    if not inside(data.parent, data.name, MAIN_FILE).is_file():
        raise DatasetDamaged(f"{data / MAIN_FILE} is missing")
    inside(data, EPISODES)
    for number, entry in enumerate(entries):
        file = episode_file(data, number)
        try:
            size = inside(file.parent, file.name).stat().st_size
        except OSError:
            if not (data / EPISODES).exists():
                # Minari's own: all episodes are in the main file.
                return
            raise DatasetDamaged(f"episode {number} is missing: there is no {file}") from None
        if size != entry.size:
            raise DatasetDamaged(f"episode {number} is damaged: {file} has {size} bytes instead of {entry.size}")


def build_index(data: Path, count: int, specs: int = 1) -> list[EpisodeEntry]:
    """Make the index of a dataset that has none, by going through its episodes.

    Args:
        data: The folder "data" in the dataset's folder.
        count: Number of episodes.
        specs: Number of specifications of environments.

    Raises:
        DatasetDamaged: If an episode cannot be read.
    """
    import h5py

    if not (data / MAIN_FILE).is_file():
        raise DatasetDamaged(f"{data / MAIN_FILE} is missing")
    check_contained(data, MAIN_FILE, count)
    entries = []
    try:
        with h5py.File(data / MAIN_FILE, "r") as main:
            for number in range(count):
                group = main[f"episode_{number}"]
                attributes = dict(group.attrs)
                seed, peaks = attributes.get("seed"), group.get(f"infos/{PEAK_FORCE}")
                file = episode_file(data, number)
                entry = EpisodeEntry(
                    steps=len(group["rewards"]),
                    total_reward=float(group["rewards"][()].sum()),
                    peak_force=None if peaks is None else _finite(peaks[-1]),
                    seed=None if seed is None else int(seed),
                    spec=int(attributes.get("spec", 0)),
                    size=file.stat().st_size if file.exists() else 0,
                    attributes={
                        name: plain(value)
                        for name, value in attributes.items()
                        if name.partition("/")[0] not in OWN_ATTRIBUTES
                    },
                )
                check_line(vars(entry), f"episode {number} in {data}", specs)
                entries.append(entry)
    except DatasetDamaged:
        raise
    except (AttributeError, IndexError, KeyError, OSError, OverflowError, RuntimeError, TypeError, ValueError) as error:
        raise DatasetDamaged(f"episode {len(entries)} in {data} cannot be read: {error}") from error
    return entries


def episode_file(data: Path, number: int) -> Path:
    """The file of an episode."""
    return data / EPISODES / f"{number:06d}.hdf5"


def plain(value: Any) -> Any:
    """Convert a NumPy value to plain Python, and bytes to text."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    return value.decode() if isinstance(value, bytes) else value


def _finite(value: Any) -> float | None:
    number = float(value)
    return number if np.isfinite(number) else None
