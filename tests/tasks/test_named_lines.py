"""Fissure and Clamp on organs that name a line: what is measured on them, and which are refused, and why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from own_organs import ellipsoid, fold, mound

from spatula_env import scenes
from spatula_env.envs.clamp import CLAMP
from spatula_env.envs.fissure import FISSURE
from spatula_env.envs.workspace import place_workspace, setting_of
from spatula_env.geometry import PreparedOrgan, box_surface
from spatula_env.geometry.overlap import overlaps
from spatula_env.geometry.prepared import UNIT_LENGTH
from spatula_env.geometry.rotations import turn
from spatula_env.tasks import Situation
from spatula_env.tasks.clamp import ClampConfig
from spatula_env.tasks.clamp_anywhere import ClampAnywhereTask
from spatula_env.tasks.fissure import FissureConfig
from spatula_env.tasks.fissure_anywhere import FissureAnywhereTask
from spatula_env.tasks.openings import opening_needed


def opened(organ: PreparedOrgan, **options: Any) -> FissureAnywhereTask:
    scene = scenes.organ_with_fissure(organ)
    workspace = place_workspace(scene, scene.organs[0].vertices, FISSURE.workspace_height)
    return FissureAnywhereTask(FissureConfig(**options), setting_of(scene, workspace))


def gripped(organ: PreparedOrgan, **options: Any) -> ClampAnywhereTask:
    scene = scenes.organ_with_ridge(organ)
    workspace = place_workspace(scene, scene.organs[0].vertices, CLAMP.workspace_height)
    return ClampAnywhereTask(ClampConfig(**options), setting_of(scene, workspace))


def with_line(organ: PreparedOrgan, choose: Callable[[tuple[int, ...]], tuple[int, ...]]) -> PreparedOrgan:
    return replace(organ, lines={name: choose(nodes) for name, nodes in organ.lines.items()})


@pytest.mark.parametrize("make", [scenes.organ_with_fissure, scenes.organ_with_ridge])
@pytest.mark.parametrize("angle", [0.0, 0.7, 2.0, -2.9])
def test_lines_run_along_x_over_the_origin_however_the_organ_lies(make: Any, angle: float) -> None:
    organ = mound() if make is scenes.organ_with_fissure else fold()
    (name,) = organ.lines
    placed = make(organ.turned(angle).moved((3.0, -2.0, 5.0))).organs[0]
    line = placed.organ.line(name)
    assert np.ptp(line[:, 0]) > 10.0 * np.ptp(line[:, 1])
    np.testing.assert_allclose(line[:, :2].min(axis=0) + line[:, :2].max(axis=0), 0.0, atol=1e-9)
    assert placed.organ.bounds[0, 2] == pytest.approx(0.0)
    assert placed.organ.volume == pytest.approx(organ.volume)


def test_targets_follow_a_bent_floor() -> None:
    """The mound's floor lies 1.2 mm beside and above the straight line between its ends."""
    task = opened(mound())
    rest = task.setting.rest_nodes
    line = rest[list(task.setting.organ.lines["fissure"])]
    middle = task._target(rest[None], np.zeros(1))[0] - [0.0, 0.0, task.config.target_height]
    assert np.sqrt(((line - middle) ** 2).sum(axis=1)).min() < 0.003
    nearest = line[np.abs(line[:, 0] - middle[0]).argmin()]
    np.testing.assert_allclose(middle[1:], nearest[1:], atol=5e-4)
    # On an organ that is larger by a tenth, a place is as far from the middle in metres.
    places = np.array([-0.008, 0.008])
    targets = task._target(np.repeat(1.1 * rest[None], 2, axis=0), places)
    assert np.linalg.norm(targets[1] - targets[0]) == pytest.approx(0.016, rel=0.01)


def test_the_blade_gets_down_at_all_places_of_targets() -> None:
    task = opened(mound())
    tool, setting = task.setting.tools[0], task.setting
    corners = turn(tool.orientation, tool.vertices)
    for place in np.linspace(-task._greatest_place(), task._greatest_place(), 5):
        edge = task._target(setting.rest_nodes[None], np.array([place]))[0] + [0.0, 0.0, task.config.reach_height]
        at = edge - [0.0, 0.0, corners[:, 2].min()]
        assert not overlaps(setting.rest_nodes, setting.triangles, corners + at, tool.triangles)
    assert 0.0 < task._greatest_place() <= task.config.place_limit
    start = task.sample(np.random.default_rng(0), 200, setting)
    assert np.abs(start.goal[:, 0]).max() <= task._greatest_place()


def test_the_depth_of_the_fissure_is_told() -> None:
    task = opened(mound())
    rest = task.setting.rest_nodes
    goal = np.array([[0.002, 0.25, 0.8]])
    situation = Situation.at_rest(task.setting, [[0.0, 0.0, 0.0]], action_size=4)
    parts = task.evaluate(situation, goal, task.new_memory(1)).parts
    target = task._target(rest[None], goal[:, 0])[0]
    assert parts["fissure_depth"][0, 0] == pytest.approx(rest[:, 2].max() - target[2])


