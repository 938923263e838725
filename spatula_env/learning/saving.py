"""The files of a run: written atomically, and read again.

A run has a folder for each seed:

    RUN/seed-0/config.yaml          the configuration, with all defaults and changes, and this seed only
    RUN/seed-0/provenance.json      versions, commit, machine
    RUN/seed-0/curve.jsonl          a line for each evaluation
    RUN/seed-0/tensorboard/
    RUN/seed-0/checkpoints/step-N/  the last two; all that training needs to go on
    RUN/seed-0/best/                the policy of the best evaluation
    RUN/seed-0/policy/              the policy at the end
    RUN/seed-0/summary.json         how it ended; exists only when the seed is finished
    RUN/summary.json                all seeds

Files and folders appear complete or not at all: they are written under a temporary name beside their place, then
renamed.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import subprocess
import uuid
from collections.abc import Callable, Mapping
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spatula_env import __version__
from spatula_env.definitions import FIRST, definition_number
from spatula_env.engines import BULLET_DISTRIBUTIONS
from spatula_env.files import UNFINISHED, write_text
from spatula_env.learning.acting import acting_policy
from spatula_env.learning.configuration import TrainingConfig, read_training, write_training
from spatula_env.learning.policies import Policy, interface_of

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecNormalize

MODEL, NORMALIZER, CONFIG = "model.zip", "normalizer.npz", "config.yaml"

EVALUATION, PROVENANCE, SUMMARY, CURVE = "evaluation.json", "provenance.json", "summary.json", "curve.jsonl"

BEST, POLICY, CHECKPOINTS = "best", "policy", "checkpoints"
"""Folders within a seed's folder."""

PACKAGES = (
    "gymnasium",
    "numpy",
    "numba",
    *BULLET_DISTRIBUTIONS,
    "torch",
    "stable-baselines3",
    "sb3-contrib",
    "ray",
)
"""Packages whose versions are recorded."""

KEPT_CHECKPOINTS = 2


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file atomically."""
    write_text(path, json.dumps(content, indent=2) + "\n")


def write_folder(path: Path, fill: Callable[[Path], None]) -> None:
    """Write a folder atomically, replacing an existing one.

    Args:
        path: Path of the folder.
        fill: Writes the files into the folder that it is given.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    mark = uuid.uuid4().hex
    temporary = path.with_name(f".{path.name}.{mark}{UNFINISHED}")
    temporary.mkdir()
    try:
        fill(temporary)
        old = path.with_name(f".{path.name}.{mark}.old")
        if path.exists():
            os.replace(path, old)
        os.replace(temporary, path)
        shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def sweep(folder: Path) -> None:
    """Clean up after a run that was killed: folders that were being replaced, and unfinished ones."""
    for old in sorted(folder.glob(".*.old")):
        place = folder / old.name[1:].partition(".")[0]
        if place.exists():
            shutil.rmtree(old, ignore_errors=True)
        else:
            os.replace(old, place)
    for unfinished in folder.glob(f".*{UNFINISHED}*"):
        if unfinished.is_dir():
            shutil.rmtree(unfinished, ignore_errors=True)
        else:
            unfinished.unlink(missing_ok=True)


def save_policy(
    folder: Path,
    model: BaseAlgorithm,
    normalizer: VecNormalize | None,
    config: TrainingConfig,
    evaluation: Mapping[str, Any] | None = None,
) -> None:
    """Save what is needed to act, with its evaluation."""

    def fill(place: Path) -> None:
        _write_policy(place, model, normalizer, config)
        if evaluation is not None:
            write_json(place / EVALUATION, evaluation)

    write_folder(folder, fill)


def save_checkpoint(
    folder: Path,
    model: BaseAlgorithm,
    normalizer: VecNormalize | None,
    config: TrainingConfig,
    progress: Mapping[str, Any],
) -> Path:
    """Save what is needed to resume, including optimisers, replay buffer, and the state of all random generators.

    Args:
        folder: Folder of the checkpoints.
        model: The model in training.
        normalizer: Normalisation of its observations.
        config: Training configuration.
        progress: Further values to save, of built-in or NumPy types.

    Returns:
        The checkpoint; all but the last two are removed.
    """
    from spatula_env.learning.storage import write_progress

    def fill(place: Path) -> None:
        _write_policy(place, model, normalizer, config)
        write_progress(place, model, progress)

    checkpoint = folder / f"step-{model.num_timesteps:012d}"
    write_folder(checkpoint, fill)
    for old in checkpoints_in(folder)[:-KEPT_CHECKPOINTS]:
        shutil.rmtree(old, ignore_errors=True)
    return checkpoint


def restore_checkpoint(checkpoint: Path, model: BaseAlgorithm) -> dict[str, Any]:
    """Restore a model's replay buffer and the state of all random generators; `model` itself is loaded before.

    Returns:
        The further values that were saved.

    Raises:
        ValueError: If the files are of an earlier version, or do not fit the model.
    """
    from spatula_env.learning.storage import read_progress

    return read_progress(checkpoint, model)


