"""Scripted demonstrations: a policy whose hand moves the grip of an emulated Falcon, recorded as a human's are.

No human has done them, and every episode says so.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium
import numpy as np

import spatula_env
from spatula_env.data.dataset import METADATA_FILE, dataset_folder
from spatula_env.data.recording import RecordingSummary, record
from spatula_env.data.replaying import open_dataset
from spatula_env.teleop.scripted import ScriptedFalcon
from spatula_env.teleop.session import EpisodeSummary

Policy = Callable[[Any], Any]
PolicyMaker = Callable[[gymnasium.Env[Any, Any]], Policy]
Progress = Callable[[str, EpisodeSummary, float], None]

DESCRIPTION = (
    "Scripted demonstrations of {env_id}: the scripted expert, {operator}, moves the grip of a Novint Falcon in "
    "software (mechanism, encoders, USB packets, driver, haptic loop), in simulated time. No human and no device took "
    "part. Episodes that did not reach their goal are there, too, and labelled."
)
AUTHOR = "a program of spatula_env"


@dataclass(frozen=True)
class Hand:
    """How a scripted operator moves.

    Attributes:
        reaction_delay: How late it acts [s].
        tremor: Standard deviation of its tremor along each axis, share of the greatest speed.
        gain: Factor on what the policy wants.
    """

    reaction_delay: float = 0.1
    tremor: float = 0.02
    gain: float = 0.4

    def __str__(self) -> str:
        """What there is to know, for a description."""
        return (
            f"{1000 * self.reaction_delay:g} ms late, with {100 * self.gain:g} % of its speed and a tremor of "
            f"{100 * self.tremor:g} % of the greatest speed"
        )


HANDS: Mapping[str, Hand] = MappingProxyType(
    {
        # The jaws have to follow the lift, and a path has to be done in time: a slow hand is too late.
        "Spatula/Clamp-v0": Hand(0.05, 0.01, 0.8),
        "Spatula/Palpate-v0": Hand(0.05, 0.01, 0.8),
    }
)
"""Of tasks that want another hand than others."""


@dataclass(frozen=True)
class ScriptedDataset:
    """What came of making a dataset.

    Attributes:
        recording: See `RecordingSummary`; nothing was recorded if all episodes were there already.
        episode_seconds: How long each new episode took, in real time [s].
    """

    recording: RecordingSummary
    episode_seconds: tuple[float, ...] = field(default=())


def scripted_id(env_id: str) -> str:
    """The id of an environment's scripted dataset: "spatula/press/scripted-v0" for "Spatula/Press-v0"."""
    name = env_id.partition("/")[2].rpartition("-v")[0]
    return f"spatula/{name.lower()}/scripted-v0"


def scripted_ids() -> dict[str, str]:
    """Ids of all tasks' scripted datasets, by those of the environments."""
    return {env_id: scripted_id(env_id) for env_id in (f"Spatula/{name}-v0" for name in spatula_env.TASKS)}


def make_scripted(
    env_id: str,
    make_policy: PolicyMaker,
    *,
    dataset_id: str | None = None,
    episodes: int = 50,
    seed: int = 0,
    hand: Hand | None = None,
    options: Mapping[str, Any] | None = None,
    end_on_success: bool = True,
    states: bool = True,
    root: str | Path | None = None,
    progress: Progress | None = None,
) -> ScriptedDataset:
    """Make a dataset of scripted demonstrations, or go on with it until it has so many.

    The same episodes come of the same seeds, in one go or after an interruption: each has a tremor of its own.

    Args:
        env_id: Of the environment.
        make_policy: Makes what the operator wants, for an environment.
        dataset_id: Of the dataset; `scripted_id` by default.
        episodes: How many it is to have in the end.
        seed: Of the first episode.
        hand: How the operator moves; None: as is good for the task.
        options: What the environment is made with.
        end_on_success: Whether reaching the goal ends an episode.
        states: Whether the physics' state is recorded.
        root: Folder of all datasets; Minari's own by default.
        progress: Called after each episode with "recorded", how it went, and how long it took [s].

    Raises:
        ImportError: If Minari is missing.
        ValueError: If `episodes` is not positive, or the dataset is one of another environment or not scripted.
        DatasetWriteError: If an episode could not be written; those before it are intact.
    """
    if episodes < 1:
        raise ValueError(f"episodes must be 1 or more, got {episodes!r}")
    name = dataset_id if dataset_id is not None else scripted_id(env_id)
    there = _count(name, env_id, root)
    chosen = hand if hand is not None else HANDS.get(env_id, Hand())
    if there >= episodes:
        return ScriptedDataset(RecordingSummary(name, dataset_folder(name, root), 0, 0, 0, there))
    seconds: list[float] = []
    successes = 0
    result: RecordingSummary | None = None
    env = gymnasium.make(env_id, **(options or {}))
    try:
        policy = make_policy(env)
        for number in range(there, episodes):
            began = time.perf_counter()

            def tell(fate: str, summary: EpisodeSummary, began: float = began) -> None:
                seconds.append(time.perf_counter() - began)
                if progress is not None:
                    progress(fate, summary, seconds[-1])

            generator = np.random.default_rng([seed, number])
            # A hand of its own for each: none begins where the last one has ended.
            with ScriptedFalcon(
                policy,
                generator,
                reaction_delay=chosen.reaction_delay,
                tremor=chosen.tremor,
                gain=chosen.gain,
            ) as device:
                result = record(
                    env,
                    device,
                    name,
                    seed=seed + number,
                    root=root,
                    end_on_success=end_on_success,
                    states=states,
                    author=AUTHOR,
                    description=DESCRIPTION.format(env_id=env_id, operator=chosen),
                    progress=tell,
                )
            successes += result.successes
    finally:
        env.close()
    assert result is not None
    recording = RecordingSummary(name, result.path, len(seconds), 0, successes, result.total_episodes)
    return ScriptedDataset(recording, tuple(seconds))


def _count(dataset_id: str, env_id: str, root: str | Path | None) -> int:
    """How many episodes a dataset has already."""
    if not (dataset_folder(dataset_id, root) / "data" / METADATA_FILE).exists():
        return 0
    dataset = open_dataset(dataset_id, root)
    count = int(dataset.total_episodes)
    found = dataset.spec.env_spec.id
    if found != env_id:
        raise ValueError(f"dataset {dataset_id!r} is one of {found}, not of {env_id}; take another name")
    operators = {str(each.get("operator")) for each in dataset.storage.get_episode_metadata(range(count))}
    if operators - {"scripted"}:
        raise ValueError(f"dataset {dataset_id!r} has episodes of a human; scripted ones do not belong there")
    return count
