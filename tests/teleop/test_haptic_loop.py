from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import spatula_env
from spatula_env.teleop import DeviceBusy, DeviceError, DeviceLost, NotCalibrated
from spatula_env.teleop.emulator import ElasticHand, FalconEmulator, GuidedHand, RealClock, homing_motion, with_garbage
from spatula_env.teleop.falcon import Falcon
from spatula_env.teleop.falcon.frames import position_to_falcon
from spatula_env.teleop.haptics import HapticDevice, HapticSettings
from spatula_env.teleop.haptics.board import Board
from spatula_env.teleop.scripted import EmulatedFalcon

RIGID = HapticSettings()


def held_falcon(position=(0.0, 0.0, 0.0)) -> EmulatedFalcon:
    """In a hand that does not yield, in simulated time."""
    return EmulatedFalcon(GuidedHand(lambda _: position_to_falcon(position)))


def real_falcon() -> EmulatedFalcon:
    """Likewise in real time; made in the loop's own process."""
    return EmulatedFalcon(GuidedHand(lambda _: position_to_falcon((0.0, 0.01, 0.02))), clock=RealClock())


def failing_falcon() -> EmulatedFalcon:
    raise DeviceError("this one is broken")


def motors(device) -> tuple[int, int, int]:
    return device.emulator.program.motors


def press_center(device) -> None:
    device.emulator.press(["center"])


def unplug(device) -> None:
    device.emulator.unplug()


def here(factory=held_falcon, settings=RIGID) -> tuple[HapticDevice, EmulatedFalcon]:
    falcon = factory()
    return HapticDevice(lambda: falcon, settings, where="here", exchange=True), falcon


def test_the_hand_feels_what_is_told():
    device, falcon = here()
    with device:
        for _ in range(40):
            device.tell(None, (0.0, 0.0, 1.5))
            device.sleep(0.005)
        np.testing.assert_allclose(device.force, [0.0, 0.0, 1.5], atol=1e-3)
        # Up in the device's frame is y of the Falcon.
        np.testing.assert_allclose(falcon.emulator.motor_force, [0.0, 1.5, 0.0], atol=0.02)


def test_the_period_is_a_millisecond_and_time_passes_as_asked():
    device, _ = here()
    with device:
        start = device.now()
        device.sleep(0.25)
        assert device.now() - start == pytest.approx(0.25, abs=1.5e-3)
        found = device.statistics()
    assert found.cycles == pytest.approx(250, abs=3)
    assert found.median_period == pytest.approx(1e-3)


def test_a_stalled_simulation_ends_the_force_within_50_ms():
    device, falcon = here()
    with device:
        for _ in range(40):
            device.tell(None, (2.0, 0.0, 0.0))
            device.sleep(0.005)
        told = device.now() - 0.005
        assert any(motors(falcon))
        device.sleep(0.05 - (device.now() - told))
        assert not any(motors(falcon))
        assert device.statistics().stalls == 1


def test_release_ends_the_force_within_50_ms_and_smoothly():
    device, falcon = here()
    with device:
        for _ in range(40):
            device.tell(None, (2.0, 0.0, 0.0))
            device.sleep(0.005)
        device.release()
        device.sleep(0.005)
        assert any(motors(falcon))
        device.sleep(0.03)
        assert not any(motors(falcon))


def test_unplugging_in_contact_is_told_and_leaves_no_force():
    device, falcon = here()
    device.open()
    for _ in range(20):
        device.tell(None, (0.0, 0.0, 2.0))
        device.sleep(0.005)
    falcon.emulator.unplug()
    device.sleep(0.02)
    assert falcon.emulator.motor_force == (0.0, 0.0, 0.0)
    with pytest.raises(DeviceLost, match="unplugged"):
        device.read()
    with pytest.raises(DeviceLost, match="unplugged"):
        device.tell(None, (0.0, 0.0, 2.0))
    device.release()
    device.close()
    device.close()


def test_garbage_on_the_line_disturbs_neither_force_nor_place():
    device, falcon = here(lambda: held_falcon((0.01, 0.0, -0.01)))
    falcon.emulator.faults.mangle = with_garbage(seed=3)
    with device:
        for _ in range(60):
            device.tell(None, (0.0, 0.0, 1.5))
            device.sleep(0.005)
        np.testing.assert_allclose(device.read().position, [0.01, 0.0, -0.01], atol=1e-4)
        np.testing.assert_allclose(falcon.emulator.motor_force, [0.0, 1.5, 0.0], atol=0.03)


def test_one_program_at_a_time():
    first, falcon = here()
    second = EmulatedFalcon()
    second.emulator = falcon.emulator
    second._connect = falcon.emulator.connect
    with first, pytest.raises(DeviceBusy, match="another program"):
        HapticDevice(lambda: second, where="here", exchange=True).open()


def test_any_exception_ends_the_force(monkeypatch):
    device, falcon = here()
    with device:
        for _ in range(20):
            device.tell(None, (0.0, 0.0, 2.0))
            device.sleep(0.005)
        assert any(motors(falcon))
        read = falcon.read
        monkeypatch.setattr(falcon, "read", lambda: (_ for _ in ()).throw(ZeroDivisionError("no such thing")))
        with pytest.raises(ZeroDivisionError):
            device.sleep(0.005)
        assert not any(motors(falcon))
        monkeypatch.setattr(falcon, "read", read)


