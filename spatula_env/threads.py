"""Distribution of independent pieces of work over threads."""

from __future__ import annotations

import threading
from collections.abc import Callable


def share_out(work: Callable[[int], None], count: int, threads: int) -> None:
    """Do `work(0)` to `work(count - 1)`, each once, on some threads; for work that releases the interpreter's lock.

    Threads are started for this call and have ended when it returns, so that the process can be forked afterwards.

    Args:
        work: The function to call; pieces must not depend on each other.
        count: Number of pieces.
        threads: Number of threads, including this one.

    Raises:
        BaseException: What the first piece that failed raised, after all threads have ended; some pieces may not have
            been begun.
    """
    pieces = iter(range(count))
    lock = threading.Lock()
    errors: list[BaseException] = []

    def take() -> int | None:
        with lock:
            return None if errors else next(pieces, None)

    def run() -> None:
        try:
            while (piece := take()) is not None:
                work(piece)
        except BaseException as error:
            errors.append(error)

    helpers = [threading.Thread(target=run, daemon=True) for _ in range(min(threads, count) - 1)]
    for helper in helpers:
        helper.start()
    run()
    for helper in helpers:
        helper.join()
    if errors:
        raise errors[0]
