"""Independent work in other processes, which end at once when the process that has started them ends.

`concurrent.futures` waits for the items that its processes are working on, whatever has happened: an interrupted
command would run on until the longest of them is done.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from types import FrameType
from typing import Any, Generic, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

PATIENCE = 0.5
"""Time that a process is given to end before it is killed [s]."""


class WorkerDied(RuntimeError):
    """A process ended in the middle of its work, as it does when the physics engine crashes."""


class WorkerFailed(RuntimeError):
    """The traceback of an exception in another process; it is the cause from which the exception itself is raised."""


def available_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_processes(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    workers: int,
    prepare: Callable[[], None] | None = None,
) -> Generator[tuple[int, Result], None, None]:
    """Apply a function to each item in other processes, and yield each result when it is ready.

    Closing the iterator, as an exception in the loop around it does, ends the processes at once.

    Args:
        work: The function; it is pickled, and so are the items and the results.
        items: Its arguments; they are begun in this order.
        workers: Number of processes; no more are started than there are items.
        prepare: Function that each process calls first.

    Yields:
        The index of an item and its result, in the order in which results become ready.

    Raises:
        ValueError: If `workers` is not positive.
        WorkerDied: If a process ends before its work does; the message says which item it was working on.
        Exception: Whatever `work` raises.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    team: list[_Worker[Item, Result]] = []
    try:
        with _interrupts_held():
            team += [_Worker(work, prepare) for _ in range(min(workers, len(items)))]
        waiting = iter(enumerate(items))
        busy = {worker.pipe: worker for worker in team if worker.give(waiting)}
        while busy:
            for pipe in wait(list(busy)):
                assert isinstance(pipe, Connection)
                worker = busy[pipe]
                number, result = worker.take()
                if not worker.give(waiting):
                    del busy[pipe]
                yield number, result
        for worker in team:
            worker.dismiss()
        for worker in team:
            worker.process.join(PATIENCE)
    finally:
        _end(team)


class _Worker(Generic[Item, Result]):
    """A worker process, as seen from the process that has started it."""

    def __init__(self, work: Callable[[Item], Result], prepare: Callable[[], None] | None) -> None:
        # Not forked: the kernels' threads would not survive that.
        context = multiprocessing.get_context("spawn")
        self.pipe, far = context.Pipe()
        self.process: SpawnProcess = context.Process(target=_serve, args=(far, work, prepare), daemon=True)
        self.process.start()
        # Closed here, so that this end is notified when the process closes the other one.
        far.close()
        self._item: tuple[int, Item] | None = None

    def give(self, waiting: Iterator[tuple[int, Item]]) -> bool:
        """Give the next item, if there is one."""
        self._item = next(waiting, None)
        if self._item is not None:
            try:
                self.pipe.send(self._item)
            except (BrokenPipeError, ConnectionResetError):
                raise self._death() from None
        return self._item is not None

    def take(self) -> tuple[int, Result]:
        """Receive the result of the current item, with the item's index."""
        assert self._item is not None
        try:
            failed, answer = self.pipe.recv()
        except (EOFError, ConnectionResetError):
            raise self._death() from None
        if failed:
            error, told = answer
            raise error from WorkerFailed(told)
        return self._item[0], answer

    def dismiss(self) -> None:
        """Tell the process that there is nothing left to do."""
        try:
            self.pipe.send(None)
        except OSError:
            # It has ended already.
            return

    def _death(self) -> WorkerDied:
        self.process.join(PATIENCE)
        item = None if self._item is None else self._item[1]
        return WorkerDied(f"a process ended, with the exit status {self.process.exitcode}, while it worked on {item}")


def _end(team: Sequence[_Worker[Any, Any]]) -> None:
    """End processes, even those that are still working."""
    for worker in team:
        worker.pipe.close()
        worker.process.terminate()
    for worker in team:
        worker.process.join(PATIENCE)
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()
        worker.process.close()


def _serve(pipe: Connection, work: Callable[[Any], Any], prepare: Callable[[], None] | None) -> None:
    """Run in a worker process: receive items and send results until there are no more."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if prepare is not None:
        prepare()
    while True:
        try:
            given = pipe.recv()
        except EOFError:
            return
        if given is None:
            return
        try:
            answer = (False, work(given[1]))
        except Exception as error:
            answer = (True, (_sendable(error), f"\n{traceback.format_exc()}"))
        try:
            pipe.send(answer)
        except OSError:
            # The other end is closed: nobody waits for the result any more.
            return


def _sendable(error: Exception) -> Exception:
    """The exception if it can be pickled, for sending it to another process; else a RuntimeError with its text."""
    import pickle

    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def _end_with_parent() -> None:
    """End this process when the one that waits for its results has ended, for whatever reason."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Defer interrupts until the processes in the block are started, with interrupts blocked.

    Ctrl-C goes to all processes of a terminal's group. Only the first one should report it; it ends the others. A
    process that is interrupted while it starts prints errors about data that it has not received.
    """
    came: list[tuple[int, FrameType | None]] = []
    here = threading.current_thread() is threading.main_thread()
    # Another thread may receive a signal that this one blocks; Python still runs the handler in this, the main thread.
    handler = signal.signal(signal.SIGINT, lambda *arguments: came.append(arguments)) if here else None
    try:
        with _interrupts_blocked():
            yield
    finally:
        if here:
            signal.signal(signal.SIGINT, handler)
        if came and callable(handler):
            handler(*came[0])


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block interrupts in this thread and in the processes that it starts."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Started first, because starting the resource tracker unblocks interrupts in this thread.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
