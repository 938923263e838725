"""What the operators' hands do on the pages: keys that are held, and where the mouse drags the tool."""

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
"""Rates, by the place of a key as browsers name it: the same on every layout."""

SLOW_KEYS = ("ShiftLeft", "ShiftRight")
SLOW = 0.25
"""What is left of a rate while one of `SLOW_KEYS` is held."""

SILENT = 0.5
"""A page that has said nothing for so long holds no key [s]; pages speak ten times a second."""

AWAY = 3.0
"""A page that has said nothing for so long is gone [s]."""


@dataclass
class _Hand:
    keys: frozenset[str]
    heard: float
    hidden: bool
    frames: int | None


class Hands:
    """All hands on all pages that are open. Everything may be called by any thread."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        """Nobody is there yet.

        Args:
            now: The clock [s].
        """
        self._now = now
        self._lock = threading.Lock()
        self._hands: dict[int, _Hand] = {}
        self._target: FloatArray | None = None
        self._anybody = threading.Event()

    def hear(self, page: int, keys: Iterable[str], hidden: bool = False, frames: int | None = None) -> frozenset[str]:
        """A page says what is held.

        Args:
            page: Which.
            keys: All keys that are held, by their places.
            hidden: Whether nobody can see the page.
            frames: How many pictures it has drawn; None: it does not say.

        Returns:
            The keys that were not held before.
        """
        held = frozenset() if hidden else frozenset(keys)
        with self._lock:
            before = self._hands[page].keys if page in self._hands else frozenset()
            self._hands[page] = _Hand(held, self._now(), hidden, frames)
        if not hidden:
            self._anybody.set()
        return held - before

    def leave(self, page: int) -> None:
        """A page is closed."""
        with self._lock:
            self._hands.pop(page, None)

    def drag(self, target: FloatArray | None) -> None:
        """The mouse drags the grip to a place (3,), workspace frame [m]; None: it has let go."""
        with self._lock:
            self._target = None if target is None else np.array(target, dtype=np.float64)

    @property
    def target(self) -> FloatArray | None:
        """(3,) where the mouse drags the grip to [m]; None if it does not, or nobody is there."""
        with self._lock:
            return self._target if self._fresh(SILENT) else None

    @property
    def keys(self) -> frozenset[str]:
        """All keys that are held now."""
        with self._lock:
            return frozenset().union(*(hand.keys for hand in self._fresh(SILENT)))

    @property
    def present(self) -> bool:
        """Whether somebody looks at a page."""
        with self._lock:
            return bool(self._fresh(AWAY))

    @property
    def frames(self) -> dict[int, int | None]:
        """How many pictures each page that is looked at has drawn."""
        earliest = self._now() - AWAY
        with self._lock:
            hands = self._hands.items()
            return {page: hand.frames for page, hand in hands if hand.heard >= earliest and not hand.hidden}

    @property
    def active(self) -> bool:
        """Whether somebody moves the tool."""
        return self.target is not None or not self.keys.isdisjoint(KEYS)

    def wait(self, timeout: float) -> bool:
        """Wait until somebody looks at a page.

        Args:
            timeout: How long at most [s].

        Returns:
            Whether somebody does.
        """
        self._anybody.clear()
        return self.present or (self._anybody.wait(timeout) and self.present)

    def rates(self) -> dict[str, float]:
        """What the keys that are held command, by name, each in [-1, 1]."""
        held = self.keys
        factor = SLOW if held.intersection(SLOW_KEYS) else 1.0
        rates: dict[str, float] = {}
        for key in held & KEYS.keys():
            name, share = KEYS[key]
            rates[name] = rates.get(name, 0.0) + share
        return {name: factor * min(1.0, max(-1.0, rate)) for name, rate in rates.items()}

    def _fresh(self, longest: float) -> list[_Hand]:
        earliest = self._now() - longest
        return [hand for hand in self._hands.values() if hand.heard >= earliest and not hand.hidden]
