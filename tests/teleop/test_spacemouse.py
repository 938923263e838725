from __future__ import annotations

import re
import sys
import types

import numpy as np
import pytest

from spatula_env.installing import install_hint
from spatula_env.teleop import DeviceBusy, DeviceError, DeviceLost, DeviceNotFound
from spatula_env.teleop.spacemouse import SpaceMouse


class FakeMouse:
    """Gives reports one by one, and then the last one again, as pyspacemouse does."""

    def __init__(self, options):
        self.options = options
        self.closed = False
        self.reports = []
        self.state = state(t=0.0)

    def read(self):
        if self.reports:
            self.state = self.reports.pop(0)
            if isinstance(self.state, Exception):
                raise self.state
        return self.state

    def close(self):
        self.closed = True


def state(**values):
    rest = dict.fromkeys(("x", "y", "z", "roll", "pitch", "yaw"), 0.0)
    return types.SimpleNamespace(**{**rest, "t": 1.0, "buttons": [0, 0], **values})


@pytest.fixture
def module(monkeypatch):
    made = types.ModuleType("pyspacemouse")
    made.types = types.ModuleType("pyspacemouse.types")
    made.types.AxisConvention = types.SimpleNamespace(HID_Z_UP="z up")
    made.get_connected_devices = lambda: ["SpaceMouse Made Up"]
    made.mice = []

    def open_mouse(**options):
        made.mice.append(FakeMouse(options))
        return made.mice[-1]

    made.open = open_mouse
    monkeypatch.setitem(sys.modules, "pyspacemouse", made)
    monkeypatch.setitem(sys.modules, "pyspacemouse.types", made.types)
    return made


def test_the_axis_convention_is_always_named(module):
    with SpaceMouse(1):
        assert module.mice[0].options == {"device_index": 1, "nonblocking": True, "axis_convention": "z up"}
    assert module.mice[0].closed


def test_the_real_module_has_this_convention():
    types_module = pytest.importorskip("pyspacemouse.types")
    assert types_module.AxisConvention.HID_Z_UP


def test_six_rates_from_the_newest_report(module):
    with SpaceMouse(dead_zone=0.0) as mouse:
        module.mice[0].reports = [
            state(t=1.0, x=-1.0),
            state(t=2.0, x=0.5, y=0.25, z=-0.75, roll=0.1, pitch=0.2, yaw=0.3),
        ]
        np.testing.assert_allclose(mouse.read().rate, [0.5, 0.25, -0.75])
        extras = mouse.extra_rates()
        assert [extras[f"rotation_{axis}"] for axis in "xyz"] == [0.1, 0.2, 0.3]


def test_a_small_deflection_is_none(module):
    with SpaceMouse(dead_zone=0.5) as mouse:
        module.mice[0].reports = [state(x=0.5, y=-0.75)]
        np.testing.assert_allclose(mouse.read().rate, [0.0, -0.5, 0.0])


@pytest.mark.parametrize(("buttons", "speed"), [([1, 0], -1.0), ([0, 1], 1.0), ([1, 1], 0.0), ([], 0.0)])
def test_buttons_move_the_jaws(module, buttons, speed):
    with SpaceMouse() as mouse:
        module.mice[0].reports = [state(buttons=buttons)]
        assert len(mouse.read().buttons) == sum(buttons)
        assert mouse.extra_rates()["jaw_speed"] == speed


def test_faults_have_names(module):
    with SpaceMouse() as mouse:
        module.mice[0].reports = [OSError("gone")]
        with pytest.raises(DeviceLost, match="gone"):
            mouse.read()
    module.open = lambda **_: (_ for _ in ()).throw(RuntimeError("in use"))
    with pytest.raises(DeviceBusy, match="in use"):
        SpaceMouse().open()
    module.get_connected_devices = list
    with pytest.raises(DeviceNotFound, match="udev"):
        SpaceMouse().open()


def test_the_systems_library_is_named_if_it_is_missing(module):
    def missing():
        raise RuntimeError("HID API is probably not installed")

    module.get_connected_devices = missing
    with pytest.raises(DeviceError, match=r"HIDAPI.*is probably not installed.*libhidapi-hidraw0"):
        SpaceMouse().open()


def test_pyspacemouse_is_named_if_it_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyspacemouse", None)
    with pytest.raises(ImportError, match=re.escape(install_hint("teleop"))):
        SpaceMouse().open()


def test_arguments():
    with pytest.raises(ValueError, match="dead_zone"):
        SpaceMouse(dead_zone=-0.1)
