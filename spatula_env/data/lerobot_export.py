"""Export of a dataset to the layout of LeRobot's datasets, version 3, written by LeRobot itself.

LeRobot needs Python 3.12 or later and a version of torch of its own choice, so it should have a virtual environment of
its own; the export needs no physics there.

Frame t of an episode has observation t, action t, and the results of that action: reward, whether the episode is over,
whether the goal has been reached. The last observation of an episode, which no action followed, is left out.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

import spatula_env
from spatula_env.data.dataset import read_layout
from spatula_env.data.drawing import StatePainter, recorded_moments
from spatula_env.data.files import inside
from spatula_env.data.layout import VECTOR, Layout
from spatula_env.data.replaying import open_dataset
from spatula_env.installing import install_hint

CAMERA = "observation.images.front"
"""Name of a camera's pictures."""
ROBOT = "spatula"
NOTES = "spatula_env.json"
"""File in the folder "meta" with what LeRobot has no place for: seeds, operators, devices, versions."""
FEATURES = {
    "next.reward": {"dtype": "float32", "shape": (1,), "names": None},
    "next.done": {"dtype": "bool", "shape": (1,), "names": None},
    "next.success": {"dtype": "bool", "shape": (1,), "names": None},
}


@dataclass(frozen=True)
class LeRobotExport:
    """The result of an export.

    Attributes:
        path: The folder.
        repo_id: Id by which LeRobot knows the dataset.
        episodes: Number of episodes.
        frames: Number of frames.
        features: Names of the features of each frame.
    """

    path: Path
    repo_id: str
    episodes: int
    frames: int
    features: tuple[str, ...]


def require_lerobot() -> Any:
    """Import LeRobot's dataset class.

    Raises:
        ImportError: If it is missing; says what to install.
    """
    try:
        from lerobot.datasets.lerobot_dataset import LeRobotDataset
    except ImportError as error:
        raise ImportError(
            "exporting needs LeRobot, which needs Python 3.12 or later: make an environment for it and "
            f"{install_hint('lerobot')} there ({error})",
            name=error.name,
        ) from error
    return LeRobotDataset


def export_lerobot(
    dataset_id: str,
    target: str | Path,
    *,
    root: str | Path | None = None,
    repo_id: str | None = None,
    episodes: Sequence[int] | None = None,
    successes_only: bool = False,
    videos: bool = True,
    camera: tuple[int, int] | None = None,
) -> LeRobotExport:
    """Export a dataset to LeRobot's format.

    Args:
        dataset_id: Its id.
        target: The folder, which must not exist yet. It is created completely or not at all.
        root: Folder of all datasets; Minari's own by default.
        repo_id: Id by which LeRobot will know it; by default the dataset's id, with no slash but the first.
        episodes: Numbers of the episodes; all by default.
        successes_only: Whether failures are left out.
        videos: Whether pictures are stored as videos, which is lossy; else as PNG.
        camera: (height, width) of pictures to draw from the recorded states, for datasets without pictures [pixels].

    Raises:
        ImportError: If LeRobot or Minari is missing.
        FileNotFoundError: If there is no such dataset.
        FileExistsError: If the folder exists.
        ValueError: If there is nothing to write, the number of steps per second is not whole, or pictures are to be
            drawn and no states were recorded.
    """
    create = require_lerobot().create
    folder = Path(target)
    if folder.exists():
        raise FileExistsError(f"{folder} exists already; name another folder or delete it")
    dataset = open_dataset(dataset_id, root)
    layout = read_layout(dataset_id, root)
    attributes = list(dataset.storage.get_episode_metadata(range(dataset.total_episodes)))
    numbers = _chosen(attributes, episodes, successes_only, dataset_id)
    painter = None if camera is None else StatePainter(layout, *camera)
    columns = make_columns(dataset.observation_space, dataset.action_space, layout, videos)
    if painter is not None:
        if CAMERA in columns.features:
            raise ValueError(f"dataset {dataset_id!r} has pictures already; leave the camera out")
        columns.features[CAMERA] = _picture_feature((*painter.size, 3), videos)
    name = repo_id if repo_id is not None else _repository(dataset_id)
    # Written beside its final place, because LeRobot writes file after file, and some of them are not a dataset.
    unfinished = inside(folder.parent, f".{folder.name}.new")
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.parent.mkdir(parents=True, exist_ok=True)
    try:
        made = create(
            repo_id=name,
            fps=_frames_per_second(layout, dataset_id),
            features=columns.features,
            root=unfinished,
            robot_type=ROBOT,
            use_videos=videos and any(each["dtype"] == "video" for each in columns.features.values()),
        )
        frames = 0
        for number in numbers:
            (episode,) = dataset.iterate_episodes([number])
            pictures = iter(()) if painter is None else map(painter.draw, recorded_moments(episode))
            for frame in columns.frames(episode):
                if painter is not None:
                    frame[CAMERA] = next(pictures)
                made.add_frame({**frame, "task": layout.task})
                frames += 1
            made.save_episode()
        made.finalize()
        notes = _notes(dataset_id, dataset, numbers, attributes)
        (unfinished / "meta" / NOTES).write_text(json.dumps(notes, indent=2) + "\n", encoding="utf-8")
        unfinished.replace(folder)
    except BaseException:
        shutil.rmtree(unfinished, ignore_errors=True)
        raise
    return LeRobotExport(folder, name, len(numbers), frames, tuple(columns.features))


