from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from render_helpers import decode, encode

from spatula_env.render import PRESSURE, SPEED, ColorMap
from spatula_env.render import palette as colors

parts = st.floats(0.0, 1.0)
triples = st.tuples(parts, parts, parts)


@given(triples)
def test_transfer_curve(color):
    np.testing.assert_allclose(colors.srgb_to_linear(color), decode(color), atol=1e-12)
    np.testing.assert_allclose(colors.linear_color(color), decode(color), atol=1e-12)
    np.testing.assert_allclose(colors.linear_to_srgb(decode(color)), encode(decode(color)), atol=1e-12)


@given(triples)
def test_oklab_and_back(color):
    np.testing.assert_allclose(colors.oklab_to_srgb(colors.srgb_to_oklab(color)), color, atol=1e-5)


def test_oklab_of_white_and_grey():
    np.testing.assert_allclose(colors.srgb_to_oklab((1.0, 1.0, 1.0)), (1.0, 0.0, 0.0), atol=1e-4)
    np.testing.assert_allclose(colors.srgb_to_oklab((0.5, 0.5, 0.5))[1:], (0.0, 0.0), atol=1e-4)


@pytest.mark.parametrize("color_map", [PRESSURE, SPEED])
def test_lightness_only_falls(color_map):
    lab = colors.srgb_to_oklab(color_map.table)
    assert (np.diff(lab[:, 0]) < 0).all()


@pytest.mark.parametrize("color_map", [SPEED, ColorMap(PRESSURE.stops)])
def test_steps_are_even(color_map):
    lab = colors.srgb_to_oklab(color_map.table)
    steps = np.linalg.norm(np.diff(lab, axis=0), axis=1)
    # Equal but for the steps that go around a stop.
    assert np.median(np.abs(steps / np.median(steps) - 1)) < 0.01
    assert steps.max() < 1.1 * np.median(steps)


def test_a_map_begins_and_ends_with_its_stops():
    np.testing.assert_allclose(PRESSURE(0.0), colors.TISSUE, atol=1e-5)
    np.testing.assert_allclose(PRESSURE([-1.0, 2.0, 9.0], 2.0, 4.0)[:2], [colors.TISSUE] * 2, atol=1e-5)
    np.testing.assert_allclose(PRESSURE([9.0], 2.0, 4.0)[0], PRESSURE.stops[-1], atol=1e-5)
    assert PRESSURE(np.zeros((2, 5))).shape == (2, 5, 3)


def test_stops_are_reached_where_asked_for():
    limits = np.array([0.0, *colors.PRESSURE_LIMITS, colors.HIGHEST_PRESSURE])
    # To one of 255 steps of the table.
    np.testing.assert_allclose(PRESSURE(limits, 0.0, colors.HIGHEST_PRESSURE), PRESSURE.stops, atol=0.015)
    halves = ColorMap(((0.0, 0.0, 0.0), (0.4, 0.3, 0.3), (0.9, 0.8, 0.8)), positions=(0.0, 0.2, 1.0))
    lab = colors.srgb_to_oklab(halves.table)
    steps = np.linalg.norm(np.diff(lab, axis=0), axis=1)
    assert np.ptp(steps[:50]) < 0.02 * steps[0]
    assert np.ptp(steps[52:]) < 0.02 * steps[60]


def test_limits_of_pressure_can_be_told_apart():
    lab = colors.srgb_to_oklab(PRESSURE.stops)
    # A difference of 0.02 is just seen; these are seen at a glance.
    assert np.linalg.norm(np.diff(lab, axis=0), axis=1).min() > 0.1


@given(st.floats(0.0, 1.0))
def test_a_map_joins_its_table(value):
    grey = ColorMap(((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
    lightness = colors.srgb_to_oklab(grey(value))[0]
    assert lightness == pytest.approx(value, abs=0.01)


def test_the_table_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        PRESSURE.table[0, 0] = 0.0


def test_bad_maps_and_values():
    with pytest.raises(ValueError, match="stops"):
        ColorMap(((0.0, 0.0, 0.0),))
    with pytest.raises(ValueError, match="stops"):
        ColorMap(((0.0, 0.0, 0.0), (0.0, 0.0, 2.0)))
    with pytest.raises(ValueError, match="stops must differ"):
        ColorMap(((0.1, 0.1, 0.1), (0.1, 0.1, 0.1)))(0.5)
    for positions in ((0.0, 0.5), (0.0, 0.0, 1.0), (0.1, 0.5, 1.0), (0.0, 0.5, 0.9)):
        with pytest.raises(ValueError, match="positions must ascend from 0 to 1, 3 of them"):
            ColorMap(((0.0, 0.0, 0.0), (0.5, 0.5, 0.5), (1.0, 1.0, 1.0)), positions)
    with pytest.raises(ValueError, match="high"):
        PRESSURE(0.0, 1.0, 1.0)
    with pytest.raises(ValueError, match="NaN"):
        PRESSURE([0.0, np.nan])
