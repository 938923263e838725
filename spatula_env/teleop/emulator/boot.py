"""The boot loader of an emulated Falcon.

It waits for a reset by DTR, then for a greeting at 9,600 baud, which it answers, and accepts the firmware at 142,857
baud once DTR is low again and an 'A' has been sent and echoed. It echoes every byte of the firmware. Any other data
that it receives before the upload spoils it: firmware loaded afterwards does not run until the device has been without
power. Real Falcons behave like this when the host looks for a running program before it loads one.
"""

from __future__ import annotations

from enum import Enum

from spatula_env.teleop.emulator.chip import LineSettings
from spatula_env.teleop.emulator.faults import Faults

GREETING = b"\x0a\x43\x0d"
ANSWER = b"\x0a\x44\x2c\x0d"
UPLOAD_REQUEST = b"A"
DIVISOR_GREETING = 0x4138
DIVISOR_UPLOAD = 0x0015


class Stage(Enum):
    """Progress of the boot loader."""

    WAITING_FOR_RESET = "waiting for reset"
    WAITING_FOR_GREETING = "waiting for greeting"
    GREETED = "greeted"
    LOADING = "loading"
    STARTED = "started"
    DEAD = "dead"


class BootLoader:
    """Receives firmware byte by byte.

    Attributes:
        stage: Progress so far.
        is_spoiled: Whether it has received data that it should not have.
    """

    def __init__(self, firmware: bytes, faults: Faults) -> None:
        """Power up.

        Args:
            firmware: The firmware that has to be loaded, compared byte by byte.
            faults: Failures to simulate.
        """
        self.stage = Stage.WAITING_FOR_RESET
        self.is_spoiled = False
        self._firmware = firmware
        self._faults = faults
        self._heard = b""

    def reset(self) -> None:
        """Handle a reset: DTR has gone from low to high."""
        self.stage = Stage.WAITING_FOR_GREETING
        self._heard = b""

    def receive(self, data: bytes, settings: LineSettings) -> bytes:
        """Receive bytes.

        Args:
            data: What was sent.
            settings: Settings of the line over which they were sent.

        Returns:
            The answer; empty if there is none.
        """
        if self.stage in (Stage.WAITING_FOR_GREETING, Stage.GREETED) and settings.divisor == DIVISOR_GREETING:
            return self._hear_greeting(data, settings)
        if self.stage is Stage.GREETED and settings.divisor == DIVISOR_UPLOAD:
            if data == UPLOAD_REQUEST and settings.is_terminal_ready is False and settings.is_readable:
                self.stage, self._heard = Stage.LOADING, b""
                return data
            return b""
        if self.stage is Stage.LOADING:
            return self._load(data, settings)
        self.is_spoiled = True
        return b""

    def _hear_greeting(self, data: bytes, settings: LineSettings) -> bytes:
        is_line_right = settings.is_readable and settings.requests_to_send is False and settings.is_terminal_ready
        if not is_line_right or data not in (GREETING, UPLOAD_REQUEST):
            self.is_spoiled = True
            return b""
        if data != GREETING:
            return b""
        if self._faults.ignored_greetings > 0:
            self._faults.ignored_greetings -= 1
            return b""
        self.stage = Stage.GREETED
        return (b"\x00" if self._faults.leading_zero else b"") + ANSWER

    def _load(self, data: bytes, settings: LineSettings) -> bytes:
        if settings.divisor != DIVISOR_UPLOAD or not settings.is_readable:
            return b""
        self._heard += data
        echo = bytearray(data)
        if self._faults.wrong_echoes > 0:
            self._faults.wrong_echoes -= 1
            echo[0] ^= 0x01
        if len(self._heard) >= len(self._firmware):
            is_right = self._heard == self._firmware and not self.is_spoiled and not self._faults.rejects_firmware
            self.stage = Stage.STARTED if is_right else Stage.DEAD
        return bytes(echo)
