"""Statistics of a dataset: returns, lengths, success, force and pressure over time, positions of the tool.

`spatula_env.data.plots` draws them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import FloatArray
from spatula_env.data.catalog import DatasetSummary, summarize
from spatula_env.data.dataset import read_layout
from spatula_env.data.layout import VECTOR, Layout
from spatula_env.data.replaying import open_dataset, read_entries

CELLS = 10
"""Number of cells along each edge of the workspace, to measure how much of it was visited."""
QUARTILES = (0.25, 0.5, 0.75)


@dataclass(frozen=True, eq=False)
class Curve:
    """Distribution of a quantity over many episodes as a function of time, up to the end of the longest episode.

    Attributes:
        times: (T,) time since the reset [s].
        low: (T,) lower quartile of the episodes.
        median: (T,) median.
        high: (T,) upper quartile.
        greatest: (T,) maximum.
        episodes: (T,) number of episodes that last that long.
    """

    times: FloatArray
    low: FloatArray
    median: FloatArray
    high: FloatArray
    greatest: FloatArray
    episodes: NDArray[np.int64]

    @classmethod
    def of(cls, times: Sequence[FloatArray], values: Sequence[FloatArray]) -> Curve:
        """Compute a curve from the times and values of episodes, (T_k,) each; control steps are equally long."""
        longest = max(times, key=len)
        table = np.full((len(values), len(longest)), np.nan)
        for row, course in zip(table, values, strict=True):
            row[: len(course)] = course
        low, median, high = np.nanquantile(table, QUARTILES, axis=0)
        counts = np.count_nonzero(~np.isnan(table), axis=0)
        return cls(np.asarray(longest), low, median, high, np.nanmax(table, axis=0), counts)


@dataclass(frozen=True, eq=False)
class DatasetStatistics:
    """Statistics of E episodes. Quantities that were not recorded are None.

    Attributes:
        summary: Summary of the dataset.
        returns: (E,) sums of the rewards.
        lengths: (E,) control steps.
        durations: (E,) [s]; None if the dataset does not say how long a step is.
        successes: (E,) whether the goal was reached.
        operators: (E) kind of operator, "human" or "scripted".
        success_interval: Wilson's 95 % interval of the success rate; (0, 1) without episodes.
        force: Magnitude of the contact force, averaged over a control step [N].
        pressure: Greatest contact pressure in a control step [Pa].
        peak_forces: (E,) the greatest force on a tool [N].
        peak_pressures: (E,) the greatest contact pressure [Pa].
        doses: (E,) doses of pressure [Pa s].
        violations: (E,) whether there was a violation.
        positions: (S, 3) observed positions of the tool in all steps [m].
        workspace: (2, 3) the corners of the workspace [m].
        coverage: Share of the workspace's `CELLS`³ cells in which the tool has been.
    """

    summary: DatasetSummary
    returns: FloatArray
    lengths: NDArray[np.int64]
    durations: FloatArray | None
    successes: NDArray[np.bool_]
    operators: tuple[str, ...]
    success_interval: tuple[float, float]
    force: Curve | None
    pressure: Curve | None
    peak_forces: FloatArray | None
    peak_pressures: FloatArray | None
    doses: FloatArray | None
    violations: NDArray[np.bool_] | None
    positions: FloatArray | None
    workspace: FloatArray | None
    coverage: float | None

    def as_record(self) -> dict[str, Any]:
        """The statistics without the curves over time, as values that JSON can store."""
        count = len(self.returns)
        record: dict[str, Any] = {
            "dataset": self.summary.dataset_id,
            "env": self.summary.env_id,
            "episodes": count,
            "steps": int(self.lengths.sum()),
            "operators": dict(self.summary.operators),
            "success_rate": float(self.successes.mean()) if count else None,
            "success_interval": list(self.success_interval) if count else None,
            "return": _spread(self.returns),
            "length": _spread(self.lengths),
            "duration": _spread(self.durations),
            "peak_force": _spread(self.peak_forces),
            "peak_pressure": _spread(self.peak_pressures),
            "dose": _spread(self.doses),
            "violation_rate": None if self.violations is None or not count else float(self.violations.mean()),
            "coverage": self.coverage,
        }
        return record


def statistics(dataset_id: str, root: str | Path | None = None) -> DatasetStatistics:
    """Compute the statistics of a dataset from all its episodes.

    Args:
        dataset_id: Its id.
        root: Folder of all datasets; Minari's own by default.

    Raises:
        ImportError: If Minari is missing.
        FileNotFoundError: If there is no such dataset.
    """
    dataset = open_dataset(dataset_id, root)
    layout = read_layout(dataset_id, root)
    attributes = [entry.attributes for entry in read_entries(dataset_id, root)]
    returns, lengths = [], []
    courses: dict[str, list[FloatArray]] = {"time": [], "force": [], "peak_pressure": []}
    ends: dict[str, list[float]] = {"episode_peak_force": [], "episode_peak_pressure": [], "episode_dose": []}
    violations: list[bool] = []
    positions: list[FloatArray] = []
    for episode in dataset.iterate_episodes():
        returns.append(float(episode.rewards.sum()))
        lengths.append(len(episode.rewards))
        infos: Mapping[str, Any] = episode.infos or {}
        for name, values in courses.items():
            if name in infos:
                values.append(np.asarray(infos[name], dtype=np.float64))
        for name, found in ends.items():
            # In the first definition of tasks, the dose was called cost.
            told = "episode_cost" if name == "episode_dose" and name not in infos else name
            if told in infos:
                found.append(float(infos[told][-1]))
        if "violation" in infos:
            violations.append(bool(np.any(infos["violation"])))
        places = tool_positions(episode.observations, layout)
        if places is not None:
            positions.append(places)
    count = len(returns)
    complete = {name: values for name, values in courses.items() if count and len(values) == count}

    def course(name: str) -> Curve | None:
        return Curve.of(complete["time"], complete[name]) if {"time", name} <= complete.keys() else None

    def ending(name: str) -> FloatArray | None:
        return np.array(ends[name]) if count and len(ends[name]) == count else None

    successes = np.array([bool(each.get("success", False)) for each in attributes], dtype=np.bool_)
    where = np.concatenate(positions) if count and len(positions) == count else None
    known = len(layout.workspace_low) == 3
    box = np.array([layout.workspace_low, layout.workspace_high]) if known else None
    frequency = layout.control_frequency
    return DatasetStatistics(
        summary=summarize(dataset_id, root),
        returns=np.array(returns),
        lengths=np.array(lengths, dtype=np.int64),
        durations=None if frequency is None else np.array(lengths) / frequency,
        successes=successes,
        operators=tuple(str(each.get("operator", "unknown")) for each in attributes),
        success_interval=wilson_interval(int(successes.sum()), count) if count else (0.0, 1.0),
        force=course("force"),
        pressure=course("peak_pressure"),
        peak_forces=ending("episode_peak_force"),
        peak_pressures=ending("episode_peak_pressure"),
        doses=ending("episode_dose"),
        violations=np.array(violations) if count and len(violations) == count else None,
        positions=where,
        workspace=box,
        coverage=None if where is None or box is None else coverage(where, box),
    )


def tool_positions(observations: Any, layout: Layout) -> FloatArray | None:
    """(T + 1, 3) observed positions of the tool in an episode, workspace frame [m]; None if they are not observed."""
    found = layout.find("tool_position")
    if found is None:
        return None
    entry, columns = found
    values = observations if entry == VECTOR and not isinstance(observations, Mapping) else observations[entry]
    array = np.asarray(values, dtype=np.float64)
    # If observations have several frames, the last is the newest.
    return array[..., columns].reshape(len(array), -1, 3)[:, -1]


def coverage(positions: FloatArray, box: FloatArray) -> float:
    """The share of a box's cells that contain a position.

    Args:
        positions: (S, 3) [m].
        box: (2, 3) its corners [m].
    """
    cells = np.floor((positions - box[0]) / (box[1] - box[0]) * CELLS).astype(np.int64)
    return len(np.unique(np.clip(cells, 0, CELLS - 1), axis=0)) / CELLS**3


def wilson_interval(successes: int, count: int, z: float = 1.959963984540054) -> tuple[float, float]:
    """The score interval of a proportion (E. B. Wilson, J Am Stat Assoc 22:209, 1927).

    Args:
        successes: Number of successes.
        count: Number of trials.
        z: Quantile of the normal distribution; the default is that of 95 %, on both sides.

    Returns:
        The interval's ends, in [0, 1].

    Raises:
        ValueError: If there were no trials, or more successes than trials.
    """
    if count < 1 or not 0 <= successes <= count:
        raise ValueError(f"successes must be 0 to count, and count 1 or more, got {successes} of {count}")
    share = successes / count
    middle = (share + z * z / (2.0 * count)) / (1.0 + z * z / count)
    half = z / (1.0 + z * z / count) * math.sqrt(share * (1.0 - share) / count + z * z / (4.0 * count * count))
    # At the ends the two terms are equal, but for rounding.
    low = 0.0 if successes == 0 else max(0.0, middle - half)
    high = 1.0 if successes == count else min(1.0, middle + half)
    return low, high


def _spread(values: NDArray[Any] | None) -> dict[str, float] | None:
    if values is None or len(values) == 0:
        return None
    return {
        "mean": float(values.mean()),
        "least": float(values.min()),
        "median": float(np.median(values)),
        "greatest": float(values.max()),
    }
