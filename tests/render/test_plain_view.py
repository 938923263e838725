from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from spatula_env import scenes
from spatula_env.contact.raycast import cast_ray
from spatula_env.geometry.transforms import rotation_matrix
from spatula_env.learning.threads import numba_threads
from spatula_env.render import Camera, Moment
from spatula_env.render.moment import Moments
from spatula_env.render.plain_view import PlainView
from spatula_env.render.scene_view import SceneView
from spatula_env.scenes import Scene

SCENES: dict[str, Callable[[], Scene]] = {
    "seed": scenes.seed,
    "fissure": scenes.fissure,
    "clamp": scenes.clamp,
    "retract": scenes.retract,
    "palpate": scenes.palpate,
}


def triangles_of(scene: Scene) -> np.ndarray:
    return np.array(scene.organs[0].organ.triangles)


def moments_of(scene: Scene, count: int = 1, seed: int = 0) -> Moments:
    """Worlds whose organs are a little out of shape, and whose tools are about where the scene has them."""
    generator = np.random.default_rng(seed)
    nodes = scene.organs[0].vertices + 0.03 * generator.normal(size=(count, len(scene.organs[0].vertices), 3))
    positions = np.array([placed.position for placed in scene.tools]) + 0.1 * generator.normal(size=(count, 1, 3))
    orientations = np.tile(np.array([placed.orientation for placed in scene.tools]), (count, 1, 1))
    return Moments(nodes, positions, orientations, 1.0 + 0.05 * generator.normal(size=count))


def rows(moments: Moments, worlds: list[int]) -> Moments:
    return Moments(
        moments.nodes[worlds],
        moments.tool_positions[worlds],
        moments.tool_orientations[worlds],
        None if moments.tool_scales is None else moments.tool_scales[worlds],
        None if moments.ground_heights is None else moments.ground_heights[worlds],
        {role: inside[worlds] for role, inside in moments.patches.items()},
    )


def meshes_of(scene: Scene, moments: Moments, world: int = 0) -> list[tuple[np.ndarray, np.ndarray]]:
    """Vertices and triangles of the organ and of the tools."""
    meshes = [(np.ascontiguousarray(moments.nodes[world]), triangles_of(scene))]
    assert moments.tool_scales is not None
    for k, placed in enumerate(scene.tools):
        turned = np.array(placed.tool.vertices) @ rotation_matrix(moments.tool_orientations[world, k]).T
        moved = moments.tool_positions[world, k] + moments.tool_scales[world] * turned
        meshes.append((np.ascontiguousarray(moved), np.array(placed.tool.triangles)))
    return meshes


