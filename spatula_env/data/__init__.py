"""Demonstrations: episodes, replay, and datasets in Minari's format. `teleop.recording` records an operator.

Modules::

    episode     one episode in memory
    layout      names of the numbers in a dataset
    dataset     a dataset on disk, written episode by episode
    replaying   `replay`: by actions, checked, or by states
    catalog     listing and summarizing datasets, filtering and merging them
    statistics  statistics of the episodes; plots draws them
    drawing     pictures of recorded states
    lerobot_export    export to the layout of LeRobot's datasets
    d3rlpy_dataset    conversion for d3rlpy

Importing this package loads neither Minari nor h5py; writing and reading datasets needs both.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from spatula_env.data.catalog import DatasetSummary, copy_episodes, list_datasets, summarize
    from spatula_env.data.d3rlpy_dataset import load_d3rlpy
    from spatula_env.data.dataset import DatasetWriteError, DatasetWriter
    from spatula_env.data.episode import Episode, EpisodeRecorder
    from spatula_env.data.layout import Layout
    from spatula_env.data.lerobot_export import LeRobotExport, export_lerobot
    from spatula_env.data.plots import plot_statistics
    from spatula_env.data.replaying import EpisodeReplay, replay
    from spatula_env.data.statistics import DatasetStatistics

__all__ = [
    "DatasetStatistics",
    "DatasetSummary",
    "DatasetWriteError",
    "DatasetWriter",
    "Episode",
    "EpisodeRecorder",
    "EpisodeReplay",
    "Layout",
    "LeRobotExport",
    "copy_episodes",
    "export_lerobot",
    "list_datasets",
    "load_d3rlpy",
    "plot_statistics",
    "replay",
    "summarize",
]


def __getattr__(name: str) -> Any:
    """Import a module when one of its names is first asked for."""
    for module, names in (
        ("catalog", ("DatasetSummary", "copy_episodes", "list_datasets", "summarize")),
        ("d3rlpy_dataset", ("load_d3rlpy",)),
        ("dataset", ("DatasetWriteError", "DatasetWriter")),
        ("episode", ("Episode", "EpisodeRecorder")),
        ("layout", ("Layout",)),
        ("lerobot_export", ("LeRobotExport", "export_lerobot")),
        ("plots", ("plot_statistics",)),
        ("statistics", ("DatasetStatistics",)),
        ("replaying", ("EpisodeReplay", "replay")),
    ):
        if name in names:
            return getattr(import_module(f"spatula_env.data.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
