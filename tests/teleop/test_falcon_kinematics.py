from __future__ import annotations

import math

import numpy as np
import pytest
from falcon_helpers import workspace_points
from hypothesis import example, given
from hypothesis import strategies as st

from spatula_env.teleop.emulator import legs
from spatula_env.teleop.falcon import frames, kinematics

POINTS = workspace_points(300)
WIDTH = frames.HALF_WIDTH
inside = st.tuples(
    st.floats(-WIDTH, WIDTH), st.floats(-WIDTH, WIDTH), st.floats(frames.CENTRE - WIDTH, frames.CENTRE + WIDTH)
)
forces = st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))


@pytest.mark.parametrize(
    ("depth", "degrees"), [(0.09, -1.055), (0.11, 16.188), (0.13, 31.494), (0.15, 47.243), (0.17, 66.756)]
)
def test_known_angles_on_the_axis(depth, degrees):
    np.testing.assert_allclose(np.degrees(kinematics.inverse((0.0, 0.0, depth))), degrees, atol=6e-4)


@given(inside)
def test_inverse_after_forward_and_forward_after_inverse(position):
    angles = kinematics.inverse(position)
    found = kinematics.forward(angles)
    assert math.dist(found, position) < 1e-12
    np.testing.assert_allclose(kinematics.inverse(found), angles, atol=1e-11)


@given(inside, inside)
@example((-0.0390625, -0.039939834177718174, 0.080078125), (0.02734375, 0.0390625, 0.1484375))
@example((-0.0390625, -0.039939834177718174, 0.080078125), (0.02734375, 0.0390625, 0.15625))
def test_forward_does_not_depend_on_where_it_starts(position, start):
    assert math.dist(kinematics.forward(kinematics.inverse(position), start), position) < 1e-12


def test_forward_starts_anew_from_an_impossible_start():
    assert (
        math.dist(kinematics.forward(kinematics.inverse((0.01, 0.0, 0.12)), (9.0, 0.0, 0.0)), (0.01, 0.0, 0.12)) < 1e-12
    )


@given(inside)
def test_jacobian_is_the_derivative(position):
    _, jacobian = kinematics.inverse_with_jacobian(position)
    step = 1e-6
    for axis in range(3):
        ahead, behind = list(position), list(position)
        ahead[axis] += step
        behind[axis] -= step
        difference = np.subtract(kinematics.inverse(tuple(ahead)), kinematics.inverse(tuple(behind))) / (2 * step)
        # Towards the far corners the legs are nearly stretched, and third derivatives large.
        np.testing.assert_allclose(np.array(jacobian)[:, axis], difference, rtol=1e-5, atol=1e-4)


@given(inside, forces, forces)
def test_power_of_torques_is_power_of_force(position, force, velocity):
    _, jacobian = kinematics.inverse_with_jacobian(position)
    torques = kinematics.torques(force, jacobian)
    assert np.dot(torques, np.array(jacobian) @ velocity) == pytest.approx(np.dot(force, velocity), abs=1e-9)


@pytest.mark.parametrize("position", POINTS)
def test_agrees_with_vectors_along_the_links(position):
    np.testing.assert_allclose(np.degrees(kinematics.inverse(position)), legs.leg_angles(position), atol=1e-9)
    assert kinematics.angles_to_counts(kinematics.inverse(position)) == legs.encoder_counts(position)


@pytest.mark.parametrize("position", POINTS[:60])
@pytest.mark.parametrize("force", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (-0.5, 0.7, 0.3)])
def test_force_comes_out_of_the_mechanism_as_it_was_asked_for(position, force):
    _, jacobian = kinematics.inverse_with_jacobian(position)
    torques = kinematics.torques(force, jacobian)
    counts, scale, _ = kinematics.torques_to_counts(torques)
    assert scale == 1.0
    # Half a count on each motor is what rounding may cost.
    rounding = 0.5e-4 * np.abs(np.array(jacobian)).sum(axis=0)
    assert (np.abs(np.subtract(legs.grip_force(position, counts), force)) <= rounding + 1e-12).all()


def test_encoders_tell_the_position_within_a_count():
    for position in POINTS:
        counts = legs.encoder_counts(position)
        found = kinematics.forward(kinematics.counts_to_angles(counts))
        back = np.array(kinematics.inverse(found)) - np.array(kinematics.inverse(position))
        assert np.abs(back).max() <= 0.5 * kinematics.COUNT_ANGLE * (1 + 1e-6)
        # What half a count is worth in millimetres differs over the workspace.
        _, jacobian = kinematics.inverse_with_jacobian(position)
        bound = 0.5 * kinematics.COUNT_ANGLE * np.abs(np.linalg.inv(np.array(jacobian))).sum(axis=1)
        assert (np.abs(np.subtract(found, position)) <= 1.05 * bound).all()


def test_a_turn_has_as_many_counts_as_encoder_and_gear_give():
    assert 2 * math.pi / kinematics.COUNT_ANGLE == pytest.approx(9880.7, abs=0.05)


@given(st.tuples(*[st.floats(-10.0, 10.0)] * 3))
def test_saturation_keeps_the_direction(torques):
    counts, scale, _ = kinematics.torques_to_counts(torques)
    assert max(map(abs, counts)) <= 4095
    assert 0.0 < scale <= 1.0
    np.testing.assert_allclose(counts, -10_000.0 * scale * np.array(torques), atol=0.5 + 1e-9)
    if scale < 1.0:
        assert max(map(abs, counts)) == 4095


@given(st.tuples(*[st.floats(-0.4, 0.4)] * 3))
def test_rounding_is_made_up_for_by_the_next_packets(torques):
    owed, sent = (0.0, 0.0, 0.0), []
    for _ in range(100):
        counts, _, owed = kinematics.torques_to_counts(torques, owed=owed)
        sent.append(counts)
    np.testing.assert_allclose(np.mean(sent, axis=0), -10_000.0 * np.array(torques), atol=0.5 / 100 + 1e-9)


@pytest.mark.parametrize("position", [(0.0, 0.0, 0.3), (0.2, 0.0, 0.12), (0.05, 0.0, 0.17)])
def test_out_of_reach(position):
    with pytest.raises(kinematics.UnreachableError, match="does not reach"):
        kinematics.inverse(position)


@pytest.mark.parametrize("degrees", [(118.0, 118.0, 118.0), (200.0, 0.0, 0.0), (115.0, -70.0, -70.0)])
def test_impossible_angles(degrees):
    with pytest.raises(kinematics.UnreachableError, match="cannot stand"):
        kinematics.forward(tuple(map(math.radians, degrees)))


def test_frames_are_inverse_to_each_other_and_right_handed():
    assert frames.position_to_device((0.01, 0.02, frames.CENTRE + 0.03)) == pytest.approx((0.01, -0.03, 0.02))
    for position in POINTS[:5]:
        assert frames.position_to_falcon(frames.position_to_device(position)) == pytest.approx(position)
        assert frames.direction_to_falcon(frames.direction_to_device(position)) == pytest.approx(position)
    columns = [frames.direction_to_device(tuple(row)) for row in np.eye(3).tolist()]
    assert np.linalg.det(np.array(columns)) == pytest.approx(1.0)
