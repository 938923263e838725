"""The page's panel: what goes on, force and pressure as bars and as a plot, and settings."""

from __future__ import annotations

import html
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from spatula_env.render.palette import FORCE, HIGHEST_PRESSURE, PRESSURE, PRESSURE_LIMITS, Color

SPAN = 10.0
"""How much of the past the plot shows [s]."""
FORCE_STEPS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
"""Ends of the force's bar [N]: the first that is not exceeded."""
HIGHEST = 1e-3 * HIGHEST_PRESSURE
LOWER, UPPER = (1e-3 * limit for limit in PRESSURE_LIMITS)
"""Pressures that warn [kPa]."""
PLOT_EVERY = 2
"""Bars are shown so many times as often as the plot."""
KEY_SPEED = 0.03
"""Speed of the tool by keys at first [m/s]."""

STYLE = """<style>
.sp{font:13px/1.35 system-ui,sans-serif;padding:2px 14px 6px 10px}
.sp b{font-weight:600}.sp .n{float:right;font-variant-numeric:tabular-nums}
.sp .bar{position:relative;height:18px;margin:3px 0 2px;border-radius:4px;background:#8884;overflow:hidden}
.sp .bar i{position:absolute;left:0;top:0;bottom:0}
.sp .bar u{position:absolute;top:0;bottom:0;width:2px;margin-left:-1px;box-shadow:0 0 0 1px #fffa}
.sp .scale{position:relative;height:15px;font-size:11px;opacity:.8;margin-bottom:8px}
.sp .scale span{position:absolute;white-space:nowrap;transform:translateX(-50%)}
.sp .state{font-size:16px;font-weight:600;padding:4px 0}.sp .dot{color:#d11f2f}
.sp .small{font-size:12px;opacity:.85}
</style>"""


@dataclass(frozen=True)
class Reading:
    """What is measured at the end of a control step.

    Attributes:
        time: Since the episode began [s].
        force: Magnitude of the contact force [N].
        pressure: Greatest contact pressure [Pa].
        within_tolerance: Whether the goal is fulfilled now.
        success: Whether it has been held.
        cost: Of the episode [Pa s].
        goal: What is asked, in words.
    """

    time: float
    force: float
    pressure: float
    within_tolerance: bool = False
    success: bool = False
    cost: float = 0.0
    goal: str = ""


@dataclass(frozen=True)
class Status:
    """What goes on.

    Attributes:
        text: In a few words.
        detail: What to do, or what has been done.
        recording: Whether this is being recorded.
    """

    text: str
    detail: str = ""
    recording: bool = False


