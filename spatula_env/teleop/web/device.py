"""A web page as a teleoperation device and as its display."""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.geometry.rotations import conjugate, multiply, to_rotation_vector
from spatula_env.tasks.base import as_seen
from spatula_env.tasks.marks import Patch
from spatula_env.teleop.buttons import DISCARD, FINISH, QUIT
from spatula_env.teleop.device import DeviceError, DeviceSample, FloatArray, NotCalibrated, Progress, TeleopDevice
from spatula_env.teleop.web.page import Page
from spatula_env.teleop.web.panel import Panel
from spatula_env.teleop.web.readings import Reading, Status
from spatula_env.teleop.web.viewers import Viewers

if TYPE_CHECKING:
    import gymnasium

    from spatula_env.teleop.web.operator_input import OperatorInput
    from spatula_env.teleop.web.scene_display import SceneDisplay

LONGEST = 1.0
"""A page that does not report drawing is still updated after this long [s]."""
APPROACH = 0.1
"""Time constant with which the grip follows the mouse [s]."""
OPENED = 0.25e-3
"""Jaws count as having reached the slider's width within this distance [m]."""
BUTTON_KEYS: Mapping[str, str] = MappingProxyType({"Enter": FINISH, "Backspace": DISCARD, "Escape": QUIT})
"""Buttons by key code, which names the key's place as browsers do."""


def weakly(method: Callable[..., None]) -> Callable[..., None]:
    """Wrap a method for the page's thread by a weak reference: a device that is dropped takes its page with it."""
    held = weakref.WeakMethod(method)

    def call(*arguments: Any) -> None:
        found = held()
        if found is not None:
            found(*arguments)

    return call


