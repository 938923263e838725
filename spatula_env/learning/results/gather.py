"""Collects rows of results from finished runs and their evaluations."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from spatula_env.learning.results.plan import ResultsPlan, Run, planned_references, planned_runs
from spatula_env.learning.results.runs import evaluation_file, is_finished
from spatula_env.learning.results.statistics import Estimate, Reached, estimate, when_reached
from spatula_env.learning.saving import read_curve

QUANTITIES = ("success_rate", "safe_success_rate", "return", "cost", "violation_rate", "time_to_success")
"""Quantities of an evaluation that the tables show."""

REFERENCE_LABELS: Mapping[str, str] = MappingProxyType(
    {
        "expert": "scripted expert",
        "proportional": "proportional controller",
        "random": "random actions",
        "pretrained": "pretrained policy",
    }
)
"""Labels of the reference policies."""


@dataclass(frozen=True)
class Row:
    """Results of one algorithm, or of one reference policy, on one task.

    Attributes:
        task: Name of the task.
        name: Name of the algorithm or policy.
        label: Label for display.
        planned: Planned number of seeds; 0 for a reference policy.
        finished: Number of finished seeds.
        rates: Success rates of the seeds, by the engine of evaluation.
        quantities: By engine, the quantities in `QUANTITIES`; empty without an evaluation.
        reached: When each threshold was reached; empty for policies that are not trained.
        curves: Learning curves of the seeds.
        steps: Mean number of control steps of training; None for policies that are not trained.
        demonstration_steps: Mean number of control steps made for demonstrations; None for policies that have not
            learned.
        seconds: Mean training time [s]; None for policies that are not trained.
    """

    task: str
    name: str
    label: str
    planned: int
    finished: int
    rates: Mapping[str, Sequence[float]]
    quantities: Mapping[str, Mapping[str, Estimate]]
    reached: Mapping[float, Reached]
    curves: Sequence[Sequence[Mapping[str, Any]]]
    steps: float | None
    demonstration_steps: float | None
    seconds: float | None

    @property
    def all_steps(self) -> float | None:
        """Control steps of training and for demonstrations; None for policies that have not learned."""
        return None if self.demonstration_steps is None else self.demonstration_steps + (self.steps or 0.0)


def gather(plan: ResultsPlan) -> list[Row]:
    """The rows of all tasks, learning algorithms first; an algorithm without a finished run has no row."""
    rows = []
    runs, references = planned_runs(plan), planned_references(plan)
    for task, planned in plan.tasks.items():
        for name, algorithm in planned.algorithms.items():
            own = [run for run in runs if (run.task, run.name) == (task, name)]
            done = [run for run in own if is_finished(run)]
            if done:
                rows.append(_learned(plan, task, name, algorithm.label or name, own, done))
        for run in references:
            if run.task == task and (row := _reference(plan, run)) is not None:
                rows.append(row)
    return rows


def names_of(plan: ResultsPlan, rows: Sequence[Row]) -> dict[str, str]:
    """Names and labels of everything that has a row on any task, learning algorithms first."""
    labels = {row.name: row.label for row in rows}
    learned = {name: label for name, label in labels.items() if name not in plan.references}
    return {**learned, **labels}


def read_evaluation(run: Run, engine: str) -> dict[str, Any] | None:
    """Read the evaluation of a run, if there is one."""
    file = evaluation_file(run, engine)
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else None


def read_machines(plan: ResultsPlan) -> list[dict[str, Any]]:
    """The distinct machines of all runs and evaluations, from their provenance files."""
    found: list[dict[str, Any]] = []
    for run in [*planned_runs(plan), *planned_references(plan)]:
        places = [run.folder / "provenance.json", *run.folder.glob("seed-*/provenance.json")]
        told = [json.loads(place.read_text(encoding="utf-8")) for place in places if place.exists()]
        told += [read["provenance"] for engine in plan.evaluation.engines if (read := read_evaluation(run, engine))]
        for each in told:
            kept = {"machine": each["machine"], "versions": each["versions"], "commit": each["commit"]}
            if kept not in found:
                found.append(kept)
    return found


def _learned(plan: ResultsPlan, task: str, name: str, label: str, own: list[Run], done: list[Run]) -> Row:
    rates: dict[str, list[float]] = {}
    quantities: dict[str, dict[str, Estimate]] = {}
    for engine in plan.evaluation.engines:
        read = [each for run in done if (each := read_evaluation(run, engine)) is not None]
        if read:
            rates[engine] = [each["summary"]["success_rate"] for each in read]
            quantities[engine] = _estimates([each["summary"] for each in read], plan)
    trained = [run for run in done if run.plan is not None and not run.plan.clone]
    curves = [read_curve(run.folder / f"seed-{run.seed}" / "curve.jsonl") for run in trained]
    summaries = [json.loads((run.folder / "summary.json").read_text(encoding="utf-8")) for run in trained]
    return Row(
        task=task,
        name=name,
        label=label,
        planned=len(own),
        finished=len(done),
        rates=rates,
        quantities=quantities,
        reached={threshold: when_reached(curves, threshold) for threshold in plan.thresholds} if trained else {},
        curves=curves,
        steps=float(np.mean([each["steps"][0] for each in summaries])) if summaries else None,
        demonstration_steps=float(np.mean([_demonstrated(run) for run in done])),
        seconds=float(np.mean([each["seconds"][0] for each in summaries])) if summaries else None,
    )


def _reference(plan: ResultsPlan, run: Run) -> Row | None:
    rates: dict[str, list[float]] = {}
    quantities: dict[str, dict[str, Estimate]] = {}
    for engine in plan.evaluation.engines:
        read = read_evaluation(run, engine)
        if read is not None:
            summary = read["summary"]
            rates[engine] = [summary["success_rate"]]
            # There is a single policy: the variation is over episodes, and success has Wilson's interval.
            quantities[engine] = {
                quantity: Estimate(summary[quantity]) for quantity in QUANTITIES if summary[quantity] is not None
            }
            quantities[engine]["success_rate"] = Estimate(summary["success_rate"], *summary["success_interval"])
    if not rates:
        return None
    return Row(run.task, run.name, REFERENCE_LABELS[run.name], 0, 0, rates, quantities, {}, [], None, None, None)


def _demonstrated(run: Run) -> int:
    """Number of control steps that were made for the demonstrations of a finished agent."""
    if run.plan is not None and run.plan.clone:
        told = json.loads((run.folder / "provenance.json").read_text(encoding="utf-8"))
        return int(told["demonstrations"]["steps_made"] + sum(each["steps"] for each in told["rounds"]))
    summary = json.loads((run.folder / "summary.json").read_text(encoding="utf-8"))
    return int(sum(summary.get("demonstration_steps", [0])))


def _estimates(summaries: Sequence[Mapping[str, Any]], plan: ResultsPlan) -> dict[str, Estimate]:
    found = {}
    for quantity in QUANTITIES:
        known = [summary[quantity] for summary in summaries if summary[quantity] is not None]
        if known:
            found[quantity] = estimate([known], plan.bootstrap)
    return found
