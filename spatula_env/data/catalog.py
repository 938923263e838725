"""The catalogue of datasets: listing, summarizing, copying and joining them."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from spatula_env.data.dataset import DatasetWriter, check_dataset_id, dataset_folder, read_layout, register_namespaces
from spatula_env.data.episode import Episode
from spatula_env.data.files import inside, recording_lock
from spatula_env.data.index import (
    INDEX_FILE,
    MAIN_FILE,
    METADATA_FILE,
    OWN_ATTRIBUTES,
    EpisodeEntry,
    check_files,
    read_index,
    read_metadata,
)
from spatula_env.data.origin import MEANING
from spatula_env.data.replaying import data_folder, open_dataset, read_entries, recorded_specs
from spatula_env.data.specs import spec_from_json
from spatula_env.files import check_can_write

Keep = Callable[[Mapping[str, Any]], bool]
"""Function of an episode's attributes that returns whether the episode is wanted."""


@dataclass(frozen=True)
class DatasetSummary:
    """What is in a dataset.

    Attributes:
        dataset_id: Its id.
        path: Its folder.
        env_id: The environment's id.
        episodes: Number of episodes.
        steps: Number of steps in all episodes.
        megabytes: Size on the disk [MB].
        successes: Number of episodes that reached their goal.
        operators: Number of episodes by each kind of operator.
        devices: Number of episodes with each device.
        authors: Number of episodes by each author.
        mean_return: Mean sum of the rewards of an episode.
        mean_length: Mean length [steps].
        mean_peak_force: Mean of the greatest force on a tool in an episode [N]; NaN if that was not recorded.
    """

    dataset_id: str
    path: Path
    env_id: str
    episodes: int
    steps: int
    megabytes: float
    successes: int
    operators: Mapping[str, int]
    devices: Mapping[str, int]
    authors: Mapping[str, int]
    mean_return: float
    mean_length: float
    mean_peak_force: float


def list_datasets(root: str | Path | None = None) -> list[str]:
    """Ids of all datasets.

    Args:
        root: Folder of all datasets; Minari's own by default.
    """
    top = dataset_folder("", root)
    found = [file.parents[1].relative_to(top) for file in top.glob(f"**/data/{METADATA_FILE}")]
    # A dataset that is still being made has a name that begins with a dot.
    return sorted(path.as_posix() for path in found if not any(part.startswith(".") for part in path.parts))


def summarize(dataset_id: str, root: str | Path | None = None) -> DatasetSummary:
    """Summarize a dataset from its index; no episode is opened.

    Args:
        dataset_id: Its id.
        root: Folder of all datasets; Minari's own by default.

    Raises:
        FileNotFoundError: If there is no such dataset.
        DatasetDamaged: If a part of it is missing or cannot be read.
    """
    data = data_folder(dataset_id, root)
    metadata = read_metadata(data)
    entries = read_index(data, metadata)
    check_files(data, entries)
    env_id = spec_from_json(metadata.get("env_spec")).id
    own = [data / name for name in (MAIN_FILE, INDEX_FILE, METADATA_FILE)]
    peaks = [entry.peak_force for entry in entries if entry.peak_force is not None]
    steps = sum(entry.steps for entry in entries)
    return DatasetSummary(
        dataset_id=dataset_id,
        path=data.parent,
        env_id=env_id,
        episodes=len(entries),
        steps=steps,
        megabytes=sum([entry.size for entry in entries] + [file.stat().st_size for file in own if file.exists()]) / 1e6,
        successes=sum(bool(entry.attributes.get("success", False)) for entry in entries),
        operators=_count(entries, "operator"),
        devices=_count(entries, "device"),
        authors=_count(entries, "author"),
        mean_return=float(np.mean([entry.total_reward for entry in entries])) if entries else float("nan"),
        mean_length=steps / len(entries) if entries else float("nan"),
        mean_peak_force=float(np.mean(peaks)) if peaks else float("nan"),
    )


