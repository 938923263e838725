"""Input of operators on the pages: keys held, and mouse drags of the tool."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from spatula_env.teleop.device import FloatArray

KEYS: Mapping[str, tuple[str, float]] = MappingProxyType(
    {
        "ArrowLeft": ("x", -1.0),
        "ArrowRight": ("x", 1.0),
        "ArrowUp": ("y", 1.0),
        "ArrowDown": ("y", -1.0),
        "PageUp": ("z", 1.0),
        "PageDown": ("z", -1.0),
        "KeyA": ("x", -1.0),
        "KeyD": ("x", 1.0),
        "KeyW": ("y", 1.0),
        "KeyS": ("y", -1.0),
        "KeyE": ("z", 1.0),
        "KeyQ": ("z", -1.0),
        "KeyU": ("rotation_x", 1.0),
        "KeyJ": ("rotation_x", -1.0),
        "KeyI": ("rotation_y", 1.0),
        "KeyK": ("rotation_y", -1.0),
        "KeyO": ("rotation_z", 1.0),
        "KeyL": ("rotation_z", -1.0),
        "Period": ("jaw_speed", 1.0),
        "Comma": ("jaw_speed", -1.0),
    }
)
"""Rates by key code, which names the key's place as browsers do: the same on every keyboard layout."""

SLOW_KEYS = ("ShiftLeft", "ShiftRight")
SLOW = 0.25
"""Factor on the rates while one of `SLOW_KEYS` is held."""

SILENT = 0.5
"""A page that has not reported for this long holds no key [s]; pages report ten times a second."""

AWAY = 3.0
"""A page that has not reported for this long is gone [s]."""


MOVES: tuple[tuple[tuple[str, ...], str, str], ...] = (
    (("KeyW", "KeyA", "KeyS", "KeyD"), "velocity_x", "(or arrows) away, left, near, right"),
    (("KeyE", "KeyQ"), "velocity_z", "up, down"),
    (("KeyU", "KeyJ"), "rotation_x", "lean towards you, away"),
    (("KeyI", "KeyK"), "rotation_y", "lean right, left"),
    (("KeyO", "KeyL"), "rotation_z", "turn left, right"),
    (("Period", "Comma"), "jaw_speed", "open, close the jaws"),
)
"""Keys, the name of the action component that they need, and their description."""

NAMES: Mapping[str, str] = MappingProxyType({"Period": ".", "Comma": ",", "ShiftLeft": "Shift"})
"""Labels of keys whose label is not the end of their code."""


@dataclass
class _PageInput:
    keys: frozenset[str]
    heard: float
    hidden: bool
    frames: int | None


