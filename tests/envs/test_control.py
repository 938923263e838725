from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env import scenes
from spatula_env.envs.control import ALL_SIX, TRANSLATION, ControlLayout, Motion, VelocityControl, as_action
from spatula_env.envs.workspace import FALCON_WORKSPACE, Workspace, place_workspace, setting_of
from spatula_env.geometry.rotations import conjugate, from_rotation_vector, multiply, to_rotation_vector, turn
from spatula_env.scenes import Scene
from spatula_env.tasks import Setting

PERIOD = 0.05
WORKSPACE = Workspace((0.5, -1.0, 7.0), length=0.02)
coordinates = st.floats(-0.0508, 0.0508)
fractions = st.floats(-1.0, 1.0)


def make_setting(scene: Scene) -> Setting:
    vertices = scene.organs[0].vertices
    return setting_of(scene, place_workspace(scene, vertices, 0.025))


SPATULA, CLAMP = make_setting(scenes.seed()), make_setting(scenes.clamp())
JAWS = ControlLayout(jaws=True, opening_range=(0.0, 0.02))


def make_control(layout: ControlLayout = TRANSLATION, setting: Setting = SPATULA, **options: float) -> VelocityControl:
    return VelocityControl(layout, setting, 0.1, **options)


def move(control: VelocityControl, actions: np.ndarray, grip: np.ndarray) -> Motion:
    return control.motion(actions, grip, *control.place(grip), PERIOD)


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
    actions = np.array([[1.0, -0.5, 0.25], [0.0, 0.0, -1.0]])
    motion = move(make_control(), actions, np.zeros((2, 3)))
    assert motion.velocity == pytest.approx(np.array([[0.1, -0.05, 0.025], [0.0, 0.0, -0.1]]))
    assert motion.linear[:, 0].tolist() == motion.velocity.tolist()
    assert not motion.angular.any()


@given(st.tuples(fractions, fractions, fractions), st.tuples(coordinates, coordinates, coordinates))
def test_the_tool_stops_at_the_faces(action: tuple[float, float, float], position: tuple[float, float, float]) -> None:
    velocity = move(make_control(), np.array([action]), np.array([position])).velocity[0]
    after = position + velocity * PERIOD
    wanted = position + 0.1 * np.array(action) * PERIOD
    # Where the face is not in the way, the action is carried out; elsewhere the tool ends on the face.
    assert after == pytest.approx(np.clip(wanted, -0.0508, 0.0508), abs=1e-12)


@given(st.lists(st.tuples(fractions, fractions, fractions), min_size=2, max_size=2), st.floats(0.0, 1.0))
def test_what_a_stop_has_left_of_a_motion_is_told(vectors: list[tuple[float, float, float]], share: float) -> None:
    control = make_control(ControlLayout(rotations="x", jaws=True), CLAMP)
    grip = np.zeros((2, 3))
    positions, orientations = control.place(grip, None, np.full((2, 1), 0.01))
    actions = np.array([[*vectors[0], 0.5, -1.0], [*vectors[1], -0.5, 1.0]])
    motion = control.motion(actions, grip, positions, orientations, PERIOD)
    after = positions + motion.linear * PERIOD
    # The first world's tools were kept from moving for a share of the time, the second's were not.
    after[0] = positions[0] + (1.0 - share) * motion.linear[0] * PERIOD
    shown = control.carried_out(motion, np.array([share, 0.0]), positions, after, PERIOD, np.ones(2))
    left = 1.0 - share
    assert shown.linear[0] == pytest.approx(left * motion.linear[0], abs=1e-12)
    assert shown.velocity[0] == pytest.approx(left * motion.velocity[0], abs=1e-12)
    assert shown.angular[0] == pytest.approx(left * motion.angular[0], abs=1e-12)
    assert shown.rate[0] == pytest.approx(left * motion.rate[0], abs=1e-12)
    opening = control.opening(np.stack([positions[0], after[0]]), np.ones(2))[:, 0]
    assert shown.coordinate_rate[0, 0] == pytest.approx((opening[1] - opening[0]) / PERIOD, abs=1e-9)
    for name in ("linear", "angular", "velocity", "rate", "coordinate_rate"):
        assert getattr(shown, name)[1].tolist() == getattr(motion, name)[1].tolist()


