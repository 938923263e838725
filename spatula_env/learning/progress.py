"""The progress of training, shown on a terminal."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

LINE_EVERY = 20.0
"""Interval of progress lines if the output is not a terminal [s]."""


class ProgressView:
    """Shows a bar with success, cost and speed, and a line per evaluation; without a terminal, lines only."""

    def __init__(self, console: Console | None = None, *, quiet: bool = False) -> None:
        """Set up the view; shows nothing yet.

        Args:
            console: Console to write to.
            quiet: Whether to write nothing.
        """
        self.console = console or Console(quiet=quiet)
        self._progress: Progress | None = None
        self._shown = 0.0

    @contextmanager
    def run(self, title: str, total: int, done: int) -> Iterator[None]:
        """Show a progress bar in this context.

        Args:
            title: Title of the bar.
            total: Total number of steps.
            done: Number of steps done already.
        """
        columns = (
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            TextColumn("{task.completed:,.0f} of {task.total:,.0f} steps"),
            TextColumn("success {task.fields[success]}"),
            TextColumn("cost {task.fields[cost]}"),
            TextColumn("{task.fields[rate]} steps/s"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        self._start, self._first = time.perf_counter(), done
        with Progress(*columns, console=self.console, disable=not self.console.is_terminal) as progress:
            self._progress = progress
            self._task = progress.add_task(title, total=total, completed=done, success="-", cost="-", rate="-")
            yield
        self._progress = None

    def update(self, steps: int, success: float | None, cost: float | None) -> None:
        """Update the bar, at most ten times a second.

        Args:
            steps: Number of steps done.
            success: Success rate of the latest training episodes.
            cost: Their mean cost [s].
        """
        now = time.perf_counter()
        terminal = self.console.is_terminal
        if self._progress is None or now - self._shown < (0.1 if terminal else LINE_EVERY):
            return
        self._shown = now
        if not terminal:
            self.console.print(
                f"{steps:>10,} steps {now - self._start:7.1f} s  training: success"
                f" {'-' if success is None else f'{100 * success:.0f} %'},"
                f" {(steps - self._first) / max(now - self._start, 1e-9):,.0f} steps/s",
                highlight=False,
                soft_wrap=True,
            )
            return
        self._progress.update(
            self._task,
            completed=steps,
            success="-" if success is None else f"{100 * success:.0f} %",
            cost="-" if cost is None else f"{1e3 * cost:.0f} ms",
            rate=f"{(steps - self._first) / max(now - self._start, 1e-9):,.0f}",
        )

    def evaluated(self, line: dict[str, Any]) -> None:
        """Show the results of an evaluation."""
        training = line["training_success"]
        self.console.print(
            f"{line['step']:>10,} steps {line['seconds']:7.1f} s  success {100 * line['success_rate']:5.1f} %"
            f" (training {'-' if training is None else f'{100 * training:.0f} %'})"
            f"  return {line['return']:7.1f}  cost {1e3 * line['cost']:7.1f} ms"
            f"  violations {100 * line['violation_rate']:3.0f} %  {line['steps_per_second']:,.0f} steps/s",
            highlight=False,
            soft_wrap=True,
        )
