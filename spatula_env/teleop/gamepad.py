"""A gamepad as a teleoperation device."""

from __future__ import annotations

import os
from collections.abc import Mapping
from types import MappingProxyType, ModuleType
from typing import Any

from spatula_env.teleop.device import DeviceLost, DeviceNotFound
from spatula_env.teleop.keys import RateDevice, check_rate_names, require_pygame

AXES: Mapping[int, tuple[str, float]] = MappingProxyType(
    {0: ("x", 1.0), 1: ("y", -1.0), 3: ("rotation_x", 1.0), 4: ("z", -1.0)}
)
"""Rates by axis number: the left stick moves along x and y, the right one along z and turns about x. SDL's axes are
positive to the right and towards the operator."""
HAT: tuple[str, str] = ("jaw_speed", "rotation_z")
"""Rates of the directional pad, horizontal (positive right) and vertical (positive up)."""
BUTTONS: Mapping[int, str] = MappingProxyType(
    {0: "center", 1: "discard", 2: "minus", 3: "plus", 6: "quit", 7: "finish"}
)
"""Names of the buttons by number; on an Xbox controller: A, B, X, Y, back, start."""
DEAD_ZONE = 0.1
"""Deflection up to which a stick counts as centred."""


class Gamepad(RateDevice):
    """A gamepad that SDL supports; how its axes and buttons are numbered depends on the make."""

    def __init__(
        self,
        index: int = 0,
        *,
        axes: Mapping[int, tuple[str, float]] = AXES,
        hat: tuple[str, str] = HAT,
        buttons: Mapping[int, str] = BUTTONS,
        dead_zone: float = DEAD_ZONE,
    ) -> None:
        """Store the settings of the gamepad; `open` opens it.

        Args:
            index: Number of the device, if there are several.
            axes: Rates by axis number: name of the rate, and its value at full deflection.
            hat: Rates of the directional pad, horizontal (positive right) and vertical (positive up).
            buttons: Names of the buttons by number.
            dead_zone: Deflection up to which a stick counts as centred; larger deflections are measured from there.

        Raises:
            ValueError: If a rate does not exist, or `dead_zone` is not in [0, 1).
        """
        check_rate_names([name for name, _ in axes.values()], "axes")
        check_rate_names(hat, "hat")
        if not 0.0 <= dead_zone < 1.0:
            raise ValueError(f"dead_zone must be 0 or more and less than 1, got {dead_zone!r}")
        super().__init__("gamepad", tuple(dict.fromkeys(buttons.values())))
        self._index = index
        self._axes, self._hat, self._button_map = dict(axes), hat, dict(buttons)
        self._dead_zone = dead_zone
        self._pygame: ModuleType | None = None
        self._joystick: Any = None

    def _start(self) -> None:
        pygame = require_pygame()
        # By default, SDL gives no events to a program without the focus, and this program has no window.
        os.environ.setdefault("SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS", "1")
        # Events need a video driver, even if a dummy; a display that is initialised already is left alone.
        if not pygame.display.get_init():
            if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
                os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
            pygame.display.init()
        pygame.joystick.init()
        count = pygame.joystick.get_count()
        if self._index >= count:
            pygame.joystick.quit()
            raise DeviceNotFound(f"there is no gamepad {self._index}: {count} found; connect one and try again")
        self._joystick = pygame.joystick.Joystick(self._index)
        self.name = f"gamepad ({self._joystick.get_name()})"
        self._pygame = pygame

    def _poll(self) -> tuple[dict[str, float], frozenset[str]]:
        pygame, stick = self._pygame, self._joystick
        assert pygame is not None
        for event in pygame.event.get():
            if event.type == pygame.JOYDEVICEREMOVED and event.instance_id == stick.get_instance_id():
                raise DeviceLost(f"the {self.name} does not answer any more; connect it, then open it again")
        rates: dict[str, float] = {}
        for number, (name, share) in self._axes.items():
            if number < stick.get_numaxes():
                rates[name] = rates.get(name, 0.0) + share * self._beyond(stick.get_axis(number))
        if stick.get_numhats() > 0:
            for name, value in zip(self._hat, stick.get_hat(0), strict=True):
                rates[name] = rates.get(name, 0.0) + value
        count = stick.get_numbuttons()
        pressed = {name for number, name in self._button_map.items() if number < count and stick.get_button(number)}
        return rates, frozenset(pressed)

    def _beyond(self, deflection: float) -> float:
        beyond = max(0.0, abs(deflection) - self._dead_zone) / (1.0 - self._dead_zone)
        return beyond if deflection > 0.0 else -beyond

    def _stop(self) -> None:
        if self._pygame is not None:
            self._joystick.quit()
            self._pygame.joystick.quit()
            self._joystick = self._pygame = None
