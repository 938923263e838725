"""Interquartile means with bootstrap intervals, and when training first reached a success rate.

R. Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice", NeurIPS 2021, say why: with
few seeds a mean hangs on one of them, and a median hardly on any. Their package rliable is not used, because it cannot
be imported with pandas 3: its release 1.2.0 needs arch, whose release 7.2.0 calls a function of pandas in a way that is
no longer possible. SciPy's bootstrap draws the same resamples: of seeds, within each task.
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
"""Share that is left out on each side."""


@dataclass(frozen=True)
class Estimate:
    """A number with its interval.

    Attributes:
        value: The number.
        low: Lower end; None with too few samples for an interval.
        high: Upper end; None likewise.
    """

    value: float
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Reached:
    """When the runs of an algorithm first reached a success rate.

    Attributes:
        count: How many did.
        of: Of how many.
        steps: Control steps, with those of demonstrations, the median over all runs; None if most did not.
        seconds: Wall-clock time until then, likewise [s].
    """

    count: int
    of: int
    steps: float | None
    seconds: float | None


def interquartile_mean(samples: FloatArray, axis: int = -1) -> Any:
    """Mean of the middle half."""
    from scipy.stats import trim_mean

    return trim_mean(samples, TRIMMED, axis=axis)


def estimate(groups: Sequence[Sequence[float] | FloatArray], plan: BootstrapPlan) -> Estimate:
    """The interquartile mean of some groups of samples together.

    Args:
        groups: Samples, such as the success rates of the seeds, for each task. Resamples are drawn within each group.
        plan: How the interval is found.

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
    """The interquartile means of columns, and the ends of their intervals.

    Args:
        samples: (R, N) of R runs.
        plan: How the intervals are found.

    Returns:
        Three times (N,); with one run only, the intervals are empty.
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
    """How many control steps an agent had cost when it was evaluated: its own, and those of its demonstrations."""
    return float(line["step"] + line.get("demonstration_steps", 0))


def first_reaching(curve: Sequence[Mapping[str, Any]], threshold: float) -> tuple[float, float] | None:
    """The step and the second at which an evaluation first was at a success rate; None if none was."""
    for line in curve:
        if line["success_rate"] >= threshold:
            return steps_at(line), float(line["seconds"])
    return None


def when_reached(curves: Sequence[Sequence[Mapping[str, Any]]], threshold: float) -> Reached:
    """When the runs of an algorithm first reached a success rate.

    A run that never did counts as infinitely long.
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
    """The success rates of a run at some steps: between evaluations on a line, and after the last one as it was.

    Args:
        curve: Of a run, with one line at least.
        grid: (N,) steps, with those of demonstrations.

    Returns:
        (N,); NaN before the first evaluation.
    """
    steps = np.array([steps_at(line) for line in curve])
    rates = np.array([line["success_rate"] for line in curve], dtype=np.float64)
    return np.asarray(np.interp(grid, steps, rates, left=np.nan), dtype=np.float64)
