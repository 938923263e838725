"""Interquartile means with bootstrap intervals, and the time at which training first reached a success rate.

The reasons are given by R. Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice",
NeurIPS 2021: with few seeds a mean depends strongly on single seeds, and a median uses hardly any of them. Their
package rliable is not used because it cannot be imported with pandas 3: its release 1.2.0 needs arch, whose release
7.2.0 calls a pandas function in a way that no longer works. SciPy's bootstrap draws the same resamples: of seeds,
within each task.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spatula_env.arrays import FloatArray
from spatula_env.learning.results.plan import BootstrapPlan

TRIMMED = 0.25
"""Share of samples that is left out at each end."""


@dataclass(frozen=True)
class Estimate:
    """A number with its confidence interval.

    Attributes:
        value: The number.
        low: Lower end; None with too few samples for an interval.
        high: Upper end; None with too few samples for an interval.
    """

    value: float
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Reached:
    """When the runs of an algorithm first reached a success rate.

    Attributes:
        count: Number of runs that reached it.
        of: Number of runs.
        steps: Median over all runs of the control steps needed, including demonstrations; None if most did not reach
            it.
        seconds: Median over all runs of the wall-clock time needed [s]; None if most did not reach it.
    """

    count: int
    of: int
    steps: float | None
    seconds: float | None


def interquartile_mean(samples: FloatArray, axis: int = -1) -> Any:
    """Mean of the middle half of the samples."""
    from scipy.stats import trim_mean

    return trim_mean(samples, TRIMMED, axis=axis)


def estimate(groups: Sequence[Sequence[float] | FloatArray], plan: BootstrapPlan) -> Estimate:
    """Interquartile mean over several groups of samples together.

    Args:
        groups: Samples, such as the success rates of the seeds, for each task. Resamples are drawn within each group.
        plan: How the interval is computed.

    Raises:
        ValueError: If a group is empty.
    """
    arrays = [np.asarray(group, dtype=np.float64) for group in groups]
    if not arrays or any(array.size == 0 for array in arrays):
        raise ValueError("groups must have one sample each at least")
    value = float(interquartile_mean(np.concatenate(arrays)))
    if any(array.size < 2 for array in arrays):
        return Estimate(value)
    low, high = _interval(arrays, plan)
    return Estimate(value, float(low), float(high))


def estimate_columns(samples: FloatArray, plan: BootstrapPlan) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Interquartile means of columns, with the ends of their intervals.

    Args:
        samples: (R, N) samples of R runs.
        plan: How the intervals are computed.

    Returns:
        Three arrays (N,): means, lower and upper ends; with one run only, the intervals are empty.
    """
    value = np.asarray(interquartile_mean(samples, axis=0), dtype=np.float64)
    if len(samples) < 2:
        return value, value, value
    low, high = _interval([samples], plan, axis=0)
    return value, np.asarray(low), np.asarray(high)


def _interval(arrays: list[FloatArray], plan: BootstrapPlan, axis: int = -1) -> tuple[Any, Any]:
    from scipy.stats import bootstrap

    def statistic(*samples: FloatArray, axis: int) -> Any:
        return interquartile_mean(np.concatenate(samples, axis=axis), axis=axis)

    found = bootstrap(
        tuple(arrays),
        statistic,
        n_resamples=plan.resamples,
        confidence_level=plan.confidence,
        method="percentile",
        vectorized=True,
        axis=axis,
        rng=np.random.default_rng(plan.seed),
    )
    low, high = found.confidence_interval
    return low, high


def steps_at(line: Mapping[str, Any]) -> float:
    """Number of control steps that an agent had used when it was evaluated, including those of its demonstrations."""
    return float(line["step"] + line.get("demonstration_steps", 0))


def first_reaching(curve: Sequence[Mapping[str, Any]], threshold: float) -> tuple[float, float] | None:
    """Steps and seconds of the first evaluation that reached a success rate; None if none did."""
    for line in curve:
        if line["success_rate"] >= threshold:
            return steps_at(line), float(line["seconds"])
    return None


def when_reached(curves: Sequence[Sequence[Mapping[str, Any]]], threshold: float) -> Reached:
    """When the runs of an algorithm first reached a success rate.

    A run that never reached it counts as infinitely long.
    """
    found = [first_reaching(curve, threshold) or (math.inf, math.inf) for curve in curves]
    steps, seconds = (float(np.median([each[k] for each in found])) if found else math.inf for k in (0, 1))
    return Reached(
        sum(math.isfinite(each[0]) for each in found),
        len(found),
        steps if math.isfinite(steps) else None,
        seconds if math.isfinite(seconds) else None,
    )


def on_grid(curve: Sequence[Mapping[str, Any]], grid: FloatArray) -> FloatArray:
    """Interpolate a run's success rates at some steps: linear between evaluations, constant after the last one.

    Args:
        curve: Curve of a run, with at least one line.
        grid: (N,) steps, including those of demonstrations.

    Returns:
        (N,) success rates; NaN before the first evaluation.
    """
    steps = np.array([steps_at(line) for line in curve])
    rates = np.array([line["success_rate"] for line in curve], dtype=np.float64)
    return np.asarray(np.interp(grid, steps, rates, left=np.nan), dtype=np.float64)
