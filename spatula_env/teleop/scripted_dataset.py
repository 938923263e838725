"""Scripted demonstrations: a policy whose hand moves an emulated Falcon's grip, recorded like a human's episodes.

They are not human demonstrations, and every episode is labelled accordingly.
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
from spatula_env.data.checking import check_seed
from spatula_env.data.dataset import DatasetWriter, check_dataset_id, check_target, dataset_folder
from spatula_env.data.episode import EpisodeRecorder, StateType
from spatula_env.data.files import recording_lock
from spatula_env.data.index import METADATA_FILE, read_index, read_metadata
from spatula_env.data.specs import spec_from_json
from spatula_env.teleop.recording import RecordingSummary, record_into
from spatula_env.teleop.scripted import ScriptedFalcon
from spatula_env.teleop.session import EpisodeSummary
from spatula_env.teleop.wrapper import FalconTeleop

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
    """How a scripted operator moves; see `ScriptedFalcon`.

    Attributes:
        reaction_delay: Delay of its actions [s].
        tremor: Standard deviation of its tremor along each axis, as a share of the greatest speed.
        gain: Factor on the policy's actions.
    """

    reaction_delay: float = 0.1
    tremor: float = 0.02
    gain: float = 0.4

    def __str__(self) -> str:
        """The properties in words, for a dataset's description."""
        return (
            f"{1000 * self.reaction_delay:g} ms late, with {100 * self.gain:g} % of its speed and a tremor of "
            f"{100 * self.tremor:g} % of the greatest speed"
        )


HANDS: Mapping[str, Hand] = MappingProxyType(
    {
        # The jaws have to follow the lift, and the path has a time limit: a slow hand would be too late.
        "Spatula/Clamp-v0": Hand(0.05, 0.01, 0.8),
        "Spatula/Palpate-v0": Hand(0.05, 0.01, 0.8),
    }
)
"""Hands of tasks that need other properties than the default."""


@dataclass(frozen=True)
class ScriptedDataset:
    """The result of making a dataset.

    Attributes:
        recording: See `RecordingSummary`; nothing was recorded if the dataset had all episodes already.
        episode_seconds: Real time that each new episode took [s].
    """

    recording: RecordingSummary
    episode_seconds: tuple[float, ...] = field(default=())


def scripted_id(env_id: str) -> str:
    """The id of an environment's scripted dataset: "spatula/press/scripted-v0" for "Spatula/Press-v0"."""
    name = env_id.partition("/")[2].rpartition("-v")[0]
    return f"spatula/{name.lower()}/scripted-v0"


def scripted_ids() -> dict[str, str]:
    """Ids of all tasks' scripted datasets, keyed by environment id."""
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
    state_dtype: StateType = "float32",
    root: str | Path | None = None,
    progress: Progress | None = None,
) -> ScriptedDataset:
    """Make a dataset of scripted demonstrations, or extend it until it has a number of episodes.

    The same seeds give the same episodes, with or without interruption: each episode has a tremor of its own.

    Args:
        env_id: Id of the environment.
        make_policy: Makes the operator's policy for an environment.
        dataset_id: Id of the dataset; `scripted_id` by default.
        episodes: Number of episodes that the dataset is to reach.
        seed: Seed of the first episode.
        hand: How the operator moves; None for the task's default.
        options: Arguments with which the environment is made.
        end_on_success: Whether reaching the goal ends an episode.
        states: Whether to record the physics state.
        state_dtype: Precision of the states; see `EpisodeRecorder`.
        root: Folder of all datasets; Minari's own by default.
        progress: Called after each episode with "recorded", its summary, and the time it took [s].

    Raises:
        ImportError: If Minari is missing.
        ValueError: If `episodes` is not positive, or the dataset belongs to another environment, has other options, or
            is not scripted.
        DatasetBusy: If another program is recording into it.
        OSError: If it cannot be written to.
        DatasetWriteError: If an episode could not be written; those before it are intact.
    """
    if episodes < 1:
        raise ValueError(f"episodes must be 1 or more, got {episodes!r}")
    check_seed(seed)
    name = dataset_id if dataset_id is not None else scripted_id(env_id)
    check_dataset_id(name)
    folder = dataset_folder(name, root)
    there = _count(name, env_id, root)
    if there >= episodes:
        return ScriptedDataset(RecordingSummary(name, folder, 0, 0, 0, there))
    chosen = hand if hand is not None else HANDS.get(env_id, Hand())
    seconds: list[float] = []
    successes = 0
    env = gymnasium.make(env_id, **(options or {}))
    try:
        check_target(name, env, root)
        with recording_lock(folder, name):
            policy = make_policy(env)
            writer = DatasetWriter(
                name,
                env,
                root=root,
                author=AUTHOR,
                description=DESCRIPTION.format(env_id=env_id, operator=chosen),
                algorithm_name="teleoperation (scripted)",
            )
            recorder = EpisodeRecorder(env, states=states, state_dtype=state_dtype)
            for number in range(writer.total_episodes, episodes):
                began = time.perf_counter()

                def tell(fate: str, summary: EpisodeSummary, began: float = began) -> None:
                    seconds.append(time.perf_counter() - began)
                    if progress is not None:
                        progress(fate, summary, seconds[-1])

                # A new hand for each episode, so that none starts where the last one ended.
                with ScriptedFalcon(
                    policy,
                    np.random.default_rng([seed, number]),
                    reaction_delay=chosen.reaction_delay,
                    tremor=chosen.tremor,
                    gain=chosen.gain,
                ) as device:
                    result = record_into(
                        writer,
                        FalconTeleop(env, device),
                        recorder,
                        episodes=1,
                        seed=seed + number,
                        end_on_success=end_on_success,
                        progress=tell,
                    )
                successes += result.successes
    finally:
        env.close()
    recording = RecordingSummary(name, folder, len(seconds), 0, successes, writer.total_episodes)
    return ScriptedDataset(recording, tuple(seconds))


def _count(dataset_id: str, env_id: str, root: str | Path | None) -> int:
    """Number of episodes that a dataset has already."""
    data = dataset_folder(dataset_id, root) / "data"
    if not (data / METADATA_FILE).exists():
        return 0
    metadata = read_metadata(data)
    found = spec_from_json(metadata.get("env_spec")).id
    if found != env_id:
        raise ValueError(f"dataset {dataset_id!r} is one of {found}, not of {env_id}; take another name")
    entries = read_index(data, metadata)
    if {str(entry.attributes.get("operator")) for entry in entries} - {"scripted"}:
        raise ValueError(f"dataset {dataset_id!r} has episodes of a human; scripted ones do not belong there")
    return len(entries)
