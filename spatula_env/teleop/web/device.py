"""A page in the browser as a teleoperation device, and as the display for it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.teleop.device import DeviceError, DeviceSample, FloatArray, NotCalibrated, Progress, TeleopDevice
from spatula_env.teleop.session import DISCARD, FINISH, QUIT
from spatula_env.teleop.web.page import Page
from spatula_env.teleop.web.panel import Panel, Reading, Status, goal_in_words

if TYPE_CHECKING:
    import gymnasium

    from spatula_env.teleop.web.stage import Stage

LONGEST = 1.0
"""A page that draws nothing is shown something again after so long [s]."""
APPROACH = 0.1
"""Time constant with which the grip follows the mouse [s]."""
BUTTON_KEYS: Mapping[str, str] = MappingProxyType({"Enter": FINISH, "Backspace": DISCARD, "Escape": QUIT})
"""Buttons, by the place of a key as browsers name it."""


class WebDevice(TeleopDevice):
    """A page in a browser: the organ as it deforms, and a tool to be dragged by the mouse or moved by keys.

    A rate device. While the mouse drags the tool, the rates are those that take the grip where the mouse is. A page
    that is closed, hidden, or silent for half a second commands nothing.

    `FalconTeleop` shows it what happens, after every control step.

    Attributes:
        page: What browsers open; None while the device is closed.
        panel: The part of the page beside the view; likewise.
    """

    kind = "rate"
    button_names = (FINISH, DISCARD, QUIT)

    def __init__(
        self,
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
        token: str | None = None,
        shortcuts: Mapping[str, Callable[[], None]] | None = None,
        patience: float = 600.0,
    ) -> None:
        """Describe it.

        Args:
            host: The address to listen at.
            port: Where; 0 for any that is free.
            token: What has to be known to open the page; None: nothing, which is allowed on a loopback address only.
            shortcuts: What keys do, by their places, beside moving the tool. None: the page has buttons and keys to
                finish and to discard an episode and to quit.
            patience: How long `calibrate` waits for somebody to open the page [s].

        Raises:
            ValueError: If there is no such port.
        """
        if not 0 <= port <= 65535:
            raise ValueError(f"port must be from 0 to 65535, got {port!r}")
        self.name = "web"
        self.page: Page | None = None
        self.panel: Panel | None = None
        self._where: dict[str, Any] = {"host": host, "port": port, "token": token}
        self._own = shortcuts is None
        buttons = {key: partial(self.press, button) for key, button in BUTTON_KEYS.items()}
        self._shortcuts: dict[str, Callable[[], None]] = dict(buttons if shortcuts is None else shortcuts)
        self._patience = patience
        self._lock = threading.Lock()
        self._pressed: set[str] = set()
        self._sequence = 0
        self._stage: Stage | None = None
        self._env: Any = None
        self._grip: FloatArray = np.zeros(3)
        self._drawn: dict[int, int | None] = {}
        self._shown = -np.inf
        self._stale = False
        self._rates: dict[str, float] = {}

    @property
    def is_open(self) -> bool:
        """See `TeleopDevice`."""
        return self.page is not None

    @property
    def url(self) -> str:
        """What to open in a browser on this machine, with the token."""
        return self._opened().url

    def open(self) -> None:
        """See `TeleopDevice`; serves the page, and does not wait for anybody to open it.

        Raises:
            ImportError: If viser is missing.
            ValueError: If there is no token where there has to be one.
            DeviceBusy: If the port is taken.
        """
        if self.page is not None:
            return
        self.page = Page(**self._where, keys=tuple(self._shortcuts), on_key=self._key)
        self.panel = panel = Panel(self.page.server)
        self._pressed.clear()
        self._stage = self._env = None
        if self._own:
            panel.add_command(
                "Finish", partial(self.press, FINISH), color="green", hint="The episode ends here (Enter)"
            )
            panel.add_command("Discard", partial(self.press, DISCARD), hint="It counts for nothing (Backspace)")
            panel.add_command("Quit", partial(self.press, QUIT), hint="Nor does any other (Escape)")
            panel.say(Status("Playing"))
        panel.gizmo.on_update(lambda _: self._stage and self._stage.set_gizmo(panel.gizmo.value))
        panel.see_through.on_update(lambda _: self._stage and self._stage.set_see_through(panel.see_through.value))
        panel.home.on_click(lambda event: self._stage and self._stage.look(event.client))

    def calibrate(self, progress: Progress | None = None) -> None:
        """Wait until somebody has opened the page.

        Args:
            progress: Told the address.

        Raises:
            NotCalibrated: If nobody does.
        """
        page = self._opened()
        if progress is not None:
            progress(f"open {page.url}")
        if not page.hands.wait(self._patience):
            raise NotCalibrated(f"nobody opened {page.url} within {self._patience:.0f} s")

    def press(self, button: str) -> None:
        """Press a button, until the next `read`."""
        with self._lock:
            self._pressed.add(button)

    def read(self) -> DeviceSample:
        """See `TeleopDevice`."""
        hands = self._opened().hands
        with self._lock:
            pressed, self._pressed = frozenset(self._pressed), set()
        share = self._key_share()
        self._rates = {name: share * rate for name, rate in hands.rates().items()}
        rate = np.array([self._rates.get(axis, 0.0) for axis in "xyz"])
        target = hands.target
        if target is not None and self._env is not None:
            rate = self._toward(target)
        self._sequence += 1
        return DeviceSample("rate", self.now(), self._sequence, None, rate, np.zeros(3), pressed)

    def extra_rates(self) -> Mapping[str, float]:
        """See `HasExtraRates`; as of the last `read`."""
        return {name: rate for name, rate in self._rates.items() if name not in "xyz"}

    def watch(self, observation: Any, env: gymnasium.Env[Any, Any]) -> None:
        """See `Watching`: shows how things stand."""
        made: Any = env.unwrapped
        page, panel = self._opened(), self.panel
        assert panel is not None
        if self._stage is None or self._env is not made:
            # Kernels are compiled, or taken from Numba's cache, when it is first needed.
            from spatula_env.teleop.web.stage import Stage

            page.hands.drag(None)
            self._env = made
            self._stage = Stage(page.server, made, self._drag)
            self._stage.set_gizmo(panel.gizmo.value)
            self._stage.set_see_through(panel.see_through.value)
        episodes = made._episodes
        self._grip = np.array(episodes.situation.tool_position[0])
        info = {name: values[0].item() for name, values in episodes.info.items()}
        panel.add(
            Reading(
                time=info["time"],
                force=info["force"],
                pressure=info["peak_pressure"],
                within_tolerance=info["within_tolerance"],
                success=info["is_success"],
                cost=info["episode_cost"],
                goal=goal_in_words(made.task.goal_names, made.task.goal_units, made.goal),
            )
        )
        # A page that is busy drawing would drown in pictures, and have no time for the hands.
        self._stale = True
        drawn, now = page.hands.frames, self.now()
        busy = any(count is not None and count == self._drawn.get(number) for number, count in drawn.items())
        if not busy or info["time"] == 0.0 or now > self._shown + LONGEST:
            self._drawn, self._shown = drawn, now
            self.refresh()

    def refresh(self) -> None:
        """Show how things stand, if they are not what the page shows."""
        if self._stale and self._stage is not None and self.panel is not None:
            self._stale = False
            self._stage.show(self._env.moment)
            self.panel.show()

    def close(self) -> None:
        """See `TeleopDevice`; all pages lose their connection."""
        page, self.page, self.panel = self.page, None, None
        self._stage = self._env = None
        if page is not None:
            page.close()

    def now(self) -> float:
        """See `TeleopDevice`."""
        return time.monotonic()

    def _opened(self) -> Page:
        if self.page is None:
            raise DeviceError("the web device is not open: call open(), or use it in a with statement")
        return self.page

    def _key(self, key: str) -> None:
        if key in self._shortcuts:
            self._shortcuts[key]()

    def _drag(self, target: FloatArray | None) -> None:
        page, env = self.page, self._env
        # A page can say anything.
        if target is not None and not np.isfinite(target).all():
            return
        if page is not None and env is not None:
            page.hands.drag(None if target is None else env.workspace.from_scene(target))

    def _key_share(self) -> float:
        """Of the greatest velocities, what keys command."""
        if self._env is None or self.panel is None:
            return 0.0
        return min(1.0, self.panel.key_speed / float(self._env.control.max_speed))

    def _toward(self, target: FloatArray) -> FloatArray:
        """(3,) rates that take the grip to a place."""
        rate: FloatArray = (target - self._grip) / (APPROACH * float(self._env.control.max_speed))
        # The direction stays where the speed is cut.
        return rate / max(1.0, float(np.abs(rate).max()))
