"""The packets that the Falcon and the host exchange while the firmware runs.

Both directions use packets of 16 bytes, and the Falcon answers each packet with one of its own::

    byte    0     1-4        5-8        9-12       13               14        15
    host    '<'   motor 1    motor 2    motor 3    lights, homing   0         '>'
    Falcon  '<'   encoder 1  encoder 2  encoder 3  status           unknown   '>'

A motor or encoder value is a 16-bit two's complement number in four bytes, one for each four bits, the least
significant first. 0x41 is added to every byte between the brackets, so that values of 0 to 15 become the letters 'A' to
'P', and the brackets cannot occur within a packet. The status can be as large as 0x7f; after the addition it is then
outside ASCII.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntFlag

PACKET_SIZE = 16
START = 0x3C
END = 0x3E
OFFSET = 0x41

_NUMBERS = range(1, 13)
_STATUS = 13
_UNKNOWN = 14
_GREATEST_NUMBER_BYTE = OFFSET + 0x0F
_GREATEST_STATUS_BYTE = OFFSET + 0x7F

# Accepts the same packets as `_first_wrong_byte`, which checks byte by byte; this is fast for valid ones.
_WHOLE = re.compile(rb"<[A-P]{12}[\x41-\xc0][^<>]>", re.DOTALL)

Counts = tuple[int, int, int]


class Lights(IntFlag):
    """The coloured lights on the Falcon's front.

    The assignment of bits to colours follows libnifalcon's code, with which its comments disagree.
    """

    OFF = 0
    GREEN = 0x02
    BLUE = 0x04
    RED = 0x08


class Buttons(IntFlag):
    """The buttons of the four-button grip."""

    NONE = 0
    PLUS = 1
    FORWARD = 2
    CENTER = 4
    MINUS = 8


BUTTON_NAMES = ("plus", "forward", "center", "minus")
"""Button names in the order of their bits: right, front, middle (with the circle), left."""

HOMING_BIT = 0x01
HOMED_SHIFT = 4
"""Position of the three legs' homed bits in the status."""


class PacketError(ValueError):
    """The bytes are not a valid packet."""


@dataclass(frozen=True)
class HostPacket:
    """A packet that the host sends.

    Attributes:
        motors: Motor counts, each a 16-bit number.
        lights: Which lights to turn on.
        homing: Whether the Falcon shall search for its encoders' zeros.
    """

    motors: Counts = (0, 0, 0)
    lights: Lights = Lights.OFF
    homing: bool = False

    def encode(self) -> bytes:
        """The packet as bytes on the line.

        Returns:
            16 bytes.

        Raises:
            ValueError: If a motor count does not fit into 16 bits.
        """
        payload = self.lights | (HOMING_BIT if self.homing else 0)
        return bytes((START, *_encode_numbers(self.motors), OFFSET + payload, OFFSET, END))

    @classmethod
    def decode(cls, data: bytes) -> HostPacket:
        """Decode a packet.

        Args:
            data: 16 bytes.

        Returns:
            The packet.

        Raises:
            PacketError: If the bytes are not a valid packet.
        """
        _check(data)
        payload = data[_STATUS] - OFFSET
        return cls(_decode_numbers(data), Lights(payload & 0x0E), bool(payload & HOMING_BIT))


@dataclass(frozen=True)
class DevicePacket:
    """A packet with which the Falcon answers.

    Attributes:
        encoders: Encoder counts, each a 16-bit number.
        buttons: Which buttons are held down.
        homed: For each leg, whether its encoder counts from its true zero.
    """

    encoders: Counts
    buttons: Buttons = Buttons.NONE
    homed: tuple[bool, bool, bool] = (False, False, False)

    @property
    def button_names(self) -> frozenset[str]:
        """Names of the buttons that are held down."""
        return _NAMES_OF[self.buttons]

    def encode(self) -> bytes:
        """The packet as bytes on the line.

        Returns:
            16 bytes.

        Raises:
            ValueError: If an encoder count does not fit into 16 bits.
        """
        status = int(self.buttons) | sum(1 << HOMED_SHIFT + leg for leg, homed in enumerate(self.homed) if homed)
        return bytes((START, *_encode_numbers(self.encoders), OFFSET + status, OFFSET, END))

    @classmethod
    def decode(cls, data: bytes) -> DevicePacket:
        """Decode a packet.

        Args:
            data: 16 bytes.

        Returns:
            The packet.

        Raises:
            PacketError: If the bytes are not a valid packet.
        """
        _check(data)
        return cls._decode(data)

    @classmethod
    def _decode(cls, data: bytes | bytearray) -> DevicePacket:
        status = data[_STATUS] - OFFSET
        homed = status >> HOMED_SHIFT
        return cls(_decode_numbers(data), Buttons(status & 0x0F), (bool(homed & 1), bool(homed & 2), bool(homed & 4)))


