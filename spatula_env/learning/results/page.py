"""Writes the page of results in Markdown."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from spatula_env.definitions import FIRST, definition_number
from spatula_env.learning.results.gather import REFERENCE_LABELS, Row, names_of
from spatula_env.learning.results.plan import ResultsPlan
from spatula_env.learning.results.statistics import Estimate, Reached, estimate

NONE = "–"

ENGINE_NAMES = {"batch": "the batch engine", "bullet": "Bullet", "tissue": "the engine of tissue", "mujoco": "MuJoCo"}

INTRODUCTION = """# Results

This page is for you if you want to know what agents learn here, or compare your own with them.

Agents trained with the configurations in `configs`, {seeds} seeds each, beside {references}.
Figures are of the tasks' [definition]({definitions}) {definition}.
`python -m agents.results` makes this page: it trains what has not been trained, evaluates it, and writes what follows;
`configs/results.yaml` says what there is to be.

Each agent is evaluated in {episodes} episodes that it has neither been trained nor chosen by, which end with success or
after ten seconds; what is kept of a run is the policy of its best evaluation. *IQM* is the interquartile mean over the
seeds, with {confidence} % intervals by {resamples} bootstrap resamples of the seeds. It leaves the worst seed out, so
that the mean and the worst seed stand beside it. Numbers of policies to compare with are means over the episodes, with
Wilson's interval of success. *Safe* is success within the task's budget of cost. Returns are those of whole episodes.
*Steps* are the control steps that an agent has cost, those of its demonstrations among them. Nothing in the reward
speaks of pressure: cost and violations ([tasks.md](tasks.md#safety)) are what agents do that are not asked to be
careful.
"""


COMMAND = "python -m agents.results"


def write_page(
    plan: ResultsPlan, rows: Sequence[Row], machines: Sequence[Mapping[str, Any]], command: str = COMMAND
) -> str:
    """Compose the page.

    Args:
        plan: The plan of results.
        rows: Rows from `gather`.
        machines: Machines from `read_machines`.
        command: The last command given, which the page shows if it covers a part of the plan only.
    """
    engines = plan.evaluation.engines
    parts = [
        INTRODUCTION.format(
            seeds=len(plan.seeds),
            episodes=plan.evaluation.episodes,
            confidence=f"{100 * plan.bootstrap.confidence:g}",
            resamples=plan.bootstrap.resamples,
            references=_enumerated([REFERENCE_LABELS[name] for name in plan.references]) or "nothing else",
            definition=" and ".join(map(str, _definitions(plan))),
            definitions="definitions.md",
        )
    ]
    if command != COMMAND:
        parts.append(f"What is here was last added to with `{command}`.\n")
    parts.append(_missing(plan, rows))
    parts.append(_all_tasks(plan, rows))
    for task in plan.tasks:
        own = [row for row in rows if row.task == task]
        if own:
            note = plan.tasks[task].note
            parts += [f"## {task.capitalize()}\n", f"{note}\n" if note else "", _success_table(own, engines[0])]
            parts += [_learning_table(own, plan), _picture(plan, task, own), _transfer_table(own, engines)]
    parts.append(_machines(machines))
    return "\n".join(part for part in parts if part)


def picture_name(task: str) -> str:
    """File name of the learning curves of a task."""
    return f"results_{task}.png"


SUMMARY_PICTURE = "results_success.png"


def _missing(plan: ResultsPlan, rows: Sequence[Row]) -> str:
    there = {(row.task, row.name): row.finished for row in rows}
    lacking = [
        f"{task} with {name} ({there.get((task, name), 0)} of {len(plan.seeds)} seeds)"
        for task, planned in plan.tasks.items()
        for name in planned.algorithms
        if there.get((task, name), 0) < len(plan.seeds)
    ]
    return f"Not finished yet: {'; '.join(lacking)}.\n" if lacking else ""


def _all_tasks(plan: ResultsPlan, rows: Sequence[Row]) -> str:
    """Table of success by task and algorithm, and over all tasks together."""
    labels = names_of(plan, rows)
    if not labels:
        return ""
    engine = plan.evaluation.engines[0]
    lines = [("", *(task.capitalize() for task in plan.tasks), "all tasks", "mean", "worst seed")]
    for name in labels:
        own = {row.task: row for row in rows if row.name == name and engine in row.rates}
        cells = [_rate(own[task].quantities[engine]["success_rate"]) if task in own else NONE for task in plan.tasks]
        whole = set(own) == set(plan.tasks) and name not in plan.references
        over = _rate(estimate([own[task].rates[engine] for task in plan.tasks], plan.bootstrap)) if whole else NONE
        every = [rate for row in own.values() for rate in row.rates[engine]] if whole else []
        lines.append((labels[name], *cells, over, *_mean_and_worst(every)))
    text = (
        f"## All tasks\n\nSuccess in {ENGINE_NAMES[engine]}, IQM [%]; of all tasks the mean and the worst seed as well:"
        f"\n\n{_table(lines)}"
    )
    picture = _link(plan, SUMMARY_PICTURE)
    return f"{text}\n![Success by task, algorithm and engine, with intervals]({picture})\n"


def _success_table(rows: Sequence[Row], engine: str) -> str:
    lines = [
        (
            "", "seeds", "steps", "success, IQM [%]", "mean", "worst seed", "safe [%]", "return", "cost [s]",
            "episodes with a violation [%]", "time to success [s]",
        )
    ]  # fmt: skip
    for row in rows:
        told = row.quantities.get(engine, {})
        lines.append(
            (
                row.label,
                str(row.finished) if row.planned else NONE,
                _steps(row.all_steps),
                _cell(told, "success_rate", _rate),
                *_mean_and_worst(row.rates.get(engine, ()) if row.planned else ()),
                _cell(told, "safe_success_rate", _rate),
                _cell(told, "return", _number),
                _cell(told, "cost", _number),
                _cell(told, "violation_rate", _rate),
                _cell(told, "time_to_success", _number),
            )
        )
    return f"In {ENGINE_NAMES[engine]}:\n\n{_table(lines)}"


def _learning_table(rows: Sequence[Row], plan: ResultsPlan) -> str:
    trained = [row for row in rows if row.reached]
    if not trained:
        return ""
    heads = [
        f"{what} to {100 * threshold:g} %" for threshold in plan.thresholds for what in ("runs", "steps", "wall-clock")
    ]
    lines = [("", *heads, "of demonstrations", "steps in all", "wall-clock in all")]
    for row in trained:
        cells = [cell for threshold in plan.thresholds for cell in _reached_cells(row.reached[threshold])]
        steps = (_steps(row.demonstration_steps), _steps(row.all_steps))
        lines.append((row.label, *cells, *steps, _minutes(row.seconds)))
    return (
        "When an evaluation during training first had a success rate, the median over all runs, one that never had it "
        "counting as endless; steps are those of demonstrations too, and time includes the evaluations. An agent that "
        "begins as a clone is evaluated before it learns: if it has the rate by then, its demonstrations are all it "
        f"took. Training ends at its target:\n\n{_table(lines)}"
    )


def _reached_cells(reached: Reached) -> tuple[str, str, str]:
    return f"{reached.count} of {reached.of}", _steps(reached.steps), _minutes(reached.seconds)


def _picture(plan: ResultsPlan, task: str, rows: Sequence[Row]) -> str:
    if not any(row.curves for row in rows):
        return ""
    return f"![Learning curves: success over environment steps]({_link(plan, picture_name(task))})\n"


def _transfer_table(rows: Sequence[Row], engines: Sequence[str]) -> str:
    if len(engines) < 2:
        return ""
    first = engines[0]
    parts = []
    for engine in engines[1:]:
        there = [row for row in rows if engine in row.quantities]
        if not there:
            continue
        lines = [("", "success, IQM [%]", "worst seed", "difference [%]", "cost [s]", "episodes with a violation [%]")]
        for row in there:
            told = row.quantities[engine]
            before = row.quantities.get(first, {}).get("success_rate")
            change = NONE if before is None else f"{100 * (told['success_rate'].value - before.value):+.1f}"
            lines.append(
                (row.label, _rate(told["success_rate"]), _mean_and_worst(row.rates[engine] if row.planned else ())[1],
                 change, _cell(told, "cost", _number),
                 _cell(told, "violation_rate", _rate))
            )  # fmt: skip
        parts.append(
            f"The same policies in {ENGINE_NAMES[engine]}, which none was trained in, and the difference to "
            f"{ENGINE_NAMES[first]}:\n\n{_table(lines)}"
        )
    return "\n".join(parts)


def _machines(machines: Sequence[Mapping[str, Any]]) -> str:
    if not machines:
        return ""
    text = (
        "Runs and evaluations took place here, one run to a process and others beside it, so that wall-clock is more "
        "than a run takes alone:\n"
    )
    lines = ["## Machine\n", text]
    seen: dict[str, set[str]] = {}
    for each in machines:
        machine, versions = each["machine"], each["versions"]
        named = ", ".join(
            f"{name.replace('_', '-') if name == 'spatula_env' else name} {version}"
            for name, version in versions.items()
            if version is not None and name != "python"
        )
        entry = (
            f"- {machine['processor'] or 'unknown processor'}, {machine['cores']} cores, {machine['system']}; "
            f"Python {versions['python']}; {named}"
        )
        seen.setdefault(entry, set()).add(str(each["commit"])[:10] if each["commit"] else "unknown")
    return (
        "\n".join([*lines, *(f"{entry}; commits {', '.join(sorted(commits))}" for entry, commits in seen.items())])
        + "\n"
    )


def _link(plan: ResultsPlan, name: str) -> str:
    """Link to a picture, relative to the page."""
    page, pictures = Path(plan.page), Path(plan.pictures)
    return Path(os.path.relpath(pictures / name, page.parent)).as_posix()


def _table(lines: Sequence[Sequence[str]]) -> str:
    rules = ["---", *["---:"] * (len(lines[0]) - 1)]
    return "".join(f"| {' | '.join(line)} |\n" for line in (lines[0], rules, *lines[1:]))


def _mean_and_worst(rates: Sequence[float]) -> tuple[str, str]:
    """Mean and worst of the success rates of some seeds."""
    if not rates:
        return NONE, NONE
    return f"{100 * sum(rates) / len(rates):.1f}", f"{100 * min(rates):.1f}"


def _enumerated(names: Sequence[str]) -> str:
    """Join names as in a sentence."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def _definitions(plan: ResultsPlan) -> list[int]:
    """The distinct definition numbers of a plan's tasks."""
    return sorted({definition_number(task.environment) for task in plan.tasks.values()}) or [FIRST]


def _cell(told: Mapping[str, Estimate], name: str, write: Callable[[Estimate], str]) -> str:
    return write(told[name]) if name in told else NONE


def _rate(value: Estimate) -> str:
    low, high = (None if limit is None else 100 * limit for limit in (value.low, value.high))
    return _with_interval(Estimate(100 * value.value, low, high), ".1f")


def _number(value: Estimate) -> str:
    return _with_interval(value, ".0f" if abs(value.value) >= 100 else ".1f" if abs(value.value) >= 10 else ".2f")


def _with_interval(value: Estimate, form: str) -> str:
    text = f"{value.value:{form}}"
    if value.low is None or value.high is None:
        return text
    return f"{text} [{value.low:{form}}, {value.high:{form}}]"


def _steps(steps: float | None) -> str:
    return NONE if steps is None else f"{round(steps):,}".replace(",", " ")


def _minutes(seconds: float | None) -> str:
    return NONE if seconds is None else f"{seconds / 60:.1f} min"
