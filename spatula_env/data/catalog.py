"""What datasets there are, what is in them, and copies of what is wanted of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from spatula_env.data.dataset import METADATA_FILE, DatasetWriter, dataset_folder, read_layout
from spatula_env.data.episode import Episode
from spatula_env.data.replaying import open_dataset

OWN_ATTRIBUTES = ("id", "seed", "total_steps", "options")
"""Of an episode's attributes, those that a copy gets anew."""

Keep = Callable[[Mapping[str, Any]], bool]
"""Takes an episode's attributes, and says whether it is wanted."""


@dataclass(frozen=True)
class DatasetSummary:
    """What is in a dataset.

    Attributes:
        dataset_id: Its id.
        path: Its folder.
        env_id: The environment's id.
        episodes: How many there are.
        steps: How many steps they have.
        megabytes: Size on the disk [MB].
        successes: How many reached their goal.
        operators: How many episodes each kind of operator did.
        devices: How many were done with each device.
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
    mean_return: float
    mean_length: float
    mean_peak_force: float


def list_datasets(root: str | Path | None = None) -> list[str]:
    """Ids of all datasets.

    Args:
        root: Folder of all datasets; Minari's own by default.
    """
    top = dataset_folder("", root)
    return sorted(str(file.parents[1].relative_to(top)) for file in top.glob(f"**/data/{METADATA_FILE}"))


def summarize(dataset_id: str, root: str | Path | None = None) -> DatasetSummary:
    """Look through a dataset.

    Args:
        dataset_id: Its id.
        root: Folder of all datasets; Minari's own by default.

    Raises:
        ImportError: If Minari is missing.
        FileNotFoundError: If there is no such dataset.
    """
    dataset = open_dataset(dataset_id, root)
    attributes = list(dataset.storage.get_episode_metadata(range(dataset.total_episodes)))
    returns, peaks = [], []
    for episode in dataset.iterate_episodes():
        returns.append(float(episode.rewards.sum()))
        if episode.infos and "episode_peak_force" in episode.infos:
            peaks.append(float(episode.infos["episode_peak_force"][-1]))
    path = dataset_folder(dataset_id, root)
    return DatasetSummary(
        dataset_id=dataset_id,
        path=path,
        env_id=dataset.spec.env_spec.id,
        episodes=int(dataset.total_episodes),
        steps=int(dataset.total_steps),
        megabytes=sum(file.stat().st_size for file in path.rglob("*") if file.is_file()) / 1e6,
        successes=sum(bool(each.get("success", False)) for each in attributes),
        operators=_count(attributes, "operator"),
        devices=_count(attributes, "device"),
        mean_return=float(np.mean(returns)) if returns else float("nan"),
        mean_length=dataset.total_steps / dataset.total_episodes if dataset.total_episodes else float("nan"),
        mean_peak_force=float(np.mean(peaks)) if peaks else float("nan"),
    )


def copy_episodes(
    sources: Sequence[str], target: str, *, root: str | Path | None = None, keep: Keep | None = None
) -> DatasetSummary:
    """Copy episodes of some datasets into another: merge them, or drop what is not wanted.

    Args:
        sources: Ids, of the same environment.
        target: Id of a dataset that does not exist yet.
        root: Folder of all datasets; Minari's own by default.
        keep: Which episodes are wanted, as ``lambda episode: episode["success"]``; all by default.

    Returns:
        What is in it then.

    Raises:
        ImportError: If Minari is missing.
        FileNotFoundError: If there is no such source.
        FileExistsError: If the target exists.
        ValueError: If there is no source, or they are of different environments; nothing is then written.
        DatasetWriteError: If it cannot be written.
    """
    if not sources:
        raise ValueError("sources must name a dataset at least")
    if (dataset_folder(target, root) / "data" / METADATA_FILE).exists():
        raise FileExistsError(f"there is a dataset {target!r} already; take another name")
    opened = [open_dataset(source, root) for source in sources]
    # Before anything is written.
    kinds = {source: dataset.spec.env_spec.id for source, dataset in zip(sources, opened, strict=True)}
    if len(set(kinds.values())) > 1:
        raise ValueError(
            f"sources must be of one environment, got {', '.join(f'{k} of {v}' for k, v in kinds.items())}"
        )
    for source, dataset in zip(sources, opened, strict=True):
        spaces = (dataset.observation_space, dataset.action_space)
        if spaces != (opened[0].observation_space, opened[0].action_space):
            raise ValueError(f"sources must have the same observations and actions, those of {source!r} are others")
    for source, dataset in zip(sources, opened, strict=True):
        # What a writer wants to know of an environment, without the physics.
        env: Any = SimpleNamespace(
            spec=dataset.spec.env_spec,
            observation_space=dataset.observation_space,
            action_space=dataset.action_space,
        )
        writer = DatasetWriter(
            target,
            env,
            root=root,
            description=f"Episodes of {', '.join(sources)}.",
            algorithm_name=dataset.storage.metadata.get("algorithm_name", "teleoperation"),
            layout=read_layout(source, root),
        )
        for number in range(dataset.total_episodes):
            (attributes,) = dataset.storage.get_episode_metadata([number])
            if keep is None or keep(attributes):
                (found,) = dataset.iterate_episodes([number])
                writer.add(_as_episode(found, attributes))
    return summarize(target, root)


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
    """Text as it was before HDF5 made bytes of it."""
    if isinstance(value, Mapping):
        return {name: _as_text(each) for name, each in value.items()}
    if isinstance(value, np.ndarray) and value.dtype == object:
        return [each.decode() if isinstance(each, bytes) else str(each) for each in value.tolist()]
    return value


def _count(attributes: Sequence[Mapping[str, Any]], name: str) -> dict[str, int]:
    found: dict[str, int] = {}
    for each in attributes:
        value = str(each.get(name, "unknown"))
        found[value] = found.get(value, 0) + 1
    return found