def checkpoints_in(folder: Path) -> list[Path]:
    """The checkpoints in a folder, oldest first."""
    return sorted(path for path in folder.glob("step-*") if re.fullmatch(r"step-\d+", path.name))


def find_saved(path: Path) -> Path:
    """Find the policy for a path: that of a run's best evaluation, else its last, else that of its last checkpoint.

    Args:
        path: Folder of a policy or checkpoint, of a seed, or of a run with one seed.

    Raises:
        FileNotFoundError: If there is none.
        ValueError: If a run has several seeds.
    """
    if (path / MODEL).exists():
        return path
    for candidate in (path / "best", path / "policy", *reversed(checkpoints_in(path / "checkpoints"))):
        if (candidate / MODEL).exists():
            return candidate
    seeds = sorted(path.glob("seed-*"))
    if len(seeds) > 1:
        raise ValueError(f"{path} has several seeds; name one of {[str(seed) for seed in seeds]}")
    if seeds:
        return find_saved(seeds[0])
    raise FileNotFoundError(f"there is no policy in {path}")


def read_saved_config(folder: Path) -> TrainingConfig:
    """Read the configuration with which a saved policy was trained."""
    return read_training(folder / CONFIG)


def load_model(folder: Path, config: TrainingConfig, env: Any = None) -> BaseAlgorithm:
    """Load a saved model: build it from its configuration and load its weights. No code in its files is run.

    Args:
        folder: Folder of a policy or checkpoint.
        config: Configuration with which it was trained.
        env: Environment to train in; None to act only.

    Raises:
        ValueError: If the files are of an earlier version, or do not fit the configuration.
    """
    from spatula_env.learning.storage import read_model

    return read_model(folder, config, env)


def load_normalizer(folder: Path, env: VecNormalize | None = None) -> VecNormalize | None:
    """Load the normalisation of a saved model's observations.

    Args:
        folder: Folder of a policy or checkpoint.
        env: Receives the estimates; None for a new normalisation without worlds.

    Returns:
        The normalisation; None if nothing was normalised.
    """
    from spatula_env.learning.storage import read_normalizer

    return read_normalizer(folder, env)


def load_policy(folder: Path, env: Any) -> Policy:
    """Load a saved policy to act in an environment."""
    config = read_saved_config(folder)
    model, normalizer = load_model(folder, config), load_normalizer(folder)
    return acting_policy(model, normalizer, export_metadata(config, definition_of(folder))).bound_to(env)


def definition_of(folder: Path) -> int:
    """Number of the task definition for which a policy was trained.

    Args:
        folder: Folder of a policy or checkpoint within the folder of its run, which records the number.
    """
    for place in (folder, *folder.parents[:2]):
        if (place / PROVENANCE).exists():
            told: Any = json.loads((place / PROVENANCE).read_text(encoding="utf-8"))
            return int(told.get("definition", FIRST))
    return FIRST


def provenance(env_id: str) -> dict[str, Any]:
    """Versions, commit, time and machine, and the number of the task definition of an environment."""
    versions: dict[str, str | None] = {"python": platform.python_version(), "spatula_env": __version__}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = None
    return {
        "definition": definition_number(env_id),
        "versions": versions,
        "commit": _git("rev-parse", "HEAD"),
        "uncommitted_changes": bool(_git("status", "--porcelain", "--untracked-files=no")),
        "started": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "machine": {"system": platform.platform(), "processor": _processor(), "cores": os.cpu_count()},
    }


def read_curve(path: Path) -> list[dict[str, Any]]:
    """Read the lines of a curve; a line cut off by the end of its process is left out."""
    if not path.exists():
        return []
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            lines.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return lines


def write_curve(path: Path, lines: list[dict[str, Any]]) -> None:
    """Write a curve atomically."""
    write_text(path, "".join(json.dumps(line) + "\n" for line in lines))


def _write_policy(place: Path, model: BaseAlgorithm, normalizer: VecNormalize | None, config: TrainingConfig) -> None:
    from spatula_env.learning.storage import write_model

    write_model(place, model, normalizer)
    write_training(config, place / CONFIG)


def export_metadata(config: TrainingConfig, definition: int | None = None) -> dict[str, Any]:
    """Metadata that an exported policy needs about its training.

    Args:
        config: Training configuration.
        definition: Number of the task's definition; None for the present one.
    """
    parts = config.environment.parts
    return {
        "env_id": config.environment.id,
        "env_kwargs": interface_of(config.environment.id, config.environment.kwargs),
        "parts": None if parts is None else list(parts),
        "definition": definition_number(config.environment.id) if definition is None else definition,
    }


def _git(*arguments: str) -> str | None:
    """Output of a git command in the folder of this package; None without git or repository."""
    try:
        done = subprocess.run(
            ["git", "-C", str(Path(__file__).parent), *arguments],
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _processor() -> str:
    file = Path("/proc/cpuinfo")
    if file.exists():
        for line in file.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor()
