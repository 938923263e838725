"""From an operator's hand to a dataset."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spatula_env import __version__
from spatula_env.data.dataset import DatasetWriter, require_minari
from spatula_env.data.episode import EpisodeRecorder
from spatula_env.teleop.device import DeviceLost, TeleopDevice
from spatula_env.teleop.session import EpisodeSummary, run_episode
from spatula_env.teleop.wrapper import FalconTeleop

if TYPE_CHECKING:
    import gymnasium


@dataclass(frozen=True)
class RecordingSummary:
    """What came of a recording.

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
    seed: int = 0,
    root: str | Path | None = None,
    options: Mapping[str, Any] | None = None,
    policy: Callable[[Any], Any] | None = None,
    keep_failures: bool = True,
    attempts: int | None = None,
    end_on_success: bool = False,
    states: bool = True,
    author: str = "unknown",
    description: str = "",
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
        seed: Of the first episode, at least.
        root: Folder of all datasets; Minari's own by default.
        options: Of every reset.
        policy: What acts while the operator does not.
        keep_failures: Whether episodes that do not reach their goal are added, too.
        attempts: After so many tries recording ends, whatever came of them; None: it goes on.
        end_on_success: Whether reaching the goal ends an episode.
        states: Whether the physics' state is recorded, so that a replay can be checked and shown without physics.
        author: Who holds the device.
        description: Of the dataset.
        progress: Called after each episode with what became of it, "recorded" or "discarded".
        after_step: Called with observation and info after every reset and step.
        **teleop: For `FalconTeleop`: mode, intervention ….

    Returns:
        What came of it. When the device is lost, the episode that was running is lost with it and nothing else.

    Raises:
        ImportError: If Minari is missing.
        ValueError: If a number is not one of those allowed.
        DatasetWriteError: If an episode could not be written; those before it are intact.
    """
    require_minari()
    if episodes < 1:
        raise ValueError(f"episodes must be 1 or more, got {episodes!r}")
    if attempts is not None and attempts < 1:
        raise ValueError(f"attempts must be None, or 1 or more, got {attempts!r}")
    operator = str(getattr(device, "operator", "human"))
    wrapped = FalconTeleop(env, device, **teleop)
    writer = DatasetWriter(
        dataset_id,
        env,
        root=root,
        author=author,
        description=description or f"Demonstrations by a {operator} operator with the {device.name}.",
        algorithm_name=f"teleoperation ({operator})",
    )
    recorder = EpisodeRecorder(env, states=states)
    tried = recorded = successes = 0
    lost: str | None = None
    first = seed if writer.last_seed is None else max(seed, writer.last_seed + 1)
    made: Any = env.unwrapped
    while recorded < episodes and (attempts is None or tried < attempts):
        try:
            summary = run_episode(
                wrapped,
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
        if keep:
            writer.add(
                recorder.finish(
                    operator=operator,
                    device=device.name,
                    success=summary.success,
                    operator_share=summary.operator_share,
                    engine=made.settings.engine,
                    spatula_env_version=__version__,
                )
            )
            recorded += 1
            successes += summary.success
        if progress is not None:
            progress("recorded" if keep else "discarded", summary)
        if summary.quit:
            break
    return RecordingSummary(
        dataset_id=dataset_id,
        path=writer.path,
        recorded=recorded,
        discarded=tried - recorded,
        successes=successes,
        total_episodes=writer.total_episodes,
        lost=lost,
    )
