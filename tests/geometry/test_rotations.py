from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.geometry import transforms
from spatula_env.geometry.rotations import conjugate, from_rotation_vector, multiply, to_rotation_vector, turn

seeds = st.integers(0, 2**32 - 1)


def draw(seed: int, count: int = 5) -> np.ndarray:
    generator = np.random.default_rng(seed)
    return np.stack([transforms.random_quaternion(generator) for _ in range(count)])


@given(seeds)
def test_many_rotations_are_as_each_alone(seed: int) -> None:
    first, second = draw(seed), draw(seed + 1)
    vectors = np.random.default_rng(seed).normal(size=(5, 3))
    for k in range(5):
        one = transforms.quaternion_multiply(first[k], second[k])
        assert multiply(first, second)[k] == pytest.approx(one, abs=1e-12)
        assert turn(first, vectors)[k] == pytest.approx(transforms.rotate(first[k], vectors[k]), abs=1e-12)
    assert turn(conjugate(first), turn(first, vectors)) == pytest.approx(vectors, abs=1e-12)


@given(seeds, st.floats(0.0, 3.1))
def test_rotation_vectors_are_axis_times_angle(seed: int, angle: float) -> None:
    axis = np.random.default_rng(seed).normal(size=(4, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    quaternions = from_rotation_vector(angle * axis)
    for k in range(4):
        assert quaternions[k] == pytest.approx(transforms.quaternion_from_axis_angle(axis[k], angle), abs=1e-12)
    # A quaternion and its negative are the same rotation.
    for sign in (1.0, -1.0):
        assert to_rotation_vector(sign * quaternions) == pytest.approx(angle * axis, abs=1e-9)


def test_tiny_turns_are_not_lost() -> None:
    tiny = np.array([[1e-9, -2e-9, 0.0], [0.0, 0.0, 0.0]])
    assert to_rotation_vector(from_rotation_vector(tiny)) == pytest.approx(tiny, rel=1e-12, abs=1e-24)


def test_axes_broadcast() -> None:
    quaternions = draw(3, 4)[:, None]
    points = np.random.default_rng(0).normal(size=(4, 6, 3))
    assert turn(quaternions, points).shape == (4, 6, 3)
    assert turn(quaternions, points)[2, 5] == pytest.approx(turn(quaternions[2, 0], points[2, 5]))
