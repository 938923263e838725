"""Folders of runs: of new runs, resumed runs, and runs to be replaced."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spatula_env.files import check_can_write
from spatula_env.learning.configuration import TrainingConfig, find_config, read_training, to_mapping
from spatula_env.learning.saving import (
    BEST,
    CHECKPOINTS,
    CONFIG,
    CURVE,
    MODEL,
    POLICY,
    PROVENANCE,
    SUMMARY,
    checkpoints_in,
    read_curve,
)
from spatula_env.naming import find_environment, registered_id

try:
    import fcntl
except ImportError:
    # Windows lacks fcntl; commands in the same folder then do not notice each other.
    fcntl = None  # type: ignore[assignment]

ENDS = ("total_steps", "success_target")
"""Settings that may change when a run is resumed: those that say when it ends."""

LEFT = (CONFIG, SUMMARY, PROVENANCE, CURVE, BEST, POLICY, CHECKPOINTS, "tensorboard")
"""Files and folders of runs, their seeds and clones, besides the folders of seeds."""


@dataclass(frozen=True)
class RunPlace:
    """Location of a run, or of one of its seeds.

    Attributes:
        config: Training configuration.
        folder: Folder of the run, or of the seed if only that is resumed.
        alone: Whether it is the folder of a single seed.
    """

    config: TrainingConfig
    folder: Path
    alone: bool = False

    def seed_folder(self, seed: int) -> Path:
        """Folder of one of its seeds."""
        return self.folder if self.alone else self.folder / f"seed-{seed}"


def new_run(name: str, changes: Sequence[str], output: Path | None, *, overwrite: bool) -> RunPlace:
    """Prepare a new run. Writes nothing yet.

    Args:
        name: Name of the configuration, or its path.
        changes: Changes of the configuration.
        output: Folder of the run; None for `runs` and the configuration's name.
        overwrite: Whether it may replace an existing run.

    Raises:
        FileNotFoundError: If there is no such configuration.
        FileExistsError: If the folder holds something that must not be replaced.
        ValueError: If the configuration is invalid.
    """
    file = find_config(name)
    config = read_training(file, changes)
    config = _in_environment(config, find_environment(config.environment.id))
    folder = output or Path("runs") / file.stem
    check_place(folder, overwrite)
    return RunPlace(config, folder)


def resumed_run(path: Path, changes: Sequence[str] = (), env: str | None = None) -> RunPlace:
    """Prepare to resume a run. Writes nothing yet.

    Args:
        path: Folder of the run, or of one of its seeds.
        changes: Changes of the configuration: `total_steps` and `success_target` only.
        env: Name of the environment as the user gives it; needed if its module has to be imported.

    Raises:
        FileNotFoundError: If there is no run.
        ValueError: If it cannot be resumed with these changes.
    """
    file = path / CONFIG
    if not file.exists():
        raise FileNotFoundError(f"{path} holds no run to go on with: it has no {CONFIG}")
    if (path / MODEL).exists():
        raise ValueError(f"{path} is a policy of a run: name the run's folder, {_run_of(path)}")
    before, config = read_training(file), read_training(file, changes)
    _check_changes(before, config, path)
    alone = _is_seed(path, config)
    place = RunPlace(_in_environment(config, registered_id(config.environment.id, env)), path, alone)
    for seed in config.seeds:
        folder = place.seed_folder(seed)
        if checkpoints_in(folder / CHECKPOINTS):
            begun = dataclasses.replace(read_training(folder / CONFIG), seeds=config.seeds)
            _check_changes(begun, config, folder)
        if config != before and (folder / SUMMARY).exists():
            _check_longer(folder, config)
    return place


def _check_changes(before: TrainingConfig, after: TrainingConfig, folder: Path) -> None:
    other = [name for name in differences(to_mapping(before), to_mapping(after)) if name not in ENDS]
    if other:
        raise ValueError(
            f"{folder} goes on as it began, but for {' and '.join(ENDS)}; other values of {', '.join(sorted(other))} "
            "make another run: --config NAME --output DIR"
        )
    if after.total_steps < before.total_steps:
        raise ValueError(
            f"total_steps must be no less than before, {before.total_steps}, for {folder}, got {after.total_steps}"
        )


def _check_longer(folder: Path, config: TrainingConfig) -> None:
    """Check that a finished seed can be continued."""
    ended = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
    rate, target = ended["evaluation"]["success_rate"], config.success_target
    if target is not None and rate >= target:
        raise ValueError(
            f"{folder} ended after {ended['steps']} steps because it reached its success_target, {target}: "
            "to go on, change that too, such as with --set success_target=null"
        )
    if not is_over(ended, config) and not checkpoints_in(folder / CHECKPOINTS):
        raise ValueError(f"{folder} has no checkpoint to go on from: it ended before the first one")


def is_over(summary: Mapping[str, Any], config: TrainingConfig) -> bool:
    """Whether a finished seed, with this summary, has nothing left to do."""
    target = config.success_target
    reached = target is not None and summary["evaluation"]["success_rate"] >= target
    return bool(reached or summary["steps"] >= config.total_steps)


def differences(one: Mapping[str, Any], other: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Names of the values in which two configurations, as plain mappings, differ: "environment.num_envs"."""
    found = []
    for key in {*one, *other}:
        first, second = one.get(key), other.get(key)
        if isinstance(first, Mapping) and isinstance(second, Mapping):
            found += differences(first, second, f"{prefix}{key}.")
        elif first != second:
            found.append(f"{prefix}{key}")
    return found