def test_the_opening_that_is_needed_is_that_of_a_wedge() -> None:
    """Upright walls 3 mm away, a view of 45 degrees, a blade of 2 mm: at a height of h, it is h + 2 - 3 mm."""
    walls = np.array([[0.0, 0.003], [0.004, 0.003], [0.008, 0.003]])
    np.testing.assert_allclose(opening_needed(walls, np.pi / 4, 0.002), [0.0, 0.003, 0.007])


@pytest.mark.parametrize(
    ("organ", "options", "told"),
    [
        (mound(width=0.0022), {}, r"the blade, 20 mm wide and 2\.5 mm thick, gets down to .* mm above the target"),
        (mound(width=0.014), {}, "of the target is seen at rest .*, 50% are allowed: it is too wide for its depth"),
        (mound(), {"view_range": (0.2, 0.6)}, r"a wall would have to be moved by 1\d\.\d mm .* 13\.0 mm are allowed"),
        (mound(), {"target_size": (0.012, 0.008)}, "of the target in its middle, 12 x 8 mm, is inside the organ"),
        (with_line(mound(), lambda line: line[4:6]), {}, r"its floor is \d\.\d mm long, the target is 12\.0 mm long"),
        (
            replace(mound(), held=tuple(np.flatnonzero(mound().vertices[:, 2] > 2.0).tolist())),
            {},
            "mm from nodes that are held, .* mm are needed",
        ),
        (
            replace(mound(), lines={"fissure": tuple(np.flatnonzero(mound().vertices[:, 2] == 0.0)[:30:6].tolist())}),
            {},
            r"its floor is 4\d\.\d mm below the organ's top, the blade reaches 40\.8 mm",
        ),
    ],
)
def test_fissures_that_cannot_be_opened_are_refused(organ: PreparedOrgan, options: Any, told: str) -> None:
    with pytest.raises(ValueError, match=f"the fissure of organ 'mound' cannot be opened: .*{told}"):
        opened(organ, **options)


def test_a_ridge_is_measured_between_the_jaws() -> None:
    width = 0.013
    task = gripped(fold(width))
    rest = task.setting.rest_nodes
    assert task._shape[0] == pytest.approx(width, abs=5e-4)
    crest, flanks = rest[task._crest], rest[task._flanks]
    assert crest[:, 2].min() > flanks[:, 2].max()
    assert np.abs(np.concatenate([crest, flanks])[:, 0]).max() <= 0.012
    assert np.abs(flanks[:, 1]).max() < 0.5 * width + 0.002
    # Jaws that grip reach 18 mm below the crest.
    lowest = flanks[:, 2].mean() + task._shape[1] - 0.008
    assert rest[:, 2].max() - lowest == pytest.approx(0.018, abs=0.002)


@pytest.mark.parametrize(
    ("organ", "options", "told"),
    [
        (fold(0.004), {}, r"8 mm below its crest it is 4\.\d mm wide, 6 to 28 mm are allowed"),
        (
            fold(),
            {"start_opening_range": (0.01, 0.012)},
            r"8 mm below its crest it is 13\.0 mm wide, 6 to 10 mm are allowed",
        ),
        (
            replace(fold(), held=tuple(np.flatnonzero(fold().vertices[:, 2] < 0.3).tolist())),
            {},
            r"nodes that are held are 2\d\.\d mm from the jaws' lower edges, so that it can be lifted by 2\.\d mm, "
            r"lift_range goes to 12\.0 mm: let the organ lie free",
        ),
        (with_line(fold(), lambda line: line[:2]), {}, r"it is \d\.\d mm long, 12\.0 mm are needed"),
    ],
)
def test_ridges_that_cannot_be_gripped_are_refused(organ: PreparedOrgan, options: Any, told: str) -> None:
    with pytest.raises(ValueError, match=f"the ridge of organ 'fold' cannot be gripped: {told}"):
        gripped(organ, **options)


def test_a_ridge_that_is_held_far_below_may_be_lifted_a_little() -> None:
    held = replace(fold(), held=tuple(np.flatnonzero(fold().vertices[:, 2] < 0.3).tolist()))
    assert gripped(held, lift_range=(0.0015, 0.002))._shape[0] > 0.0


def test_a_slope_is_no_flank() -> None:
    ball = ellipsoid((0.03, 0.018, 0.05), 0.0)
    top = np.flatnonzero((np.abs(ball.vertices[:, 1]) < 1e-9) & (ball.vertices[:, 2] > 2.0))
    line = top[np.argsort(ball.vertices[top, 0])]
    with pytest.raises(ValueError, match=r"its flanks lean by 0\.\d\d mm per mm of height, 0\.1 are allowed"):
        gripped(replace(ball, lines={"ridge": tuple(line.tolist())}))


def test_jaws_need_room_beside_a_ridge() -> None:
    """Beside a post of 10 mm, which stands 2.5 mm away from it."""
    one = fold()
    post = box_surface((0.5, 0.5, 0.9), 1.0)
    vertices = post.vertices - [0.0, post.vertices[:, 1].min(), post.vertices[:, 2].min()]
    both = PreparedOrgan(
        np.concatenate([one.vertices, vertices + np.array([0.0, 0.009 / UNIT_LENGTH, 1.25])]),
        np.concatenate([one.triangles, post.triangles + len(one.vertices)]),
        "folds",
        lines=one.lines,
    )
    with pytest.raises(ValueError, match="mm below its crest there is no room for the jaws beside it"):
        gripped(both)
