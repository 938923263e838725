"""Force and pressure on the page: current values as bars, and the last seconds as curves."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from spatula_env.render.palette import HIGHEST_PRESSURE, PRESSURE, PRESSURE_LIMITS, Color
from spatula_env.teleop.web.readings import Reading, css_color

SPAN = 10.0
"""Time span of the plot [s]."""
FORCE_STEPS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
"""Possible upper ends of the force bar [N]: the first that is not exceeded is used."""
HIGHEST = 1e-3 * HIGHEST_PRESSURE
LOWER, UPPER = (1e-3 * limit for limit in PRESSURE_LIMITS)
"""Pressures from which on the page warns [kPa]."""
LIMIT_COLORS: tuple[Color, Color] = (PRESSURE.stops[1], PRESSURE.stops[2])
"""Colours of the two limits."""

FORCE_LINE, PRESSURE_LINE = "#3b82d6", "#e0455a"
LIMIT_LINES = ("#c98a1b", "#d5406a")
"""Colours of the curves, with a contrast of 3 or more to both white and the dark panel."""
PLOT_HEIGHT = 150


class Bars:
    """Bars for current force and pressure."""

    def __init__(self) -> None:
        """Start without measurements."""
        self.force_end = FORCE_STEPS[0]

    def grow(self, force: float) -> bool:
        """Extend the force bar's range to a force [N], if necessary; return whether it was."""
        if force <= self.force_end:
            return False
        before, self.force_end = self.force_end, next((step for step in FORCE_STEPS if force <= step), FORCE_STEPS[-1])
        return self.force_end != before

    def content(self, reading: Reading) -> str:
        """The bars as HTML."""
        end, kilo = self.force_end, 1e-3 * reading.pressure
        warm = css_color(PRESSURE(np.array([max(reading.pressure, 900.0)]), 0.0, HIGHEST_PRESSURE)[0])
        limits = [(LOWER, css_color(LIMIT_COLORS[0])), (UPPER, css_color(LIMIT_COLORS[1]))]
        pressures = [(0.0, "0"), (LOWER, f"{LOWER:.2f}"), (UPPER, f"{UPPER:.1f}"), (HIGHEST, f"{HIGHEST:g} kPa")]
        return (
            _bar("Contact force", f"{reading.force:.2f} N", reading.force, end, FORCE_LINE)
            + _scale([(0.0, "0"), (0.5 * end, f"{0.5 * end:g}"), (end, f"{end:g} N")], end)
            + _bar("Peak pressure", f"{kilo:.2f} kPa", kilo, HIGHEST, warm, limits)
            + _scale(pressures, HIGHEST)
            + f'<div class="small">Dose above {LOWER:.2f} kPa'
            f'<span class="n">{1e-3 * reading.dose:.2f} kPa·s</span></div>'
        )


class Plot:
    """Plot of force and pressure in the last seconds; continues across episodes."""

    def __init__(self, gui: Any) -> None:
        """Add the plot to a page.

        Args:
            gui: viser's interface.
        """
        self._past: deque[tuple[float, float, float]] = deque()
        self._clock = self._last = 0.0
        gui.add_html(f'<div class="sp">{LEGEND}</div>')
        past = np.array([-SPAN, 0.0])
        self._plot = gui.add_uplot(
            (past, np.full(2, np.nan), np.full(2, np.nan), np.full(2, LOWER), np.full(2, UPPER)),
            (
                {"label": "time [s]"},
                {"label": "pressure [kPa]", "stroke": PRESSURE_LINE, "width": 2, "scale": "kPa"},
                {"label": "force [N]", "stroke": FORCE_LINE, "width": 2, "scale": "N"},
                {"label": f"{LOWER:.2f} kPa", "stroke": LIMIT_LINES[0], "width": 1.5, "dash": (6, 4), "scale": "kPa"},
                {"label": f"{UPPER:.1f} kPa", "stroke": LIMIT_LINES[1], "width": 1.5, "dash": (2, 3), "scale": "kPa"},
            ),
            scales=_scales(FORCE_STEPS[0]),
            axes=(
                {"scale": "x", "size": 24, "label": "time before now [s]", "labelSize": 16, "labelFont": FONT},
                {"scale": "kPa", "size": 38, "label": "pressure [kPa]", "labelSize": 16, "labelFont": FONT},
                {
                    "scale": "N",
                    "side": 1,
                    "size": 38,
                    "label": "force [N]",
                    "labelSize": 16,
                    "labelFont": FONT,
                    "grid": {"show": False},
                },
            ),
            legend={"show": False},
            cursor={"show": False},
            height=PLOT_HEIGHT,
            padding=(10, 0, 0, 0),
        )

    def add(self, reading: Reading) -> None:
        """Add a measurement, once per control step."""
        self._clock += reading.time - self._last if reading.time > self._last else 0.0
        self._last = reading.time
        self._past.append((self._clock, 1e-3 * reading.pressure, reading.force))
        while self._past[0][0] < self._clock - SPAN:
            self._past.popleft()

    def show(self) -> None:
        """Show the measurements added so far."""
        past = np.array(self._past)
        # Values at both ends keep the time axis at a fixed length from the beginning.
        time = np.concatenate([[-SPAN], past[:, 0] - self._clock, [0.0]])
        pressure, force = (np.concatenate([[np.nan], past[:, column], past[-1:, column]]) for column in (1, 2))
        self._plot.data = (time, pressure, force, np.full(len(time), LOWER), np.full(len(time), UPPER))

    def scale(self, most_force: float) -> None:
        """Change the upper end of the force axis [N]."""
        self._plot.scales = _scales(most_force)


FONT = "11px system-ui, sans-serif"


def _swatch(color: str, text: str, line: str = "solid") -> str:
    return f'<span class="key"><i style="border-top:3px {line} {color}"></i>{text}</span>'


LEGEND = (
    f"<b>The last {SPAN:.0f} seconds</b>"
    f'<div class="legend">{_swatch(PRESSURE_LINE, "peak pressure (left)")}'
    f"{_swatch(FORCE_LINE, 'contact force (right)')}"
    f"{_swatch(LIMIT_LINES[0], f'{LOWER:.2f} kPa (20 mmHg)', 'dashed')}"
    f"{_swatch(LIMIT_LINES[1], f'{UPPER:.1f} kPa (30 mmHg)', 'dotted')}</div>"
)


def _scales(most_force: float) -> dict[str, Any]:
    return {
        "x": {"time": False, "range": (-SPAN, 0.0)},
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
        # Keep the first and the last label within the bar.
        shift = "0" if share == 0.0 else "-100%" if share == 1.0 else "-50%"
        spans.append(f'<span style="left:{100.0 * share:.2f}%;transform:translateX({shift})">{text}</span>')
    return f'<div class="scale">{"".join(spans)}</div>'
