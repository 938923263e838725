"""Conversion of datasets for d3rlpy, which learns from them without an environment.

d3rlpy 2.8 has a loader for Minari's datasets, `d3rlpy.datasets.get_minari`. It concatenates the observations of all
episodes, of which each has one more than it has actions, and then indexes both alike: in episode k every observation is
k steps away from its action. Here each episode is converted separately. Needs `pip install d3rlpy`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatula_env.data.replaying import open_dataset


def load_d3rlpy(dataset_id: str, root: str | Path | None = None, *, successes_only: bool = False) -> Any:
    """Load a recorded dataset as d3rlpy's replay buffer.

    Action t of an episode is the response to observation t. The last observation of an episode, which no action
    followed, has no place in d3rlpy: the last step of a truncated episode is therefore not learnt from, and after
    termination the value is zero. An episode that its operator ended counts as truncated.

    Args:
        dataset_id: Such as "spatula/press/human-v0".
        root: Folder of all datasets; Minari's own by default.
        successes_only: Whether to leave out episodes that did not reach their goal.

    Returns:
        A `d3rlpy.dataset.ReplayBuffer` with (T, O) observations, (T, A) actions and (T, 1) rewards for each episode;
        with the goal interface, observations are "observation" and "desired_goal", concatenated.

    Raises:
        FileNotFoundError: If there is no such dataset.
        ImportError: If d3rlpy or Minari is missing.
        ValueError: If observations are not vectors, or no episode is left.
    """
    try:
        from d3rlpy.dataset import Episode, create_infinite_replay_buffer
    except ImportError as error:
        raise ImportError(f"load_d3rlpy needs d3rlpy: pip install d3rlpy ({error})", name=error.name) from error
    dataset = open_dataset(dataset_id, root)
    attributes = list(dataset.storage.get_episode_metadata(dataset.episode_indices))
    episodes = [
        Episode(
            observations=_vectors(episode.observations)[:-1],
            actions=np.asarray(episode.actions, dtype=np.float32),
            rewards=np.asarray(episode.rewards, dtype=np.float32)[:, None],
            terminated=bool(episode.terminations[-1]),
        )
        for episode, known in zip(dataset.iterate_episodes(), attributes, strict=True)
        if len(episode.actions) and (known.get("success", False) or not successes_only)
    ]
    if not episodes:
        raise ValueError(f"dataset {dataset_id!r} has no {'successful ' if successes_only else ''}episode")
    return create_infinite_replay_buffer(episodes=episodes)


def _vectors(observations: Any) -> NDArray[np.float32]:
    """(T + 1, O) the observations of an episode as vectors."""
    if not isinstance(observations, dict):
        array = np.asarray(observations, dtype=np.float32)
        return array.reshape(len(array), -1)
    if "observation" in observations and "desired_goal" in observations:
        observations = {name: observations[name] for name in ("observation", "desired_goal")}
    if any(np.ndim(values) != 2 for values in observations.values()):
        raise ValueError(f"observations must be vectors for d3rlpy, got entries {sorted(observations)}")
    return np.concatenate([np.asarray(values, dtype=np.float32) for values in observations.values()], axis=1)
