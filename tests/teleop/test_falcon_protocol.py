from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.teleop.emulator.chip import LineSettings
from spatula_env.teleop.emulator.faults import Faults
from spatula_env.teleop.emulator.program import Program
from spatula_env.teleop.falcon import ftdi
from spatula_env.teleop.falcon.protocol import (
    Buttons,
    DevicePacket,
    HostPacket,
    Lights,
    PacketError,
    PacketStream,
)

numbers = st.integers(-0x8000, 0x7FFF)
packets = st.builds(
    DevicePacket,
    encoders=st.tuples(numbers, numbers, numbers),
    buttons=st.integers(0, 15).map(Buttons),
    homed=st.tuples(st.booleans(), st.booleans(), st.booleans()),
)

# Recorded between the vendor's driver and a device.
RECORDED = bytes.fromhex("3c 50 50 50 41 43 45 50 41 43 4d 50 41 45 41 3e")


def test_empty_packet():
    assert HostPacket().encode() == b"<AAAAAAAAAAAAAA>"
    assert HostPacket.decode(b"<AAAAAAAAAAAAAA>") == HostPacket()


def test_recorded_packet():
    packet = HostPacket.decode(RECORDED)
    assert packet == HostPacket((4095, 3906, 4034), Lights.BLUE, homing=False)
    assert packet.encode() == RECORDED


def test_negative_number():
    assert DevicePacket.decode(b"<JFKPAAAAAAAAAA>").encoders == (0xFA59 - 0x10000, 0, 0) == (-1447, 0, 0)


def test_lights_homing_buttons_and_homed_legs():
    assert HostPacket(lights=Lights.RED | Lights.GREEN, homing=True).encode()[13] == 0x41 + 0x08 + 0x02 + 0x01
    packet = DevicePacket.decode(b"<AAAAAAAAAAAA" + bytes([0x41 + 0b0101_1010]) + b"A>")
    assert packet.button_names == {"forward", "minus"}
    assert packet.homed == (True, False, True)
    assert DevicePacket.decode(b"<AAAAAAAAAAAA" + bytes([0x41 + 0x7F]) + b"A>").button_names == {
        "plus",
        "forward",
        "center",
        "minus",
    }


@given(packets)
def test_device_packets_survive(packet):
    assert DevicePacket.decode(packet.encode()) == packet


@given(st.tuples(numbers, numbers, numbers), st.integers(0, 7), st.booleans())
def test_the_emulated_device_reads_what_the_driver_writes(motors, lights, homing):
    program = Program(Faults(motor_limit=0x8000))
    data = HostPacket(motors, Lights(2 * lights), homing).encode()
    assert HostPacket.decode(data) == HostPacket(motors, Lights(2 * lights), homing)
    answer = program.receive(data, LineSettings(2, 8, 0), (35.0, 35.0, 35.0), (0, 0, 0))
    assert program.demanded == motors
    assert program.lights == 2 * lights
    assert program.is_homing == homing
    assert DevicePacket.decode(answer) == DevicePacket((0, 0, 0))


@given(st.tuples(numbers, numbers, numbers), st.integers(0, 15))
def test_the_driver_reads_what_the_emulated_device_writes(counts, buttons):
    program = Program(Faults(), homed=True)
    program.buttons = buttons
    answer = program.receive(HostPacket().encode(), LineSettings(2, 8, 0), (35.0, 35.0, 35.0), counts)
    assert DevicePacket.decode(answer) == DevicePacket(counts, Buttons(buttons), (True, True, True))


@pytest.mark.parametrize("count", [0x8000, -0x8001])
def test_count_that_does_not_fit(count):
    with pytest.raises(ValueError, match="16 bits"):
        HostPacket((count, 0, 0)).encode()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"<AAAAAAAAAAAAAA",
        b"<AAAAAAAAAAAAAAA>",
        b">AAAAAAAAAAAAAA>",
        b"<QAAAAAAAAAAAAA>",
        b"<AAAAAAAAAAA@AA>",
        b"<AAAAAAAAAAAA@A>",
        # The reply with two bytes missing that a careless reader takes for homed, with three buttons held.
        b"<AAAAAAAAAAAA>A>",
        b"<AAAAAAAAAAAA>AA",
        b"<AAAAAAAAAAAAA<>",
        b"<AAAAAAAAAAAA\xc1A>",
    ],
)
def test_what_is_no_packet(data):
    with pytest.raises(PacketError):
        DevicePacket.decode(data)


@given(st.lists(st.tuples(st.binary(max_size=40), packets), min_size=1, max_size=6), st.integers(1, 40), st.data())
def test_no_packet_is_lost_and_none_invented_among_garbage(parts, piece, data):
    stream = PacketStream()
    line = b"".join(garbage + packet.encode() for garbage, packet in parts) + data.draw(st.binary(max_size=20))
    found = [packet for start in range(0, len(line), piece) for packet in stream.feed(line[start : start + piece])]
    assert found == [packet for _, packet in parts]


@given(st.lists(packets, min_size=2, max_size=5), st.integers(0, 15), st.integers(1, 15))
def test_a_packet_with_bytes_missing_is_dropped_alone(sent, start, count):
    damaged = sent[0].encode()
    damaged = damaged[:start] + damaged[start + count :]
    line = damaged + b"".join(packet.encode() for packet in sent[1:])
    assert PacketStream().feed(line) == sent[1:]


@given(packets, st.integers(0, 15), st.integers(0, 255))
def test_a_packet_with_a_byte_too_many_is_dropped(packet, place, byte):
    encoded = packet.encode()
    longer = encoded[:place] + bytes([byte]) + encoded[place:]
    found = PacketStream().feed(longer)
    # Only a bracket doubled at either end leaves the packet itself whole.
    assert found == ([packet] if encoded in longer else [])


def test_packets_come_as_soon_as_they_are_complete():
    stream = PacketStream()
    packet = DevicePacket((1, -2, 3))
    encoded = packet.encode()
    # The garbage could be the beginning of a packet, until the real one shows that it is not.
    assert stream.feed(b"<AAAA" + encoded[:-1]) == []
    assert stream.feed(encoded[-1:]) == [packet]
    assert stream.discarded == 5
    stream.feed(encoded[:7])
    stream.clear()
    assert stream.feed(encoded[7:]) == []


def test_status_bytes_are_taken_out_of_every_usb_packet():
    assert ftdi.strip_status(b"\x01\x60") == b""
    assert ftdi.strip_status(b"") == b""
    full = b"\x01\x60" + bytes(range(62))
    assert ftdi.strip_status(full + b"\x11\x60xyz") == bytes(range(62)) + b"xyz"
