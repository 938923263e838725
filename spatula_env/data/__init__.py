"""Demonstrations: recording, replay, and datasets in Minari's format.

Modules::

    episode     one episode in memory
    dataset     a dataset on disk, written episode by episode
    recording   `record`: an operator, a device, a dataset
    replaying   `replay`: by actions, checked, or by states
    catalog     what datasets there are and what is in them; copies without failures, several in one

Importing this package loads neither Minari nor h5py; writing and reading datasets needs both.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from spatula_env.data.catalog import DatasetSummary, copy_episodes, list_datasets, summarize
    from spatula_env.data.dataset import DatasetWriteError, DatasetWriter
    from spatula_env.data.episode import Episode, EpisodeRecorder
    from spatula_env.data.recording import RecordingSummary, record
    from spatula_env.data.replaying import EpisodeReplay, replay

__all__ = [
    "DatasetSummary",
    "DatasetWriteError",
    "DatasetWriter",
    "Episode",
    "EpisodeRecorder",
    "EpisodeReplay",
    "RecordingSummary",
    "copy_episodes",
    "list_datasets",
    "record",
    "replay",
    "summarize",
]


def __getattr__(name: str) -> Any:
    """Import a module when something of it is first asked for."""
    for module, names in (
        ("catalog", ("DatasetSummary", "copy_episodes", "list_datasets", "summarize")),
        ("dataset", ("DatasetWriteError", "DatasetWriter")),
        ("episode", ("Episode", "EpisodeRecorder")),
        ("recording", ("RecordingSummary", "record")),
        ("replaying", ("EpisodeReplay", "replay")),
    ):
        if name in names:
            return getattr(import_module(f"spatula_env.data.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
