"""Places and walls of organs of any shape."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from own_organs import bean, ellipsoid

from spatula_env import scenes
from spatula_env.envs.workspace import place_workspace, setting_of
from spatula_env.geometry import PreparedOrgan, box_surface, ridged_block
from spatula_env.geometry.overlap import overlaps
from spatula_env.geometry.prepared import UNIT_LENGTH
from spatula_env.geometry.rotations import turn
from spatula_env.tasks import Setting
from spatula_env.tasks.places import (
    COMPRESSION,
    MARGIN,
    STEEPEST,
    STEEPEST_FREE,
    judge_candidates,
    judge_places,
    place_on,
    turned_to,
    upright,
)
from spatula_env.tasks.walls import ROOMS, find_walls, upright_blade

VECTORS = st.tuples(*[st.floats(-1.0, 1.0)] * 3)
UNIT = VECTORS.filter(lambda v: np.linalg.norm(v) > 0.1 and v[2] > -0.9 * np.linalg.norm(v))


def setting_on(organ: PreparedOrgan, *, aside: bool = False) -> Setting:
    make, height = (scenes.organ_from_aside, 0.02) if aside else (scenes.organ_from_above, 0.025)
    scene = make(organ)
    return setting_of(scene, place_workspace(scene, scene.organs[0].vertices, height))


@given(UNIT)
def test_upright_turns_normals_into_the_vertical_by_the_shortest_way(vector: tuple[float, float, float]) -> None:
    normal = np.array(vector) / np.linalg.norm(vector)
    rotation = upright(normal)
    np.testing.assert_allclose(turn(rotation, normal), [0.0, 0.0, 1.0], atol=1e-12)
    # The shortest way turns about a horizontal axis, by the angle between the two.
    assert rotation[2] == 0.0
    angle = 2.0 * np.arctan2(np.hypot(rotation[0], rotation[1]), rotation[3])
    assert angle == pytest.approx(np.arctan2(np.hypot(normal[0], normal[1]), normal[2]), abs=1e-9)


@given(UNIT)
def test_a_tool_that_is_turned_to_a_normal_looks_against_it(vector: tuple[float, float, float]) -> None:
    normal = np.array(vector) / np.linalg.norm(vector)
    orientation = turned_to(normal, np.array([0.0, 0.0, 0.0, 1.0]))
    np.testing.assert_allclose(turn(orientation, [0.0, 0.0, -1.0]), -normal, atol=1e-12)


@given(st.floats(-np.pi, np.pi))
def test_an_upright_blade_stays_upright_and_faces_outwards(angle: float) -> None:
    outwards = np.array([np.cos(angle), np.sin(angle)])
    orientation = upright_blade(outwards, np.array(scenes.UPRIGHT))
    thickness, height = turn(orientation, [0.0, 0.0, 1.0]), turn(orientation, [0.0, 1.0, 0.0])
    np.testing.assert_allclose(thickness, [*outwards, 0.0], atol=1e-12)
    np.testing.assert_allclose(height, [0.0, 0.0, 1.0], atol=1e-12)


def test_the_normals_of_an_ellipsoid_are_its_own() -> None:
    axes = np.array([0.045, 0.035, 0.025])
    setting = setting_on(ellipsoid(axes, divisions=4))
    places = np.array([[0.0, 0.0], [0.02, 0.0], [0.0, -0.015], [0.02, 0.01]])
    points, normals = place_on(setting, places, 0.004)
    middle = np.array([0.0, 0.0, setting.rest_nodes[:, 2].max() - axes[2]])
    wanted = (points - middle) / axes**2
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    # Seen over 4 mm, on triangles of about 4 mm.
    assert np.rad2deg(np.arccos((normals * wanted).sum(axis=1))).max() < 4.0
    beside, none = place_on(setting, np.array([[0.049, 0.0]]), 0.004)
    assert np.isnan(beside).all()
    assert np.isnan(none).all()


@pytest.mark.parametrize("organ", [ellipsoid(), bean()], ids=lambda organ: organ.name)
def test_places_are_what_they_are_said_to_be(organ: PreparedOrgan) -> None:
    setting, depth, heights = setting_on(organ), 0.005, (0.003, 0.01, 0.03)
    judged = judge_candidates(setting, depth, heights)
    points = judged.spots.some(judged.good).on(setting.rest_nodes)
    assert len(points) > 50
    found, normals = place_on(setting, points[:, :2], 0.01)
    np.testing.assert_allclose(found, points, atol=1e-6)
    assert (normals[:, 2] >= np.cos(STEEPEST)).all()
    assert (judged.depths[judged.good] >= depth).all()
    assert (judged.depths[judged.good] <= COMPRESSION * np.ptp(setting.rest_nodes[:, 2])).all()
    tool = setting.tools[0]
    for point, normal in zip(points[::7], normals[::7], strict=True):
        corners = turn(turned_to(normal, tool.orientation), tool.vertices) + point - tool.vertices[:, 2].min() * normal
        for height in heights:
            at = corners + height * normal
            assert not overlaps(setting.rest_nodes, setting.triangles, at, tool.triangles)
            assert (at.mean(axis=0) > setting.workspace_low).all()
            assert (at.mean(axis=0) < setting.workspace_high).all()


def test_the_tool_stays_within_the_workspace_down_to_the_greatest_depth() -> None:
    setting = setting_on(ellipsoid((0.06, 0.06, 0.06), 0.01))
    judged = judge_candidates(setting, 0.005, (0.003, 0.03))
    places, depths = judged.spots.some(judged.good).on(setting.rest_nodes), judged.depths[judged.good]
    half_width, under = 0.01, float(setting.tools[0].vertices[:, 2].min())
    points, normals = place_on(setting, places[:, :2], half_width)
    ends = points - (depths + under)[:, None] * normals
    assert (ends >= setting.workspace_low + MARGIN - 1e-9).all()
    assert (ends <= setting.workspace_high - MARGIN + 1e-9).all()
    # The border limits some of the depths, the thickness others.
    assert depths.min() < 0.018 < depths.max()


def test_an_organ_that_lies_free_is_pressed_from_above_alone() -> None:
    held = ellipsoid()
    free = setting_on(PreparedOrgan(held.vertices, held.triangles, "free"))
    judged = judge_candidates(free, 0.005, (0.003, 0.03))
    _, normals = place_on(free, judged.spots.some(judged.good).on(free.rest_nodes)[:, :2], 0.01)
    assert len(normals)
    assert (normals[:, 2] >= np.cos(STEEPEST_FREE)).all()


def slab(thickness: float) -> PreparedOrgan:
    box = box_surface((0.06 / UNIT_LENGTH, 0.06 / UNIT_LENGTH, thickness / UNIT_LENGTH), 0.3)
    return PreparedOrgan(box.vertices, box.triangles, "slab")


def test_the_reasons_are_told() -> None:
    thin = setting_on(slab(0.012))
    middle, rim, beside = judge_places(thin, np.array([[0.0, 0.0], [0.0, 0.0294], [0.0, 0.035]]), 0.005, (0.003,))[1]
    assert middle == rim == f"are thinner than {0.005 / COMPRESSION:.3g} m above what is held"
    assert beside == "are beside it"
    judged = judge_candidates(thin, 0.005, (0.003,))
    assert not judged.good.any()
    assert judged.told(thin.organ).startswith("organ 'slab' has 0 places that the tool reaches: of ")
    assert "are thinner than 0.0167 m above what is held" in judged.told(thin.organ)


def test_a_depth_follows_from_the_thickness() -> None:
    depths, reasons = judge_places(setting_on(slab(0.04)), np.array([[0.0, 0.0]]), 0.005, (0.003,))
    assert reasons == [""]
    assert depths[0] == pytest.approx(COMPRESSION * 0.04, rel=1e-3)


def test_a_tool_does_not_span_a_hollow() -> None:
    """Beside the foot of a fold, the fold is under the tool, too; on its crest it is not."""
    block = ridged_block((3.2, 3.0, 1.5), 0.9, 2.4, 0.9, 0.35)
    setting = setting_on(PreparedOrgan(block.vertices, block.triangles, "folded", held=tuple(block.base.tolist())))
    crest = setting.rest_nodes[np.array(block.crest), :2].mean(axis=0)
    beside = crest + np.array([0.0, 0.015])
    assert judge_places(setting, np.array([crest, beside]), 0.003, (0.003,))[1] == [
        "",
        "lie in hollows that the tool spans",
    ]


@pytest.mark.parametrize("organ", [ellipsoid(), bean()], ids=lambda organ: organ.name)
def test_blades_get_beside_walls(organ: PreparedOrgan) -> None:
    setting = setting_on(organ, aside=True)
    walls, told = find_walls(setting, 0.009, 0.008)
    assert told.startswith(f"organ {organ.name!r} has {len(walls.rooms)} places that a blade can push")
    assert len(walls.rooms) > 20
    points, tool = walls.spots.on(setting.rest_nodes), setting.tools[0]
    half = float(turn(tool.orientation, tool.vertices)[:, 0].max())
    for point, outwards, room in list(zip(points, walls.outwards, walls.rooms, strict=True))[::5]:
        assert room in ROOMS
        corners = turn(upright_blade(outwards, tool.orientation), tool.vertices)
        grip = np.array([*(point[:2] + (room + half) * outwards), point[2] - 0.008 - corners[:, 2].min()])
        assert not overlaps(setting.rest_nodes, setting.triangles, corners + grip, tool.triangles)
        # A step further in, it meets the wall.
        inside = grip - np.array([*(room + 0.006) * outwards, 0.0])
        assert overlaps(setting.rest_nodes, setting.triangles, corners + inside, tool.triangles)


def test_a_flat_slab_has_no_walls_a_blade_can_push() -> None:
    walls, told = find_walls(setting_on(slab(0.012), aside=True), 0.009, 0.008)
    assert not len(walls.rooms)
    assert "are too low" in told
