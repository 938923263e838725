"""The driver over the Force Dimension SDK, on bindings that are made up."""

from __future__ import annotations

import sys
from types import ModuleType

import numpy as np
import pytest

from spatula_env.teleop import DeviceBusy, DeviceError, DeviceLost, DeviceNotFound, NotCalibrated
from spatula_env.teleop.falcon.forcedimension import ForceDimensionDevice


class FakeStatus:
    reset = 0


class FakeSdk:
    """One device, number 3, with the conventions of the SDK: -1 is an error, results go into a list."""

    def __init__(self):
        self.position = [0.01, 0.02, 0.03]
        self.velocity = [0.1, 0.2, 0.3]
        self.buttons = 0
        self.forces = []
        self.awaits_calibration = False
        self.is_there = True
        self.available = 1
        self.has_velocity = True
        self.closed = []
        self.enabled = None

    def open(self):
        return 3 if self.available else -1

    def openID(self, index):
        return 3 if self.available and index == 0 else -1

    def install(self, dhd):
        for name in dir(self):
            if not name.startswith("_") and callable(getattr(self, name)):
                setattr(dhd, name, getattr(self, name))

    def _answer(self, number):
        assert number == 3
        return 0 if self.is_there else -1

    def close(self, number):
        self.closed.append(number)
        return self._answer(number)

    def getDeviceCount(self):
        return 1

    def getAvailableCount(self):
        return self.available

    def errorGetLastStr(self):
        return "made-up reason"

    def getSystemName(self, number):
        return "omega.3"

    def enableForce(self, enable, number):
        self.enabled = enable
        return self._answer(number)

    def getPosition(self, out, number):
        out[:] = self.position
        # The SDK says 1 when it has only just measured.
        return self._answer(number) or 1

    def getLinearVelocity(self, out, number):
        out[:] = self.velocity
        return self._answer(number) if self.has_velocity else -1

    def getButtonMask(self, number):
        return self.buttons

    def setForce(self, force, number):
        self.forces.append(tuple(force))
        return self._answer(number)

    def getStatus(self, out, number):
        out.reset = int(bool(self.awaits_calibration))
        return self._answer(number)

    def waitForReset(self, timeout, number):
        assert timeout == 60_000
        if self.awaits_calibration == "never":
            return -1
        self.awaits_calibration = False
        return self._answer(number)


@pytest.fixture
def sdk(monkeypatch):
    fake = FakeSdk()
    package, dhd, containers = (ModuleType(name) for name in ("forcedimension_core", "dhd", "containers"))
    fake.install(dhd)
    containers.Status = FakeStatus
    package.__path__ = []
    monkeypatch.setitem(sys.modules, "forcedimension_core", package)
    monkeypatch.setitem(sys.modules, "forcedimension_core.dhd", dhd)
    monkeypatch.setitem(sys.modules, "forcedimension_core.containers", containers)
    return fake


class Time:
    now = 100.0

    def __call__(self):
        return self.now


def test_reading_in_the_device_frame(sdk):
    with ForceDimensionDevice(threaded=False) as device:
        assert device.name == "omega.3"
        assert sdk.enabled is True
        sample = device.read()
        # The SDK's x comes towards the operator, its y goes to the right.
        np.testing.assert_allclose(sample.position, [0.02, -0.01, 0.03])
        np.testing.assert_allclose(sample.velocity, [0.2, -0.1, 0.3])
        sdk.buttons = 0b1001
        second = device.read()
        assert second.buttons == {"center", "plus"}
        assert second.sequence == sample.sequence + 1
    assert sdk.closed == [3]


def test_forces_in_the_device_frame(sdk):
    with ForceDimensionDevice(threaded=False, greatest_force=5.0) as device:
        device.send_force([1.0, 2.0, 3.0])
        np.testing.assert_allclose(sdk.forces[-1], [-2.0, 1.0, 3.0])
        device.send_force([0.0, 300.0, 400.0])
        np.testing.assert_allclose(sdk.forces[-1], [-3.0, 0.0, 4.0])
        with pytest.raises(ValueError, match="finite"):
            device.send_force([np.nan, 0.0, 0.0])
        assert sdk.forces[-1] == (0.0, 0.0, 0.0)
        device.send_force([1.0, 0.0, 0.0])
    assert sdk.forces[-1] == (0.0, 0.0, 0.0)


def test_forces_expire(sdk):
    clock = Time()
    device = ForceDimensionDevice(threaded=False, clock=clock)
    device.open()
    device.send_force([1.0, 0.0, 0.0])
    clock.now += 0.019
    device.expire_force()
    assert sdk.forces == [(0.0, 1.0, 0.0)]
    clock.now += 0.002
    device.expire_force()
    device.expire_force()
    assert sdk.forces == [(0.0, 1.0, 0.0), (0.0, 0.0, 0.0)]
    device.close()


def test_the_thread_ends_forces_that_nobody_renews(sdk):
    with ForceDimensionDevice() as device:
        device.send_force([1.0, 0.0, 0.0])
        while len(sdk.forces) < 2:
            assert device.is_open
        assert sdk.forces[-1] == (0.0, 0.0, 0.0)


def test_velocity_of_a_slow_reader(sdk):
    sdk.has_velocity = False
    clock = Time()
    with ForceDimensionDevice(threaded=False, clock=clock) as device:
        np.testing.assert_array_equal(device.read().velocity, np.zeros(3))
        clock.now += 0.5
        sdk.position = [0.01, 0.07, 0.03]
        np.testing.assert_allclose(device.read().velocity, [0.1, 0.0, 0.0])


def test_calibration(sdk):
    sdk.awaits_calibration = True
    with ForceDimensionDevice(threaded=False) as device:
        assert not device.is_calibrated
        with pytest.raises(NotCalibrated, match=r"calibrate\(\)"):
            device.read()
        said = []
        device.calibrate(said.append)
        assert device.is_calibrated
        assert len(said) == 2
        sdk.awaits_calibration = "never"
        with pytest.raises(NotCalibrated, match="within 60 s"):
            device.calibrate()


def test_lost(sdk):
    device = ForceDimensionDevice(threaded=False)
    device.open()
    sdk.is_there = False
    with pytest.raises(DeviceLost, match="made-up reason"):
        device.read()
    with pytest.raises(DeviceLost, match="setForce"):
        device.send_force([1.0, 0.0, 0.0])
    device.close()
    assert sdk.closed == [3]
    with pytest.raises(DeviceError, match="not open"):
        device.read()


def test_not_found_and_busy(sdk):
    with pytest.raises(DeviceNotFound, match="made-up reason"):
        ForceDimensionDevice(5).open()
    sdk.available = 0
    with pytest.raises(DeviceBusy, match="another program"):
        ForceDimensionDevice().open()


def test_bindings_are_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "forcedimension_core", None)
    with pytest.raises(ImportError, match="pip install forcedimension-core"):
        ForceDimensionDevice().open()


def test_sdk_is_missing(monkeypatch, tmp_path):
    package = tmp_path / "forcedimension_core"
    package.mkdir()
    (package / "__init__.py").write_text("raise ImportError('There were problems loading libdrd.')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ImportError, match=r"does not find the Force Dimension SDK .*libdrd"):
        ForceDimensionDevice().open()


@pytest.mark.parametrize("option", ["greatest_force", "force_timeout", "calibration_timeout"])
def test_wrong_options(option):
    with pytest.raises(ValueError, match=option):
        ForceDimensionDevice(**{option: 0.0})
