"""Recorded episodes once more: by their actions, which checks them, or by their states, which needs no physics."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spatula_env.data.dataset import dataset_folder, require_minari
from spatula_env.data.episode import STATE, physics_state

if TYPE_CHECKING:
    FloatArray = NDArray[np.float64]

TOLERANCE = 1e-9
"""Greatest difference of a position that counts as the same [u]."""


@dataclass(frozen=True)
class EpisodeReplay:
    """How a replay by actions compares.

    Attributes:
        episode: Its number.
        steps: How many there were.
        difference: Greatest difference of a recorded position or quaternion [u]; NaN if no states were recorded.
        reward_difference: Greatest difference of a reward.
        matches: Whether both are within the tolerance; without states, the rewards.
        success: Whether the goal was reached, this time.
    """

    episode: int
    steps: int
    difference: float
    reward_difference: float
    matches: bool
    success: bool


def open_dataset(dataset_id: str, root: str | Path | None = None) -> Any:
    """A recorded dataset, as ``minari.load_dataset`` gives it.

    Args:
        dataset_id: Its id.
        root: Folder of all datasets; Minari's own by default.

    Raises:
        ImportError: If Minari is missing.
        FileNotFoundError: If there is no such dataset.
    """
    minari, _ = require_minari()
    data = dataset_folder(dataset_id, root) / "data"
    if not (data / "metadata.json").exists():
        raise FileNotFoundError(f"there is no dataset {dataset_id!r} in {data.parent}")
    return minari.MinariDataset(data)


def replay(
    dataset_id: str,
    *,
    root: str | Path | None = None,
    episodes: Sequence[int] | None = None,
    tolerance: float = TOLERANCE,
    render_mode: str | None = None,
    after_step: Callable[[gymnasium.Env[Any, Any], int], None] | None = None,
) -> list[EpisodeReplay]:
    """Do the recorded actions again, from the recorded seeds, and compare what comes of them.

    With the same engine and the same version all is the same; Bullet is deterministic.

    Args:
        dataset_id: Its id.
        root: Folder of all datasets; Minari's own by default.
        episodes: Which; all by default.
        tolerance: Greatest difference that counts as the same [u].
        render_mode: Of the environment.
        after_step: Called with the environment and the step's number after the reset (0) and every step.

    Returns:
        How each compares.

    Raises:
        ImportError: If Minari is missing, or PyBullet is and the episodes were recorded with it.
        FileNotFoundError: If there is no such dataset.
        ValueError: If an episode has no seed.
    """
    dataset = open_dataset(dataset_id, root)
    numbers = list(range(dataset.total_episodes)) if episodes is None else [int(number) for number in episodes]
    spec = copy.deepcopy(dataset.spec.env_spec)
    if numbers and spec.kwargs.get("engine") is None:
        # Datasets did not always name the engine in what they were recorded with. The default here may be another one.
        (first,) = dataset.storage.get_episode_metadata(numbers[:1])
        spec.kwargs["engine"] = first.get("engine")
    env = gymnasium.make(spec, render_mode=render_mode)
    results = []
    try:
        for number in numbers:
            (metadata,) = dataset.storage.get_episode_metadata([number])
            (recorded,) = dataset.iterate_episodes([number])
            results.append(_repeat(env, number, recorded, metadata, tolerance, after_step))
    finally:
        env.close()
    return results


def recorded_states(
    dataset_id: str, episode: int = 0, *, root: str | Path | None = None
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """The states of a recorded episode, one after the other, to look at without physics.

    Args:
        dataset_id: Its id.
        episode: Which.
        root: Folder of all datasets; Minari's own by default.

    Yields:
        Nodes (V, 3) of the organ, and positions and quaternions (N, 7) of the tools, in the scene [u].

    Raises:
        ValueError: If no states were recorded.
    """
    dataset = open_dataset(dataset_id, root)
    (recorded,) = dataset.iterate_episodes([episode])
    if STATE not in recorded.infos:
        raise ValueError(f"episode {episode} of {dataset_id!r} was recorded without states")
    states = recorded.infos[STATE]
    yield from zip(states["nodes"], states["tools"], strict=True)


def _repeat(
    env: gymnasium.Env[Any, Any],
    number: int,
    recorded: Any,
    metadata: dict[str, Any],
    tolerance: float,
    after_step: Callable[[gymnasium.Env[Any, Any], int], None] | None,
) -> EpisodeReplay:
    if metadata.get("seed") is None:
        raise ValueError(f"episode {number} has no seed, it cannot be repeated")
    simulation: Any = getattr(env.unwrapped, "simulation", None)
    states = recorded.infos.get(STATE) if recorded.infos else None
    _, info = env.reset(seed=int(metadata["seed"]), options=metadata.get("options"))
    difference = _difference(simulation, states, 0)
    rewards = []
    if after_step is not None:
        after_step(env, 0)
    for step, action in enumerate(recorded.actions, start=1):
        _, reward, _, _, info = env.step(action)
        rewards.append(float(reward))
        difference = max(difference, _difference(simulation, states, step))
        if after_step is not None:
            after_step(env, step)
    apart = float(np.abs(np.array(rewards) - recorded.rewards).max())
    return EpisodeReplay(
        episode=number,
        steps=len(rewards),
        difference=difference if states is not None else float("nan"),
        reward_difference=apart,
        matches=difference <= tolerance and apart <= tolerance,
        success=bool(info["is_success"]),
    )


def _difference(simulation: Any, states: Any, step: int) -> float:
    if states is None:
        return 0.0
    now = physics_state(simulation)
    return max(float(np.abs(now[name] - states[name][step]).max()) for name in now)
