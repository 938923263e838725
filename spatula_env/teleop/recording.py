"""From an operator's hand to a dataset."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spatula_env import __version__
from spatula_env.data.checking import check_seed
from spatula_env.data.dataset import AUTHOR, DatasetWriter, check_target, dataset_folder
from spatula_env.data.episode import EpisodeRecorder, StateType
from spatula_env.data.files import recording_lock
from spatula_env.teleop.device import DeviceLost, TeleopDevice
from spatula_env.teleop.haptics.device import HapticDevice
from spatula_env.teleop.session import EpisodeSummary, run_episode
from spatula_env.teleop.wrapper import FalconTeleop

if TYPE_CHECKING:
    import gymnasium


TRACK_TIME = 300.0
"""For so long at most an episode is recorded at the haptic loop's rate [s]."""


@dataclass(frozen=True)
class RecordingSummary:
    """The result of a recording.

    Attributes:
        dataset_id: Of the dataset.
        path: Its folder.
        recorded: Episodes that were added.
        discarded: Episodes that the operator discarded, or that failed where failures are dropped.
        successes: How many of those added reached their goal.
        total_episodes: How many the dataset has now.
        lost: What the device said when it was lost; None if it was not.
    """

    dataset_id: str
    path: Path
    recorded: int
    discarded: int
    successes: int
    total_episodes: int
    lost: str | None = None


def record(
    env: gymnasium.Env[Any, Any],
    device: TeleopDevice,
    dataset_id: str,
    *,
    episodes: int = 1,
    total: int | None = None,
    seed: int = 0,
    root: str | Path | None = None,
    options: Mapping[str, Any] | None = None,
    policy: Callable[[Any], Any] | None = None,
    keep_failures: bool = True,
    attempts: int | None = None,
    end_on_success: bool = False,
    states: bool = True,
    state_dtype: StateType = "float32",
    author: str = AUTHOR,
    description: str = "",
    haptics: bool = False,
    progress: Callable[[str, EpisodeSummary], None] | None = None,
    after_step: Callable[[Any, dict[str, Any]], None] | None = None,
    **teleop: Any,
) -> RecordingSummary:
    """Record episodes of an operator, each on the disk before the next begins.

    An episode has the seed `seed` plus its number among those tried; in a dataset that has episodes, seeds go on from
    the greatest of theirs, so that none comes twice.

    Args:
        env: One of the Spatula environments, from `gymnasium.make`, for one agent.
        device: What the operator holds, open and calibrated.
        dataset_id: As "spatula/press/human-v0"; is made, or added to.
        episodes: How many to add.
        total: Add until the dataset has so many, instead; None: `episodes` counts.
        seed: Of the first episode, at least.
        root: Folder of all datasets; Minari's own by default.
        options: Of every reset.
        policy: What acts while the operator does not.
        keep_failures: Whether episodes that do not reach their goal are added, too.
        attempts: After so many tries recording ends, kept or not; None: it goes on.
        end_on_success: Whether reaching the goal ends an episode.
        states: Whether the physics' state is recorded, so that a replay can be checked and shown without physics.
        state_dtype: How precisely; see `EpisodeRecorder`.
        author: Who holds the device; kept with each episode.
        description: Of the dataset.
        haptics: Whether what the haptic loop does is recorded at its own rate, in the folder `haptics` of the dataset,
            a file for each episode; see `spatula_env.teleop.haptics.track`.
        progress: Called after each episode with its fate, "recorded" or "discarded".
        after_step: Called with observation and info after every reset and step.
        **teleop: For `FalconTeleop`: mode, intervention ….

    Returns:
        The result. When the device is lost, the episode that was running is lost with it and nothing else.

    Raises:
        ImportError: If Minari is missing.
        ValueError: If a number is not one of those allowed, `env` cannot be kept in a dataset, or the dataset has
            episodes of another environment or with other options.
        TypeError: If `haptics` is asked for and the device has no haptic loop.
        DatasetBusy: If another program is recording into the dataset.
        OSError: If the dataset cannot be written to.
        DatasetWriteError: If an episode could not be written; those before it are intact.
    """
    for name, value in (("episodes", episodes), ("total", total), ("attempts", attempts)):
        if value is not None and value < 1:
            raise ValueError(f"{name} must be 1 or more, got {value!r}")
    check_seed(seed)
    if haptics and not isinstance(device, HapticDevice):
        raise TypeError(f"haptics needs a device with a haptic loop, the {device.name} has none")
    operator = str(getattr(device, "operator", "human"))
    wrapped = FalconTeleop(env, device, **teleop)
    # Before anything is made.
    check_target(dataset_id, env, root)
    with recording_lock(dataset_folder(dataset_id, root), dataset_id):
        writer = DatasetWriter(
            dataset_id,
            env,
            root=root,
            author=author,
            description=description or f"Demonstrations by a {operator} operator with the {device.name}.",
            algorithm_name=f"teleoperation ({operator})",
        )
        return record_into(
            writer,
            wrapped,
            EpisodeRecorder(env, states=states, state_dtype=state_dtype),
            episodes=episodes if total is None else total - writer.total_episodes,
            seed=seed,
            options=options,
            policy=policy,
            keep_failures=keep_failures,
            attempts=attempts,
            end_on_success=end_on_success,
            haptics=haptics,
            progress=progress,
            after_step=after_step,
        )


