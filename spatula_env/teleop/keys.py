"""Common parts of keyboard and gamepad: pygame, and rates by name."""

from __future__ import annotations

import os
import time
from abc import abstractmethod
from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np

from spatula_env.installing import install_hint
from spatula_env.teleop.device import DeviceError, DeviceSample, TeleopDevice

AXIS_NAMES = ("x", "y", "z")
RATE_NAMES = (*AXIS_NAMES, "rotation_x", "rotation_y", "rotation_z", "jaw_speed")
"""Names of the rates that can be commanded."""


def require_pygame() -> ModuleType:
    """Import pygame.

    Raises:
        ImportError: If it is missing; the message says what to install.
    """
    # Otherwise pygame prints a greeting on standard output.
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        import pygame
    except ImportError as error:
        raise ImportError(f"keyboard and gamepad need pygame-ce: {install_hint('teleop')}") from error
    module: ModuleType = pygame
    return module


class RateDevice(TeleopDevice):
    """A device that commands rates by name and has to be polled.

    `read` processes its events; with pygame it has to be called in the main thread.
    """

    kind = "rate"

    def __init__(self, name: str, button_names: tuple[str, ...]) -> None:
        """Store name and buttons.

        Args:
            name: Name of the device in messages.
            button_names: Names of all buttons.
        """
        self.name = name
        self.button_names = button_names
        self._is_open = False
        self._sequence = 0
        self._rates: dict[str, float] = {}

    @property
    def is_open(self) -> bool:
        """See `TeleopDevice`."""
        return self._is_open

    def open(self) -> None:
        """See `TeleopDevice`."""
        if not self._is_open:
            self._start()
            self._is_open = True

    def read(self) -> DeviceSample:
        """See `TeleopDevice`."""
        if not self._is_open:
            raise DeviceError(f"the {self.name} is not open: call open(), or use it in a with statement")
        self._rates, buttons = self._poll()
        self._sequence += 1
        rate = np.clip([self._rates.get(name, 0.0) for name in AXIS_NAMES], -1.0, 1.0)
        return DeviceSample("rate", self.now(), self._sequence, None, rate, np.zeros(3), buttons)

    def extra_rates(self) -> Mapping[str, float]:
        """See `HasExtraRates`; the values of the last `read`."""
        return {name: min(1.0, max(-1.0, value)) for name, value in self._rates.items() if name not in AXIS_NAMES}

    def close(self) -> None:
        """See `TeleopDevice`."""
        if self._is_open:
            self._is_open = False
            self._rates = {}
            self._stop()

    def now(self) -> float:
        """See `TeleopDevice`."""
        return time.monotonic()

    @abstractmethod
    def _start(self) -> None:
        """Open the device."""

    @abstractmethod
    def _poll(self) -> tuple[dict[str, float], frozenset[str]]:
        """The rates by name, and the buttons that are held down."""

    @abstractmethod
    def _stop(self) -> None:
        """Release the device."""


def check_rate_names(names: Any, argument: str) -> None:
    """Check that all rates exist.

    Raises:
        ValueError: If one is unknown.
    """
    unknown = sorted(set(names) - set(RATE_NAMES))
    if unknown:
        raise ValueError(f"{argument} must name some of {list(RATE_NAMES)}, got {unknown}")
