"""Measurements and status that the page shows, and how it words them."""

from __future__ import annotations

import html
import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from spatula_env.render.palette import CAUTION, FORCE, GOAL, MARKER, PRESSURE
from spatula_env.tasks.criteria import Criterion

SHOWN_UNITS: dict[str, tuple[float, str, int]]
"""For each unit: factor to the displayed unit, its name, and the number of decimals."""
SHOWN_UNITS = {"m": (1e3, "mm", 1), "rad": (math.degrees(1.0), "°", 1), "1": (100.0, "%", 0), "N": (1.0, "N", 2)}


ROLE_COLORS = MappingProxyType({"goal": GOAL, "target": MARKER, "caution": CAUTION})
"""Colours of the marks in the picture, by role."""


@dataclass(frozen=True)
class Reading:
    """Measurements at the end of a control step.

    Attributes:
        time: Time since the episode began [s].
        force: Magnitude of the contact force [N].
        pressure: Greatest contact pressure [Pa].
        success: Whether the goal has been held in this episode.
        dose: Pressure dose in the episode [Pa s].
        held: Time for which the goal has been held [s].
        hold_time: Time for which it has to be held [s].
        criteria: Criteria of the goal.
        opening: Free width between the jaws [m]; None without jaws.
    """

    time: float
    force: float
    pressure: float
    success: bool = False
    dose: float = 0.0
    held: float = 0.0
    hold_time: float = 0.0
    criteria: tuple[Criterion, ...] = ()
    opening: float | None = None


@dataclass(frozen=True)
class Status:
    """Status of the session.

    Attributes:
        text: Status in a few words.
        detail: What to do, or what was done.
        recording: Whether the episode is being recorded.
    """

    text: str
    detail: str = ""
    recording: bool = False


def in_words(value: float, unit: str, *, named: bool = True) -> str:
    """Format a number in a unit that is easy to read.

    Args:
        value: In SI units.
        unit: "m", "rad", "1", "N", or any other, which is shown unchanged.
        named: Whether to name the unit.
    """
    factor, name, decimals = SHOWN_UNITS.get(unit, (1.0, unit, 2))
    # Adding 0.0 removes the sign of a negative zero.
    shown = f"{round(factor * value, decimals) + 0.0:.{decimals}f}".replace("-", "\N{MINUS SIGN}")
    return f"{shown}{'' if name == '°' else ' '}{name}".rstrip() if named else shown


def wanted_in_words(criterion: Criterion) -> str:
    """A criterion's goal in words."""
    low, high, unit = criterion.low, criterion.high, criterion.unit
    if low == high:
        return in_words(low, unit)
    if math.isinf(low):
        return f"≤ {in_words(high, unit)}"
    if math.isinf(high):
        return f"≥ {in_words(low, unit)}"
    return f"{in_words(0.5 * (low + high), unit, named=False)} ± {in_words(0.5 * (high - low), unit)}"


def criteria_table(reading: Reading) -> str:
    """Table of the goal's criteria, the values achieved and the time for which they have been held, as HTML."""
    rows = [
        '<tr><th colspan="2">Goal</th><th class="n">now</th><th class="n">wanted</th></tr>',
        *(_criterion_row(criterion) for criterion in reading.criteria),
    ]
    content = f'<table class="goal">{"".join(rows)}</table>' if reading.criteria else ""
    if reading.success:
        return content + f'<div class="success" role="status">✓ Success: held for {reading.hold_time:g} s</div>'
    share = 100.0 * min(reading.held / reading.hold_time, 1.0) if reading.hold_time > 0.0 else 0.0
    return content + (
        f'<div class="hold"><i style="width:{share:.0f}%"></i>'
        f"<span>all ✓ for {reading.hold_time:g} s without a break: {reading.held:.1f} s</span></div>"
    )


def colors_in_words(roles: tuple[str, ...]) -> str:
    """Legend of the colours in the picture, as HTML.

    Args:
        roles: Roles of the marks that are shown: "goal", and those of patches.
    """
    meanings = {"goal": "goal", "target": "what is to be moved", "caution": "to be spared"}
    named = [(ROLE_COLORS[role], said) for role, said in meanings.items() if role in roles]
    named += [(FORCE, "force"), (PRESSURE.stops[1], "pressure")]
    spans = (f'<span><i style="background:{css_color(color)}"></i>{said}</span>' for color, said in named)
    return f'<div class="colors">{"".join(spans)}</div>'


def css_color(color: Any) -> str:
    """A colour in CSS notation.

    Args:
        color: Three numbers in [0, 1].
    """
    return "#" + "".join(f"{round(255.0 * float(value)):02x}" for value in color)


def _criterion_row(criterion: Criterion) -> str:
    kind, sign, said = ("ok", "✓", "within tolerance") if criterion.within else ("off", "○", "not within tolerance")
    present = html.escape(criterion.note or in_words(criterion.present, criterion.unit))
    name = html.escape(criterion.name)
    return (
        f'<tr class="{kind}"><td aria-label="{said}" title="{said}">{sign}</td><td>{name}</td>'
        f'<td class="n"><b>{present}</b></td><td class="n">{html.escape(wanted_in_words(criterion))}</td></tr>'
    )
