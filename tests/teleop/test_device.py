from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.teleop import (
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceSample,
    FirmwareError,
    NotCalibrated,
)
from spatula_env.teleop.device import TeleopDevice, check_force, limit_force


class Stick(TeleopDevice):
    """A rate device that is half way to the right."""

    name = "stick"
    kind = "rate"
    button_names = ("fire",)

    def __init__(self):
        self._is_open = False

    @property
    def is_open(self):
        return self._is_open

    def open(self):
        self._is_open = True

    def read(self):
        return DeviceSample("rate", 2.0, 1, None, np.array([0.5, 0.0, 0.0]), np.zeros(3), frozenset({"fire"}))

    def close(self):
        self._is_open = False

    def now(self):
        return 3.0


def test_a_device_needs_little():
    with Stick() as stick:
        assert stick.is_calibrated
        stick.calibrate()
        assert stick.read().age(stick.now()) == 1.0
        stick.send_force([1.0, 2.0, 3.0])
        with pytest.raises(ValueError, match="shape"):
            stick.send_force([1.0])
        assert stick.get_action() == {
            "rate.x": 0.5,
            "rate.y": 0.0,
            "rate.z": 0.0,
            "velocity.x": 0.0,
            "velocity.y": 0.0,
            "velocity.z": 0.0,
            "button.fire": True,
        }
        assert stick.feedback_features == {}
        stick.send_feedback({})
    assert not stick.is_open


@pytest.mark.parametrize(
    ("kind", "position", "rate", "velocity", "message"),
    [
        ("position", None, None, np.zeros(3), "must have position"),
        ("position", np.zeros(3), np.zeros(3), np.zeros(3), "only position"),
        ("rate", np.zeros(3), None, np.zeros(3), "must have rate"),
        ("speed", None, None, np.zeros(3), "kind"),
        ("position", np.zeros(2), None, np.zeros(3), "position must have shape"),
        ("rate", None, np.zeros(3), np.zeros((3, 1)), "velocity must have shape"),
    ],
)
def test_samples_that_make_no_sense(kind, position, rate, velocity, message):
    with pytest.raises(ValueError, match=message):
        DeviceSample(kind, 0.0, 1, position, rate, velocity)


def test_samples_are_copies():
    position = np.zeros(3)
    sample = DeviceSample("position", 0.0, 1, position, None, np.zeros(3))
    position[0] = 1.0
    assert sample.position[0] == 0.0


@given(st.tuples(*[st.floats(-1e308, 1e308)] * 3))
def test_limited_forces(force):
    limited = limit_force(check_force(force), 8.0)
    assert np.linalg.norm(limited) <= 8.0 * (1 + 1e-12)
    if max(map(abs, force)) < 4.0:
        assert limited.tolist() == list(force)
    scale = np.abs(force).max()
    if scale > 0.0:
        direction = np.array(force) / scale
        np.testing.assert_allclose(limited / np.abs(limited).max(), direction, atol=1e-9)


@pytest.mark.parametrize("error", [DeviceBusy, DeviceLost, DeviceNotFound, FirmwareError, NotCalibrated])
def test_all_errors_are_device_errors(error):
    assert issubclass(error, DeviceError)
