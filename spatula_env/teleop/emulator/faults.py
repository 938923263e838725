"""What can go wrong with a Falcon, for tests to switch on."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass

Mangle = Callable[[bytes], bytes]
"""Takes a reply and returns what comes of it on its way."""


@dataclass
class Faults:
    """Faults of an emulated Falcon; change them at any time. Unplugging is a method of the emulator.

    Attributes:
        mangle: What happens to every reply on its way to the chip.
        reply_delay: By how much replies are late [s].
        is_silent: Whether packets are not answered at all, as without power.
        motor_limit: The strongest motor count; stronger ones are cut, each on its own.
        ignored_greetings: So many greetings the boot loader overhears.
        wrong_echoes: So many bytes of firmware are echoed wrongly.
        leading_zero: Whether a zero byte precedes the boot loader's answer.
        rejects_firmware: Whether loaded firmware does not start.
    """

    mangle: Mangle | None = None
    reply_delay: float = 0.0
    is_silent: bool = False
    motor_limit: int = 4095
    ignored_greetings: int = 0
    wrong_echoes: int = 0
    leading_zero: bool = False
    rejects_firmware: bool = False


def cut_short(length: int) -> Mangle:
    """Replies that break off.

    Args:
        length: Bytes that arrive.

    Returns:
        The fault.
    """
    return lambda reply: reply[:length]


def lose_bytes(start: int, count: int) -> Mangle:
    """Replies out of whose middle bytes are lost, so that the rest is shifted.

    Args:
        start: The first byte that is lost.
        count: How many are.

    Returns:
        The fault.
    """
    return lambda reply: reply[:start] + reply[start + count :]


def with_garbage(seed: int, most: int = 20) -> Mangle:
    """Replies with random bytes in front of them.

    Args:
        seed: Of the random numbers.
        most: How many bytes at most.

    Returns:
        The fault.
    """
    generator = random.Random(seed)

    def mangle(reply: bytes) -> bytes:
        return generator.randbytes(generator.randint(0, most)) + reply

    return mangle
