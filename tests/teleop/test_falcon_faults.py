from __future__ import annotations

import threading

import numpy as np
import pytest
from falcon_helpers import MIDDLE, exchange_for, held_at, make_driver, open_homed
from hypothesis import given, settings
from hypothesis import strategies as st

from spatula_env.teleop import DeviceBusy, DeviceError, DeviceLost, DeviceNotFound, FirmwareError, NotCalibrated
from spatula_env.teleop.emulator import (
    ElasticHand,
    FalconEmulator,
    Faults,
    GuidedHand,
    cut_short,
    homing_motion,
    lose_bytes,
    with_garbage,
)
from spatula_env.teleop.falcon import ftdi
from spatula_env.teleop.falcon.firmware import read_firmware, upload
from spatula_env.teleop.falcon.protocol import DevicePacket

FIRMWARE = bytes((31 * index + index // 7) % 256 for index in range(1313))


@pytest.fixture
def firmware_file(tmp_path):
    path = tmp_path / "falcon.bin"
    path.write_bytes(FIRMWARE)
    return path


# The cable.


def test_unplugged_while_a_force_acts():
    emulator, falcon = open_homed()
    falcon.send_force([2.0, 0.0, 0.0])
    falcon.exchange()
    emulator.unplug()
    with pytest.raises(DeviceLost, match="emulated Falcon"):
        falcon.exchange()
    for call in (falcon.read, lambda: falcon.send_force([0.0, 0.0, 0.0]), falcon.calibrate, falcon.state):
        with pytest.raises(DeviceLost):
            call()
    assert not falcon.is_calibrated
    falcon.close()


def test_unplugged_while_the_thread_pushes():
    emulator = FalconEmulator(ElasticHand(homing_motion()))
    falcon = make_driver(emulator, threaded=True)
    falcon.open()
    falcon.calibrate()
    falcon.send_force([2.0, 0.0, 0.0])
    (thread,) = [thread for thread in threading.enumerate() if thread.name == "falcon"]
    emulator.unplug()
    thread.join(timeout=30.0)
    assert not thread.is_alive()
    with pytest.raises(DeviceLost, match="unplugged"):
        falcon.read()
    with pytest.raises(DeviceLost, match="unplugged"):
        falcon.send_force([1.0, 0.0, 0.0])
    assert emulator.motor_force == (0.0, 0.0, 0.0)
    falcon.close()

    emulator.plug_in()
    with pytest.raises(FirmwareError, match="no firmware, or no power"):
        falcon.open()


def test_a_connection_does_not_come_back_with_the_cable():
    emulator, falcon = open_homed()
    emulator.unplug()
    emulator.plug_in()
    with pytest.raises(DeviceLost):
        falcon.exchange()
    falcon.close()


def test_no_device():
    emulator = FalconEmulator()
    emulator.unplug()
    with pytest.raises(DeviceNotFound, match="not plugged in"):
        make_driver(emulator).open()


def test_two_programs_want_one_falcon():
    emulator, falcon = open_homed()
    other = make_driver(emulator)
    with pytest.raises(DeviceBusy, match="emulated Falcon"):
        other.open()
    assert not other.is_open
    falcon.exchange()
    falcon.close()
    other.open()
    other.close()


def test_power_lost_while_a_force_acts():
    emulator, falcon = open_homed(hand=held_at(MIDDLE))
    falcon.send_force([2.0, 0.0, 0.0])
    falcon.exchange()
    emulator.faults.is_silent = True
    start = emulator.clock.now()
    with pytest.raises(DeviceLost, match="power supply"):
        for _ in range(1000):
            falcon.send_force([2.0, 0.0, 0.0])
            falcon.exchange()
    # Long before it is given up, a Falcon that does not answer gets no force any more.
    pushed = [time for time, counts in emulator.motor_history if counts != (0, 0, 0)]
    assert pushed[-1] - start <= 0.020
    falcon.close()


def test_an_error_that_no_device_makes_ends_the_thread_and_the_force():
    emulator = FalconEmulator(homed=True)
    falcon = make_driver(emulator, threaded=True)
    falcon.open()
    (thread,) = [thread for thread in threading.enumerate() if thread.name == "falcon"]
    falcon.send_force([2.0, 0.0, 0.0])
    answer = emulator.program.receive

    def broken(data, *rest):
        if data[1:13] != b"A" * 12:
            raise RuntimeError("bug")
        return answer(data, *rest)

    emulator.program.receive = broken
    while thread.is_alive():
        try:
            falcon.send_force([2.0, 0.0, 0.0])
        except DeviceError:
            pass
    with pytest.raises(DeviceError, match="RuntimeError"):
        falcon.read()
    assert emulator.program.motors == (0, 0, 0)
    falcon.close()


# The line.


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_garbage_between_packets_never_makes_a_sample(seed):
    emulator, falcon = open_homed(hand=held_at((0.013, -0.021, 0.111)))
    truth = falcon.read().position
    before = falcon.read().sequence
    emulator.faults.mangle = with_garbage(seed)
    for _ in range(40):
        falcon.exchange()
        np.testing.assert_allclose(falcon.read().position, truth, atol=1e-12)
        assert falcon.read().buttons == frozenset()
    # Each packet came through, though it had noise in front of it.
    assert falcon.read().sequence == before + 40
    assert falcon.statistics().discarded_bytes > 0
    falcon.close()


@pytest.mark.parametrize(
    "mangle", [cut_short(15), cut_short(1), cut_short(0), lose_bytes(11, 2), lose_bytes(0, 1), lose_bytes(1, 4)]
)
def test_damaged_replies_make_no_sample(mangle):
    emulator, falcon = open_homed(hand=held_at((0.013, -0.021, 0.111)))
    before = falcon.read()
    emulator.faults.mangle = mangle
    for _ in range(10):
        assert not falcon.exchange()
    assert falcon.read().sequence == before.sequence
    assert falcon.statistics().missed == 10
    emulator.faults.mangle = None
    # The first whole reply counts again, whatever was left of a broken one.
    assert falcon.exchange()
    np.testing.assert_allclose(falcon.read().position, before.position, atol=1e-12)
    falcon.close()


def test_encoders_that_jump_are_not_believed_until_they_stay():
    emulator, falcon = open_homed(hand=held_at(MIDDLE))
    exchange_for(falcon, 0.05)
    truth = falcon.read().position
    jump = DevicePacket((900, 900, 900), homed=(True, True, True)).encode()
    emulator.faults.mangle = lambda _: jump
    assert not falcon.exchange()
    np.testing.assert_allclose(falcon.read().position, truth, atol=1e-12)
    assert falcon.statistics().implausible == 1
    exchange_for(falcon, 0.02)
    assert falcon.state().encoders == (900, 900, 900)
    falcon.close()


def test_encoders_that_no_falcon_shows_are_not_believed():
    emulator, falcon = open_homed(hand=held_at(MIDDLE))
    truth = falcon.read().position
    emulator.faults.mangle = lambda _: DevicePacket((30_000, -30_000, 0), homed=(True, True, True)).encode()
    exchange_for(falcon, 0.1)
    np.testing.assert_allclose(falcon.read().position, truth, atol=1e-12)
    falcon.close()


def test_a_falcon_that_forgets_its_homing_gets_no_force():
    emulator, falcon = open_homed()
    falcon.send_force([2.0, 0.0, 0.0])
    falcon.exchange()
    emulator.program.homed[1] = False
    falcon.exchange()
    falcon.send_force([2.0, 0.0, 0.0])
    falcon.exchange()
    assert emulator.program.motors == (0, 0, 0)
    with pytest.raises(NotCalibrated):
        falcon.read()
    falcon.close()


def test_one_late_reply_does_not_make_all_late():
    speed = 0.2
    emulator, falcon = open_homed(hand=GuidedHand(lambda time: (0.0, 0.0, 0.09 + speed * time)))

    def lag():
        return (emulator.grip[2] - falcon.state().position[2]) / speed

    exchange_for(falcon, 0.05)
    usual = lag()
    emulator.faults.reply_delay = 0.0055
    assert not falcon.exchange()
    emulator.faults.reply_delay = 0.0
    assert falcon.exchange()
    # An encoder count is worth a quarter of a millisecond at this speed.
    for _ in range(5):
        falcon.exchange()
        assert lag() == pytest.approx(usual, abs=0.0004)
    falcon.close()


def test_late_replies_are_taken_when_they_come():
    emulator, falcon = open_homed()
    emulator.faults.reply_delay = 0.003
    before = falcon.statistics().missed
    exchange_for(falcon, 0.2)
    assert falcon.statistics().missed == before
    assert falcon.statistics().late > 30
    # Later than an exchange waits: every answer meets a later question, and none is lost.
    emulator.faults.reply_delay = 0.008
    exchange_for(falcon, 0.2)
    assert falcon.read().age(falcon.now()) < 0.02
    falcon.close()


def test_weak_motors():
    emulator, falcon = open_homed(hand=held_at(MIDDLE))
    emulator.faults.motor_limit = 100
    falcon.send_force([8.0, 0.0, 0.0])
    falcon.exchange()
    assert max(map(abs, emulator.program.motors)) == 100
    falcon.close()


# Firmware.


def unloaded(**faults):
    return FalconEmulator(firmware=FIRMWARE, loaded=False, faults=Faults(**faults))


def test_firmware_is_loaded(firmware_file):
    emulator = unloaded()
    progress = []
    falcon = make_driver(emulator, firmware=firmware_file, upload_progress=lambda *done: progress.append(done))
    falcon.open()
    assert emulator.is_loaded
    assert progress[0] == (62, len(FIRMWARE))
    assert progress[-1] == (len(FIRMWARE), len(FIRMWARE))
    assert emulator.chip.latency == 0.001
    falcon.close()


@pytest.mark.parametrize(
    "faults", [{"ignored_greetings": 30}, {"leading_zero": True}, {"wrong_echoes": 3}, {"ignored_greetings": 130}]
)
def test_firmware_is_loaded_in_the_end(firmware_file, faults):
    emulator = unloaded(**faults)
    with make_driver(emulator, firmware=firmware_file):
        assert emulator.is_loaded


def test_every_try_counts():
    assert upload(unloaded(wrong_echoes=3).connect(), FIRMWARE, FalconEmulator().clock.now) == 4


@pytest.mark.parametrize(
    ("faults", "reason"),
    [
        ({"wrong_echoes": 10**6}, "echo of bytes 0 to 61"),
        ({"ignored_greetings": 10**6}, "did not answer 100 greetings"),
    ],
)
def test_firmware_that_cannot_be_loaded(faults, reason):
    emulator = unloaded(**faults)
    with pytest.raises(FirmwareError, match=f"2 tries: .*{reason}"):
        upload(emulator.connect(), FIRMWARE, emulator.clock.now, tries=2)


def test_a_failed_upload_lets_go(firmware_file):
    emulator = unloaded(wrong_echoes=10**6)
    with pytest.raises(FirmwareError, match="10 tries"):
        make_driver(emulator, firmware=firmware_file).open()
    assert emulator.owner is None


def test_firmware_that_does_not_run(firmware_file):
    with pytest.raises(FirmwareError, match="does not run"):
        make_driver(unloaded(rejects_firmware=True), firmware=firmware_file).open()


def test_no_firmware_at_all_and_what_helps(firmware_file):
    emulator = unloaded()
    with pytest.raises(FirmwareError, match="Take it off its power supply"):
        make_driver(emulator).open()
    # The question has spoilt the boot loader, as it does in a real one …
    with pytest.raises(FirmwareError, match="does not run"):
        make_driver(emulator, firmware=firmware_file).open()
    # … until the advice is followed.
    emulator.unplug()
    emulator.plug_in()
    with make_driver(emulator, firmware=firmware_file):
        assert emulator.is_loaded


def test_firmware_is_loaded_again_over_running_firmware(firmware_file):
    emulator = FalconEmulator(firmware=FIRMWARE, homed=True)
    with make_driver(emulator, firmware=firmware_file) as falcon:
        assert not falcon.is_calibrated


@pytest.mark.parametrize("content", [b"", b"x" * 999, b"x" * 65_537])
def test_files_that_are_no_firmware(tmp_path, content):
    path = tmp_path / "wrong.bin"
    path.write_bytes(content)
    with pytest.raises(FirmwareError, match=f"{len(content)} bytes"):
        read_firmware(path)


def test_a_wrong_file_name_leaves_the_falcon_alone(tmp_path):
    emulator = FalconEmulator(homed=True)
    with pytest.raises(FirmwareError, match="cannot read"):
        make_driver(emulator, firmware=tmp_path / "none.bin").open()
    assert emulator.owner is None
    with make_driver(emulator) as falcon:
        assert falcon.is_calibrated


class Forgetful:
    """A transport that leaves out one kind of control request."""

    def __init__(self, transport, forgotten):
        self._transport = transport
        self._forgotten = forgotten

    def __getattr__(self, name):
        return getattr(self._transport, name)

    def control_transfer(self, request_type, request, value, index):
        if (request, value) != self._forgotten:
            self._transport.control_transfer(request_type, request, value, index)


@pytest.mark.parametrize(
    "forgotten",
    [
        (ftdi.SET_BAUD_RATE, ftdi.BAUD_BOOT),
        (ftdi.SET_BAUD_RATE, ftdi.BAUD_UPLOAD),
        (ftdi.SET_DATA_FORMAT, ftdi.EIGHT_BITS_NO_PARITY),
        (ftdi.SET_FLOW_CONTROL, ftdi.NO_FLOW_CONTROL),
        (ftdi.SET_MODEM_CONTROL, ftdi.RTS_LOW),
        (ftdi.SET_MODEM_CONTROL, ftdi.DTR_LOW),
        (ftdi.SET_MODEM_CONTROL, ftdi.DTR_HIGH),
    ],
)
def test_no_step_of_the_upload_can_be_left_out(forgotten):
    emulator = unloaded()
    with pytest.raises(FirmwareError):
        upload(Forgetful(emulator.connect(), forgotten), FIRMWARE, emulator.clock.now, tries=1)


def test_normal_mode_needs_its_baud_rate_and_latency():
    emulator = FalconEmulator(homed=True)
    falcon = make_driver(emulator)
    falcon._connect = lambda: Forgetful(emulator.connect(), (ftdi.SET_BAUD_RATE, ftdi.BAUD_NORMAL))
    with pytest.raises(FirmwareError):
        falcon.open()
    falcon._connect = lambda: Forgetful(emulator.connect(), (ftdi.SET_LATENCY_TIMER, ftdi.LATENCY_NORMAL))
    falcon.open()
    exchange_for(falcon, 0.5)
    # 16 ms pass between one IN packet and the next, far less than 500 answers fit in.
    assert falcon.statistics().missed > 50
    falcon.close()