class Panel:
    """The part of a page beside the view.

    Attributes:
        gui: viser's, to add further things to.
        commands: Folder for buttons, between the status and the instruments.
    """

    def __init__(self, server: Any, title: str = "spatula") -> None:
        """Add everything to a page.

        Args:
            server: viser's.
            title: Over the panel.
        """
        self.gui = gui = server.gui
        gui.set_panel_label(title)
        gui.configure_theme(
            control_width="medium",
            show_logo=False,
            show_share_button=False,
            brand_color=tuple(round(255.0 * value) for value in FORCE),
        )
        gui.main_panel.dock_right()
        self._status = gui.add_html(STYLE)
        self.commands = gui.add_folder("Episode")
        self._bars = gui.add_html("")
        self._plot = self._add_plot()
        with gui.add_folder("View and keys", expand_by_default=False):
            self.speed = gui.add_slider("Key speed [mm/s]", 5, 100, 5, round(1e3 * KEY_SPEED))
            self.gizmo = gui.add_checkbox("Arrows to drag by", True)
            self.see_through = gui.add_checkbox("See through the organ", False)
            self.home = gui.add_button("First view")
            gui.add_markdown(HELP)
        self._past: deque[tuple[float, float, float]] = deque()
        self._clock = 0.0
        self._last = 0.0
        self._shown = 0
        self._reading = Reading(0.0, 0.0, 0.0)
        self._force_end = FORCE_STEPS[0]
        self.say(Status("Waiting"))
        self._show_bars(self._reading)

    @property
    def key_speed(self) -> float:
        """How fast keys move the tool [m/s]."""
        return 1e-3 * float(self.speed.value)

    def add_command(self, label: str, on_click: Callable[[], None], *, color: Any = None, hint: str = "") -> Any:
        """Add a button.

        Args:
            label: On it.
            on_click: Called by a thread of viser's.
            color: One of viser's names of colours.
            hint: Shown under the mouse.

        Returns:
            viser's handle.
        """
        with self.commands:
            button = self.gui.add_button(label, color=color, hint=hint or None)

        button.on_click(lambda _: on_click())
        return button

    def say(self, status: Status) -> None:
        """Say what goes on."""
        dot = '<span class="dot">●</span> ' if status.recording else ""
        text, detail = html.escape(status.text), html.escape(status.detail)
        content = f'{STYLE}<div class="sp"><div class="state">{dot}{text}</div><div class="small">{detail}</div></div>'
        if content != self._status.content:
            self._status.content = content

    def add(self, reading: Reading) -> None:
        """Take what is measured, once in each control step."""
        # The plot goes on from one episode to the next.
        self._clock += reading.time - self._last if reading.time > self._last else 0.0
        self._last = reading.time
        self._past.append((self._clock, 1e-3 * reading.pressure, reading.force))
        while self._past[0][0] < self._clock - SPAN:
            self._past.popleft()
        self._reading = reading

    def show(self) -> None:
        """Show what was measured last, and before."""
        force = self._reading.force
        if force > self._force_end:
            self._force_end = next((step for step in FORCE_STEPS if force <= step), FORCE_STEPS[-1])
            self._plot.scales = _scales(self._force_end)
        self._show_bars(self._reading)
        self._shown += 1
        if self._shown % PLOT_EVERY == 0:
            self._plot.data = self._curves()

    # Bars.

    def _show_bars(self, reading: Reading) -> None:
        end = self._force_end
        kilo = 1e-3 * reading.pressure
        warm = _css(PRESSURE(np.array([max(reading.pressure, 900.0)]), 0.0, HIGHEST_PRESSURE)[0])
        limits = [(LOWER, _css(PRESSURE_COLORS[0])), (UPPER, _css(PRESSURE_COLORS[1]))]
        goal = "reached" if reading.success else "hold it" if reading.within_tolerance else "not yet"
        self._bars.content = (
            '<div class="sp">'
            + _bar("Contact force", f"{reading.force:.2f} N", reading.force, end, _css(FORCE))
            + _scale([(0.0, "0"), (0.5 * end, f"{0.5 * end:g}"), (end, f"{end:g} N")], end)
            + _bar("Peak pressure", f"{kilo:.2f} kPa", kilo, HIGHEST, warm, limits)
            + _scale(
                [(0.0, "0"), (LOWER, f"{LOWER:.2f}"), (UPPER, f"{UPPER:.1f}"), (HIGHEST, f"{HIGHEST:g} kPa")], HIGHEST
            )
            + f'<div><b>Goal</b><span class="n">{goal}</span></div>'
            + f'<div class="small">{html.escape(reading.goal)}</div>'
            + f'<div class="small">Cost of the episode<span class="n">{reading.cost:.0f} Pa s</span></div></div>'
        )

    # The plot.

    def _add_plot(self) -> Any:
        colors = (_css(PRESSURE_COLORS[1]), _css(FORCE), *(_css(color) for color in PRESSURE_COLORS))
        series: tuple[Any, ...] = (
            {"label": "s"},
            {"label": "pressure [kPa]", "stroke": colors[0], "width": 2, "scale": "kPa"},
            {"label": "force [N]", "stroke": colors[1], "width": 2, "scale": "N"},
            {"label": f"{LOWER:.2f} kPa", "stroke": colors[2], "width": 1.5, "dash": (6, 4), "scale": "kPa"},
            {"label": f"{UPPER:.1f} kPa", "stroke": colors[3], "width": 1.5, "dash": (6, 4), "scale": "kPa"},
        )
        past = np.array([-SPAN, 0.0])
        return self.gui.add_uplot(
            (past, np.zeros(2), np.zeros(2), np.full(2, LOWER), np.full(2, UPPER)),
            series,
            scales=_scales(FORCE_STEPS[0]),
            axes=(
                {"scale": "x", "size": 28},
                {"scale": "kPa", "stroke": colors[0], "size": 34},
                {"scale": "N", "side": 1, "stroke": colors[1], "size": 38, "grid": {"show": False}},
            ),
            legend={"show": False},
            height=190,
            padding=(10, 0, 0, 0),
        )

    def _curves(self) -> tuple[Any, ...]:
        past = np.array(self._past)
        if len(past) < 2:
            past = np.repeat(past, 2, axis=0)
        # The limits go all the way.
        time = np.concatenate([[-SPAN], past[:, 0] - self._clock])
        empty = np.full(1, np.nan)
        pressure, force = (np.concatenate([empty, past[:, column]]) for column in (1, 2))
        return time, pressure, force, np.full(len(time), LOWER), np.full(len(time), UPPER)