class PacketStream:
    """Finds the Falcon's packets in a stream of bytes that may contain anything else.

    A packet has to be valid in every byte whose meaning is known. Where one breaks off or turns out to be invalid, only
    its opening bracket is discarded and the search continues behind it, so that no packet is lost because of bytes in
    front of it, and the stream never waits for the rest of a packet that can no longer be completed.

    Attributes:
        discarded: Number of bytes discarded.
    """

    def __init__(self) -> None:
        self.discarded = 0
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[DevicePacket]:
        """Add received bytes.

        Args:
            data: The bytes, in pieces of any size.

        Returns:
            The packets that these bytes complete, in order.
        """
        self._buffer += data
        buffer = self._buffer
        packets: list[DevicePacket] = []
        position = 0
        while True:
            start = buffer.find(START, position)
            if start < 0:
                start = len(buffer)
            self.discarded += start - position
            position = start
            candidate = buffer[position : position + PACKET_SIZE]
            if _WHOLE.fullmatch(candidate):
                position += PACKET_SIZE
                packets.append(DevicePacket._decode(candidate))
            elif _first_wrong_byte(candidate) is not None:
                self.discarded += 1
                position += 1
            else:
                del buffer[:position]
                return packets

    def clear(self) -> None:
        """Discard an incomplete packet, if there is one."""
        self.discarded += len(self._buffer)
        self._buffer.clear()


def _encode_numbers(numbers: Counts) -> list[int]:
    encoded = []
    for number in numbers:
        if not -0x8000 <= number <= 0x7FFF:
            raise ValueError(f"a count must fit into 16 bits, got {number}")
        encoded += [OFFSET + (number >> shift & 0x0F) for shift in (0, 4, 8, 12)]
    return encoded


def _decode_numbers(data: bytes | bytearray) -> Counts:
    return _decode_number(data, 1), _decode_number(data, 5), _decode_number(data, 9)


def _decode_number(data: bytes | bytearray, first: int) -> int:
    value = (
        data[first]
        - OFFSET
        + (data[first + 1] - OFFSET << 4)
        + (data[first + 2] - OFFSET << 8)
        + (data[first + 3] - OFFSET << 12)
    )
    return value - 0x10000 if value & 0x8000 else value


def _first_wrong_byte(data: bytes | bytearray) -> int | None:
    """Index of the first byte that a packet, or the beginning of one, cannot have there; None if all are valid."""
    for index, byte in enumerate(data):
        if index in _NUMBERS:
            right = OFFSET <= byte <= _GREATEST_NUMBER_BYTE
        elif index == _STATUS:
            right = OFFSET <= byte <= _GREATEST_STATUS_BYTE
        elif index == _UNKNOWN:
            # The meaning of this byte is unknown, but a bracket here belongs to a packet with bytes missing.
            right = byte not in (START, END)
        else:
            right = byte == (START if index == 0 else END)
        if not right:
            return index
    return None


def _check(data: bytes) -> None:
    if len(data) != PACKET_SIZE:
        raise PacketError(f"a packet has {PACKET_SIZE} bytes, got {len(data)}: {data.hex(' ')}")
    wrong = _first_wrong_byte(data)
    if wrong is not None:
        raise PacketError(f"byte {wrong} of a packet cannot be 0x{data[wrong]:02x}: {data.hex(' ')}")


_NAMES_OF = tuple(frozenset(name for bit, name in enumerate(BUTTON_NAMES) if value >> bit & 1) for value in range(16))