def test_what_is_told_is_checked():
    device, _ = here()
    with device:
        with pytest.raises(ValueError, match="finite"):
            device.tell(None, (0.0, 0.0, np.nan))
        with pytest.raises(ValueError, match="shape"):
            device.tell((0.0, 0.0), (0.0, 0.0, 1.0))
    with pytest.raises(DeviceError, match="not open"):
        device.tell(None, (0.0, 0.0, 1.0))


def test_only_position_devices_with_force():
    from spatula_env.teleop.scripted import ScriptedOperator

    device = HapticDevice(lambda: ScriptedOperator(lambda _: np.zeros(3)), where="here")
    with pytest.raises(ValueError, match="position device with force"):
        device.open()
    with pytest.raises(ValueError, match="where"):
        HapticDevice(held_falcon, where="elsewhere")


def test_homing_comes_first():
    emulator = FalconEmulator(ElasticHand(homing_motion()))
    falcon = Falcon(transport=emulator.connect, clock=emulator.clock.now, sleep=emulator.clock.sleep, threaded=False)
    device = HapticDevice(lambda: falcon, where="here", exchange=True)
    device.open()
    assert not device.is_calibrated
    with pytest.raises(NotCalibrated):
        device.read()
    told = []
    device.calibrate(told.append)
    assert device.is_calibrated
    assert "homed" in told[-1]
    assert device.read().position is not None
    device.close()


def test_in_a_thread():
    device = HapticDevice(real_falcon, RIGID, where="thread", exchange=True)
    with device:
        deadline = time.monotonic() + 20.0
        while device.force[0] < 0.9 and time.monotonic() < deadline:
            device.tell(None, (1.0, 0.0, 0.0))
            time.sleep(0.002)
        assert device.force[0] > 0.9
        assert device.statistics().cycles > 1
        device.ask(unplug)
        with pytest.raises(DeviceLost):
            while time.monotonic() < deadline:
                device.read()
                time.sleep(0.002)


def test_in_a_process():
    device = HapticDevice(real_falcon, RIGID, where="process", exchange=True)
    with device:
        assert device.name == "emulated Falcon"
        assert device.button_names == Falcon.button_names
        assert device.greatest_stiffness == Falcon.greatest_stiffness
        deadline = time.monotonic() + 20.0
        while device.force[0] < 0.9 and time.monotonic() < deadline:
            device.tell(None, (1.0, 0.0, 0.0))
            time.sleep(0.002)
        assert device.force[0] > 0.9
        np.testing.assert_allclose(device.read().position, [0.0, 0.01, 0.02], atol=1e-4)
        device.ask(press_center)
        while "center" not in device.read().buttons and time.monotonic() < deadline:
            time.sleep(0.002)
        assert device.read().buttons == {"center"}
        while device.force.any() and time.monotonic() < deadline:
            time.sleep(0.002)
        assert device.ask(motors) == (0, 0, 0)
        assert device.statistics().stalls >= 1
        with pytest.raises(AttributeError):
            device.ask(no_such_question)
        device.ask(unplug)
        with pytest.raises(DeviceLost, match="unplugged"):
            while time.monotonic() < deadline:
                device.tell(None, (1.0, 0.0, 0.0))
                time.sleep(0.002)


def no_such_question(device) -> None:
    _ = device.no_such_thing


def test_errors_of_the_process_come_here():
    with pytest.raises(DeviceError, match="this one is broken"):
        HapticDevice(failing_falcon, where="process").open()


ORPHAN = """
import sys, time
sys.path.insert(0, {folder!r})
from test_haptic_loop import real_falcon, RIGID
from spatula_env.teleop.haptics import HapticDevice
if __name__ == "__main__":
    device = HapticDevice(real_falcon, RIGID, where="process", exchange=True)
    device.open()
    print(device._runner._process.pid, flush=True)
    while True:
        device.tell(None, (1.0, 0.0, 0.0))
        time.sleep(0.002)
"""


def test_a_killed_program_leaves_no_loop_running(tmp_path):
    script = tmp_path / "orphan.py"
    script.write_text(ORPHAN.format(folder=os.path.dirname(__file__)))
    root = str(Path(spatula_env.__file__).parents[1])
    program = subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        text=True,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": root},
    )
    loop = int(program.stdout.readline())
    program.send_signal(signal.SIGKILL)
    program.wait()
    program.stdout.close()
    deadline = time.monotonic() + 30.0
    while _is_alive(loop) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not _is_alive(loop)


def _is_alive(process: int) -> bool:
    try:
        with open(f"/proc/{process}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_a_board_keeps_the_newest_whole_message():
    writer = Board("d3dB")
    reader = Board("d3dB", writer.name)
    try:
        assert reader.read() is None
        writer.write(1.0, 2.0, 3.0, 4.0, 5)
        assert reader.read() == (1.0, 2.0, 3.0, 4.0, 5)
        # Torn: half of a message, and the checksum of another.
        writer._memory.buf[3] ^= 0xFF
        assert reader.read() == (1.0, 2.0, 3.0, 4.0, 5)
        writer.write(6.0, 7.0, 8.0, 9.0, 10)
        assert reader.read() == (6.0, 7.0, 8.0, 9.0, 10)
    finally:
        reader.close()
        writer.close()
        writer.close()
