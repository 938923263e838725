from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.envs.control import FALCON_WORKSPACE, VelocityControl, Workspace, as_action

PERIOD = 0.05
WORKSPACE = Workspace((0.5, -1.0, 7.0), length=0.02)
coordinates = st.floats(-0.0508, 0.0508)
fractions = st.floats(-1.0, 1.0)


def test_the_workspace_is_the_falcons_cube() -> None:
    assert FALCON_WORKSPACE == pytest.approx(4 * 0.0254)
    assert (WORKSPACE.high - WORKSPACE.low).tolist() == [0.1016] * 3
    # 20 mm to the unit: the cube is 5.08 units wide.
    assert WORKSPACE.to_scene(WORKSPACE.high) == pytest.approx([3.04, 1.54, 9.54])
    assert WORKSPACE.from_scene((0.5, -1.0, 7.0)).tolist() == [0.0, 0.0, 0.0]


@given(st.tuples(coordinates, coordinates, coordinates))
def test_frames_are_inverse_to_each_other(point: tuple[float, float, float]) -> None:
    assert WORKSPACE.from_scene(WORKSPACE.to_scene(point)) == pytest.approx(point, abs=1e-12)


def test_the_action_is_a_fraction_of_the_greatest_speed() -> None:
    control = VelocityControl(WORKSPACE, 0.1, PERIOD)
    velocity = control.velocity(np.array([[1.0, -0.5, 0.25], [0.0, 0.0, -1.0]]), np.zeros((2, 3)))
    assert velocity == pytest.approx(np.array([[0.1, -0.05, 0.025], [0.0, 0.0, -0.1]]))


@given(st.tuples(fractions, fractions, fractions), st.tuples(coordinates, coordinates, coordinates))
def test_the_tool_stops_at_the_faces(action: tuple[float, float, float], position: tuple[float, float, float]) -> None:
    control = VelocityControl(WORKSPACE, 0.1, PERIOD)
    velocity = control.velocity(np.array([action]), np.array([position]))[0]
    after = position + velocity * PERIOD
    wanted = position + 0.1 * np.array(action) * PERIOD
    # Where the face is not in the way, the action is carried out; elsewhere the tool ends on the face.
    assert after == pytest.approx(np.clip(wanted, -0.0508, 0.0508), abs=1e-12)


@pytest.mark.parametrize("speed", [0.0, -0.1, np.inf, np.nan])
def test_impossible_speeds_are_refused(speed: float) -> None:
    with pytest.raises(ValueError, match="max_speed must be positive and finite"):
        VelocityControl(WORKSPACE, speed, PERIOD)


def test_actions_beyond_the_bounds_are_clipped() -> None:
    assert as_action([2.0, -3, 0.5], 3).tolist() == [1.0, -1.0, 0.5]


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ([0.0, np.nan, 0.0], "action must be finite, got"),
        ([np.inf, 0.0, 0.0], "action must be finite, got"),
        ([0.0, 0.0], r"action must have shape \(3,\), got \(2,\)"),
        ([[0.0, 0.0, 0.0]], r"action must have shape \(3,\), got \(1, 3\)"),
        ("up", "action must be 3 numbers in"),
        (None, r"action must have shape \(3,\), got \(\)"),
    ],
)
def test_malformed_actions_are_refused(action: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        as_action(action, 3)


def test_the_callers_action_is_left_alone() -> None:
    action = np.array([2.0, 0.0, 0.0])
    as_action(action, 3)
    assert action.tolist() == [2.0, 0.0, 0.0]
