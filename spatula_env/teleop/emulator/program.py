"""The program of an emulated Falcon once its firmware is loaded: packets in, packets out, homing.

Written from the description of the bytes, independently of the driver's protocol module.
"""

from __future__ import annotations

import struct

from spatula_env.teleop.emulator.chip import LineSettings
from spatula_env.teleop.emulator.faults import Faults

DIVISOR = 0x0002
"""Baud rate divisor for 1.5 MBaud."""

HOMING_OUT = 55.0
HOMING_IN = 5.0
"""A thigh is homed when its angle has exceeded the first value and then fallen below the second [deg].

Assumed values: it is only known that the operator has to pull the grip all the way out and push it all the way in.
"""

TO_HEXADECIMAL = bytes(b"0123456789abcdef"[letter - 65] if 65 <= letter < 81 else 63 for letter in range(256))
"""Maps each byte of a number to its hexadecimal digit, or to '?' if it is none."""
TO_LETTERS = bytes.maketrans(b"0123456789abcdef", b"ABCDEFGHIJKLMNOP")

Counts = tuple[int, int, int]


class Program:
    """The device's side of the 16-byte packets.

    Attributes:
        motors: Motor counts, clipped to what the motors can do.
        lights: The light bits: 2 green, 4 blue, 8 red.
        buttons: The button bits: 1 plus, 2 forward, 4 centre, 8 minus.
        homed: For each leg, whether its encoder counts from its true zero.
        packets: Number of packets understood so far.
        is_homing: Whether the last packet asked for homing.
        demanded: Motor counts of the last packet before clipping.
    """

    def __init__(self, faults: Faults, homed: bool = False) -> None:
        """Start the program.

        Args:
            faults: Failures to simulate.
            homed: Whether the encoders have found their zeros already.
        """
        self.motors: Counts = (0, 0, 0)
        self.demanded: Counts = (0, 0, 0)
        self.lights = 0
        self.buttons = 0
        self.homed = [homed] * 3
        self.packets = 0
        self.is_homing = False
        self._faults = faults
        self._has_been_out = [False] * 3
        self._first_counts: Counts | None = None
        self._buffer = b""

    def receive(self, data: bytes, settings: LineSettings, angles: tuple[float, ...], counts: Counts) -> bytes:
        """Receive bytes.

        Args:
            data: What was sent.
            settings: Settings of the line over which they were sent.
            angles: Angles of the thighs [deg].
            counts: Encoder counts relative to the true zeros.

        Returns:
            The answer: one packet for each packet received.
        """
        if settings.divisor != DIVISOR or not settings.is_readable:
            return b""
        self._buffer += data
        answer = b""
        while len(self._buffer) >= 16:
            if self._buffer[:1] != b"<" or self._buffer[15:16] != b">":
                self._buffer = self._buffer[1:]
                continue
            packet, self._buffer = self._buffer[:16], self._buffer[16:]
            answer += self._answer(packet, angles, counts)
        return answer

    def _answer(self, packet: bytes, angles: tuple[float, ...], counts: Counts) -> bytes:
        digits = packet[12:0:-1].translate(TO_HEXADECIMAL)
        if b"?" in digits:
            return b""
        self.packets += 1
        # The digits are reversed, so that the most significant come first; the third motor comes first, too.
        third, second, first = struct.unpack(">hhh", bytes.fromhex(digits.decode("ascii")))
        limit = self._faults.motor_limit
        self.demanded = (first, second, third)
        self.motors = (_cut(first, limit), _cut(second, limit), _cut(third, limit))
        command = packet[13] - ord("A")
        self.is_homing = bool(command & 1)
        self.lights = command & 0x0E
        self._home(angles)
        if self._first_counts is None:
            self._first_counts = counts
        return self._reply(counts)

    def _home(self, angles: tuple[float, ...]) -> None:
        for leg, angle in enumerate(angles):
            if not self.is_homing:
                # If homing is switched off, it has to start again.
                self._has_been_out[leg] = False
            elif angle > HOMING_OUT:
                self._has_been_out[leg] = True
            elif angle < HOMING_IN and self._has_been_out[leg]:
                self.homed[leg] = True

    def _reply(self, counts: Counts) -> bytes:
        if self._faults.is_silent:
            return b""
        assert self._first_counts is not None
        reply = b"<"
        status = self.buttons
        for leg, homed in enumerate(self.homed):
            # Until a leg is homed, its encoder counts from its position when the first packet arrived.
            count = counts[leg] - (0 if homed else self._first_counts[leg])
            reply += (b"%04x" % (count & 0xFFFF))[::-1].translate(TO_LETTERS)
            status += 16 * 2**leg if homed else 0
        return reply + bytes((ord("A") + status,)) + b"A>"


def _cut(count: int, limit: int) -> int:
    return max(-limit, min(limit, count))
