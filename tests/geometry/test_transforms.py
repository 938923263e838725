from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from spatula_env.geometry.transforms import (
    as_quaternion,
    as_vector3,
    integrate_rotation,
    quaternion_conjugate,
    quaternion_from_axis_angle,
    quaternion_from_matrix,
    quaternion_from_two_vectors,
    quaternion_multiply,
    random_quaternion,
    rotate,
    rotation_matrix,
    slerp,
)

numbers = st.floats(-10.0, 10.0)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
directions = vectors.filter(lambda vector: np.linalg.norm(vector) > 1e-3)
quaternions = st.integers(0, 2**32 - 1).map(lambda seed: random_quaternion(np.random.default_rng(seed)))


def same_rotation(first: np.ndarray, second: np.ndarray, tolerance: float = 1e-12) -> bool:
    return min(np.abs(first - second).max(), np.abs(first + second).max()) < tolerance


@settings(deadline=None)
@given(quaternions, vectors)
def test_rotation_keeps_length_and_agrees_with_scipy(quaternion, vector):
    turned = rotate(quaternion, vector)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(vector), abs=1e-12)
    np.testing.assert_allclose(turned, Rotation.from_quat(quaternion).apply(vector), atol=1e-12)


@settings(deadline=None)
@given(quaternions)
def test_rotation_matrix_is_a_rotation(quaternion):
    matrix = rotation_matrix(quaternion)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)


@settings(deadline=None)
@given(quaternions, quaternions, vectors)
def test_product_turns_by_the_second_factor_first(first, second, vector):
    product = quaternion_multiply(first, second)
    np.testing.assert_allclose(rotate(product, vector), rotate(first, rotate(second, vector)), atol=1e-12)


@settings(deadline=None)
@given(quaternions, vectors)
def test_conjugate_turns_back(quaternion, vector):
    back = rotate(quaternion_conjugate(quaternion), rotate(quaternion, vector))
    np.testing.assert_allclose(back, vector, atol=1e-12)


def test_rotate_takes_any_number_of_points():
    quarter = quaternion_from_axis_angle((0.0, 0.0, 2.0), 0.5 * np.pi)
    points = np.array([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0], [1.0, 1.0, 0.0]]])
    expected = np.array([[[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0], [-1.0, 1.0, 0.0]]])
    np.testing.assert_allclose(rotate(quarter, points), expected, atol=1e-12)


def test_axis_angle_is_xyzw():
    np.testing.assert_allclose(
        quaternion_from_axis_angle((0.0, 3.0, 0.0), 1.0), [0.0, np.sin(0.5), 0.0, np.cos(0.5)], atol=1e-12
    )


@settings(deadline=None)
@given(directions, directions)
def test_two_vectors_by_the_smallest_rotation(start, end):
    quaternion = quaternion_from_two_vectors(start, end)
    a, b = start / np.linalg.norm(start), end / np.linalg.norm(end)
    np.testing.assert_allclose(rotate(quaternion, a), b, atol=1e-12)
    angle = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
    assert 2.0 * np.arctan2(np.linalg.norm(quaternion[:3]), quaternion[3]) == pytest.approx(angle, abs=1e-9)


@pytest.mark.parametrize("tilt", [0.0, 1e-16, 1e-12, 1e-9, 1e-6, 1e-3])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_two_vectors_nearly_parallel_or_opposite(tilt, sign):
    start, end = np.array([0.6, 0.0, 0.8]), sign * np.array([0.6, tilt, 0.8])
    np.testing.assert_allclose(
        rotate(quaternion_from_two_vectors(start, end), start), end / np.linalg.norm(end), atol=1e-12
    )


@settings(deadline=None)
@given(quaternions)
def test_matrix_and_back(quaternion):
    assert same_rotation(quaternion_from_matrix(rotation_matrix(quaternion)), quaternion)


@pytest.mark.parametrize("axis", range(3))
def test_matrix_of_half_turn(axis):
    matrix = -np.eye(3)
    matrix[axis, axis] = 1.0
    assert same_rotation(quaternion_from_matrix(matrix), np.append(np.eye(3)[axis], 0.0))


@settings(deadline=None)
@given(quaternions, vectors, st.floats(0.0, 2.0))
def test_integration_is_the_exponential_map(quaternion, angular_velocity, dt):
    turned = integrate_rotation(quaternion, angular_velocity, dt)
    expected = Rotation.from_rotvec(angular_velocity * dt) * Rotation.from_quat(quaternion)
    assert np.linalg.norm(turned) == pytest.approx(1.0, abs=1e-12)
    assert same_rotation(turned, expected.as_quat(), 1e-11)


