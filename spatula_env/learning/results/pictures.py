"""Draws the pictures of the page of results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from spatula_env.installing import install_hint
from spatula_env.learning.results.gather import Row, names_of
from spatula_env.learning.results.page import SUMMARY_PICTURE, picture_name
from spatula_env.learning.results.plan import ResultsPlan
from spatula_env.learning.results.statistics import estimate_columns, on_grid, steps_at

COLORS: Mapping[str, str] = MappingProxyType(
    {
        "sac": "#0072b2",
        "tqc": "#d55e00",
        "ppo": "#009e73",
        "sac_her": "#cc79a7",
        "clone": "#56b4e9",
        "expert": "#444444",
        "sac_scratch": "#882255",
        "proportional": "#777777",
        "random": "#aaaaaa",
        "pretrained": "#e69f00",
    }
)
"""Colours of the algorithms, distinguishable for colour-blind readers (M. Okabe and K. Ito, 2002)."""

OTHERS = ("#8c564b", "#7f7f7f", "#bcbd22")

GRID = 120
"""Number of points of a curve."""

DPI = 110


def draw_pictures(plan: ResultsPlan, rows: Sequence[Row]) -> list[Path]:
    """Draw all pictures for which there are results.

    Returns:
        Their files.

    Raises:
        ImportError: If the extra "results" is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise ImportError(f"pictures need matplotlib: {install_hint('results')}", name=error.name) from error
    matplotlib.use("Agg")
    folder = Path(plan.pictures)
    folder.mkdir(parents=True, exist_ok=True)
    colors = _colors(rows)
    files = []
    for task in plan.tasks:
        own = [row for row in rows if row.task == task]
        if any(row.curves for row in own):
            files.append(_draw_curves(plan, own, folder / picture_name(task), colors))
    if any(row.quantities for row in rows):
        files.append(_draw_success(plan, rows, folder / SUMMARY_PICTURE, colors))
    return files


def _colors(rows: Sequence[Row]) -> dict[str, str]:
    names = list(dict.fromkeys(row.name for row in rows))
    others = [name for name in names if name not in COLORS]
    return {**COLORS, **{name: OTHERS[k % len(OTHERS)] for k, name in enumerate(others)}}


def _draw_curves(plan: ResultsPlan, rows: Sequence[Row], file: Path, colors: Mapping[str, str]) -> Path:
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6.6, 3.6), layout="constrained")
    for row in rows:
        curves = [curve for curve in row.curves if curve]
        if curves:
            _draw_curve(axes, plan, row, curves, colors[row.name])
        elif row.name not in plan.references and row.rates:
            _draw_level(axes, plan, row, colors[row.name], "-.")
        elif row.rates and row.name not in ("pretrained", "proportional"):
            _draw_level(axes, plan, row, colors[row.name], ":")
    axes.set(xlabel="control steps of all worlds, with those of demonstrations", ylabel="success [%]", ylim=(-3, 103))
    axes.set_xlim(left=0)
    axes.xaxis.set_major_formatter(lambda value, _: f"{value / 1000:g} k" if value else "0")
    axes.set_title(rows[0].task.capitalize(), loc="left", fontsize=11)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.savefig(file, dpi=DPI)
    pyplot.close(figure)
    return file


def _draw_curve(axes: Any, plan: ResultsPlan, row: Row, curves: Sequence[Any], color: str) -> None:
    """Draw the interquartile mean with its band, up to the end of the longest run; thin lines are the single runs."""
    first = max(steps_at(curve[0]) for curve in curves)
    last = max(steps_at(curve[-1]) for curve in curves)
    grid = np.linspace(first, max(last, first + 1), GRID)
    samples = np.stack([on_grid(curve, grid) for curve in curves])
    value, low, high = estimate_columns(samples, plan.bootstrap)
    axes.plot(grid, 100 * value, color=color, linewidth=2, label=f"{row.label}, {len(curves)} seeds")
    axes.fill_between(grid, 100 * low, 100 * high, color=color, alpha=0.18, linewidth=0)
    for curve in curves:
        steps, rates = [steps_at(line) for line in curve], [100 * line["success_rate"] for line in curve]
        axes.plot(steps, rates, color=color, linewidth=0.6, alpha=0.45)
        axes.plot(steps[-1:], rates[-1:], color=color, marker="o", markersize=2.5, alpha=0.7)


def _draw_level(axes: Any, plan: ResultsPlan, row: Row, color: str, style: str) -> None:
    """Draw a horizontal line for a policy that does not learn in steps."""
    engine = plan.evaluation.engines[0]
    if engine in row.quantities:
        rate = 100 * row.quantities[engine]["success_rate"].value
        axes.axhline(rate, color=color, linestyle=style, linewidth=1.2, label=row.label)


def _draw_success(plan: ResultsPlan, rows: Sequence[Row], file: Path, colors: Mapping[str, str]) -> Path:
    """Draw points with intervals: a panel for each task, a row for each algorithm, a mark for each engine."""
    from matplotlib import pyplot
    from matplotlib.lines import Line2D

    tasks = [task for task in plan.tasks if any(row.task == task for row in rows)]
    labels = names_of(plan, rows)
    names = list(labels)
    figure, panels = pyplot.subplots(
        1, len(tasks), figsize=(1.6 + 1.75 * len(tasks), 0.9 + 0.34 * len(names)), sharey=True, squeeze=False,
        layout="constrained",
    )  # fmt: skip
    marks = ("o", "D", "s")
    for axes, task in zip(panels[0], tasks, strict=True):
        for row in rows:
            if row.task != task:
                continue
            for k, engine in enumerate(plan.evaluation.engines):
                if engine not in row.quantities:
                    continue
                told = row.quantities[engine]["success_rate"]
                place = names.index(row.name) + 0.24 * (k - 0.5 * (len(plan.evaluation.engines) - 1))
                if told.low is not None and told.high is not None:
                    axes.plot([100 * told.low, 100 * told.high], [place] * 2, color=colors[row.name], linewidth=1.6)
                face = colors[row.name] if k == 0 else "white"
                axes.plot(
                    [100 * told.value], [place], marks[k % 3], markersize=4.5, color=colors[row.name],
                    markerfacecolor=face,
                )  # fmt: skip
        axes.set(xlim=(-5, 105), xlabel="success [%]")
        axes.set_title(task.capitalize(), fontsize=10)
        axes.grid(axis="x", alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0][0].set_yticks(range(len(names)), [labels[name] for name in names], fontsize=8)
    panels[0][0].set_ylim(len(names) - 0.5, -0.5)
    handles = [
        Line2D([], [], color="#333333", marker=marks[k % 3], linestyle="", markersize=4.5,
                      markerfacecolor="#333333" if k == 0 else "white", label=engine)
        for k, engine in enumerate(plan.evaluation.engines)
    ]  # fmt: skip
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles), fontsize=8, frameon=False)
    figure.savefig(file, dpi=DPI)
    pyplot.close(figure)
    return file