@dataclass(frozen=True, eq=False)
class Columns:
    """The features of each frame.

    Attributes:
        features: Descriptions of the features, as LeRobot takes them.
        entries: Names of an observation's entries, by LeRobot's names.
    """

    features: dict[str, dict[str, Any]]
    entries: Mapping[str, str]

    def frames(self, episode: Any) -> Iterator[dict[str, NDArray[Any]]]:
        """Iterate over the T frames of an episode of T steps, in LeRobot's form."""
        steps = len(episode.rewards)
        success = _flags(episode.infos, "is_success", steps)
        done = np.asarray(episode.terminations) | np.asarray(episode.truncations)
        for step in range(steps):
            frame = {
                "action": np.asarray(episode.actions[step], dtype=np.float32),
                "next.reward": np.array([episode.rewards[step]], dtype=np.float32),
                "next.done": np.array([done[step]], dtype=np.bool_),
                "next.success": np.array([success[step]], dtype=np.bool_),
            }
            for name, entry in self.entries.items():
                values = (
                    episode.observations[entry] if isinstance(episode.observations, Mapping) else episode.observations
                )
                frame[name] = np.asarray(values[step], dtype=_type_of(self.features[name]))
            yield frame


def make_columns(
    observations: spaces.Space[Any], actions: spaces.Space[Any], layout: Layout, videos: bool = True
) -> Columns:
    """Derive the features of each frame of a dataset.

    Args:
        observations: The space of the dataset's observations.
        actions: The space of its actions.
        layout: Names of the numbers.
        videos: Whether pictures are stored as videos.

    Raises:
        ValueError: If LeRobot cannot store an entry, or has no name for it.
    """
    features: dict[str, dict[str, Any]] = {}
    entries: dict[str, str] = {}
    inner = observations.spaces if isinstance(observations, spaces.Dict) else {VECTOR: observations}
    for entry, space in inner.items():
        name = layout.lerobot_names.get(entry)
        if name is None:
            raise ValueError(f"the dataset does not say what LeRobot calls {entry!r}; was it recorded by this package?")
        if not isinstance(space, spaces.Box):
            raise ValueError(f"observations must be boxes, or a dictionary of them, got {space} as {entry!r}")
        entries[name] = entry
        if space.dtype == np.uint8 and len(space.shape) == 3:
            features[name] = _picture_feature(space.shape, videos)
        else:
            features[name] = _vector_feature(space.shape, layout.observation_names.get(entry, ()))
    features["action"] = _vector_feature(actions.shape or (), layout.action_names)
    return Columns({**features, **{name: dict(feature) for name, feature in FEATURES.items()}}, entries)


def _vector_feature(shape: tuple[int, ...], names: tuple[str, ...]) -> dict[str, Any]:
    fits = len(shape) == 1 and len(names) == shape[0]
    return {"dtype": "float32", "shape": tuple(shape), "names": list(names) if fits else None}


def _picture_feature(shape: tuple[int, ...], videos: bool) -> dict[str, Any]:
    return {
        "dtype": "video" if videos else "image",
        "shape": tuple(shape),
        "names": ["height", "width", "channels"],
    }


def _type_of(feature: Mapping[str, Any]) -> Any:
    return np.uint8 if feature["dtype"] in ("image", "video") else np.float32


def _flags(infos: Any, name: str, steps: int) -> NDArray[np.bool_]:
    """(T,) flags in the infos of the steps, without that of the reset; false where they are missing."""
    if not infos or name not in infos:
        return np.zeros(steps, dtype=np.bool_)
    return np.asarray(infos[name], dtype=np.bool_)[-steps:]


def _chosen(
    attributes: Sequence[Mapping[str, Any]], episodes: Sequence[int] | None, successes_only: bool, dataset_id: str
) -> list[int]:
    numbers = list(range(len(attributes))) if episodes is None else [int(number) for number in episodes]
    for number in numbers:
        if not 0 <= number < len(attributes):
            raise ValueError(f"episodes must be 0 to {len(attributes) - 1}, got {number}")
    if successes_only:
        numbers = [number for number in numbers if bool(attributes[number].get("success", False))]
    if not numbers:
        raise ValueError(f"there is nothing to write of dataset {dataset_id!r}")
    return numbers


def _frames_per_second(layout: Layout, dataset_id: str) -> int:
    frequency = layout.control_frequency
    if frequency is None or abs(frequency - round(frequency)) > 1e-9:
        raise ValueError(
            f"dataset {dataset_id!r} must have a whole number of control steps in a second, as LeRobot wants; "
            f"it has {frequency if frequency is not None else 'an unknown one'}"
        )
    return round(frequency)


def _repository(dataset_id: str) -> str:
    """LeRobot's id of a dataset, which has one slash."""
    first, slash, rest = dataset_id.partition("/")
    return first + slash + rest.replace("/", "-")


def _notes(
    dataset_id: str, dataset: Any, numbers: Sequence[int], attributes: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    kept = ("seed", "operator", "device", "success", "operator_share", "engine", "spatula_env_version")
    return {
        "dataset_id": dataset_id,
        "env_id": dataset.spec.env_spec.id,
        "env_kwargs": dict(dataset.spec.env_spec.kwargs),
        "description": str(dataset.storage.metadata.get("description", "")),
        "spatula_env_version": spatula_env.__version__,
        "episodes": [
            {
                "number": number,
                **{name: _plain(attributes[number][name]) for name in kept if name in attributes[number]},
            }
            for number in numbers
        ],
    }


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
