"""Loading the Falcon's firmware.

The Falcon loses its program when it loses power, so the host has to load it. The firmware belongs to the vendor and
is under the vendor's licence, so this package does not include it: the user names a file.

Before firmware is loaded, nothing may be sent to the Falcon to find out whether it already runs: a Falcon that was
asked misbehaves with the firmware it gets afterwards. Hence a user who names a file wants it loaded, and a user who
names none states that it is loaded already (:mod:`spatula_env.teleop.falcon.driver`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from spatula_env.teleop.device import DeviceError, FirmwareError
from spatula_env.teleop.falcon import ftdi
from spatula_env.teleop.falcon.transport import Transport

HELLO = bytes((0x0A, 0x43, 0x0D))
HELLO_ANSWER = bytes((0x0A, 0x44, 0x2C, 0x0D))
HELLO_TRIES = 100
"""Number of times that the boot loader is greeted; it is known to miss greetings."""
START_UPLOAD = b"A"

CHUNK_SIZE = 62
"""Number of bytes written at a time, so that their echo fits into one IN packet."""
UPLOAD_TRIES = 10
"""Number of times that the whole procedure is tried."""

ANSWER_TIMEOUT = 0.05
"""Time to wait for an answer to a greeting [s]."""
ECHO_TIMEOUT = 0.5
"""Time to wait for the echo of a chunk [s]."""
WRITE_TIMEOUT = 1.0
"""Longest time that a write may take [s]."""

SMALLEST = 1_000
LARGEST = 65_536
"""Files outside these sizes are not a Falcon's firmware; known firmware has 7 to 9 kB [bytes]."""

Clock = Callable[[], float]
UploadProgress = Callable[[int, int], None]
"""Takes the number of bytes loaded so far and the total number."""


def read_firmware(path: str | Path) -> bytes:
    """Read a firmware file.

    Args:
        path: The file.

    Returns:
        Its bytes.

    Raises:
        FirmwareError: If it cannot be read, or cannot be a Falcon's firmware.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise FirmwareError(f"cannot read the firmware file {str(path)!r}: {error.strerror or error}") from error
    if not SMALLEST <= len(content) <= LARGEST:
        raise FirmwareError(
            f"{str(path)!r} has {len(content)} bytes, a Falcon's firmware has between {SMALLEST} and {LARGEST}"
        )
    return content


def upload(
    transport: Transport,
    firmware: bytes,
    clock: Clock,
    progress: UploadProgress | None = None,
    tries: int = UPLOAD_TRIES,
) -> int:
    """Load firmware into a Falcon and check every byte by its echo.

    Args:
        transport: The connection.
        firmware: The firmware to load.
        clock: Returns the time by which `transport` waits [s].
        progress: Called after each chunk.
        tries: Greatest number of attempts.

    Returns:
        The number of attempts it took.

    Raises:
        FirmwareError: If no attempt succeeded; the message gives the reason of the last one.
        DeviceLost: If the device is not there any more.
    """
    reason = "no try was made"
    for attempt in range(1, tries + 1):
        try:
            _try_upload(transport, firmware, clock, progress)
        except _TryFailed as failure:
            reason = str(failure)
        else:
            return attempt
    raise FirmwareError(
        f"the firmware could not be loaded into the {transport.name} in {tries} tries: {reason}. Take the Falcon off "
        "its power supply and the USB for a few seconds, then try again"
    )


def enter_normal_mode(transport: Transport) -> None:
    """Set the line up for packets: 1.5 MBaud, and IN packets every millisecond.

    The data terminal ready line keeps its state because it resets the Falcon.

    Args:
        transport: The connection.

    Raises:
        DeviceLost: If the device is not there any more.
    """
    ftdi.request(transport, ftdi.SET_LATENCY_TIMER, ftdi.LATENCY_NORMAL)
    ftdi.request(transport, ftdi.SET_DATA_FORMAT, ftdi.EIGHT_BITS_NO_PARITY)
    ftdi.request(transport, ftdi.SET_FLOW_CONTROL, ftdi.NO_FLOW_CONTROL)
    ftdi.request(transport, ftdi.SET_BAUD_RATE, ftdi.BAUD_NORMAL)
    ftdi.purge(transport)


class _TryFailed(DeviceError):
    """One attempt of several failed."""


def _try_upload(transport: Transport, firmware: bytes, clock: Clock, progress: UploadProgress | None) -> None:
    ftdi.purge(transport)
    ftdi.request(transport, ftdi.SET_LATENCY_TIMER, ftdi.LATENCY_BOOT)
    ftdi.request(transport, ftdi.SET_BAUD_RATE, ftdi.BAUD_BOOT)
    ftdi.request(transport, ftdi.SET_DATA_FORMAT, ftdi.EIGHT_BITS_NO_PARITY)
    ftdi.request(transport, ftdi.SET_FLOW_CONTROL, ftdi.NO_FLOW_CONTROL)
    ftdi.request(transport, ftdi.SET_MODEM_CONTROL, ftdi.RTS_LOW)
    ftdi.request(transport, ftdi.SET_MODEM_CONTROL, ftdi.DTR_LOW)
    ftdi.request(transport, ftdi.SET_MODEM_CONTROL, ftdi.DTR_HIGH)

    for _ in range(HELLO_TRIES):
        _write(transport, HELLO)
        # The answer may be preceded by a zero or by the rest of an earlier answer.
        if HELLO_ANSWER in _read(transport, clock, ANSWER_TIMEOUT, lambda heard: HELLO_ANSWER in heard):
            break
    else:
        raise _TryFailed(f"the boot loader did not answer {HELLO_TRIES} greetings")

    ftdi.request(transport, ftdi.SET_MODEM_CONTROL, ftdi.DTR_LOW)
    ftdi.request(transport, ftdi.SET_BAUD_RATE, ftdi.BAUD_UPLOAD)
    _write(transport, START_UPLOAD)
    answer = _read(transport, clock, ECHO_TIMEOUT, partial(_is_at_least, len(START_UPLOAD)))
    if answer != START_UPLOAD:
        raise _TryFailed(f"the boot loader was not ready for the firmware (it sent {answer.hex(' ') or 'nothing'})")

    for start in range(0, len(firmware), CHUNK_SIZE):
        chunk = firmware[start : start + CHUNK_SIZE]
        _write(transport, chunk)
        echo = _read(transport, clock, ECHO_TIMEOUT, partial(_is_at_least, len(chunk)))
        if echo != chunk:
            raise _TryFailed(f"the echo of bytes {start} to {start + len(chunk) - 1} was wrong or late")
        if progress is not None:
            progress(start + len(chunk), len(firmware))


def _write(transport: Transport, data: bytes) -> None:
    written = transport.bulk_write(data, WRITE_TIMEOUT)
    if written != len(data):
        raise _TryFailed(f"the Falcon took {written} of {len(data)} bytes")


def _is_at_least(size: int, heard: bytes) -> bool:
    return len(heard) >= size


def _read(transport: Transport, clock: Clock, timeout: float, is_enough: Callable[[bytes], bool]) -> bytes:
    """Read until `is_enough` accepts the data or the time is over."""
    heard = b""
    deadline = clock() + timeout
    while not is_enough(heard):
        left = deadline - clock()
        if left <= 0.0:
            break
        heard += ftdi.strip_status(transport.bulk_read(ftdi.PACKET_SIZE, left))
    return heard
