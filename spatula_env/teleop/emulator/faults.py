"""Failures of a Falcon that tests can switch on."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass

Mangle = Callable[[bytes], bytes]
"""Takes a reply and returns the bytes that arrive after transmission."""


@dataclass
class Faults:
    """Faults of an emulated Falcon; may be changed at any time. To unplug it, call `FalconEmulator.unplug`.

    Attributes:
        mangle: Applied to every reply on its way to the chip.
        reply_delay: Delay of replies [s].
        is_silent: Whether packets are left unanswered, as without power.
        motor_limit: Greatest motor count; larger ones are clipped, each motor separately.
        ignored_greetings: Number of greetings that the boot loader misses.
        wrong_echoes: Number of firmware chunks that are echoed wrongly.
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
    """Cut replies off after some bytes.

    Args:
        length: Number of bytes that arrive.

    Returns:
        The fault.
    """
    return lambda reply: reply[:length]


def lose_bytes(start: int, count: int) -> Mangle:
    """Lose bytes in the middle of replies, so that the rest is shifted.

    Args:
        start: Index of the first byte that is lost.
        count: Number of bytes that are lost.

    Returns:
        The fault.
    """
    return lambda reply: reply[:start] + reply[start + count :]


def with_garbage(seed: int, most: int = 20) -> Mangle:
    """Put random bytes in front of replies.

    Args:
        seed: Seed of the random numbers.
        most: Greatest number of random bytes.

    Returns:
        The fault.
    """
    generator = random.Random(seed)

    def mangle(reply: bytes) -> bytes:
        return generator.randbytes(generator.randint(0, most)) + reply

    return mangle
