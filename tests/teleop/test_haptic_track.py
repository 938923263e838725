"""Recordings at the rate of the haptic loop, replayed on the emulator."""

from __future__ import annotations

import time

import numpy as np
import pytest

from spatula_env.teleop import NotCalibrated
from spatula_env.teleop.emulator import GuidedHand, RealClock
from spatula_env.teleop.falcon.frames import position_to_falcon
from spatula_env.teleop.haptics import HapticDevice
from spatula_env.teleop.haptics.track import HapticTrack
from spatula_env.teleop.scripted import EmulatedFalcon


def moving(seconds: float) -> tuple[float, float, float]:
    return 0.01 * float(np.sin(9.0 * seconds)), 0.0, -0.002


def device_at(motion) -> tuple[HapticDevice, EmulatedFalcon]:
    falcon = EmulatedFalcon(GuidedHand(lambda seconds: position_to_falcon(motion(seconds))))
    return HapticDevice(lambda: falcon, where="here", exchange=True), falcon


def real_falcon() -> EmulatedFalcon:
    return EmulatedFalcon(GuidedHand(lambda _: position_to_falcon((0.0, 0.01, 0.02))), clock=RealClock())


def push(device: HapticDevice, seconds: float) -> None:
    for _ in range(round(240 * seconds)):
        device.tell(None, (0.0, 0.0, 1.2))
        device.sleep(1.0 / 240.0)


def test_a_track_has_every_cycle_and_survives_a_file(tmp_path):
    device, falcon = device_at(moving)
    with device:
        device.keep_track(0.2)
        falcon.emulator.press(["plus", "center"])
        push(device, 0.25)
        found = device.take_track()
        assert len(device.take_track().time) == 0
        device.keep_track(0.0)
        push(device, 0.1)
        assert len(device.take_track().time) == 0
    assert len(found.time) == 200
    assert found.lost > 40
    np.testing.assert_allclose(np.diff(found.time), 1e-3, atol=1e-4)
    np.testing.assert_allclose(found.told[50:, 2], 1.2)
    assert found.shown[-1, 2] == pytest.approx(1.2, abs=0.01)
    pressed = {name for bit, name in enumerate(found.button_names) if found.buttons[-1] >> bit & 1}
    assert pressed == {"plus", "center"}
    found.save(tmp_path / "haptics" / "episode_0.npz")
    again = HapticTrack.load(tmp_path / "haptics" / "episode_0.npz")
    for name in ("time", "position", "velocity", "told", "shown", "buttons"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))
    assert (again.button_names, again.lost) == (found.button_names, found.lost)
    assert [each.name for each in (tmp_path / "haptics").iterdir()] == ["episode_0.npz"]


def test_a_track_is_done_again_on_the_emulator():
    device, _ = device_at(moving)
    with device:
        device.keep_track(1.0)
        push(device, 0.5)
        found = device.take_track()
    device, _ = device_at(found.motion())
    with device:
        device.keep_track(1.0)
        push(device, 0.4)
        again = device.take_track()
    common = min(len(found.time), len(again.time)) - 10
    np.testing.assert_allclose(again.position[:common], found.position[:common], atol=3e-4)


def test_in_a_process_too():
    with HapticDevice(real_falcon, where="process", exchange=True) as device:
        device.keep_track(30.0)
        deadline = time.monotonic() + 20.0
        while device.force[2] < 0.5 and time.monotonic() < deadline:
            device.tell(None, (0.0, 0.0, 1.0))
            time.sleep(0.002)
        found = device.take_track()
    assert found.shown[:, 2].max() > 0.4
    np.testing.assert_allclose(found.position[-1], [0.0, 0.01, 0.02], atol=1e-4)


def test_a_lost_homing_is_told_as_such_and_the_loop_begins_again_with_it():
    device, falcon = device_at(lambda _: (0.0, 0.0, 0.0))
    with device:
        push(device, 0.1)
        homed = falcon.emulator.program.homed
        assert all(homed)
        falcon.emulator.program.homed = [False] * 3
        device.sleep(0.02)
        assert not any(falcon.emulator.program.motors)
        with pytest.raises(NotCalibrated, match="not homed"):
            device.read()
        falcon.emulator.program.homed = [True] * 3
        device.sleep(0.005)
        falcon.exchange()
        device.calibrate()
        push(device, 0.2)
        assert device.force[2] > 1.0