@pytest.mark.parametrize("speed", [0.0, -0.1, np.inf, np.nan])
@pytest.mark.parametrize("index", range(3))
def test_impossible_speeds_are_refused(speed: float, index: int) -> None:
    speeds, name = [0.1, 1.0, 0.05], ("max_speed", "max_rotation_rate", "max_jaw_speed")[index]
    speeds[index] = speed
    with pytest.raises(ValueError, match=f"{name} must be positive and finite"):
        VelocityControl(TRANSLATION, SPATULA, *speeds)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rotations": "yx"}, "rotations must be some of 'xyz', in this order, got 'yx'"),
        ({"rotations": "roll"}, "rotations must be some of 'xyz'"),
        ({"max_turn": 0.0}, "max_turn must be positive and pi at most, got 0.0"),
        ({"max_turn": 4.0}, "max_turn must be positive and pi at most"),
        ({"opening_range": (0.02, 0.01)}, "opening_range must be two lengths"),
    ],
)
def test_layouts_are_checked(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ControlLayout(**options)


def test_jaws_need_two_tools() -> None:
    with pytest.raises(ValueError, match="jaws need two tools, the scene has 1"):
        make_control(ControlLayout(jaws=True))


# ----------------------------------------------------------------------------------------- turning


def test_names_and_units_are_those_of_the_layout() -> None:
    assert make_control(ALL_SIX).names == tuple(f"{kind}_{axis}" for kind in ("velocity", "rotation") for axis in "xyz")
    control = make_control(ControlLayout(rotations="x", jaws=True), CLAMP)
    assert control.names == ("velocity_x", "velocity_y", "velocity_z", "rotation_x", "jaw_speed")
    assert control.units == ("m/s", "m/s", "m/s", "rad/s", "m/s")
    assert control.size == 5
    assert [part.name for part in control.parts] == [
        "tool_orientation",
        "tool_rotation_rate",
        "jaw_opening",
        "jaw_speed",
    ]


@given(st.tuples(*[fractions] * 6))
def test_tools_turn_about_the_grip_like_a_rigid_body(action: tuple[float, ...]) -> None:
    control = make_control(ControlLayout(rotations="xyz", jaws=True, opening_range=(0.0, 0.05)), CLAMP)
    grip = np.array([[0.01, 0.0, 0.005]])
    positions, orientations = control.place(grip)
    motion = control.motion(np.array([[*action, 0.0]]), grip, positions, orientations, PERIOD)
    after = positions + motion.linear * PERIOD
    turned = from_rotation_vector(np.array(action[3:]) * PERIOD)
    assert after.mean(axis=1) == pytest.approx(grip + motion.velocity * PERIOD, abs=1e-12)
    arms = after - after.mean(axis=1, keepdims=True)
    assert arms == pytest.approx(turn(turned, positions - grip[:, None]), abs=1e-12)
    assert motion.angular[0] == pytest.approx(np.tile(action[3:], (2, 1)))


@given(st.tuples(*[fractions] * 3), st.integers(0, 2**32 - 1))
def test_no_turn_leads_beyond_the_greatest(action: tuple[float, ...], seed: int) -> None:
    control = make_control(ControlLayout(rotations="xyz", max_turn=0.1))
    generator = np.random.default_rng(seed)
    start = generator.normal(size=3)
    start *= generator.uniform(0.0, 0.1) / np.linalg.norm(start)
    grip = np.zeros((1, 3))
    positions, orientations = control.place(
        grip, multiply(from_rotation_vector(start), SPATULA.tools[0].orientation)[None]
    )
    motion = control.motion(np.array([[0.0, 0.0, 0.0, *action]]), grip, positions, orientations, PERIOD)
    after = multiply(from_rotation_vector(motion.rate * PERIOD), orientations[:, 0])
    turned = to_rotation_vector(multiply(after, conjugate(SPATULA.tools[0].orientation)))
    assert np.linalg.norm(turned) <= 0.1 + 1e-12
    wanted = to_rotation_vector(multiply(from_rotation_vector(np.array(action) * PERIOD), from_rotation_vector(start)))
    if np.linalg.norm(wanted) <= 0.1:
        assert motion.rate[0] == pytest.approx(action, abs=1e-12)


def test_a_tilt_stops_at_its_limit_and_comes_back() -> None:
    control = make_control(ControlLayout(rotations="x", max_turn=0.08))
    grip, orientations = np.zeros((1, 3)), np.tile(SPATULA.tools[0].orientation, (1, 1, 1))
    positions = grip[:, None]
    tilts = []
    for way in [1.0, 1.0, 1.0, -1.0]:
        motion = control.motion(np.array([[0.0, 0.0, 0.0, way]]), grip, positions, orientations, PERIOD)
        orientations = multiply(from_rotation_vector(motion.rate * PERIOD), orientations[:, 0])[:, None]
        tilts.append(float(to_rotation_vector(orientations)[0, 0, 0]))
    assert tilts == pytest.approx([0.05, 0.08, 0.08, 0.03], abs=1e-12)


# ----------------------------------------------------------------------------------------- the stop

STOP = -0.02 - SPATULA.ground_height
"""A stop 20 mm below the workspace's middle, reckoned from the ground [m]."""


def lowest_points(tools, positions, orientations):
    """(W,) height of the lowest corner of any tool [m]."""
    corners = [turn(orientations[:, index, None], tool.vertices[None]) for index, tool in enumerate(tools)]
    return np.min([positions[:, i, 2] + turned[..., 2].min(axis=1) for i, turned in enumerate(corners)], axis=0)


@given(st.tuples(*[fractions] * 6), st.floats(-0.018, 0.03), st.integers(0, 2**32 - 1))
def test_no_corner_gets_below_the_stop(action: tuple[float, ...], height: float, seed: int) -> None:
    control = make_control(ControlLayout(rotations="xyz"), stop_height=STOP)
    turned = from_rotation_vector(np.random.default_rng(seed).uniform(-0.4, 0.4, size=3))
    grip = np.array([[0.0, 0.0, height]])
    positions, orientations = control.place(grip, multiply(turned, SPATULA.tools[0].orientation)[None])
    before = lowest_points(SPATULA.tools, positions, orientations)
    motion = control.motion(np.array([action]), grip, positions, orientations, PERIOD)
    after = lowest_points(
        SPATULA.tools,
        positions + motion.linear * PERIOD,
        multiply(from_rotation_vector(motion.angular * PERIOD), orientations),
    )
    # One that is below it is lifted no faster than it may move.
    assert after[0] >= min(-0.02, before[0]) - 1e-12 or motion.velocity[0, 2] == pytest.approx(control.max_speed)
    if after[0] > -0.02 + 1e-9:
        assert motion.velocity[0, 2] == pytest.approx(action[2] * control.max_speed)


def test_a_tool_comes_to_rest_on_the_stop() -> None:
    control = make_control(stop_height=STOP)
    grip = np.zeros((1, 3))
    for _ in range(20):
        positions, orientations = control.place(grip)
        motion = control.motion(np.array([[0.0, 0.0, -1.0]]), grip, positions, orientations, PERIOD)
        grip = grip + motion.velocity * PERIOD
    assert grip[0, 2] + SPATULA.tool_low[2] == pytest.approx(-0.02, abs=1e-12)


# ----------------------------------------------------------------------------------------- jaws


def test_jaws_are_placed_as_far_apart_as_told() -> None:
    control = make_control(JAWS, CLAMP)
    openings = np.array([[0.004], [0.012]])
    positions, orientations = control.place(np.zeros((2, 3)), coordinates=openings)
    assert control.opening(positions, np.ones(2)) == pytest.approx(openings, abs=1e-12)
    assert positions.mean(axis=1) == pytest.approx(np.zeros((2, 3)), abs=1e-12)
    for w in range(2):
        corners = [
            turn(orientation, tool.vertices) + position
            for tool, position, orientation in zip(CLAMP.tools, positions[w], orientations[w], strict=True)
        ]
        # The first tool is at negative y.
        assert corners[1][:, 1].min() - corners[0][:, 1].max() == pytest.approx(openings[w, 0], abs=1e-12)
    # Thicker jaws at the same places leave less room.
    assert (control.opening(positions, np.full(2, 1.5)) < openings).all()


@given(st.floats(0.0, 0.02), fractions)
def test_jaws_open_and_close_within_their_range(opening: float, speed: float) -> None:
    control = make_control(JAWS, CLAMP)
    grip = np.zeros((1, 3))
    positions, orientations = control.place(grip, coordinates=np.array([[opening]]))
    motion = control.motion(np.array([[0.0, 0.0, 0.0, speed]]), grip, positions, orientations, PERIOD)
    after = control.opening(positions + motion.linear * PERIOD, np.ones(1))[0, 0]
    assert after == pytest.approx(np.clip(opening + 0.05 * speed * PERIOD, 0.0, 0.02), abs=1e-12)
    assert motion.coordinate_rate[0, 0] == pytest.approx((after - opening) / PERIOD, abs=1e-9)
    assert motion.linear.mean(axis=1) == pytest.approx(np.zeros((1, 3)), abs=1e-12)


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
        (np.zeros(3, dtype=complex), "action must be 3 numbers in"),
        ([1j, 0.0, 0.0], "action must be 3 numbers in"),
        (["1", "0", "0"], "action must be 3 numbers in"),
        ([True, False, True], "action must be 3 numbers in"),
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