def check_place(folder: Path, overwrite: bool) -> None:
    """Check that a run or a clone can be written to a folder without losing another.

    Args:
        folder: The folder.
        overwrite: Whether it may replace an existing run or clone.

    Raises:
        FileExistsError: If the folder holds something that must not be replaced.
        NotADirectoryError: If a file is in the way.
        OSError: If the folder is not writable.
    """
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"{folder} is a file")
    check_can_write(folder)
    if overwrite:
        return
    if holds_training(folder):
        raise FileExistsError(
            f"{folder} holds a run already: go on with it (train --resume), name another place (--output), or replace "
            "it (--overwrite)"
        )
    if (folder / CONFIG).exists():
        try:
            read_training(folder / CONFIG)
        except ValueError:
            raise FileExistsError(
                f"{folder} holds a {CONFIG} that is not of a run: name another place (--output), or replace it "
                "(--overwrite)"
            ) from None


def holds_training(folder: Path) -> bool:
    """Whether a folder holds anything trained, of any version; a run refused at its start leaves nothing trained."""
    places = (folder, *folder.glob("seed-*"))
    return any(
        (place / SUMMARY).exists()
        or any((place / name / MODEL).exists() for name in (BEST, POLICY))
        or checkpoints_in(place / CHECKPOINTS)
        or read_curve(place / CURVE)
        for place in places
    )


def clear_place(folder: Path, overwrite: bool) -> None:
    """Remove the files of an earlier run or clone from a folder, and nothing else.

    Args:
        folder: A folder that `check_place` has accepted.
        overwrite: Whether to remove trained policies too, and not only the rest of a run that was refused at its start.
    """
    seeds = [place for place in folder.glob("seed-*") if re.fullmatch(r"seed-\d+", place.name)]
    for place in (*seeds, *([folder] if overwrite else [])):
        for name in LEFT:
            if (place / name).is_dir():
                shutil.rmtree(place / name)
            else:
                (place / name).unlink(missing_ok=True)
        if place != folder and not any(place.iterdir()):
            place.rmdir()


def describe_saved(place: RunPlace) -> str:
    """Describe what is saved of an interrupted run."""
    told = []
    for seed in place.config.seeds:
        folder = place.seed_folder(seed)
        saved = checkpoints_in(folder / CHECKPOINTS)
        if (folder / SUMMARY).exists():
            told.append(f"seed {seed} is finished")
        elif saved:
            told.append(f"seed {seed} is saved as it was at {int(saved[-1].name.partition('-')[2]):,} steps")
        else:
            told.append(f"seed {seed} has no checkpoint yet")
    return ", ".join(told)


@contextmanager
def occupied(folder: Path) -> Iterator[None]:
    """Lock a folder against other commands in this context; creates it if it is missing.

    Raises:
        BlockingIOError: If another command is using the folder.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if fcntl is None:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BlockingIOError(f"another command is at work in {folder}") from None
        except OSError:
            # The file system does not support locks.
            pass
        yield
    finally:
        os.close(descriptor)


def _in_environment(config: TrainingConfig, env_id: str) -> TrainingConfig:
    return dataclasses.replace(config, environment=dataclasses.replace(config.environment, id=env_id))


def _is_seed(path: Path, config: TrainingConfig) -> bool:
    """Whether a folder belongs to a single seed rather than to a run."""
    named = re.fullmatch(r"seed-(\d+)", path.resolve().name)
    begun = any((path / name).exists() for name in (PROVENANCE, CURVE, CHECKPOINTS, BEST, POLICY))
    within = (path.resolve().parent / CONFIG).exists()
    return named is not None and config.seeds == (int(named[1]),) and (begun or within)


def _run_of(path: Path) -> Path:
    parents = [parent for parent in path.resolve().parents if (parent / CONFIG).exists()]
    return parents[0] if parents else path.parent
