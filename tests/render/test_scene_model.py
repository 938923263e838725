from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from spatula_env import scenes
from spatula_env.geometry.transforms import rotation_matrix
from spatula_env.render import Moment, palette
from spatula_env.render.scene_model import LONGEST_ARROW, SceneModel
from spatula_env.render.scene_view import SceneView
from spatula_env.scenes import Scene
from spatula_env.tasks.marks import Patch, Path, Points, Ring

SCENES: dict[str, Callable[[], Scene]] = {"seed": scenes.seed, "fissure": scenes.fissure, "clamp": scenes.clamp}


def triangles_of(scene: Scene) -> np.ndarray:
    return np.array(scene.organs[0].organ.triangles)


def pose_of(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return (
        scene.organs[0].vertices,
        np.array([placed.position for placed in scene.tools]),
        np.array([placed.orientation for placed in scene.tools]),
    )


def model_of(scene: Scene, levels: int = 1) -> SceneModel:
    return SceneModel(scene, triangles_of(scene), levels)


def lowered(scene: Scene, depth: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The first tool with its underside so far below the organ's top."""
    nodes, positions, orientations = pose_of(scene)
    low = (scene.tools[0].tool.vertices @ rotation_matrix(orientations[0]).T)[:, 2].min()
    positions[0, 2] = nodes[:, 2].max() - low - depth
    return nodes, positions, orientations


@pytest.mark.parametrize("name", SCENES)
def test_every_tool_is_drawn_where_it_is(name: str) -> None:
    scene = SCENES[name]()
    nodes, positions, orientations = pose_of(scene)
    meshes = model_of(scene).compose(Moment(nodes, positions, orientations)).meshes
    assert len(meshes) == 1 + len(scene.tools)
    for mesh, position, orientation, placed in zip(meshes[1:], positions, orientations, scene.tools, strict=True):
        expected = placed.tool.vertices @ rotation_matrix(orientation).T + position
        np.testing.assert_allclose(mesh.vertices, expected, atol=1e-12)
    larger = model_of(scene).compose(Moment(nodes, positions, orientations, tool_scale=1.5)).meshes
    for small, large, position in zip(meshes[1:], larger[1:], positions, strict=True):
        np.testing.assert_allclose(large.vertices - position, 1.5 * (small.vertices - position), atol=1e-12)


def test_both_jaws_are_in_the_picture() -> None:
    scene = scenes.clamp()
    nodes, positions, orientations = pose_of(scene)
    view = SceneView(scene, triangles_of(scene), 120, 120)
    whole = view.draw(Moment(nodes, positions, orientations)).astype(int)
    for index in range(2):
        moved = positions.copy()
        moved[index, 2] -= 50.0
        without = view.draw(Moment(nodes, moved, orientations)).astype(int)
        changed = np.abs(whole - without).max(axis=-1) > 20
        assert changed.sum() > 100
        # The first jaw is on the left, the second on the right.
        assert (np.flatnonzero(changed.any(axis=0)).mean() < 60) == (index == 0)


def test_each_force_is_an_arrow() -> None:
    scene = scenes.clamp()
    pose = pose_of(scene)
    model = model_of(scene)
    forces = np.array([[0.0, -0.2, 0.0], [0.0, 0.0, 0.001]])
    meshes = model.compose(Moment(*pose, forces=forces)).meshes
    # A force too small to be seen has none.
    assert len(meshes) == 4
    arrow = meshes[3]
    assert arrow.color == palette.FORCE
    along = arrow.vertices - pose[1][0]
    assert along[:, 1].min() < -0.4 and along[:, 1].max() < 1e-9
    twice = model.compose(Moment(*pose, forces=2.0 * forces)).meshes[3]
    reach = np.ptp((twice.vertices - pose[1][0])[:, 1])
    assert reach == pytest.approx(2.0 * np.ptp(along[:, 1]), rel=1e-9)
    far = model.compose(Moment(*pose, forces=1e3 * forces[:1].repeat(2, axis=0))).meshes[3]
    assert np.ptp(far.vertices[:, 1]) == pytest.approx(LONGEST_ARROW)


def colors_under_pressure(scene: Scene, pose: tuple[np.ndarray, ...], pressure: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of the organ (V', 3), and how far their colours are from those without pressure (V',)."""
    model = model_of(scene)
    nodes = [len(placed.tool.nodes) for placed in scene.tools]
    bare = model.compose(Moment(*pose)).meshes[0]
    pressed = model.compose(Moment(*pose, pressures=[np.full(count, pressure) for count in nodes])).meshes[0]
    assert bare.vertex_colors is not None and pressed.vertex_colors is not None
    return bare.vertices, np.abs(pressed.vertex_colors - bare.vertex_colors).max(axis=1)


def test_pressure_colours_the_organ_at_the_tool_and_nowhere_else() -> None:
    scene = scenes.seed()
    pose = lowered(scene)
    places, change = colors_under_pressure(scene, pose, 3000.0)
    away = np.linalg.norm(places - (0.0, 0.0, places[:, 2].max()), axis=1)
    assert change[away < 0.5].min() > 0.15
    assert change[away > 1.5].max() == 0.0
    assert colors_under_pressure(scene, pose, 0.0)[1].max() == 0.0


@pytest.mark.parametrize("limit", palette.PRESSURE_LIMITS)
def test_the_limits_of_pressure_have_the_colours_that_warn(limit: float) -> None:
    scene = scenes.seed()
    pose = lowered(scene)
    pressure = [np.full(len(scene.tools[0].tool.nodes), limit)]
    colors = model_of(scene).compose(Moment(*pose, pressures=pressure)).meshes[0].vertex_colors
    assert colors is not None
    expected = palette.PRESSURE(limit, 0.0, palette.HIGHEST_PRESSURE)
    assert np.abs(colors - expected).max(axis=1).min() < 0.09


def test_only_the_wall_that_is_pressed_is_coloured() -> None:
    scene = scenes.fissure()
    nodes, positions, orientations = pose_of(scene)
    positions[0, 2] -= 1.2
    block = scene.organs[0].organ
    model = model_of(scene, levels=0)
    normals = scene.tools[0].tool.normals @ rotation_matrix(orientations[0]).T
    # The face that looks along -y presses the wall at negative y.
    pressures = [np.where(normals[:, 1] < -0.9, 3000.0, 0.0)]
    positions[0, 1] = -0.09
    bare = model.compose(Moment(nodes, positions, orientations)).meshes[0]
    pressed = model.compose(Moment(nodes, positions, orientations, pressures=pressures)).meshes[0]
    change = np.abs(pressed.vertex_colors - bare.vertex_colors).max(axis=1)
    changed = bare.vertices[change > 0.02]
    assert len(changed) > 3
    assert (changed[:, 1] < 0.0).all()
    assert block.walls[0].size > 0


@pytest.mark.parametrize(("role", "color"), [("goal", palette.GOAL), ("target", palette.MARKER)])
def test_a_patch_stays_on_its_nodes(role: str, color: palette.Color) -> None:
    scene = scenes.clamp()
    nodes, positions, orientations = pose_of(scene)
    crest = np.array(scene.organs[0].organ.crest)
    moved = nodes + np.where(np.isin(np.arange(len(nodes)), crest)[:, None], (0.0, 0.0, 0.4), 0.0)
    model = model_of(scene)
    for shape in (nodes, moved):
        bare = model.compose(Moment(shape, positions, orientations)).meshes[0]
        marked = model.compose(Moment(shape, positions, orientations, marks=(Patch(crest, role),))).meshes[0]
        dyed = np.abs(marked.vertex_colors - color).sum(axis=1) < np.abs(bare.vertex_colors - color).sum(axis=1)
        assert dyed.sum() >= len(crest)
        lowest = shape[crest, 2].min()
        assert bare.vertices[dyed, 2].min() > lowest - 0.15
        same = (marked.vertex_colors == bare.vertex_colors).all(axis=1)
        assert (same == ~dyed).all()


def test_marks_are_meshes_of_their_own() -> None:
    scene = scenes.seed()
    nodes, positions, orientations = pose_of(scene)
    line = np.array([[-1.0, 0.0, 6.5], [0.0, 0.5, 6.5], [1.0, 0.0, 6.5]])
    marks = (Ring(np.array([0.0, 0.0, 6.2]), 0.7), Path(line), Points(line[:2]))
    composition = model_of(scene).compose(Moment(nodes, positions, orientations, marks=marks))
    assert len(composition.meshes) == 2
    ring, path, points = composition.marks
    assert np.hypot(*ring.vertices[:, :2].T).max() == pytest.approx(0.725, abs=1e-3)
    np.testing.assert_allclose(path.vertices.min(axis=0)[0], -1.0, atol=0.05)
    assert np.ptp(points.vertices[:, 0]) == pytest.approx(1.2, abs=0.02)
    assert len(composition.curves) == 4


def test_hidden_parts_of_marks_are_dashed() -> None:
    scene = scenes.seed()
    nodes, positions, orientations = pose_of(scene)
    view = SceneView(scene, triangles_of(scene), 160, 160)
    bare = view.draw(Moment(nodes, positions, orientations)).astype(int)

    def green(height: float) -> int:
        line = np.column_stack([np.linspace(-1.5, 1.5, 20), np.zeros(20), np.full(20, height)])
        picture = view.draw(Moment(nodes, positions, orientations, marks=(Path(line),))).astype(int)
        return int((np.abs(picture - bare).max(axis=-1) > 20).sum())

    hidden, seen = green(5.0), green(6.3)
    assert 20 < hidden < 0.8 * seen


def test_the_target_on_the_floor_is_seen_when_the_fissure_is_open() -> None:
    scene = scenes.fissure()
    nodes, positions, orientations = pose_of(scene)
    block = scene.organs[0].organ
    floor = np.unique(triangles_of(scene)[block.target])
    positions[0, 2] += 50.0
    view = SceneView(scene, triangles_of(scene), 160, 160)

    def green(shape: np.ndarray) -> int:
        picture = view.draw(Moment(shape, positions, orientations, marks=(Patch(floor, "goal"),))).astype(int)
        return int((picture[..., 1] > picture[..., 0] + 15).sum())

    middle = np.abs(nodes[:, 0]) < 1.4
    height = np.clip((nodes[:, 2] - block.floor_height) / 1.6, 0.0, 1.0)
    opened = nodes.copy()
    opened[:, 1] += 0.8 * np.sign(nodes[:, 1]) * middle * height * np.exp(-((np.abs(nodes[:, 1]) / 1.5) ** 2))
    assert green(nodes) < green(opened) - 10


def test_the_ground_is_where_it_is_said_to_be() -> None:
    scene = scenes.seed()
    pose = pose_of(scene)
    model = model_of(scene)
    assert model.compose(Moment(*pose)).ground.height == 0.0
    assert model.compose(Moment(*pose, ground_height=-0.3)).ground.height == -0.3


def test_wrong_shapes_are_named() -> None:
    scene = scenes.clamp()
    nodes, positions, orientations = pose_of(scene)
    model = model_of(scene)
    with pytest.raises(ValueError, match=r"tool_positions must have the shape \(2, 3\), got \(1, 3\)"):
        model.compose(Moment(nodes, positions[0], orientations))
    with pytest.raises(ValueError, match=r"forces must have the shape \(2, 3\)"):
        model.compose(Moment(nodes, positions, orientations, forces=np.zeros(3)))
    with pytest.raises(ValueError, match="pressures must be given for 2 tools, got 1"):
        model.compose(Moment(nodes, positions, orientations, pressures=[np.zeros(4)]))
    count = len(scene.tools[0].tool.nodes)
    with pytest.raises(ValueError, match=rf"pressures must be given for {count} contact nodes, got \(4,\)"):
        model.compose(Moment(nodes, positions, orientations, pressures=[np.zeros(4), np.zeros(4)]))
