"""A storage for Minari that checks each episode's file before it is read. Importing this module loads Minari."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from minari.dataset.minari_storage import MinariStorage

from spatula_env.data.contained import check_episode_file


class CheckedStorage(MinariStorage):  # type: ignore[misc]
    """Wraps one of Minari's storages, and refuses to read an episode that refers to other files.

    An episode is checked when it is first read, and not again.
    """

    def __init__(self, storage: Any, unchecked: Mapping[int, str]) -> None:
        """Wrap a storage.

        Args:
            storage: The storage that reads.
            unchecked: File of each episode to check, relative to the storage's folder, by the episode's number.
        """
        super().__init__(storage.data_path, storage.observation_space, storage.action_space)
        self.FORMAT = storage.FORMAT
        self._storage = storage
        self._unchecked = dict(unchecked)

    @property
    def jpeg_encoding(self) -> bool:
        """Whether pictures are kept as JPEG."""
        # Minari 0.5.3 has no such attribute, and always encodes pictures.
        return bool(getattr(self._storage, "jpeg_encoding", True))

    @classmethod
    def _create(cls, *_: Any, **__: Any) -> MinariStorage:
        raise NotImplementedError("datasets are made by DatasetWriter")

    def get_episodes(self, episode_indices: Iterable[int]) -> Iterable[dict[str, Any]]:
        """See Minari; raises `DatasetDamaged` if an episode refers to data outside the dataset."""
        found: Iterable[dict[str, Any]] = self._storage.get_episodes(self._checked(episode_indices))
        return found

    def get_episode_metadata(self, episode_indices: Iterable[int]) -> Iterable[dict[str, Any]]:
        """See Minari; raises `DatasetDamaged` if an episode refers to data outside the dataset."""
        found: Iterable[dict[str, Any]] = self._storage.get_episode_metadata(self._checked(episode_indices))
        return found

    def update_episode_metadata(
        self, metadatas: Iterable[dict[str, Any]], episode_indices: Iterable[int] | None = None
    ) -> None:
        """See Minari."""
        wanted = range(self.total_episodes) if episode_indices is None else list(episode_indices)
        self._storage.update_episode_metadata(metadatas, list(self._checked(wanted)))

    def update_episodes(self, episodes: Iterable[Any]) -> None:
        """See Minari."""
        self._storage.update_episodes(episodes)

    def _checked(self, numbers: Iterable[int]) -> Iterator[int]:
        """Yield the numbers of episodes, each after a check of its file."""
        for number in numbers:
            file = self._unchecked.get(int(number))
            if file is not None:
                check_episode_file(Path(self.data_path), file)
                del self._unchecked[int(number)]
            yield number
