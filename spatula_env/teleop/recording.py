"""Recording an operator's episodes into a dataset."""

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
"""Longest part of an episode that is recorded at the haptic loop's rate [s]."""


@dataclass(frozen=True)
class RecordingSummary:
    """The result of a recording.

    Attributes:
        dataset_id: Id of the dataset.
        path: Folder of the dataset.
        recorded: Number of episodes that were added.
        discarded: Number of episodes that the operator discarded, or that failed where failures are dropped.
        successes: Number of added episodes that reached their goal.
        total_episodes: Number of episodes in the dataset now.
        lost: The device's error message if it was lost; None if it was not.
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
    """Record episodes of an operator; each is on disk before the next begins.

    Attempt number i uses the seed `seed` + i. In a dataset that has episodes already, seeds continue after the greatest
    one used, so that no seed occurs twice.

    Args:
        env: One of the Spatula environments, from `gymnasium.make`, for one agent.
        device: The operator's device, open and calibrated.
        dataset_id: Id such as "spatula/press/human-v0"; the dataset is created, or extended if it exists.
        episodes: Number of episodes to add.
        total: Number of episodes that the dataset is to reach, instead of `episodes`; None to use `episodes`.
        seed: Least seed of the first episode.
        root: Folder of all datasets; Minari's own by default.
        options: Options of every reset.
        policy: Acts while the operator does not.
        keep_failures: Whether episodes that do not reach their goal are added, too.
        attempts: Recording ends after this number of attempts, kept or not; None for no limit.
        end_on_success: Whether reaching the goal ends an episode.
        states: Whether to record the physics state, so that a replay can be checked, and shown without physics.
        state_dtype: Precision of the states; see `EpisodeRecorder`.
        author: Name of the operator; stored with each episode.
        description: Description of the dataset.
        haptics: Whether to record the haptic loop at its own rate, in the folder `haptics` of the dataset, one file per
            episode; see `spatula_env.teleop.haptics.track`.
        progress: Called after each episode with its summary and its outcome, "recorded" or "discarded".
        after_step: Called with observation and info after every reset and step.
        **teleop: Arguments for `FalconTeleop`: mode, intervention ….

    Returns:
        The result. If the device is lost, only the episode in progress is lost with it.

    Raises:
        ImportError: If Minari is missing.
        ValueError: If a number is out of range, `env` cannot be recorded in a dataset, or the dataset holds episodes of
            another environment or with other options.
        TypeError: If `haptics` is set and the device has no haptic loop.
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
    # Check before anything is created.
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
    """Record episodes as `record` does, once everything is checked and the dataset is claimed.

    Args:
        writer: Writer of the dataset.
        env: The environment with its device.
        recorder: Recorder for the environment.
        episodes: Number of episodes to add; none if it is 0 or less.
        seed: Least seed of the first episode.
        options: Options of every reset.
        policy: Acts while the operator does not.
        keep_failures: Whether episodes that do not reach their goal are added, too.
        attempts: Recording ends after this number of attempts.
        end_on_success: Whether reaching the goal ends an episode.
        haptics: Whether to record the haptic loop at its own rate.
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
        # Always take the track, even of an episode that is dropped: the next one has to start empty.
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
    """File with the haptic loop's track of an episode.

    Args:
        folder: Folder of the dataset.
        episode: Number of the episode.
    """
    return folder / "haptics" / f"episode_{episode}.npz"


def next_seed(writer: DatasetWriter, least: int) -> int:
    """Seed of the next episode of a dataset, chosen so that no seed occurs twice.

    Args:
        writer: Writer of the dataset.
        least: Least seed of the first episode.
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