def copy_episodes(
    sources: Sequence[str], target: str, *, root: str | Path | None = None, keep: Keep | None = None
) -> DatasetSummary:
    """Copy episodes of some datasets into a new one: to merge them, or to drop episodes.

    The new dataset is complete, or not there at all. Episodes keep their attributes, including author and options of
    their environment; the options may differ as long as observations and actions mean the same.

    Args:
        sources: Ids of datasets of the same environment.
        target: Id of a dataset that does not exist yet.
        root: Folder of all datasets; Minari's own by default.
        keep: Which episodes are wanted, as ``lambda episode: episode["success"]``; all by default.

    Returns:
        Summary of the new dataset.

    Raises:
        ImportError: If Minari is missing.
        FileNotFoundError: If there is no such source.
        FileExistsError: If the target exists.
        ValueError: If there is no source, or they are of different environments; nothing is then written.
        DatasetDamaged: If a source cannot be read or refers to data outside of it, or a link is in the target's place.
        DatasetBusy: If another program is making a dataset of that name.
        OSError: If it cannot be written.
    """
    if not sources:
        raise ValueError("sources must name a dataset at least")
    check_dataset_id(target)
    folder = dataset_folder(target, root)
    if inside(folder, "data", METADATA_FILE).exists():
        raise FileExistsError(f"there is a dataset {target!r} already; take another name")
    opened = [open_dataset(source, root) for source in sources]
    # All checks come before anything is written.
    _check_sources(sources, opened, root)
    check_can_write(folder)
    # There might be a link at this place, and the contents of the folder are removed below.
    new = inside(folder.parent, f".{folder.name}.new")
    inside(new, "data")
    with recording_lock(new, target):
        # Left by a program that was killed.
        shutil.rmtree(new / "data", ignore_errors=True)
        try:
            for source, dataset in zip(sources, opened, strict=True):
                _copy_into(new, target, source, dataset, f"Episodes of {', '.join(sources)}.", keep, root)
            folder.mkdir(parents=True, exist_ok=True)
            register_namespaces(target, root)
            (new / "data").replace(folder / "data")
        finally:
            shutil.rmtree(new / "data", ignore_errors=True)
    return summarize(target, root)


def _check_sources(sources: Sequence[str], opened: Sequence[Any], root: str | Path | None) -> None:
    """Check that datasets can be joined."""
    kinds = {source: dataset.spec.env_spec.id for source, dataset in zip(sources, opened, strict=True)}
    if len(set(kinds.values())) > 1:
        raise ValueError(
            f"sources must be of one environment, got {', '.join(f'{k} of {v}' for k, v in kinds.items())}"
        )
    layouts = [read_layout(source, root) for source in sources]
    for source, dataset, layout in zip(sources, opened, layouts, strict=True):
        spaces = (dataset.observation_space, dataset.action_space)
        if spaces != (opened[0].observation_space, opened[0].action_space):
            raise ValueError(f"sources must have the same observations and actions, those of {source!r} are others")
        for name in MEANING:
            pair = getattr(layouts[0], name), getattr(layout, name)
            if pair[0] != pair[1]:
                raise ValueError(
                    f"sources must have the same {name.replace('_', ' ')}, got {pair[0]} in {sources[0]!r} and "
                    f"{pair[1]} in {source!r}"
                )


def _copy_into(
    folder: Path,
    target: str,
    source: str,
    dataset: Any,
    description: str,
    keep: Keep | None,
    root: str | Path | None,
) -> None:
    """Copy the episodes of a dataset into one that is being made."""
    metadata = dataset.storage.metadata
    author = ", ".join(sorted(metadata.get("author", ()))) or "unknown"
    layout = read_layout(source, root)

    def writer(spec: Any) -> DatasetWriter:
        # Stands in for an environment: what a writer needs of it, without the physics.
        env: Any = SimpleNamespace(
            spec=spec, observation_space=dataset.observation_space, action_space=dataset.action_space
        )
        return DatasetWriter(
            target,
            env,
            root=root,
            author=author,
            description=description,
            algorithm_name=metadata.get("algorithm_name", "teleoperation"),
            layout=layout,
            several_settings=True,
            path=folder,
        )

    writers = [writer(spec) for spec in recorded_specs(source, root)]
    for number, entry in enumerate(read_entries(source, root)):
        (attributes,) = dataset.storage.get_episode_metadata([number])
        if keep is None or keep(attributes):
            (found,) = dataset.iterate_episodes([number])
            writers[entry.spec].add(_as_episode(found, attributes))


def _as_episode(found: Any, attributes: Mapping[str, Any]) -> Episode:
    seed = attributes.get("seed")
    return Episode(
        observations=found.observations,
        actions=found.actions,
        rewards=found.rewards,
        terminations=found.terminations,
        truncations=found.truncations,
        infos=_as_text(found.infos or {}),
        seed=None if seed is None else int(seed),
        options=attributes.get("options"),
        attributes={name: value for name, value in attributes.items() if name not in OWN_ATTRIBUTES},
    )


def _as_text(value: Any) -> Any:
    """Convert bytes from HDF5 back to text, also in nested mappings."""
    if isinstance(value, Mapping):
        return {name: _as_text(each) for name, each in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.kind in "OS":
        return [each.decode() if isinstance(each, bytes) else str(each) for each in value.tolist()]
    return value


def _count(entries: Sequence[EpisodeEntry], name: str) -> dict[str, int]:
    found: dict[str, int] = {}
    for entry in entries:
        value = str(entry.attributes.get(name, "unknown"))
        found[value] = found.get(value, 0) + 1
    return found
