"""The words and numbers on the page."""

from __future__ import annotations

import math
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.tasks.criteria import Criterion
from spatula_env.teleop.web.gauges import FORCE_LINE, LIMIT_LINES, PRESSURE_LINE, SPAN, Plot
from spatula_env.teleop.web.readings import Reading, colors_in_words, criteria_table, in_words, wanted_in_words

NUMBERS = st.floats(-0.5, 0.5)


def text_of(content: str) -> str:
    return " ".join("".join(ElementTree.fromstring(f"<div>{content}</div>").itertext()).split())


@pytest.mark.parametrize(
    ("value", "unit", "words"),
    [
        (0.01234, "m", "12.3 mm"),
        (-1e-6, "m", "0.0 mm"),
        (-0.004, "m", "\N{MINUS SIGN}4.0 mm"),
        (math.radians(12.25), "rad", "12.2°"),
        (0.806, "1", "81 %"),
        (0.1449, "N", "0.14 N"),
        (1234.5, "Pa", "1234.50 Pa"),
    ],
)
def test_numbers_are_in_units_that_people_read(value, unit, words):
    assert in_words(value, unit) == words


def test_what_is_wanted_says_how_exactly():
    assert wanted_in_words(Criterion.near("depth", "m", 0.0, 0.012, 0.001)) == "12.0 ± 1.0 mm"
    assert wanted_in_words(Criterion.at_most("slip", "m", 0.0, 0.0015)) == "≤ 1.5 mm"
    assert wanted_in_words(Criterion.at_least("seen", "1", 0.0, 0.8)) == "≥ 80 %"
    assert wanted_in_words(Criterion("x", "m", 0.0, 0.003, 0.003, False)) == "3.0 mm"


def test_the_table_has_the_present_value_beside_each_goal():
    near = Criterion.near("depth", "m", 0.0118, 0.012, 0.001)
    far = Criterion.at_most("distance to place", "m", 0.0031, 0.002)
    reading = Reading(1.0, 0.0, 0.0, held=0.2, hold_time=0.5, criteria=(near, far))
    said = text_of(criteria_table(reading))
    assert "✓ depth 11.8 mm 12.0 ± 1.0 mm".replace(" ", "") in said.replace(" ", "")
    assert "○distancetoplace3.1mm≤2.0mm" in said.replace(" ", "")
    assert "for 0.5 s without a break: 0.2 s" in said and "Success" not in said
    done = Reading(2.0, 0.0, 0.0, success=True, hold_time=0.5, criteria=(near, far))
    assert "Success: held for 0.5 s" in text_of(criteria_table(done))


def test_a_note_stands_for_what_is_no_measurement():
    slip = Criterion.at_most("slip", "m", 0.02, 0.001, "no grip")
    said = text_of(criteria_table(Reading(0.0, 0.0, 0.0, criteria=(slip,))))
    assert "no grip" in said and "20.0 mm" not in said


@given(st.text(), NUMBERS, NUMBERS, st.text())
def test_names_are_no_markup(name, present, wanted, note):
    table = criteria_table(Reading(0.0, 0.0, 0.0, criteria=(Criterion.near(name, "m", present, wanted, 0.1, note),)))
    assert table.count("<tr") == 2 and table.count("<td") == 4


def test_only_colours_that_are_there_are_named():
    assert "to be moved" in colors_in_words(("target",)) and "to be moved" not in colors_in_words(("goal",))
    assert "spared" not in colors_in_words(("goal", "target"))


def luminance(color: str) -> float:
    channels = [int(color[at : at + 2], 16) / 255.0 for at in (1, 3, 5)]
    light = [value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4 for value in channels]
    return float(np.dot((0.2126, 0.7152, 0.0722), light))


@pytest.mark.parametrize("color", [FORCE_LINE, PRESSURE_LINE, *LIMIT_LINES])
@pytest.mark.parametrize("ground", ["#ffffff", "#242424"])
def test_curves_are_seen_on_light_and_on_dark(color, ground):
    # As WCAG 2.2 asks of what is not text (1.4.11).
    first, second = sorted((luminance(color), luminance(ground)))
    assert (second + 0.05) / (first + 0.05) >= 2.8


class Gui:
    """Keeps what is added."""

    def add_html(self, content):
        self.legend = content

    def add_uplot(self, data, series, **options):
        self.data, self.series, self.options, self.scales = data, series, options, options["scales"]
        return self


def test_the_plot_has_axes_titles_and_units_before_there_is_anything_to_plot():
    gui = Gui()
    plot = Plot(gui)
    assert gui.scales["x"]["range"] == (-SPAN, 0.0)
    assert [axis["label"] for axis in gui.options["axes"]] == ["time before now [s]", "pressure [kPa]", "force [N]"]
    for word in ("last 10 seconds", "pressure", "force", "2.67 kPa", "4.0 kPa"):
        assert word in gui.legend
    assert gui.data[0].tolist() == [-SPAN, 0.0]
    plot.add(Reading(0.0, 0.3, 1500.0))
    plot.show()
    assert gui.data[0][0] == -SPAN and gui.data[0][-1] == 0.0
    for step in range(300):
        plot.add(Reading(0.05 * step, 0.3, 1500.0))
        plot.show()
        assert gui.data[0][0] == -SPAN and gui.data[0][-1] == 0.0 and (np.diff(gui.data[0]) >= 0.0).all()
    assert gui.data[1][-1] == 1.5 and gui.data[2][-1] == 0.3
