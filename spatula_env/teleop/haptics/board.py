"""A lock-free message board in shared memory: one process leaves its newest message for another.

The reader must never wait for the writer: a process that is suspended while it writes would hold up the haptic loop. So
each message carries a checksum; a reader that finds a torn message tries again, and otherwise keeps the last valid one.
Unlike sequence counters, this makes no assumption about the processor's memory ordering.
"""

from __future__ import annotations

import struct
import zlib
from multiprocessing.shared_memory import SharedMemory
from typing import Any

TRIES = 8
"""Number of times that a reader retries a torn message."""
_CHECKSUM = struct.Struct("=I")


class Board:
    """Shared memory for one message. One process writes, any number read.

    Attributes:
        name: Name by which other processes open the board.
    """

    def __init__(self, layout: str, name: str | None = None) -> None:
        """Create a board, or open one.

        Args:
            layout: Format of a message, as for `struct`.
            name: Name of an existing board; None creates one, which `close` then removes.
        """
        self._layout = struct.Struct("=" + layout)
        size = self._layout.size + _CHECKSUM.size
        self._owner = name is None
        self._memory = SharedMemory(name=name, create=self._owner, size=size)
        self.name = self._memory.name
        self._last: tuple[Any, ...] | None = None

    def write(self, *values: Any) -> None:
        """Replace the message."""
        message = self._layout.pack(*values)
        self._buffer()[: len(message) + _CHECKSUM.size] = message + _CHECKSUM.pack(_checksum(message))

    def read(self) -> tuple[Any, ...] | None:
        """The newest complete message; None before the first."""
        size = self._layout.size
        for _ in range(TRIES):
            raw = bytes(self._buffer()[: size + _CHECKSUM.size])
            if _checksum(raw[:size]) == _CHECKSUM.unpack_from(raw, size)[0]:
                self._last = self._layout.unpack_from(raw)
                break
        return self._last

    def _buffer(self) -> memoryview:
        buffer = self._memory.buf
        if buffer is None:
            raise ValueError("this board is closed")
        return buffer

    def close(self) -> None:
        """Release the memory; the process that created it also removes it. Closing twice is allowed."""
        self._memory.close()
        if self._owner:
            self._owner = False
            self._memory.unlink()


def _checksum(message: bytes) -> int:
    # Modified, so that the zeros of a new board do not pass for a message.
    return zlib.crc32(message) ^ 0x5EED
