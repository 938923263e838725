"""Episodes of a page on their way into datasets."""

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
"""The dataset of a task, unless another is named."""


@dataclass(frozen=True)
class RecordingOptions:
    """How episodes of a page are recorded.

    Attributes:
        exclusive: Whether the page is there to record: then it is checked at the start that this can be done, and
            nobody else records into the dataset meanwhile. Otherwise that is seen to when an episode begins.
        author: Who holds the device; kept with each episode.
        description: Of the dataset.
        episodes: After so many the page ends; None: it goes on.
        total: It ends when the dataset has so many; None: it goes on.
        attempts: It ends after so many tries, kept or not; None: it goes on.
        keep_failures: Whether episodes that do not reach their goal are added, too.
        end_on_success: Whether reaching the goal ends an episode.
        states: Whether the physics' state is recorded.
        state_dtype: How precisely; see `EpisodeRecorder`.
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
    """Recording from a page.

    Attributes:
        options: How.
        saved: How many episodes have been added, by ids of datasets.
        discarded: How many were not kept.
        successes: How many of those added reached their goal.
    """

    def __init__(
        self, first_id: str, options: RecordingOptions, *, dataset: str | None, root: Path | None, seed: int
    ) -> None:
        """Describe it.

        Args:
            first_id: The task to begin with.
            options: How to record.
            dataset: Id of the dataset of the first task, or of all tasks with ``{task}`` in it; None: `DATASET`.
            root: Folder of all datasets; Minari's own by default.
            seed: Of the first episode, at least.

        Raises:
            ValueError: If the dataset has a name that Minari does not take.
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
        """How many episodes have been added."""
        return sum(self.saved.values())

    @property
    def claimed(self) -> bool:
        """Whether nobody else records into the dataset of the first task."""
        return self._claimed is not None

    @property
    def done(self) -> bool:
        """Whether all is recorded that was to be."""
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
        """The summary, for the dataset of the first task."""
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
        """Record into the dataset of the first task for as long as a ``with`` block lasts, and let nobody else.

        Args:
            env: The first task.

        Raises:
            ImportError: If Minari is missing.
            ValueError: If episodes of `env` cannot be added to the dataset.
            DatasetBusy: If somebody else records into it.
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
        """Record an episode in a ``with`` block; then say what becomes of it.

        Args:
            env: The task, with the page as its device.
            env_id: Its id.

        Raises:
            ImportError: If Minari is missing.
            ValueError: If episodes of `env` cannot be added to the dataset.
            DatasetBusy: If somebody else records into it.
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
        """The seed of the next episode."""
        return next_seed(writer, self._seed)


class PageEpisode:
    """An episode while it is recorded.

    Attributes:
        recorder: Takes what happens.
        seed: Of its reset.
    """

    def __init__(self, recording: PageRecording, env: FalconTeleop, writer: DatasetWriter) -> None:
        """Begin with it."""
        self._recording, self._env, self._writer = recording, env, writer
        options = recording.options
        self.recorder = EpisodeRecorder(env.env, states=options.states, state_dtype=options.state_dtype)
        self.seed = recording.next_seed(writer)

    def save(self, summary: EpisodeSummary, **attributes: Any) -> str:
        """Add it to its dataset, unless it has failed and failures are dropped.

        Args:
            summary: How it went.
            **attributes: What else there is to tell of it.

        Returns:
            What has become of it, in words; empty if it was not added.

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
        """It is not kept."""
        self._recording.discarded += 1
