"""The rigid motion that takes points to where they are now."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numba import njit
from scipy.spatial.transform import Rotation

from spatula_env.contact.rigid_fit import fit_motion, move_back, move_points

seeds = st.integers(0, 2**32 - 1)


@njit
def fitted(before, now):
    rotation, shift = np.empty((3, 3)), np.empty(3)
    fit_motion(before, now, rotation, shift)
    moved, back = np.empty_like(before), np.empty_like(now)
    move_points(before, rotation, shift, moved)
    move_back(now, rotation, shift, back)
    return rotation, moved, back


@given(seeds)
def test_a_rigid_motion_is_found(seed):
    generator = np.random.default_rng(seed)
    points = generator.normal(size=(20, 3))
    turn = Rotation.random(random_state=seed).as_matrix()
    now = points @ turn.T + generator.normal(size=3)
    rotation, moved, back = fitted(np.ascontiguousarray(points.T), now)
    np.testing.assert_allclose(rotation, turn, atol=1e-7)
    np.testing.assert_allclose(moved.T, now, atol=1e-7)
    np.testing.assert_allclose(back, points, atol=1e-7)


@given(seeds)
def test_it_is_a_rotation_that_fits_about_as_well_as_the_best(seed):
    generator = np.random.default_rng(seed)
    points = generator.normal(size=(20, 3))
    now = points @ Rotation.random(random_state=seed).as_matrix().T + 0.1 * generator.normal(size=points.shape)
    rotation, moved, _ = fitted(np.ascontiguousarray(points.T), now)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-7)
    _, distance = Rotation.align_vectors(now - now.mean(axis=0), points - points.mean(axis=0))
    assert np.linalg.norm(moved.T - now) <= distance + 1e-6


def test_points_on_a_line_tell_no_rotation():
    line = np.zeros((3, 4))
    line[0] = np.arange(4.0)
    rotation, moved, _ = fitted(line, np.ascontiguousarray(line.T) + 2.0)
    np.testing.assert_array_equal(rotation, np.eye(3))
    np.testing.assert_allclose(moved, line + 2.0)
