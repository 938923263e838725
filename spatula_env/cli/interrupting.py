"""Signals that end a command: Ctrl-C, and those that the system sends before it ends a program."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

ENDINGS = ("SIGTERM", "SIGHUP", "SIGBREAK")
"""Signals that mean the same as Ctrl-C, where the system has them: the end of a session or of a terminal, `kill`, and a
console that is closed."""


class Terminated(KeyboardInterrupt):
    """The system has ended the command.

    Attributes:
        status: The exit status, 128 plus the number of the signal.
    """

    def __init__(self, number: int) -> None:
        """Create the exception for a signal.

        Args:
            number: Number of the signal.
        """
        super().__init__(f"ended by {signal.Signals(number).name}")
        self.status = 128 + number


@contextmanager
def endings_like_ctrl_c() -> Iterator[None]:
    """Make signals that end the program act like Ctrl-C during a ``with`` block, so that nothing is lost.

    Signals that are ignored stay ignored, so that ``nohup`` works. Only the main thread can handle signals; in other
    threads this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before: dict[int, Any] = {}

    def end(number: int, _: Any) -> None:
        # Only once: further signals must not interrupt the saving that follows.
        for each in before:
            signal.signal(each, signal.SIG_IGN)
        raise Terminated(number)

    for name in ENDINGS:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            before[number] = signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