def test_integration_is_exact_however_time_is_cut():
    start, velocity = np.array([0.5, -0.5, 0.5, 0.5]), np.array([0.3, -2.0, 7.0])
    once = integrate_rotation(start, velocity, 1.0)
    often = start
    for _ in range(240):
        often = integrate_rotation(often, velocity, 1.0 / 240.0)
    assert same_rotation(once, often)


def test_integration_of_a_tiny_turn_keeps_its_size():
    turned = integrate_rotation(np.array([0.0, 0.0, 0.0, 1.0]), np.array([2e-9, 0.0, 0.0]), 1.0)
    assert turned[0] == pytest.approx(1e-9, rel=1e-12)


@settings(deadline=None)
@given(quaternions, quaternions, st.floats(0.0, 1.0))
def test_slerp_turns_at_a_constant_rate(start, end, fraction):
    assert same_rotation(slerp(start, end, 0.0), start)
    assert same_rotation(slerp(start, end, 1.0), end)
    whole = Rotation.from_quat(start).inv() * Rotation.from_quat(end)
    part = Rotation.from_quat(start).inv() * Rotation.from_quat(slerp(start, end, fraction))
    assert part.magnitude() == pytest.approx(fraction * whole.magnitude(), abs=1e-7)


def test_slerp_between_equal_orientations():
    quaternion = np.array([0.5, 0.5, 0.5, 0.5])
    assert same_rotation(slerp(quaternion, quaternion, 0.3), quaternion)
    assert same_rotation(slerp(quaternion, -quaternion, 0.3), quaternion)


def test_random_orientations_are_uniform():
    generator = np.random.default_rng(0)
    sample = np.array([random_quaternion(generator) for _ in range(4000)])
    np.testing.assert_allclose(np.linalg.norm(sample, axis=1), 1.0, atol=1e-12)
    # On the unit sphere in four dimensions the second moment is I / 4, the fourth of each component 1 / 8.
    np.testing.assert_allclose(sample.T @ sample / len(sample), np.eye(4) / 4.0, atol=0.015)
    np.testing.assert_allclose((sample**4).mean(axis=0), 0.125, atol=0.015)


def test_as_quaternion_normalises_what_is_nearly_unit():
    quaternion = as_quaternion([0.0, 0.0, 0.0, 1.0 + 5e-7], "orientation")
    assert quaternion.tolist() == [0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([0.0, 0.0, 0.0, 1.1], "unit quaternion"),
        ([0.0, 0.0, 0.0, 0.0], "unit quaternion"),
        ([0.0, 0.0, 1.0], r"shape \(4,\), got shape \(3,\)"),
        ([0.0, 0.0, np.nan, 1.0], "finite"),
        (["a", 0.0, 0.0, 1.0], "must be 4 numbers"),
        ([[0.0, 0.0], [0.0]], "must be 4 numbers"),
        (None, "shape"),
    ],
)
def test_as_quaternion_refuses(value, message):
    with pytest.raises(ValueError, match=f"orientation .*{message}"):
        as_quaternion(value, "orientation")


def test_as_vector3_copies():
    given_array = np.array([1.0, 2.0, 3.0])
    vector = as_vector3(given_array, "position")
    vector[0] = 9.0
    assert given_array[0] == 1.0


@pytest.mark.parametrize("value", [[1.0, 2.0], [[1.0, 2.0, 3.0]], [1.0, 2.0, np.inf], 1.0, ["x", "y", "z"]])
def test_as_vector3_refuses(value):
    with pytest.raises(ValueError, match="position must"):
        as_vector3(value, "position")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: quaternion_from_axis_angle((0, 0, 0), 1.0), "axis must have a length"),
        (lambda: quaternion_from_axis_angle((0, 0, 1), np.nan), "angle must be finite"),
        (lambda: quaternion_from_two_vectors((0, 0, 0), (1, 0, 0)), "start must have a length"),
        (lambda: quaternion_from_two_vectors((1, 0, 0), (0, 0, 0)), "end must have a length"),
        (lambda: quaternion_from_matrix(np.eye(4)), "shape"),
        (lambda: quaternion_from_matrix(2.0 * np.eye(3)), "orthogonal"),
        (lambda: quaternion_from_matrix(np.full((3, 3), np.nan)), "orthogonal"),
        (lambda: quaternion_from_matrix(np.diag([1.0, 1.0, -1.0])), "mirrors"),
        (lambda: slerp(np.eye(4)[3], np.eye(4)[3], 1.5), r"fraction must be in \[0, 1\], got 1.5"),
    ],
)
def test_impossible_rotations_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
