from __future__ import annotations

import re
import sys

import numpy as np
import pytest

from spatula_env.installing import install_hint
from spatula_env.teleop import DeviceLost, DeviceNotFound
from spatula_env.teleop.gamepad import Gamepad

pygame = pytest.importorskip("pygame")


class FakeJoystick:
    """A pad with six axes, ten buttons and a hat."""

    def __init__(self, index):
        self.axes, self.buttons, self.hat = [0.0] * 6, [False] * 10, (0, 0)

    def get_name(self):
        return "made up"

    def get_instance_id(self):
        return 7

    def get_numaxes(self):
        return len(self.axes)

    def get_axis(self, number):
        return self.axes[number]

    def get_numbuttons(self):
        return len(self.buttons)

    def get_button(self, number):
        return self.buttons[number]

    def get_numhats(self):
        return 1

    def get_hat(self, number):
        return self.hat

    def quit(self):
        pass


@pytest.fixture
def pad(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(pygame.joystick, "get_count", lambda: 1)
    monkeypatch.setattr(pygame.joystick, "Joystick", FakeJoystick)
    with Gamepad() as device:
        pygame.event.clear()
        yield device
    pygame.display.quit()


def test_sticks_move_along_the_axes_of_the_device_frame(pad):
    # Left stick to the right and away from the operator, right stick towards the operator: SDL counts that positive.
    pad._joystick.axes[:5] = [1.0, -1.0, 0.0, 0.0, 1.0]
    np.testing.assert_allclose(pad.read().rate, [1.0, 1.0, -1.0])


def test_a_stick_has_a_zone_of_rest_and_no_step_at_its_edge(pad):
    pad._joystick.axes[:2] = [0.09, -0.1]
    np.testing.assert_array_equal(pad.read().rate, 0.0)
    pad._joystick.axes[:2] = [0.100001, -0.55]
    np.testing.assert_allclose(pad.read().rate, [0.0, 0.5, 0.0], atol=1e-5)


def test_pad_turns_and_jaws(pad):
    pad._joystick.axes[3] = -1.0
    pad._joystick.hat = (1, -1)
    pad.read()
    assert pad.extra_rates() == {"rotation_x": -1.0, "jaw_speed": 1.0, "rotation_z": -1.0}


def test_buttons(pad):
    pad._joystick.buttons[0] = pad._joystick.buttons[7] = True
    assert pad.read().buttons == {"center", "finish"}
    assert "made up" in pad.name


def test_a_pad_that_is_pulled_out_is_lost(pad):
    pygame.event.post(pygame.event.Event(pygame.JOYDEVICEREMOVED, instance_id=3))
    pad.read()
    pygame.event.post(pygame.event.Event(pygame.JOYDEVICEREMOVED, instance_id=7))
    with pytest.raises(DeviceLost, match="made up"):
        pad.read()


def test_no_pad(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(pygame.joystick, "get_count", lambda: 0)
    with pytest.raises(DeviceNotFound, match="no gamepad 0"):
        Gamepad().open()
    pygame.display.quit()


def test_arguments():
    with pytest.raises(ValueError, match="dead_zone"):
        Gamepad(dead_zone=1.0)
    with pytest.raises(ValueError, match="hat"):
        Gamepad(hat=("jaws", "x"))


def test_pygame_is_named_if_it_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ImportError, match=re.escape(install_hint("teleop"))):
        Gamepad().open()
