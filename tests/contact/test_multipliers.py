"""What constraints hand on from step to step."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from spatula_env.contact.multipliers import expect_vertices
from spatula_env.contact.structures import (
    DISPLACEMENT,
    FEATURE_LENGTH,
    FOURTH,
    GROUND,
    NO_VERTEX,
    NORMAL,
    OWNER,
    POINT,
    ROW_LENGTH,
    WEIGHTS,
    make_constraints,
    restore_constraints,
)

DT = 1.0 / 240.0


@njit
def expected_vertices(known, warm, inverse_mass, start, linear, angular, part, thrown):
    expected = np.empty_like(thrown)
    expect_vertices(known, warm.table, inverse_mass, start, linear, angular, DT, part, thrown, expected)
    return expected


def kept(displacements, points, owner, vertices=None, normal=(0.0, 0.0, 1.0)):
    """Constraints on single vertices, with what they displaced in the last step [kg u]."""
    count = len(points)
    rows, features = np.zeros((count, ROW_LENGTH)), np.zeros((count, FEATURE_LENGTH), dtype=np.int32)
    features[:, FOURTH] = NO_VERTEX
    rows[:, WEIGHTS], rows[:, NORMAL : NORMAL + 3], rows[:, POINT : POINT + 3] = 1.0, normal, points
    rows[:, DISPLACEMENT : DISPLACEMENT + 3] = np.asarray(displacements)[:, None] * np.asarray(normal)
    features[:, :3] = np.arange(count)[:, None] if vertices is None else np.asarray(vertices)[:, None]
    features[:, OWNER] = owner
    warm = make_constraints(count)
    restore_constraints(warm, np.arange(count), features, rows)
    return warm


@given(st.floats(0.01, 0.5), st.floats(0.0, 2.0), st.floats(0.1, 0.95))
def test_a_surface_is_expected_a_little_behind_what_holds_it(depth, change, part):
    # It was put back by 0.2 in the last step, and is thrown to some other depth in this one.
    mass, displaced = 3.0, depth * change
    warm = kept([mass * displaced], [(0.0, 0.0, 1.0)], GROUND)
    thrown = np.array([[0.0, 0.0, 1.0 - depth]])
    zeros = np.zeros((1, 3))
    height = expected_vertices(1, warm, np.array([1.0 / mass]), zeros, zeros, zeros, part, thrown)[0, 2]
    assert height == pytest.approx(1.0 - depth + part * min(displaced, depth))
    assert 1.0 - depth <= height < 1.0


def test_what_no_longer_meets_its_plane_is_expected_where_it_goes():
    zeros = np.zeros((1, 3))
    warm = kept([0.3], [(0.0, 0.0, 1.0)], GROUND)
    thrown = np.array([[0.0, 0.0, 1.1]])
    np.testing.assert_array_equal(expected_vertices(1, warm, np.ones(1), zeros, zeros, zeros, 0.9, thrown), thrown)


def test_planes_move_on_with_their_tool():
    # The tool turns about its origin while it rises; its point, at (1, 0, 0) from there, goes up and sideways.
    start, linear, angular = np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 2.4]]), np.array([[0.0, -4.8, 0.0]])
    warm = kept([1.0], [(1.0, 0.0, 1.0)], 0)
    thrown = np.array([[1.0, 0.0, 0.5]])
    expected = expected_vertices(1, warm, np.ones(1), start, linear, angular, 0.5, thrown)
    # Half of the way to where the plane is now.
    plane = 1.0 + DT * (2.4 + 4.8)
    assert expected[0, 2] == pytest.approx(0.5 + 0.5 * (plane - 0.5))


def test_fixed_vertices_are_not_expected_to_move():
    zeros = np.zeros((1, 3))
    warm = kept([0.3, 0.3], [(0.0, 0.0, 1.0)] * 2, GROUND)
    thrown = np.array([[0.0, 0.0, 0.8], [0.0, 0.0, 0.8]])
    expected = expected_vertices(2, warm, np.array([0.0, 1.0]), zeros, zeros, zeros, 0.9, thrown)
    assert expected[0, 2] == 0.8
    assert expected[1, 2] > 0.9
