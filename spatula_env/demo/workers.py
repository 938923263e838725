"""Running things in other processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

from spatula_env.demo.press import PressCase, PressResult, run_press
from spatula_env.engines import bullet_is_there

Result = TypeVar("Result")


@contextmanager
def start_workers(count: int = 2) -> Iterator[ProcessPoolExecutor]:
    """A pool of processes; what has not begun when the block is left by an exception is dropped.

    Args:
        count: How many, at most as many as there are processors.
    """
    pool = ProcessPoolExecutor(
        max_workers=max(1, min(count, os.cpu_count() or 1)),
        # Forking a process that has started threads is not safe, and Numba and the progress bar do start some.
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_prepare_worker,
    )
    try:
        yield pool
    except BaseException:
        # What is in the middle of something would keep this process from its end.
        running = list((pool._processes or {}).values())
        pool.shutdown(wait=False, cancel_futures=True)
        for process in running:
            process.terminate()
        raise
    pool.shutdown()


def submit_cases(
    pool: ProcessPoolExecutor, cases: Sequence[PressCase], on_done: Callable[[PressCase], None]
) -> list[Future[PressResult]]:
    """Start a comparison.

    Args:
        pool: Where to run it.
        cases: What to run.
        on_done: Called for each case that has ended, in any order and from another thread.

    Returns:
        The results to come, in the order of the cases.
    """
    futures: dict[int, Future[PressResult]] = {}
    # The longest first, or one process would be left with it at the end.
    for index in sorted(range(len(cases)), key=lambda index: -cases[index].expected_steps):
        future = pool.submit(run_press, cases[index])
        future.add_done_callback(_tell(on_done, cases[index]))
        futures[index] = future
    return [futures[index] for index in range(len(cases))]


def _tell(on_done: Callable[[PressCase], None], case: PressCase) -> Callable[[Future[PressResult]], None]:
    """What a future calls when a case has ended."""
    return lambda _: on_done(case)


def _prepare_worker() -> None:
    """Let an interrupt end the worker at once, without a traceback, and load the engine."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    # PyBullet greets on the terminal when it is imported, in the middle of a progress bar.
    kept = [os.dup(number) for number in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for number in (1, 2):
            os.dup2(nowhere, number)
        bullet_is_there()
    finally:
        for number, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, number)
            os.close(copy)
        os.close(nowhere)
