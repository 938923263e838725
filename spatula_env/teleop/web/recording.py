"""Recording a page's episodes into datasets."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spatula_env.data.dataset import AUTHOR, DatasetWriter, check_dataset_id, check_target, dataset_folder
from spatula_env.data.episode import EpisodeRecorder, StateType
from spatula_env.data.files import recording_lock
from spatula_env.data.index import read_metadata
from spatula_env.naming import task_name
from spatula_env.teleop.recording import RecordingSummary, episode_attributes, next_seed

if TYPE_CHECKING:
    import gymnasium

    from spatula_env.teleop.session import EpisodeSummary
    from spatula_env.teleop.wrapper import FalconTeleop

DATASET = "spatula/{task}/web-v0"
"""Default name of a task's dataset."""


@dataclass(frozen=True)
class RecordingOptions:
    """How a page's episodes are recorded.

    Attributes:
        exclusive: Whether the page serves to record: the dataset is then checked at the start and kept from other
            programs meanwhile. Otherwise that is done when an episode begins.
        author: Name of the operator; stored with each episode.
        description: Description of the dataset.
        episodes: The page ends after this number of episodes; None for no limit.
        total: The page ends when the dataset has this number of episodes; None for no limit.
        attempts: The page ends after this number of attempts, kept or not; None for no limit.
        keep_failures: Whether episodes that do not reach their goal are added, too.
        end_on_success: Whether reaching the goal ends an episode.
        states: Whether to record the physics state.
        state_dtype: Precision of the states; see `EpisodeRecorder`.
    """

    exclusive: bool = False
    author: str = AUTHOR
    description: str = ""
    episodes: int | None = None
    total: int | None = None
    attempts: int | None = None
    keep_failures: bool = True
    end_on_success: bool = False
    states: bool = True
    state_dtype: StateType = "float32"

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("episodes", "total", "attempts"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"{name} must be None, or 1 or more, got {value!r}")


