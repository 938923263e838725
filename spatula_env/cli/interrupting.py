"""Signals that end a command: Ctrl-C, and what the system sends before it ends a program."""

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
        status: The exit status that tells so.
    """

    def __init__(self, number: int) -> None:
        """End by a signal.

        Args:
            number: Of the signal.
        """
        super().__init__(f"ended by {signal.Signals(number).name}")
        self.status = 128 + number


@contextmanager
def endings_like_ctrl_c() -> Iterator[None]:
    """For as long as a ``with`` block lasts, whatever ends the program ends it like Ctrl-C, which loses nothing.

    What is being ignored stays ignored, so that ``nohup`` does what it is for. Threads are not told, only the main one.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before: dict[int, Any] = {}

    def end(number: int, _: Any) -> None:
        # Once: what is saved now is not to be interrupted by the next one.
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
