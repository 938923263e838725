"""Many independent runs in several processes, with results as they become ready and a sign of progress."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from typing import TypeVar

from spatula_env.processes import WorkerDied, available_cores, in_processes

__all__ = ["WorkerDied", "available_cores", "results"]

Item = TypeVar("Item")
Result = TypeVar("Result")

PLAIN_STEPS = 20
"""How often the plain counter prints something in all."""


def results(
    work: Callable[[Item], Result], items: Sequence[Item], workers: int, label: str
) -> Generator[tuple[Item, Result], None, None]:
    """Do some work for each item, show progress on standard error, and yield each result as soon as it is ready.

    Closing the iterator, as an exception in the loop around it does, ends the processes at once.

    Args:
        work: The function to call; other processes must be able to import it.
        items: Its arguments, one for each call.
        workers: Number of processes; with 1 the work is done in this process, in order.
        label: Name of the work, shown with the progress.

    Yields:
        Each item with its result, in the order in which they become ready.

    Raises:
        ValueError: If `workers` is not positive.
        WorkerDied: If a process crashes; the message names the item that may have caused it.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    with _progress(len(items), label) as advance:
        if workers == 1:
            for item in items:
                yield item, work(item)
                advance()
            return
        with closing(in_processes(work, items, workers)) as stream:
            for number, result in stream:
                yield items[number], result
                advance()


@contextmanager
def _progress(total: int, label: str) -> Iterator[Callable[[], None]]:
    """Show a progress bar, or a plain counter without Rich or a terminal; yields the function that advances it."""
    try:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
    except ImportError:
        with_bar = False
    else:
        with_bar = sys.stderr.isatty()
    if with_bar:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
            task = progress.add_task(label, total=total)
            yield lambda: progress.advance(task)
        return
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        if done * PLAIN_STEPS // total > (done - 1) * PLAIN_STEPS // total:
            print(f"{label}: {done} of {total}", file=sys.stderr, flush=True)

    yield advance