class OperatorInput:
    """Combined input of all open pages. All methods may be called from any thread."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        """Start without any pages.

        Args:
            now: Returns the time [s].
        """
        self._now = now
        self._lock = threading.Lock()
        self._pages: dict[int, _PageInput] = {}
        self._target: FloatArray | None = None
        self._orientation: FloatArray | None = None
        self._opening: float | None = None
        self._anybody = threading.Event()

    def hear(self, page: int, keys: Iterable[str], hidden: bool = False, frames: int | None = None) -> frozenset[str]:
        """Update a page's state from its report.

        Args:
            page: Number of the page.
            keys: Codes of all keys that are held.
            hidden: Whether the page is not visible.
            frames: Number of frames it has drawn; None if it does not report that.

        Returns:
            The keys that were not held before.
        """
        held = frozenset() if hidden else frozenset(keys)
        with self._lock:
            before = self._pages[page].keys if page in self._pages else frozenset()
            self._pages[page] = _PageInput(held, self._now(), hidden, frames)
        if not hidden:
            self._anybody.set()
        return held - before

    def leave(self, page: int) -> None:
        """Remove a page that was closed."""
        with self._lock:
            self._pages.pop(page, None)

    def drag(self, target: FloatArray | None) -> None:
        """Set the position (3,) to which the mouse drags the grip, workspace frame [m]; None on release."""
        with self._lock:
            self._target = None if target is None else np.array(target, dtype=np.float64)

    def turn(self, orientation: FloatArray | None) -> None:
        """Set the orientation (4,) to which the mouse turns the first tool, workspace frame; None on release."""
        with self._lock:
            self._orientation = None if orientation is None else np.array(orientation, dtype=np.float64)

    def open(self, opening: float | None) -> None:
        """Set the wanted distance between the jaws [m]; None to leave them as they are."""
        with self._lock:
            self._opening = opening

    def let_go(self) -> None:
        """Discard all mouse input."""
        with self._lock:
            self._target = self._orientation = self._opening = None

    @property
    def target(self) -> FloatArray | None:
        """(3,) position to which the mouse drags the grip [m]; None without a drag, or if no page is present."""
        with self._lock:
            return self._target if self._fresh(SILENT) else None

    @property
    def orientation(self) -> FloatArray | None:
        """(4,) orientation to which the mouse turns the first tool; None without a turn, or if no page is present."""
        with self._lock:
            return self._orientation if self._fresh(SILENT) else None

    @property
    def opening(self) -> float | None:
        """Wanted distance between the jaws [m]; None if none is set, or if no page is present."""
        with self._lock:
            return self._opening if self._fresh(SILENT) else None

    @property
    def keys(self) -> frozenset[str]:
        """Codes of all keys that are held now."""
        with self._lock:
            return frozenset().union(*(page.keys for page in self._fresh(SILENT)))

    @property
    def present(self) -> bool:
        """Whether a page is open and visible."""
        with self._lock:
            return bool(self._fresh(AWAY))

    @property
    def viewers(self) -> int:
        """Number of pages that are open and visible."""
        with self._lock:
            return len(self._fresh(AWAY))

    @property
    def frames(self) -> dict[int, int | None]:
        """Number of frames that each visible page has drawn."""
        earliest = self._now() - AWAY
        with self._lock:
            pages = self._pages.items()
            return {number: page.frames for number, page in pages if page.heard >= earliest and not page.hidden}

    @property
    def active(self) -> bool:
        """Whether an operator is moving the tool."""
        by_mouse = self.target is not None or self.orientation is not None or self.opening is not None
        return by_mouse or not self.keys.isdisjoint(KEYS)

    def wait(self, timeout: float) -> bool:
        """Wait until a page is visible.

        Args:
            timeout: Longest time to wait [s].

        Returns:
            Whether a page is visible.
        """
        self._anybody.clear()
        return self.present or (self._anybody.wait(timeout) and self.present)

    def rates(self) -> dict[str, float]:
        """Rates that the held keys command, by name, each in [-1, 1]."""
        held = self.keys
        factor = SLOW if held.intersection(SLOW_KEYS) else 1.0
        rates: dict[str, float] = {}
        for key in held & KEYS.keys():
            name, share = KEYS[key]
            rates[name] = rates.get(name, 0.0) + share
        return {name: factor * min(1.0, max(-1.0, rate)) for name, rate in rates.items()}

    def _fresh(self, longest: float) -> list[_PageInput]:
        earliest = self._now() - longest
        return [page for page in self._pages.values() if page.heard >= earliest and not page.hidden]


def hints(names: tuple[str, ...], buttons: tuple[tuple[str, str], ...] = ()) -> str:
    """Description of keys, mouse and touch gestures as HTML.

    Args:
        names: Names of the action's components: only keys that move one of them are described.
        buttons: Codes of further keys with their descriptions.
    """
    turns, jaws = any(name.startswith("rotation_") for name in names), "jaw_speed" in names
    keys = [("".join(map(_key, codes)), does) for codes, name, does in MOVES if name in names]
    keys += [(_key("ShiftLeft"), "slow"), *((_key(code), does) for code, does in buttons)]
    drags = ["an arrow: one axis"] + turns * ["the arc: turn it"] + jaws * ["the slider: jaws"]
    drags += ["beside it: the view"]
    return (
        '<div class="sp sp-keys">'
        + _line("keys", "Keys", [f"{what} {does}" for what, does in keys])
        + _line("mouse", "Drag", [f"the tool: move it ({_key('ShiftLeft')} at its height)", *drags, "wheel: zoom"])
        + _line("touch", "Drag", ["the tool: move it", *drags, "two fingers: zoom"])
        + "</div>"
    )


def _line(kind: str, title: str, entries: list[str]) -> str:
    return f'<div class="{kind}"><b>{title}</b> {" ".join(f"<span>{entry}</span>" for entry in entries)}</div>'


def _key(code: str) -> str:
    return f'<kbd data-code="{code}">{NAMES.get(code, code.removeprefix("Key"))}</kbd>'
