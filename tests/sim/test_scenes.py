"""Scenes are checked when they are made, and errors name what is wrong."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest

from spatula_env import scenes
from spatula_env.geometry import FissuredBlock, RidgedBlock, Tool, box_surface
from spatula_env.geometry.transforms import rotate

ORGAN = box_surface((1.0, 1.0, 1.0), 0.5)
TOOL = Tool.box(nodes_per_edge=2)
PLACED_ORGAN = scenes.PlacedOrgan(ORGAN)
PLACED_TOOL = scenes.PlacedTool(TOOL, position=(0.0, 0.0, 3.0))
NOT_POSITIVE = [0.0, -1.0, np.nan, np.inf]
BAD_POSITIONS = [(0.0, 0.0), 1.0, (0.0, 0.0, np.nan), (0.0, np.inf, 0.0), "here", None]
BAD_ORIENTATIONS = [(0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), (0.0, 0.0, 0.0, np.nan), None]


def check_refused(name, make, value):
    with pytest.raises(ValueError, match=name):
        make(**{name: value})


# The seed ----------------------------------------------------------------------------------------------------------


def test_the_scene_of_the_seed():
    scene = scenes.seed()
    (organ,), (tool,) = scene.organs, scene.tools
    assert len(organ.organ.vertices) == 328
    assert len(organ.organ.triangles) == 652
    assert organ.mass == 10.0
    np.testing.assert_allclose(np.linalg.norm(organ.vertices - organ.position, axis=1), 3.0, rtol=1e-12)
    np.testing.assert_array_equal(tool.tool.size, [1.0, 1.0, 0.125])
    assert len(tool.tool.nodes) == 72
    assert scene.dt == 1.0 / 240.0
    assert scene.gravity == 10.0
    assert scene.ground == scenes.Ground()
    # The tool is above the organ, the organ above the ground.
    assert tool.position[2] - 0.0625 > organ.vertices[:, 2].max()
    assert organ.vertices[:, 2].min() >= -1e-9


def test_options_of_the_seed():
    scene = scenes.seed((2.0, 1.0, 0.25), 5.0, 1.0 / 60.0, nodes_per_edge=4, faces="all", friction=0.3)
    np.testing.assert_array_equal(scene.tools[0].tool.size, [2.0, 1.0, 0.25])
    assert len(scene.tools[0].tool.face_normals) == 6
    assert scene.organs[0].mass == 5.0
    assert scene.dt == 1.0 / 60.0
    assert scene.tools[0].friction == 0.3


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("mass", value) for value in NOT_POSITIVE],
        *[("dt", value) for value in NOT_POSITIVE],
        ("friction", -0.1),
        ("friction", np.nan),
        ("friction", np.inf),
        ("faces", "some"),
        ("nodes_per_edge", 1),
        ("nodes_per_edge", 2.5),
    ],
)
def test_the_seed_refuses(name, value):
    check_refused(name, scenes.seed, value)


@pytest.mark.parametrize("value", [(1.0, 1.0), (1.0, 1.0, 0.0), (1.0, -1.0, 0.1), (1.0, np.nan, 0.1)])
def test_the_seed_refuses_tool_sizes(value):
    with pytest.raises(ValueError, match="size"):
        scenes.seed(tool_size=value)


# Fissure and clamp -------------------------------------------------------------------------------------------------


def test_the_scene_of_the_fissure():
    scene = scenes.fissure()
    (organ,), (tool,) = scene.organs, scene.tools
    block = organ.organ
    assert isinstance(block, FissuredBlock)
    assert 600 <= len(block.vertices) <= 1200
    assert set(organ.fixed_nodes) == {*block.base.tolist(), *block.floor.tolist()}
    # The spatula stands on edge, thin across the fissure, above it.
    corners = rotate(np.array(tool.orientation), tool.tool.vertices) + tool.position
    np.testing.assert_allclose(np.ptp(corners, axis=0), [1.0, 0.125, 2.0], atol=1e-12)
    assert corners[:, 2].min() == pytest.approx(block.vertices[:, 2].max() + 0.3)
    assert len(tool.tool.face_normals) == 6


def test_options_of_the_fissure():
    scene = scenes.fissure(
        (7.0, 6.0, 3.5), 5.0, 1.0 / 120.0, depth=2.0, width=0.4, fixed_floor=False, tool_size=(0.8, 2.5, 0.1),
        faces="largest", friction=0.1, edge_length=0.4, base_edge_length=None,
    )  # fmt: skip
    (organ,), (tool,) = scene.organs, scene.tools
    assert organ.mass == 5.0
    assert scene.dt == 1.0 / 120.0
    assert organ.fixed_nodes == tuple(organ.organ.base.tolist())
    assert organ.organ.floor_height == 1.5
    np.testing.assert_array_equal(tool.tool.size, [0.8, 2.5, 0.1])
    assert len(tool.tool.face_normals) == 2
    assert tool.friction == 0.1


def test_the_scene_of_the_clamp():
    scene = scenes.clamp()
    (organ,) = scene.organs
    block = organ.organ
    assert isinstance(block, RidgedBlock)
    assert organ.fixed_nodes == ()
    assert len(scene.tools) == 2
    for placed, side in zip(scene.tools, (-1.0, 1.0), strict=True):
        corners = rotate(np.array(placed.orientation), placed.tool.vertices) + placed.position
        np.testing.assert_allclose(np.ptp(corners, axis=0), [1.2, 0.12, 0.8], atol=1e-12)
        # Beside the ridge, and above its foot.
        assert (side * corners[:, 1]).min() == pytest.approx(0.4 + scenes.JAW_CLEARANCE)
        assert block.foot_height < corners[:, 2].min()
        assert corners[:, 2].max() < block.vertices[:, 2].max()
        assert placed.friction == 0.4


def test_options_of_the_clamp():
    scene = scenes.clamp(mass=4.0, fixed_base=True, ridge_width=0.6, jaw_size=(1.0, 0.5, 0.1), friction=0.9)
    (organ,) = scene.organs
    assert organ.mass == 4.0
    assert set(organ.fixed_nodes) == set(organ.organ.base.tolist())
    for placed in scene.tools:
        assert abs(placed.position[1]) == pytest.approx(0.3 + scenes.JAW_CLEARANCE + 0.05)
        np.testing.assert_array_equal(placed.tool.size, [1.0, 0.5, 0.1])
        assert placed.friction == 0.9


@pytest.mark.parametrize("make", [scenes.fissure, scenes.clamp])
@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("mass", value) for value in NOT_POSITIVE],
        *[("dt", value) for value in NOT_POSITIVE],
        *[("edge_length", value) for value in NOT_POSITIVE],
        *[("base_edge_length", value) for value in NOT_POSITIVE],
        *[("node_spacing", value) for value in NOT_POSITIVE],
        ("size", (1.0, 1.0)),
        ("friction", -0.1),
        ("faces", "some"),
    ],
)
def test_other_scenes_refuse(make, name, value):
    check_refused(name, make, value)


@pytest.mark.parametrize("value", [0.5 * np.pi, -2.0, np.nan, np.inf])
def test_the_clamp_refuses_tilts(value):
    check_refused("jaw_tilt", scenes.clamp, value)


def test_fissure_and_clamp_can_be_compared_hashed_and_sent():
    for make in (scenes.fissure, scenes.clamp):
        scene = make()
        assert scene == make()
        assert scene != make(edge_length=0.3)
        sent = pickle.loads(pickle.dumps(scene))
        assert sent == scene
        np.testing.assert_array_equal(sent.organs[0].organ.base, scene.organs[0].organ.base)


# Scale -------------------------------------------------------------------------------------------------------------

PRESETS = [scenes.seed, scenes.retract, scenes.fissure, scenes.clamp, scenes.palpate]


@pytest.mark.parametrize("make", PRESETS)
def test_a_scene_is_twenty_millimetres_in_a_unit_by_either_scale(make):
    for scale in ("stiffness", "density"):
        assert make(scale=scale).scale.length == 0.02
    assert make().scale == make(scale="stiffness").scale != make(scale="density").scale


@pytest.mark.parametrize("make", PRESETS)
@pytest.mark.parametrize("mass", [10.0, 3.0])
def test_a_scene_may_have_the_density_of_brain_tissue(make, mass):
    scene = make(mass=mass, dt=1.0 / 120.0, scale="density")
    kilograms = scene.organs[0].mass * scene.scale.mass
    assert kilograms / (scene.organs[0].organ.volume * scene.scale.length**3) == pytest.approx(1040.0)


@pytest.mark.parametrize("make", PRESETS)
def test_by_stiffness_kilograms_stay_and_steps_change_them(make):
    kilograms = 10.0 * make().scale.mass
    assert 3.0 * make(mass=3.0).scale.mass == pytest.approx(kilograms)
    assert 10.0 * make(dt=1.0 / 120.0).scale.mass == pytest.approx(4.0 * kilograms)


@pytest.mark.parametrize("make", PRESETS)
def test_a_scene_takes_a_scale(make):
    given = scenes.Scale(length=0.01, mass=0.25)
    assert make(scale=given).scale is given


@pytest.mark.parametrize("make", PRESETS)
@pytest.mark.parametrize("value", ["weight", None, 1.0, ["stiffness"]])
def test_scenes_refuse_other_scales(make, value):
    with pytest.raises(ValueError, match=r"scale must be one of .*'stiffness', 'density'.* or a Scale"):
        make(scale=value)


# The parts ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["length", "mass"])
@pytest.mark.parametrize("value", NOT_POSITIVE)
def test_scale_refuses(name, value):
    check_refused(name, scenes.Scale, value)


def test_scale_from_units_to_si():
    scale = scenes.Scale(length=0.02, mass=0.5)
    assert scale.speed == pytest.approx(0.02)
    assert scale.force == pytest.approx(0.5 * 0.02)
    assert scale.torque == pytest.approx(0.5 * 0.02**2)
    assert scale.pressure == pytest.approx(0.5 * 0.02 / 0.02**2)


@pytest.mark.parametrize(
    ("name", "value"),
    [("height", np.nan), ("height", "0"), ("height", np.inf), ("friction", -1.0), ("friction", np.nan)],
)
def test_ground_refuses(name, value):
    check_refused(name, scenes.Ground, value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("position", value) for value in BAD_POSITIONS],
        *[("orientation", value) for value in BAD_ORIENTATIONS],
        *[("mass", value) for value in NOT_POSITIVE],
        ("fixed_nodes", (len(ORGAN.vertices),)),
        ("fixed_nodes", (0, -1)),
        ("fixed_nodes", (1.5,)),
    ],
)
def test_a_placed_organ_refuses(name, value):
    check_refused(name, lambda **given: scenes.PlacedOrgan(ORGAN, **given), value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("position", value) for value in BAD_POSITIONS],
        *[("orientation", value) for value in BAD_ORIENTATIONS],
        ("friction", -0.1),
        ("friction", np.inf),
    ],
)
def test_a_placed_tool_refuses(name, value):
    check_refused(name, lambda **given: scenes.PlacedTool(TOOL, **({"position": (0.0, 0.0, 3.0)} | given)), value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("organs", ()),
        ("tools", ()),
        ("gravity", np.nan),
        ("gravity", np.inf),
        ("gravity", "10"),
        *[("dt", value) for value in NOT_POSITIVE],
    ],
)
def test_a_scene_refuses(name, value):
    good = {"organs": (PLACED_ORGAN,), "tools": (PLACED_TOOL,)}
    check_refused(name, lambda **given: scenes.Scene(**(good | given)), value)


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("organs", (PLACED_TOOL,), r"organs\[0\] must be a PlacedOrgan, got PlacedTool"),
        ("organs", (PLACED_ORGAN, ORGAN), r"organs\[1\] must be a PlacedOrgan"),
        ("organs", PLACED_ORGAN, "organs must be a sequence of PlacedOrgan"),
        ("organs", None, "organs must be a sequence of PlacedOrgan"),
        ("tools", (PLACED_ORGAN,), r"tools\[0\] must be a PlacedTool"),
        ("tools", PLACED_TOOL, "tools must be a sequence of PlacedTool"),
        ("tools", "spatula", "tools must be a sequence of PlacedTool, got 'spatula'"),
        ("ground", 0.0, r"ground must be a Ground or None, got 0\.0"),
        ("scale", 0.02, r"scale must be a Scale, got 0\.02"),
    ],
)
def test_a_scene_refuses_what_is_of_another_kind(name, value, allowed):
    good = {"organs": (PLACED_ORGAN,), "tools": (PLACED_TOOL,)}
    with pytest.raises(TypeError, match=allowed):
        scenes.Scene(**(good | {name: value}))


def test_organs_and_tools_that_are_none_are_refused():
    with pytest.raises(TypeError, match="organ must be an Organ, got"):
        scenes.PlacedOrgan(TOOL)
    with pytest.raises(TypeError, match="tool must be a Tool, got"):
        scenes.PlacedTool(ORGAN, (0.0, 0.0, 3.0))


def test_lists_of_organs_and_tools_become_tuples():
    scene = scenes.Scene([PLACED_ORGAN], [PLACED_TOOL])
    assert scene == scenes.Scene((PLACED_ORGAN,), (PLACED_TOOL,))
    assert hash(scene) == hash(scenes.Scene((PLACED_ORGAN,), (PLACED_TOOL,)))


def test_errors_tell_what_came():
    with pytest.raises(ValueError, match=r"-3\.5"):
        scenes.PlacedOrgan(ORGAN, mass=-3.5)
    with pytest.raises(ValueError, match=rf"0\.\.{len(ORGAN.vertices) - 1}.*99"):
        scenes.PlacedOrgan(ORGAN, fixed_nodes=(99,))


def test_an_organ_is_turned_before_it_is_placed():
    half = np.sqrt(0.5)
    placed = scenes.PlacedOrgan(ORGAN, position=(1.0, 2.0, 3.0), orientation=(0.0, 0.0, half, half))
    expected = ORGAN.vertices[:, [1, 0, 2]] * [-1.0, 1.0, 1.0] + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(placed.vertices, expected, atol=1e-12)


def test_poses_may_be_given_as_arrays():
    placed = scenes.PlacedTool(TOOL, position=np.array([1, 2, 3]), orientation=[0, 0, 0, 1])
    assert placed.position == (1.0, 2.0, 3.0)
    assert placed.orientation == (0.0, 0.0, 0.0, 1.0)


def test_scenes_can_be_compared_hashed_sent_and_not_changed():
    scene = scenes.seed()
    assert scene == scenes.seed()
    assert hash(scene) == hash(scenes.seed())
    assert scene != scenes.seed(mass=11.0)
    assert scene != scenes.seed(tool_size=(1.0, 1.0, 0.2))
    assert pickle.loads(pickle.dumps(scene)) == scene
    with pytest.raises(dataclasses.FrozenInstanceError):
        scene.dt = 1.0
    with pytest.raises(ValueError, match="read-only"):
        scene.organs[0].organ.vertices[0, 0] = 5.0
