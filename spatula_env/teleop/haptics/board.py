"""A message that one process leaves for another, the newest only, without a lock.

Whoever reads must never wait for whoever writes: a process that is stopped in the middle of writing would hold up the
haptic loop. So a message carries a checksum, and a reader that finds a torn one looks again and else keeps the one it
had. That needs nothing of the processor's memory order, unlike sequence counters.
"""

from __future__ import annotations

import struct
import zlib
from multiprocessing.shared_memory import SharedMemory
from typing import Any

TRIES = 8
"""How often a reader looks at a torn message."""
_CHECKSUM = struct.Struct("=I")


class Board:
    """Place for one message in shared memory. One process writes, any number read.

    Attributes:
        name: By which other processes find it.
    """

    def __init__(self, layout: str, name: str | None = None) -> None:
        """Make a board, or find one.

        Args:
            layout: What a message holds, as for `struct`.
            name: Of a board that exists; None makes one, which ends with `close`.
        """
        self._layout = struct.Struct("=" + layout)
        size = self._layout.size + _CHECKSUM.size
        self._owner = name is None
        self._memory = SharedMemory(name=name, create=self._owner, size=size)
        self.name = self._memory.name
        self._last: tuple[Any, ...] | None = None

    def write(self, *values: Any) -> None:
        """Leave a message in the place of the last one."""
        message = self._layout.pack(*values)
        self._buffer()[: len(message) + _CHECKSUM.size] = message + _CHECKSUM.pack(_checksum(message))

    def read(self) -> tuple[Any, ...] | None:
        """The newest whole message; None before the first."""
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
        """Let go of the memory; its maker also frees it. Closing twice is allowed."""
        self._memory.close()
        if self._owner:
            self._owner = False
            self._memory.unlink()


def _checksum(message: bytes) -> int:
    # Not that of an empty board, whose zeros must not pass for a message.
    return zlib.crc32(message) ^ 0x5EED
