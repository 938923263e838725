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
def test_lightness_only_falls_and_steps_are_even(color_map):
    lab = colors.srgb_to_oklab(color_map.table)
    assert (np.diff(lab[:, 0]) < 0).all()
    steps = np.linalg.norm(np.diff(lab, axis=0), axis=1)
    # Equal but for the steps that go around a stop.
    assert np.median(np.abs(steps / np.median(steps) - 1)) < 0.01
    assert steps.max() < 1.1 * np.median(steps)


def test_a_map_begins_and_ends_with_its_stops():
    np.testing.assert_allclose(PRESSURE(0.0), colors.TISSUE, atol=1e-5)
    np.testing.assert_allclose(PRESSURE([-1.0, 2.0, 9.0], 2.0, 4.0)[:2], [colors.TISSUE] * 2, atol=1e-5)
    np.testing.assert_allclose(PRESSURE([9.0], 2.0, 4.0)[0], PRESSURE.stops[-1], atol=1e-5)
    assert PRESSURE(np.zeros((2, 5))).shape == (2, 5, 3)


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
    with pytest.raises(ValueError, match="high"):
        PRESSURE(0.0, 1.0, 1.0)
    with pytest.raises(ValueError, match="NaN"):
        PRESSURE([0.0, np.nan])