def rays(camera: Camera, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """The eye (3,), and directions (H, W, 3) through the middles of pixels, whose part along the axis is one."""
    eye = np.array(camera.position)
    return eye, camera.unproject(np.ones((height, width))) - eye


@pytest.mark.parametrize("name", SCENES)
def test_depth_is_where_rays_meet_the_surfaces(name: str) -> None:
    scene = SCENES[name]()
    moments = moments_of(scene)
    view = PlainView(scene, triangles_of(scene), 61, 53)
    _, depths = view.draw(moments, depth=True)
    assert depths is not None
    eye, directions = rays(view.camera, 61, 53)
    seen = set()
    for row in range(1, 53, 4):
        for column in range(1, 61, 4):
            met = {}
            for k, (vertices, triangles) in enumerate(meshes_of(scene, moments)):
                triangle, away, *_ = cast_ray(eye, directions[row, column], vertices, triangles)
                if triangle >= 0:
                    met[away] = k
            down = directions[row, column, 2]
            if scene.ground is not None and down < 0.0:
                met[(scene.ground.height - eye[2]) / down] = -1
            nearest = min(met, default=view.camera.far)
            assert depths[0, row, column] == pytest.approx(min(nearest, view.camera.far), rel=1e-5)
            seen.add(met.get(nearest))
    assert {-1, 0, 1} <= seen


@pytest.mark.parametrize("name", SCENES)
def test_depth_is_that_of_the_full_style_away_from_outlines(name: str) -> None:
    scene = SCENES[name]()
    moments = moments_of(scene)
    assert moments.tool_scales is not None
    moment = Moment(
        moments.nodes[0],
        moments.tool_positions[0],
        moments.tool_orientations[0],
        tool_scale=float(moments.tool_scales[0]),
    )
    view = PlainView(scene, triangles_of(scene), 84, 84)
    full = SceneView(scene, triangles_of(scene), 84, 84, levels=0)
    assert view.camera == full.camera
    pictures, depths = view.draw(moments, depth=True)
    picture, depth = full.draw_rgbd(moment)
    assert depths is not None
    away = np.abs(depths[0] - depth)
    assert (away < 1e-3 * depth).mean() > 0.8
    # Where neighbours have about the same depth, no outline is near.
    steep = np.maximum(*(np.abs(np.gradient(depth, axis=axis)) for axis in (0, 1)))
    assert (away[steep < 0.05] < 0.05).mean() > 0.995
    # Same colours of organ, tool and ground, but for highlights, textures and shadows.
    assert np.abs(pictures[0].astype(int) - picture).mean() < 14.0


def test_a_world_looks_the_same_with_others_and_on_any_number_of_threads() -> None:
    scene = scenes.clamp()
    moments = moments_of(scene, 7)
    inside = np.zeros(moments.nodes.shape[:2], dtype=np.bool_)
    inside[2:5, ::3] = True
    moments = replace(moments, patches={"target": inside}, ground_heights=np.linspace(-0.3, 0.0, 7))
    view = PlainView(scene, triangles_of(scene), 48, 40)
    pictures, depths = view.draw(moments, depth=True)
    assert depths is not None
    assert (pictures[0] != pictures[1]).any()
    for threads in (1, 2):
        with numba_threads(threads):
            again, depths_again = view.draw(moments, depth=True)
            bare, nothing = view.draw(moments)
        assert (again == pictures).all() and depths_again is not None and (depths_again == depths).all()
        assert (bare == pictures).all() and nothing is None
    fresh = PlainView(scene, triangles_of(scene), 48, 40)
    for world in (3, 0, 6):
        one, depth = fresh.draw(rows(moments, [world]), depth=True)
        assert (one[0] == pictures[world]).all() and depth is not None and (depth[0] == depths[world]).all()
    some, _ = view.draw(rows(moments, [5, 1]), slots=np.array([5, 1]))
    assert (some == pictures[[5, 1]]).all()


def test_ground_that_moves_is_drawn_anew() -> None:
    scene = scenes.seed()
    view = PlainView(scene, triangles_of(scene), 48, 48)
    moments = moments_of(scene, 2)
    level, _ = view.draw(moments)
    lower = replace(moments, ground_heights=np.array([-1.0, -0.2]))
    moved, depths = view.draw(lower, depth=True)
    assert depths is not None
    assert (moved[0] != level[0]).any()
    fresh, depth = PlainView(scene, triangles_of(scene), 48, 48).draw(rows(lower, [0]), depth=True)
    assert (fresh[0] == moved[0]).all() and depth is not None and (depth[0] == depths[0]).all()
    assert (view.draw(moments)[0] == level).all()


def pixel_of(view: PlainView, point: np.ndarray, size: tuple[int, int]) -> tuple[int, int]:
    (x, y), _ = view.camera.project(point, *size)
    return int(y), int(x)


def test_organ_tool_and_dye_have_their_colours_where_they_are() -> None:
    scene = scenes.seed()
    view = PlainView(scene, triangles_of(scene), 96, 96)
    nodes = np.array(scene.organs[0].vertices)[None]
    top = int(nodes[0, :, 2].argmax())
    beside = nodes[0, top] + np.array([0.0, -1.5, 2.0])
    moments = Moments(nodes, beside[None, None], np.array([[[0.0, 0.0, 0.0, 1.0]]]))
    bare = view.draw(moments)[0][0].astype(int)
    organ = bare[pixel_of(view, nodes[0, top] - [0.0, 0.3, 0.15], (96, 96))]
    assert organ[0] > organ[1] + 40 and organ[0] > organ[2] + 40
    tool = bare[pixel_of(view, beside, (96, 96))]
    assert np.ptp(tool) < 20
    for role, channel in (("goal", 1), ("caution", 0), ("target", 2)):
        inside = np.zeros((1, nodes.shape[1]), dtype=np.bool_)
        inside[0, np.linalg.norm(nodes[0] - nodes[0, top], axis=1) < 1.2] = True
        dyed = view.draw(replace(moments, patches={role: inside}))[0][0].astype(int)
        color = dyed[pixel_of(view, nodes[0, top] - [0.0, 0.3, 0.1], (96, 96))]
        assert color.argmax() == channel and color.max() > sorted(color)[1] + 15
        assert 100 < (dyed != bare).any(axis=-1).sum() < 2500


def test_a_tool_that_reaches_behind_the_eye_is_cut_at_the_near_plane() -> None:
    scene = scenes.seed()
    moments = moments_of(scene)
    camera = Camera((0.0, -4.0, 5.0), (0.0, 0.0, 4.0), near=0.5)
    inside = replace(moments, tool_positions=np.array([[camera.position]]) + np.array([0.1, 0.5, -0.1]))
    assert inside.tool_scales is not None
    view = PlainView(scene, triangles_of(scene), 40, 40, camera)
    _, depths = view.draw(inside, depth=True)
    full = SceneView(scene, triangles_of(scene), 40, 40, camera, supersample=1, levels=0)
    moment = Moment(
        inside.nodes[0], inside.tool_positions[0], inside.tool_orientations[0], tool_scale=float(inside.tool_scales[0])
    )
    assert depths is not None
    np.testing.assert_allclose(depths[0], full.draw_rgbd(moment)[1], rtol=1e-5)
    assert depths.min() >= 0.5


def test_arrays_may_be_read_only_and_of_any_layout() -> None:
    scene = scenes.seed()
    view, moments = PlainView(scene, triangles_of(scene), 20, 16), moments_of(scene, 2)
    nodes = np.asfortranarray(moments.nodes)
    nodes.flags.writeable = False
    orientations = np.broadcast_to(moments.tool_orientations[:1], moments.tool_orientations.shape)
    other = replace(moments, nodes=nodes, tool_orientations=orientations)
    slots = np.arange(2)
    slots.flags.writeable = False
    assert (view.draw(other, slots=slots)[0] == view.draw(moments)[0]).all()


def test_no_worlds_are_no_pictures() -> None:
    scene = scenes.seed()
    pictures, depths = PlainView(scene, triangles_of(scene), 20, 16).draw(moments_of(scene, 0), depth=True)
    assert pictures.shape == (0, 16, 20, 3) and depths is not None and depths.shape == (0, 16, 20)


@pytest.mark.parametrize("name", ["nodes", "tool_positions", "tool_orientations", "tool_scales", "ground_heights"])
def test_errors_name_the_array(name: str) -> None:
    scene = scenes.seed()
    view, moments = PlainView(scene, triangles_of(scene), 20, 20), moments_of(scene, 2)
    wrong: dict[str, Any] = {name: np.zeros((2, 5, 3))}
    with pytest.raises(ValueError, match=rf"^{name} must have the shape .*, got \(2, 5, 3\)"):
        view.draw(replace(moments, **wrong))


def test_errors_name_the_role() -> None:
    scene = scenes.seed()
    view, moments = PlainView(scene, triangles_of(scene), 20, 20), moments_of(scene, 2)
    inside = np.zeros(moments.nodes.shape[:2], dtype=np.bool_)
    with pytest.raises(ValueError, match=r"patches must be of the roles \['goal', 'target', 'caution'\], got 'blue'"):
        view.draw(replace(moments, patches={"blue": inside}))
    with pytest.raises(ValueError, match=r"^patches\['goal'\] must have the shape"):
        view.draw(replace(moments, patches={"goal": inside[:1]}))


def test_sizes_are_checked() -> None:
    scene = scenes.seed()
    with pytest.raises(ValueError, match=r"width must be an integer in 1\.\.8192, got 0"):
        PlainView(scene, triangles_of(scene), 0, 20)