PRESSURE_COLORS: tuple[Color, Color] = (PRESSURE.stops[1], PRESSURE.stops[2])
"""Of the two limits."""

HELP = """
| | |
|---|---|
| drag the tool | up and down, and sideways |
| shift + drag | at its height |
| W A S D, arrows | x, y |
| E, Q, page up, page down | up, down |
| U J, I K, O L | turn about x, y, z |
| full stop, comma | open, close jaws |
| shift | slow |
"""


def _scales(most_force: float) -> dict[str, Any]:
    return {
        # All of the data, which always goes from -SPAN to 0.
        "x": {"time": False},
        "kPa": {"range": (0.0, HIGHEST)},
        "N": {"range": (0.0, most_force)},
    }


def _bar(
    name: str, value: str, length: float, end: float, color: str, limits: list[tuple[float, str]] | None = None
) -> str:
    lines = "".join(f'<u style="left:{100.0 * at / end:.2f}%;background:{stroke}"></u>' for at, stroke in limits or ())
    width = 100.0 * min(max(length / end, 0.0), 1.0)
    return (
        f'<div><b>{name}</b><span class="n">{value}</span></div>'
        f'<div class="bar"><i style="width:{width:.2f}%;background:{color}"></i>{lines}</div>'
    )


def _scale(marks: list[tuple[float, str]], end: float) -> str:
    spans = []
    for at, text in marks:
        share = at / end
        # The first and the last stay within the bar.
        shift = "0" if share == 0.0 else "-100%" if share == 1.0 else "-50%"
        spans.append(f'<span style="left:{100.0 * share:.2f}%;transform:translateX({shift})">{text}</span>')
    return f'<div class="scale">{"".join(spans)}</div>'


def goal_in_words(names: tuple[str, ...], units: tuple[str, ...], goal: Any) -> str:
    """A goal (G,) in words, in units that are easy to read.

    Args:
        names: Of its numbers.
        units: Of its numbers: "m", "rad", "1", "N".
        goal: (G,).
    """
    said = []
    for name, unit, value in zip(names, units, goal, strict=True):
        factor, shown = {"m": (1e3, "mm"), "rad": (57.29577951308232, "°"), "1": (100.0, "%")}.get(unit, (1.0, unit))
        said.append(f"{name.replace('_', ' ')} {factor * float(value):.3g} {shown}")
    return ", ".join(said)


def _css(color: Any) -> str:
    return "#" + "".join(f"{round(255.0 * float(value)):02x}" for value in color)
