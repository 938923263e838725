"""The keyboard as a teleoperation device, in a small window of its own."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType, ModuleType

from spatula_env.teleop.device import DeviceError
from spatula_env.teleop.keys import RateDevice, check_rate_names, require_pygame

KEYS: Mapping[str, tuple[str, float]] = MappingProxyType(
    {
        "left": ("x", -1.0),
        "right": ("x", 1.0),
        "up": ("y", 1.0),
        "down": ("y", -1.0),
        "page up": ("z", 1.0),
        "page down": ("z", -1.0),
        "d": ("x", 1.0),
        "a": ("x", -1.0),
        "w": ("y", 1.0),
        "s": ("y", -1.0),
        "r": ("z", 1.0),
        "f": ("z", -1.0),
        "u": ("rotation_x", 1.0),
        "j": ("rotation_x", -1.0),
        "i": ("rotation_y", 1.0),
        "k": ("rotation_y", -1.0),
        "o": ("rotation_z", 1.0),
        "l": ("rotation_z", -1.0),
        ".": ("jaw_speed", 1.0),
        ",": ("jaw_speed", -1.0),
    }
)
"""Rates by pygame's key names."""

BUTTONS: Mapping[str, str] = MappingProxyType(
    {"space": "center", "return": "finish", "backspace": "discard", "escape": "quit"}
)
"""Buttons by pygame's key names."""

SLOW_KEYS = ("left shift", "right shift")
SLOW = 0.25
"""Factor on the rates while one of `SLOW_KEYS` is held."""
BLIND_DRIVERS = ("dummy", "offscreen")
"""SDL's video drivers that show no window and therefore deliver no key events."""
WINDOW = (420, 120)
"""Width and height of the window that receives the keys [pixels]."""


class Keyboard(RateDevice):
    """The keyboard, read through a window.

    Arrows move along x and y, page up and page down along z; so do w, a, s, d, r and f. The pairs u and j, i and k, o
    and l turn about x, y and z; comma and full stop close and open jaws; shift slows everything down.

    The window has to have the focus to receive keys; losing the focus releases all keys. Closing the window presses the
    button "quit".
    """

    def __init__(
        self, keys: Mapping[str, tuple[str, float]] = KEYS, buttons: Mapping[str, str] = BUTTONS, slow: float = SLOW
    ) -> None:
        """Store the settings of the keyboard; `open` opens it.

        Args:
            keys: Rates by pygame's key names: name of the rate, and its value.
            buttons: Names of buttons by key names.
            slow: Factor on the rates while shift is held.

        Raises:
            ValueError: If a rate does not exist, or `slow` is not in (0, 1].
        """
        check_rate_names([name for name, _ in keys.values()], "keys")
        if not 0.0 < slow <= 1.0:
            raise ValueError(f"slow must be positive and 1 at most, got {slow!r}")
        super().__init__("keyboard", tuple(dict.fromkeys([*buttons.values(), "quit"])))
        self._keys, self._buttons, self._slow = dict(keys), dict(buttons), slow
        self._held: set[str] = set()
        self._quit = False
        self._pygame: ModuleType | None = None

    def _start(self) -> None:
        pygame = require_pygame()
        pygame.display.init()
        try:
            pygame.display.set_mode(WINDOW)
        except pygame.error as error:
            pygame.display.quit()
            raise DeviceError(f"the keyboard needs a window, and there is no display: {error}") from error
        driver = pygame.display.get_driver()
        if driver in BLIND_DRIVERS:
            # Without a display SDL draws into nothing, and no key event would ever arrive.
            pygame.display.quit()
            raise DeviceError(
                f"the keyboard needs a window, and there is no display (SDL has {driver!r} only); --device web shows "
                "a page in a browser, which may be on another machine"
            )
        pygame.display.set_caption("spatula: keys go here")
        self._pygame = pygame
        self._held, self._quit = set(), False

    def _poll(self) -> tuple[dict[str, float], frozenset[str]]:
        pygame = self._pygame
        assert pygame is not None
        for event in pygame.event.get():
            if event.type == pygame.KEYDOWN:
                self._held.add(pygame.key.name(event.key))
            elif event.type == pygame.KEYUP:
                self._held.discard(pygame.key.name(event.key))
            elif event.type == pygame.WINDOWFOCUSLOST:
                # The key's release event goes to the window that has the focus then.
                self._held.clear()
            elif event.type == pygame.QUIT:
                self._quit = True
        factor = self._slow if self._held.intersection(SLOW_KEYS) else 1.0
        rates: dict[str, float] = {}
        for key in self._held & self._keys.keys():
            name, share = self._keys[key]
            rates[name] = rates.get(name, 0.0) + factor * share
        pressed = {self._buttons[key] for key in self._held & self._buttons.keys()}
        return rates, frozenset(pressed | ({"quit"} if self._quit else set()))

    def _stop(self) -> None:
        if self._pygame is not None:
            self._pygame.display.quit()
            self._pygame = None
