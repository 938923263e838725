"""When moving features meet, against a fine sampling of time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.contact.meeting import fill_volume, find_roots, has_no_root

seeds = st.integers(0, 2**32 - 1)
TIMES = np.linspace(0.0, 1.0, 2001)


def volumes(before, now, times):
    """u x v . w at some times (T,)."""
    sides = before + np.asarray(times)[:, None, None] * (now - before)
    return np.einsum("ta,ta->t", np.cross(sides[:, 0], sides[:, 1]), sides[:, 2])


def roots_of(before, now):
    cubic, roots = np.empty(4), np.empty(3)
    fill_volume(before.ravel(), now.ravel(), cubic)
    return cubic, roots[: find_roots(cubic, roots)]


@given(seeds)
def test_every_change_of_sign_is_found(seed):
    before, now = np.random.default_rng(seed).normal(size=(2, 3, 3))
    cubic, roots = roots_of(before, now)
    sampled = volumes(before, now, TIMES)
    assert cubic[0] == pytest.approx(sampled[0]) and cubic[3] == pytest.approx(sampled[-1])
    changes = TIMES[:-1][np.sign(sampled[:-1]) != np.sign(sampled[1:])]
    # Two roots within a sample are none to it.
    assert len(roots) >= len(changes) and (len(roots) - len(changes)) % 2 == 0
    for change in changes:
        assert np.abs(roots - change).min() < 2e-3
    assert (np.diff(roots) > 0.0).all()
    for root in roots:
        assert volumes(before, now, [root - 1e-5])[0] * volumes(before, now, [root + 1e-5])[0] <= 1e-9


@given(seeds)
def test_where_no_root_is_promised_there_is_none(seed):
    generator = np.random.default_rng(seed)
    before = generator.normal(size=(3, 3))
    now = before + generator.uniform(0.0, 0.5) * generator.normal(size=(3, 3))
    cubic, roots = roots_of(before, now)
    if has_no_root(cubic):
        assert len(roots) == 0
        assert len(set(np.sign(volumes(before, now, TIMES)))) == 1


def test_two_meetings_in_one_step_are_both_found():
    """A vertex under which a turning triangle goes through it and comes back."""
    before = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.8, 0.3, 0.1]])
    now = np.array([[1.0, 0.0, 2.0], [0.0, 1.0, -2.0], [0.3, 0.3, 0.1]])
    cubic, roots = roots_of(before, now)
    assert cubic[0] > 0.0 and cubic[3] > 0.0
    np.testing.assert_allclose(roots, (1.0 + np.sqrt(0.6) * np.array([-1.0, 1.0])) / 2.0, atol=1e-5)
