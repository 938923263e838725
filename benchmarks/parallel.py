"""Many independent runs over several processes, with the results as they come and a sign of progress."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

PLAIN_STEPS = 20
"""How often a plain counter says something."""


class WorkerDied(RuntimeError):
    """A process ended in the middle of its work, as it does when the physics engine crashes."""


def available_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def results(
    work: Callable[[Item], Result], items: Sequence[Item], workers: int, label: str
) -> Generator[tuple[Item, Result], None, None]:
    """Do some work for each item, show progress on standard error, and yield each result when it is there.

    Closing the iterator, as an exception in the loop around it does, gives up what has not begun.

    Args:
        work: What to do; a function that other processes can import.
        items: What to do it for.
        workers: Number of processes; with 1 the work is done in this one, in order.
        label: What to call the work.

    Yields:
        Each item with its result, in the order in which they become ready.

    Raises:
        ValueError: If `workers` is not positive.
        WorkerDied: If a process crashes; the message names the items that may have been the reason.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    with _progress(len(items), label) as advance:
        if workers == 1:
            for item in items:
                yield item, work(item)
                advance()
            return
        # Not forked: the kernels' threads would not survive that.
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_ignore_interrupts)
        waiting = list(reversed(items))
        running: dict[Future[Result], Item] = {}
        try:
            while waiting or running:
                # Only as much as keeps the processes busy: a crash then has few suspects.
                while waiting and len(running) < workers + 1:
                    item = waiting.pop()
                    running[pool.submit(work, item)] = item
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    result = future.result()
                    yield running.pop(future), result
                    advance()
        except BrokenProcessPool as error:
            raise WorkerDied(f"a process died while it worked on one of {list(running.values())}") from error
        finally:
            pool.shutdown(cancel_futures=True)


def _ignore_interrupts() -> None:
    """The first process is told too, and ends the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _progress(total: int, label: str) -> Iterator[Callable[[], None]]:
    """A progress bar where there is a terminal and Rich, a plain counter elsewhere; yields what advances it."""
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
