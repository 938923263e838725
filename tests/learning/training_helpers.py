"""Small trainings, of a second or two."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from spatula_env.learning.configuration import training_from_mapping, write_training

OFF_POLICY = {"learning_starts": 20, "batch_size": 8, "gradient_steps": 1, "buffer_size": 500}
HYPERPARAMETERS: dict[str, dict[str, Any]] = {
    "ppo": {"n_steps": 10, "batch_size": 20, "n_epochs": 1},
    "sac": OFF_POLICY,
    "tqc": OFF_POLICY,
    "sac_her": {**OFF_POLICY, "learning_starts": 30},
}


def write_small(file: Path, algorithm: str = "sac", *, env_id: str = "Spatula/Press-v0", **changes: Any) -> Path:
    """Write a configuration: two worlds, episodes of ten steps, sixty steps in all.

    Args:
        file: Where to.
        algorithm: What trains.
        env_id: Where.
        **changes: Options of the environment, and fields at the top under their names with "top_" before.

    Returns:
        The file.
    """
    top = {name.removeprefix("top_"): value for name, value in changes.items() if name.startswith("top_")}
    options = {name: value for name, value in changes.items() if not name.startswith("top_")}
    if algorithm == "sac_her":
        options["reward"] = "sparse"
    content = {
        "environment": {"id": env_id, "kwargs": {"max_episode_steps": 10, **options}, "num_envs": 2},
        "algorithm": algorithm,
        "hyperparameters": HYPERPARAMETERS[algorithm],
        "network": {"layers": [16]},
        "total_steps": 60,
        "evaluation": {"every": 40, "episodes": 2},
        "checkpoint_every": 30,
        "success_target": None,
        **top,
    }
    write_training(training_from_mapping(content), file)
    return file
