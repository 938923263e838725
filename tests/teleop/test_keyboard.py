from __future__ import annotations

import re
import sys

import numpy as np
import pytest

from spatula_env.installing import install_hint
from spatula_env.teleop import DeviceError
from spatula_env.teleop.keyboard import Keyboard

pygame = pytest.importorskip("pygame")


@pytest.fixture(autouse=True)
def no_display(monkeypatch):
    """No window is shown, and these tests post events themselves."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr("spatula_env.teleop.keyboard.BLIND_DRIVERS", ())


@pytest.fixture
def keyboard():
    with Keyboard() as device:
        pygame.event.clear()
        yield device


def press(*names: str) -> None:
    for name in names:
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.key.key_code(name)))


def lift(*names: str) -> None:
    for name in names:
        pygame.event.post(pygame.event.Event(pygame.KEYUP, key=pygame.key.key_code(name)))


def test_arrows_and_page_keys_move_along_the_axes_of_the_device_frame(keyboard):
    press("right", "up", "page down")
    sample = keyboard.read()
    assert sample.kind == "rate"
    np.testing.assert_array_equal(sample.rate, [1.0, 1.0, -1.0])
    lift("up")
    np.testing.assert_array_equal(keyboard.read().rate, [1.0, 0.0, -1.0])


def test_opposite_keys_cancel_and_two_keys_are_not_twice_as_fast(keyboard):
    press("left", "right", "up", "w")
    np.testing.assert_array_equal(keyboard.read().rate, [0.0, 1.0, 0.0])


def test_letters_turn_and_jaws_open(keyboard):
    press("u", "k", ".")
    keyboard.read()
    rates = keyboard.extra_rates()
    assert (rates["rotation_x"], rates["rotation_y"], rates["jaw_speed"]) == (1.0, -1.0, 1.0)


def test_shift_is_slow(keyboard):
    press("right", "left shift", "u")
    np.testing.assert_array_equal(keyboard.read().rate, [0.25, 0.0, 0.0])
    assert keyboard.extra_rates()["rotation_x"] == 0.25


def test_buttons_and_closing_the_window(keyboard):
    press("space", "return")
    assert keyboard.read().buttons == {"center", "finish"}
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    assert "quit" in keyboard.read().buttons


def test_all_keys_are_let_go_with_the_focus(keyboard):
    press("right")
    pygame.event.post(pygame.event.Event(pygame.WINDOWFOCUSLOST))
    np.testing.assert_array_equal(keyboard.read().rate, 0.0)


def test_a_closed_keyboard_says_so():
    keyboard = Keyboard()
    with pytest.raises(DeviceError, match="not open"):
        keyboard.read()
    keyboard.open()
    press("right")
    keyboard.read()
    keyboard.close()
    keyboard.open()
    np.testing.assert_array_equal(keyboard.read().rate, 0.0)
    keyboard.close()
    keyboard.close()


def test_other_keys():
    with Keyboard(keys={"x": ("z", -0.5)}) as keyboard:
        pygame.event.clear()
        press("x", "right")
        np.testing.assert_array_equal(keyboard.read().rate, [0.0, 0.0, -0.5])
    with pytest.raises(ValueError, match="keys must name"):
        Keyboard(keys={"x": ("roll", 1.0)})


def test_pygame_is_named_if_it_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ImportError, match=re.escape(install_hint("teleop"))):
        Keyboard().open()


@pytest.mark.parametrize("driver", ["dummy", "offscreen", None])
def test_a_keyboard_without_a_display_is_refused(monkeypatch, driver):
    """SDL draws into nothing then, and no key would ever come."""
    monkeypatch.undo()
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    if driver is not None:
        monkeypatch.setenv("SDL_VIDEODRIVER", driver)
    keyboard = Keyboard()
    with pytest.raises(DeviceError, match="there is no display"):
        keyboard.open()
    assert not keyboard.is_open
    assert not pygame.display.get_init()