def record_into(
    writer: DatasetWriter,
    env: FalconTeleop,
    recorder: EpisodeRecorder,
    *,
    episodes: int,
    seed: int,
    options: Mapping[str, Any] | None = None,
    policy: Callable[[Any], Any] | None = None,
    keep_failures: bool = True,
    attempts: int | None = None,
    end_on_success: bool = False,
    haptics: bool = False,
    progress: Callable[[str, EpisodeSummary], None] | None = None,
    after_step: Callable[[Any, dict[str, Any]], None] | None = None,
) -> RecordingSummary:
    """What `record` does when all is checked, and nobody else records into the dataset.

    Args:
        writer: Of the dataset.
        env: The environment with its device.
        recorder: For the environment.
        episodes: How many to add; 0 or less: none.
        seed: See `record`, and so for the others.
        options: Of every reset.
        policy: What acts while the operator does not.
        keep_failures: Whether episodes that do not reach their goal are added, too.
        attempts: After so many tries recording ends.
        end_on_success: Whether reaching the goal ends an episode.
        haptics: Whether the haptic loop is recorded at its own rate.
        progress: Called after each episode.
        after_step: Called after every reset and step.

    Returns:
        The result.

    Raises:
        DatasetWriteError: If an episode could not be written; those before it are intact.
    """
    tried = recorded = successes = 0
    lost: str | None = None
    first = next_seed(writer, seed)
    tracked = env.device if haptics and isinstance(env.device, HapticDevice) else None
    if tracked is not None:
        tracked.keep_track(TRACK_TIME)
    while recorded < episodes and (attempts is None or tried < attempts):
        try:
            summary = run_episode(
                env,
                seed=first + tried,
                options=options,
                policy=policy,
                recorder=recorder,
                end_on_success=end_on_success,
                after_step=after_step,
            )
        except DeviceLost as error:
            lost = str(error)
            break
        tried += 1
        keep = summary.kept and (keep_failures or summary.success)
        # Taken in any case: what is kept next is the next episode's.
        track = None if tracked is None else tracked.take_track()
        if keep:
            if track is not None:
                track.save(haptics_file(writer.path, writer.total_episodes))
            writer.add(recorder.finish(**episode_attributes(env, summary)))
            recorded += 1
            successes += summary.success
        if progress is not None:
            progress("recorded" if keep else "discarded", summary)
        if summary.quit:
            break
    return RecordingSummary(
        dataset_id=writer.dataset_id,
        path=writer.path,
        recorded=recorded,
        discarded=tried - recorded,
        successes=successes,
        total_episodes=writer.total_episodes,
        lost=lost,
    )


def haptics_file(folder: Path, episode: int) -> Path:
    """Where the haptic loop's track of an episode is.

    Args:
        folder: Of the dataset.
        episode: Its number.
    """
    return folder / "haptics" / f"episode_{episode}.npz"


def next_seed(writer: DatasetWriter, least: int) -> int:
    """The seed of the next episode of a dataset, so that none comes twice.

    Args:
        writer: Of the dataset.
        least: Of the first episode.
    """
    return least if writer.last_seed is None else max(least, writer.last_seed + 1)


def episode_attributes(env: FalconTeleop, summary: EpisodeSummary) -> dict[str, Any]:
    """Metadata of an episode in a dataset.

    Args:
        env: The environment with its device.
        summary: How the episode went.
    """
    made: Any = env.unwrapped
    felt = {"force_scale": env.device.settings.force_scale} if isinstance(env.device, HapticDevice) else {}
    return {
        **felt,
        "operator": str(getattr(env.device, "operator", "human")),
        "device": env.device.name,
        "success": summary.success,
        "operator_share": summary.operator_share,
        "engine": made.settings.engine,
        "spatula_env_version": __version__,
    }