class WebDevice(TeleopDevice):
    """A web page that shows the organ as it deforms, with a tool to drag by the mouse or move by keys.

    A rate device. While the mouse drags the tool, the rates move the grip towards the mouse position. A page that is
    closed, hidden, or silent for half a second commands nothing.

    `FalconTeleop` updates it after every control step.

    Attributes:
        page: The page that browsers open; None while the device is closed.
        panel: Panel beside the view; None while the device is closed.
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
        """Store the settings of the page; `open` serves it.

        Args:
            host: Address to listen on.
            port: Port to listen on; 0 for any that is free.
            token: Token required to open the page; None for none, which is allowed on a loopback address only.
            shortcuts: Functions of further keys, by key code, in addition to those that move the tool. None: the page
                has buttons and keys to finish and to discard an episode and to quit.
            patience: How long `calibrate` waits for the page to be opened [s].

        Raises:
            ValueError: If the port is out of range.
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
        self._display: SceneDisplay | None = None
        self._viewers: Viewers | None = None
        self._env: Any = None
        self._grip: FloatArray = np.zeros(3)
        self._orientation: FloatArray = np.array([0.0, 0.0, 0.0, 1.0])
        self._width: float | None = None
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
        """URL to open in a browser on this machine, with the token."""
        return self._opened().url

    def open(self) -> None:
        """See `TeleopDevice`; serves the page without waiting for it to be opened.

        Raises:
            ImportError: If viser is missing.
            ValueError: If a token is required and missing.
            DeviceBusy: If the port is taken.
        """
        if self.page is not None:
            return
        self.page = Page(**self._where, keys=tuple(self._shortcuts), on_key=weakly(self._key))
        self._finish = weakref.finalize(self, self.page.close)
        self._finish.atexit = False
        self.panel = panel = Panel(self.page.server)
        self._viewers = Viewers(self.page.server, panel)
        self._pressed.clear()
        self._display = self._env = None
        if self._own:
            press = weakly(self.press)
            panel.add_command("Finish", partial(press, FINISH), color="green", hint="The episode ends here (Enter)")
            panel.add_command("Discard", partial(press, DISCARD), hint="It counts for nothing (Backspace)")
            panel.add_command("Quit", partial(press, QUIT), hint="Nor does any other (Escape)")
            panel.hint((("Enter", "finish"), ("Backspace", "discard"), ("Escape", "quit")))
        panel.gizmo.on_update(weakly(self._set_gizmo))
        panel.see_through.on_update(weakly(self._set_see_through))
        panel.home.on_click(weakly(self._look))
        panel.jaws.on_update(weakly(self._slid))

    def calibrate(self, progress: Progress | None = None) -> None:
        """Wait until the page has been opened in a browser.

        Args:
            progress: Called with the address of the page.

        Raises:
            NotCalibrated: If the page is not opened in time.
        """
        page = self._opened()
        if progress is not None:
            progress(f"open {page.url}")
        if not page.operator_input.wait(self._patience):
            raise NotCalibrated(f"nobody opened {page.url} within {self._patience:.0f} s")

    def press(self, button: str) -> None:
        """Press a button; it is released by the next `read`."""
        with self._lock:
            self._pressed.add(button)

    def read(self) -> DeviceSample:
        """See `TeleopDevice`."""
        operator_input = self._opened().operator_input
        with self._lock:
            pressed, self._pressed = frozenset(self._pressed), set()
        share = self._key_share()
        self._rates = {name: share * rate for name, rate in operator_input.rates().items()}
        rate = np.array([self._rates.get(axis, 0.0) for axis in "xyz"])
        target = operator_input.target
        if self._env is not None:
            if target is not None:
                rate = self._toward(target)
            self._rates.update(self._turning(operator_input.orientation) | self._opening(operator_input))
        self._sequence += 1
        return DeviceSample("rate", self.now(), self._sequence, None, rate, np.zeros(3), pressed)

    def extra_rates(self) -> Mapping[str, float]:
        """See `HasExtraRates`; the values of the last `read`."""
        return {name: rate for name, rate in self._rates.items() if name not in "xyz"}

    def watch(self, observation: Any, env: gymnasium.Env[Any, Any]) -> None:
        """See `Watching`: shows the current state."""
        made: Any = env.unwrapped
        page, panel = self._opened(), self.panel
        assert panel is not None
        if self._display is None or self._env is not made:
            # Imported on first use, as this compiles kernels or loads them from Numba's cache.
            from spatula_env.teleop.web.scene_display import SceneDisplay

            page.operator_input.let_go()
            self._env = made
            assert self._viewers is not None
            self._display = SceneDisplay(page.server, self._viewers, made, weakly(self._drag), weakly(self._turn))
            self._display.set_gizmo(panel.gizmo.value)
            self._display.set_see_through(panel.see_through.value)
            self._explain(env)
        elif made._episodes.elapsed[0] == 0:
            page.operator_input.let_go()
            self._display.begin()
        episodes = made._episodes
        situation = episodes.situation
        self._grip = np.array(situation.tool_position[0])
        self._orientation = np.array(situation.tool_orientation[0])
        self._width = float(situation.control[0, 0]) if made.control.layout.jaws else None
        info = {name: values[0].item() for name, values in episodes.info.items()}
        panel.add(
            Reading(
                time=info["time"],
                force=info["force"],
                pressure=info["peak_pressure"],
                success=info["is_success"],
                dose=info["episode_dose"],
                held=info["hold_time"],
                hold_time=made.task.hold_time,
                criteria=made.task.criteria(as_seen(episodes.achieved[0]), as_seen(episodes.goals[0])),
                opening=self._width,
            )
        )
        # A page that is still drawing would fall behind with more updates, and would delay the operator's input.
        self._stale = True
        drawn, now = page.operator_input.frames, self.now()
        busy = any(count is not None and count == self._drawn.get(number) for number, count in drawn.items())
        if not busy or info["time"] == 0.0 or now > self._shown + LONGEST:
            self._drawn, self._shown = drawn, now
            self.refresh()

    def refresh(self) -> None:
        """Show the current state, if the page does not show it yet."""
        if self._stale and self._display is not None and self.panel is not None:
            self._stale = False
            self._display.show(self._env.moment)
            self.panel.show()
            if self.page is not None and self.page.operator_input.opening is None:
                self.panel.show_opening()

    def close(self) -> None:
        """See `TeleopDevice`; all pages lose their connection."""
        page, self.page, self.panel = self.page, None, None
        self._display = self._env = self._viewers = None
        if page is not None:
            self._finish()

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
        # The page's data are untrusted.
        if target is not None and not np.isfinite(target).all():
            return
        if page is not None and env is not None:
            page.operator_input.drag(None if target is None else env.workspace.from_scene(target))

    def _turn(self, orientation: FloatArray | None) -> None:
        page = self.page
        if orientation is not None and not np.isfinite(orientation).all():
            return
        if page is not None:
            page.operator_input.turn(orientation)

    def _set_gizmo(self, event: Any) -> None:
        if self._display is not None:
            self._display.set_gizmo(event.target.value)

    def _set_see_through(self, event: Any) -> None:
        if self._display is not None:
            self._display.set_see_through(event.target.value)

    def _look(self, event: Any) -> None:
        if self._viewers is not None and event.client is not None:
            self._viewers.look(event.client)

    def _slid(self, event: Any) -> None:
        # Changes made by the program itself have no client.
        if event.client is not None and self.page is not None:
            self.page.operator_input.open(1e-3 * float(event.target.value))

    def _explain(self, env: Any) -> None:
        """Show what an environment's task is, and how to do it."""
        made, panel = self._env, self.panel
        assert panel is not None
        control = made.control
        task = made.definition.name.capitalize()
        opening = control.layout.opening_range if control.layout.jaws else None
        roles = [mark.role if isinstance(mark, Patch) else "goal" for mark in made.moment.marks]
        panel.explain(task, made.task_description, control.names, tuple(roles), opening)
        if self._own:
            limit = getattr(getattr(env, "spec", None), "max_episode_steps", None)
            end = "" if limit is None else f"after {limit * made._episodes.period:g} s, or "
            panel.say(Status("Playing", f"The episode ends {end}with Finish."))

    def _turning(self, wanted: FloatArray | None) -> dict[str, float]:
        """Rates by name that turn the first tool towards an orientation (4,)."""
        control = self._env.control
        if wanted is None:
            return {}
        away = to_rotation_vector(multiply(wanted, conjugate(self._orientation)))
        rates = np.clip(away / (APPROACH * float(control.max_rotation_rate)), -1.0, 1.0)
        return {f"rotation_{axis}": float(rates["xyz".index(axis)]) for axis in control.layout.rotations}

    def _opening(self, operator_input: OperatorInput) -> dict[str, float]:
        """Rate by name that moves the jaws to the slider's width, until they reach it or a key moves them."""
        wanted = operator_input.opening
        if wanted is None or self._width is None:
            return {}
        if "jaw_speed" in self._rates or abs(wanted - self._width) < OPENED:
            operator_input.open(None)
            return {}
        rate = (wanted - self._width) / (APPROACH * float(self._env.control.max_jaw_speed))
        return {"jaw_speed": min(1.0, max(-1.0, rate))}

    def _key_share(self) -> float:
        """Share of the greatest velocities that keys command."""
        if self._env is None or self.panel is None:
            return 0.0
        return min(1.0, self.panel.key_speed / float(self._env.control.max_speed))

    def _toward(self, target: FloatArray) -> FloatArray:
        """(3,) rates that move the grip towards a position."""
        rate: FloatArray = (target - self._grip) / (APPROACH * float(self._env.control.max_speed))
        # Scale all components together, so that limiting the speed keeps the direction.
        return rate / max(1.0, float(np.abs(rate).max()))