class PageRecording:
    """Records episodes of a page.

    Attributes:
        options: How episodes are recorded.
        saved: Number of episodes added, by dataset id.
        discarded: Number of episodes that were not kept.
        successes: Number of added episodes that reached their goal.
    """

    def __init__(
        self, first_id: str, options: RecordingOptions, *, dataset: str | None, root: Path | None, seed: int
    ) -> None:
        """Store the settings.

        Args:
            first_id: Id of the first task.
            options: How to record.
            dataset: Id of the first task's dataset, or with ``{task}`` in it, of all tasks' datasets; None: `DATASET`.
            root: Folder of all datasets; Minari's own by default.
            seed: Least seed of the first episode.

        Raises:
            ValueError: If Minari does not accept the dataset's name.
        """
        self.options = options
        self.saved: dict[str, int] = {}
        self.discarded = self.successes = 0
        self._first_id, self._dataset, self._root, self._seed = first_id, dataset or DATASET, root, seed
        self._claimed: str | None = None
        self._in_dataset = 0
        check_dataset_id(self.dataset_id(first_id))

    @property
    def recorded(self) -> int:
        """Number of episodes added."""
        return sum(self.saved.values())

    @property
    def claimed(self) -> bool:
        """Whether the dataset of the first task is claimed, so that no other program records into it."""
        return self._claimed is not None

    @property
    def done(self) -> bool:
        """Whether all requested episodes have been recorded."""
        wanted = self.options
        return (
            (wanted.episodes is not None and self.recorded >= wanted.episodes)
            or (wanted.attempts is not None and self.recorded + self.discarded >= wanted.attempts)
            or (wanted.total is not None and self._in_dataset >= wanted.total)
        )

    def dataset_id(self, env_id: str) -> str:
        """The dataset that episodes of a task are added to."""
        own = "{task}" in self._dataset or env_id == self._first_id
        return (self._dataset if own else DATASET).replace("{task}", task_name(env_id))

    def summary(self) -> RecordingSummary:
        """Summary for the dataset of the first task."""
        name = self.dataset_id(self._first_id)
        return RecordingSummary(
            dataset_id=name,
            path=dataset_folder(name, self._root),
            recorded=self.recorded,
            discarded=self.discarded,
            successes=self.successes,
            total_episodes=self._in_dataset,
        )

    @contextmanager
    def claim(self, env: gymnasium.Env[Any, Any]) -> Iterator[None]:
        """Claim the dataset of the first task while a ``with`` block lasts, so that no other program records into it.

        Args:
            env: Environment of the first task.

        Raises:
            ImportError: If Minari is missing.
            ValueError: If episodes of `env` cannot be added to the dataset.
            DatasetBusy: If another program records into it.
            OSError: If it cannot be written to.
        """
        name = self.dataset_id(self._first_id)
        check_target(name, env, self._root)
        with recording_lock(dataset_folder(name, self._root), name):
            self._claimed = name
            with suppress(FileNotFoundError):
                metadata = read_metadata(dataset_folder(name, self._root) / "data")
                self._in_dataset = int(metadata["total_episodes"])
            try:
                yield
            finally:
                self._claimed = None

    @contextmanager
    def episode(self, env: FalconTeleop, env_id: str) -> Iterator[PageEpisode]:
        """Record an episode in a ``with`` block; the caller saves or discards it.

        Args:
            env: Environment of the task, with the page as its device.
            env_id: Id of the environment.

        Raises:
            ImportError: If Minari is missing.
            ValueError: If episodes of `env` cannot be added to the dataset.
            DatasetBusy: If another program records into it.
            DatasetWriteError: If it cannot be written to.
        """
        name = self.dataset_id(env_id)
        folder = dataset_folder(name, self._root)
        with nullcontext() if name == self._claimed else recording_lock(folder, name):
            writer = DatasetWriter(
                name,
                env.env,
                root=self._root,
                author=self.options.author,
                description=self.options.description or "Demonstrations by a human operator with the web device.",
                algorithm_name="teleoperation (human)",
            )
            self._in_dataset = writer.total_episodes
            yield PageEpisode(self, env, writer)

    def count(self, writer: DatasetWriter, success: bool) -> None:
        """Count an episode that was added."""
        self.saved[writer.dataset_id] = self.saved.get(writer.dataset_id, 0) + 1
        self.successes += success
        self._in_dataset = writer.total_episodes

    def next_seed(self, writer: DatasetWriter) -> int:
        """Seed of the next episode."""
        return next_seed(writer, self._seed)


class PageEpisode:
    """An episode while it is being recorded.

    Attributes:
        recorder: Records the episode.
        seed: Seed of its reset.
    """

    def __init__(self, recording: PageRecording, env: FalconTeleop, writer: DatasetWriter) -> None:
        """Begin recording."""
        self._recording, self._env, self._writer = recording, env, writer
        options = recording.options
        self.recorder = EpisodeRecorder(env.env, states=options.states, state_dtype=options.state_dtype)
        self.seed = recording.next_seed(writer)

    def save(self, summary: EpisodeSummary, **attributes: Any) -> str:
        """Add the episode to its dataset, unless it failed and failures are dropped.

        Args:
            summary: Result of the episode.
            **attributes: Further metadata of the episode.

        Returns:
            Description of what was saved; empty if the episode was not added.

        Raises:
            DatasetWriteError: If it could not be written.
        """
        if not (summary.success or self._recording.options.keep_failures):
            self._recording.discarded += 1
            return ""
        number = self._writer.add(self.recorder.finish(**episode_attributes(self._env, summary), **attributes))
        self._recording.count(self._writer, summary.success)
        return f"Episode {number} of {self._writer.dataset_id}, {summary.steps} steps."

    def discard(self) -> None:
        """Drop the episode."""
        self._recording.discarded += 1
