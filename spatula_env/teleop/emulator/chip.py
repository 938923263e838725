"""The FTDI chip of an emulated Falcon: effects of control requests, and when received data are handed over.

After power-up no line setting is made, and wrong settings make the bytes on the line unreadable: a driver has to send
all the requests. The chip fills IN packets of 64 bytes, two of which are status bytes; it hands a packet over when it
is full, or with whatever it holds when the latency timer runs out. The timer restarts with every packet.
"""

from __future__ import annotations

from dataclasses import dataclass

PACKET = 64
STATUS = 2
MODEM_STATUS = 0x01
CLEAR_TO_SEND = 0x10
LINE_STATUS = 0x60
"""First and second status byte: fixed bits; the Falcon is clear to send; transmitter empty."""

BITS_PER_BYTE = 10
"""Start bit, eight data bits, stop bit."""

CLOCK = 3_000_000.0
"""Input frequency of the chip's baud rate divisors [Hz]."""


@dataclass(frozen=True)
class LineSettings:
    """Settings of the serial line; None for those that have not been made since power-up.

    Attributes:
        divisor: Raw baud rate value.
        data_format: Raw value; 8 is 8N1.
        flow_control: Raw value; 0 is none.
        is_terminal_ready: The DTR line.
        requests_to_send: The RTS line.
    """

    divisor: int | None = None
    data_format: int | None = None
    flow_control: int | None = None
    is_terminal_ready: bool | None = None
    requests_to_send: bool | None = None

    @property
    def is_readable(self) -> bool:
        """Whether a device that uses 8N1 without flow control can read the data, if the baud rate is right."""
        return self.data_format == 8 and self.flow_control == 0

    @property
    def byte_time(self) -> float:
        """Time that one byte takes on the line [s]."""
        if self.divisor is None:
            return BITS_PER_BYTE / 9600.0
        # Bits 14 and 15 encode eighths of the divisor: 0, 1/2, 1/4, 1/8. Divisors 0 and 1 are special cases.
        whole = self.divisor & 0x3FFF
        if whole == 0:
            return BITS_PER_BYTE / CLOCK
        fraction = (0.0, 0.5, 0.25, 0.125)[self.divisor >> 14 & 3]
        return BITS_PER_BYTE * (whole + fraction) / CLOCK


class RefusedRequest(ValueError):
    """A control request that the chip does not know."""


class FtdiChip:
    """The chip's registers and its buffer for data from the Falcon.

    Attributes:
        settings: Settings of the serial line.
        latency: Period of the latency timer [s].
        purges: Number of purges of each direction: received data, data to send.
    """

    def __init__(self, now: float, leftover: bytes = b"") -> None:
        """Power up.

        Args:
            now: The time [s].
            leftover: Content of the buffer, for a chip that has been used before.
        """
        self.settings = LineSettings()
        self.latency = 0.016
        self.purges = [0, 0]
        self._received = bytearray(leftover)
        self._last_packet = now

    def control(self, request_type: int, request: int, value: int, index: int) -> bool:
        """Execute a control request.

        Args:
            request_type: bmRequestType.
            request: bRequest.
            value: wValue.
            index: wIndex.

        Returns:
            Whether DTR has gone from low to high.

        Raises:
            RefusedRequest: If the chip does not know the request.
        """
        if request_type != 0x40 or index != 0:
            raise RefusedRequest(f"request type 0x{request_type:02x}, index {index}")
        old = self.settings
        ready, sending, divisor, data_format, flow = (
            old.is_terminal_ready,
            old.requests_to_send,
            old.divisor,
            old.data_format,
            old.flow_control,
        )
        if request == 0 and value in (1, 2):
            self.purges[value - 1] += 1
            if value == 1:
                self._received.clear()
        elif request == 0 and value == 0:
            self._received.clear()
        elif request == 1 and value & 0x0300:
            # The high byte selects the lines to change, the low byte holds their new values.
            ready = bool(value & 0x01) if value & 0x0100 else ready
            sending = bool(value & 0x02) if value & 0x0200 else sending
        elif request == 2:
            flow = value
        elif request == 3:
            divisor = value
        elif request == 4:
            data_format = value
        elif request == 9 and 1 <= value <= 255:
            self.latency = value / 1000.0
        else:
            raise RefusedRequest(f"request {request}, value 0x{value:04x}")
        self.settings = LineSettings(divisor, data_format, flow, ready, sending)
        return old.is_terminal_ready is False and ready is True

    def receive(self, data: bytes) -> None:
        """Receive bytes from the Falcon.

        Args:
            data: The bytes.
        """
        self._received += data

    def ready_at(self, now: float) -> float:
        """Time at which the next IN packet can be taken, if the Falcon sends nothing more.

        Args:
            now: The time [s].

        Returns:
            The time, not before `now` [s].
        """
        if len(self._received) >= PACKET - STATUS:
            return now
        return max(now, self._last_packet + self.latency)

    def take_packet(self, now: float) -> bytes:
        """Hand over an IN packet.

        Args:
            now: The time [s].

        Returns:
            Two status bytes and at most 62 others.
        """
        data = bytes(self._received[: PACKET - STATUS])
        del self._received[: PACKET - STATUS]
        self._last_packet = now
        return bytes((MODEM_STATUS | CLEAR_TO_SEND, LINE_STATUS)) + data
