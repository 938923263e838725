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
    """The result of making a dataset.

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
    state_dtype: StateType = "float32",
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
        state_dtype: How precisely; see `EpisodeRecorder`.
        root: Folder of all datasets; Minari's own by default.
        progress: Called after each episode with "recorded", how it went, and how long it took [s].

    Raises:
        ImportError: If Minari is missing.
        ValueError: If `episodes` is not positive, or the dataset is one of another environment, has other options,
            or is not scripted.
        DatasetBusy: If another program is making it.
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

                # A hand of its own for each: none begins where the last one has ended.
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
    """How many episodes a dataset has already."""
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
