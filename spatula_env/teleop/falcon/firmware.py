"""Loading the Falcon's firmware.

The Falcon forgets its program when it loses power; the host has to load it. The firmware is the vendor's and comes
under the vendor's licence, so none comes with this package: the user names a file.

Nothing may be sent to the Falcon to find out whether it has its firmware already before firmware is loaded: a Falcon
that was asked so misbehaves with the firmware it gets afterwards. Hence whoever gives a file wants it loaded, and
whoever gives none says that it is loaded (:mod:`spatula_env.teleop.falcon.driver`).
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
"""How often the boot loader is greeted; it is known to be hard of hearing."""
START_UPLOAD = b"A"

CHUNK_SIZE = 62
"""Bytes that go out at a time, so that their echo fits into one IN packet."""
UPLOAD_TRIES = 10
"""How often the whole procedure is tried."""

ANSWER_TIMEOUT = 0.05
"""How long to wait for an answer to a greeting [s]."""
ECHO_TIMEOUT = 0.5
"""How long to wait for the echo of a chunk [s]."""
WRITE_TIMEOUT = 1.0
"""How long a write may take [s]."""

SMALLEST = 1_000
LARGEST = 65_536
"""A file whose size is not between these is no Falcon's firmware, of which the known ones have 7 to 9 kB [bytes]."""

Clock = Callable[[], float]
UploadProgress = Callable[[int, int], None]
"""Takes the number of bytes loaded and the number of all."""


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
        firmware: What to load.
        clock: The time that `transport` waits in [s].
        progress: Called after each chunk.
        tries: How often to try.

    Returns:
        How many tries it took.

    Raises:
        FirmwareError: If no try succeeded; the message has the last one's reason.
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

    The line for data terminal ready is left as it is, because it resets the Falcon.

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
    """One try of several failed."""


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
        # A zero may come first, and what is left of an earlier answer too.
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
    """Read until there is enough, or the time is over."""
    heard = b""
    deadline = clock() + timeout
    while not is_enough(heard):
        left = deadline - clock()
        if left <= 0.0:
            break
        heard += ftdi.strip_status(transport.bulk_read(ftdi.PACKET_SIZE, left))
    return heard
