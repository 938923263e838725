"""The FTDI chip between USB and the Falcon's serial line: raw control requests and status bytes.

The numbers are those of FTDI's own protocol, as libnifalcon uses them on the Falcon. Raw values are sent because two of
the baud rates are not what a general FTDI library would ask for: to load firmware, the Falcon needs divisor 0x0015
(3 MHz / 21 = 142,857 baud), where libraries choose a finer one.
"""

from __future__ import annotations

from typing import Protocol

VENDOR_ID = 0x0403
PRODUCT_ID = 0xCB48

ENDPOINT_OUT = 0x02
ENDPOINT_IN = 0x81
PACKET_SIZE = 64
"""Size of the largest IN packet, status included [bytes]."""
STATUS_SIZE = 2
"""Every IN packet, even one without data, starts with the modem status and the line status."""

REQUEST_TYPE = 0x40
"""bmRequestType: host to device, vendor, device."""

RESET = 0
SET_MODEM_CONTROL = 1
SET_FLOW_CONTROL = 2
SET_BAUD_RATE = 3
SET_DATA_FORMAT = 4
SET_LATENCY_TIMER = 9

PURGE_RECEIVED = 1
"""Values of `RESET`: discard what has arrived from the device …"""
PURGE_TO_SEND = 2
"""… and what has not been sent to it yet."""

DTR_HIGH = 0x0101
DTR_LOW = 0x0100
RTS_LOW = 0x0200
NO_FLOW_CONTROL = 0
EIGHT_BITS_NO_PARITY = 8
"""8 data bits, no parity, 1 stop bit."""

BAUD_BOOT = 0x4138
"""9,600 baud."""
BAUD_UPLOAD = 0x0015
"""142,857 baud."""
BAUD_NORMAL = 0x0002
"""1,500,000 baud."""

LATENCY_BOOT = 16
"""How long the chip waits for more data before it sends a packet that is not full [ms]."""
LATENCY_NORMAL = 1


class ControlTransfers(Protocol):
    """A connection that can make control transfers without data."""

    def control_transfer(self, request_type: int, request: int, value: int, index: int) -> None:
        """Make a control transfer with the given bmRequestType, bRequest, wValue and wIndex."""


def request(transport: ControlTransfers, number: int, value: int) -> None:
    """Send a control request to the chip.

    Args:
        transport: The connection.
        number: Number of the request.
        value: Its value.

    Raises:
        DeviceLost: If the device is not there any more.
    """
    transport.control_transfer(REQUEST_TYPE, number, value, 0)


def purge(transport: ControlTransfers) -> None:
    """Discard all data in transit in both directions.

    Args:
        transport: The connection.

    Raises:
        DeviceLost: If the device is not there any more.
    """
    request(transport, RESET, PURGE_RECEIVED)
    request(transport, RESET, PURGE_TO_SEND)


def strip_status(received: bytes) -> bytes:
    """Remove the status bytes from the result of a bulk read.

    Args:
        received: One or several IN packets; all but the last are full.

    Returns:
        The bytes that the Falcon sent.
    """
    if len(received) <= PACKET_SIZE:
        return received[STATUS_SIZE:]
    return b"".join(
        received[start + STATUS_SIZE : start + PACKET_SIZE] for start in range(0, len(received), PACKET_SIZE)
    )
