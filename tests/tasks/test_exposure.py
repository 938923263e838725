"""Which points are visible past an organ and past tools."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.contact.raycast import cast_ray
from spatula_env.geometry import Tool, icosphere
from spatula_env.geometry.rotations import from_rotation_vector, turn
from spatula_env.tasks.exposure import visible_points

NO_TOOL = np.zeros((1, 0, 8, 3))

HALF_WIDTH, DEPTH = 1.0, 5.0
"""Of a slit between two upright walls, which is open above."""


def slit() -> tuple[np.ndarray, np.ndarray]:
    """Two walls at y = -1 and y = 1, from z = 0 to z = 5, long along x."""
    nodes = np.array([[x, y, z] for y in (-HALF_WIDTH, HALF_WIDTH) for x in (-50.0, 50.0) for z in (0.0, DEPTH)])
    triangles = [[first, first + 1, first + 3] for first in (0, 4)] + [
        [first, first + 3, first + 2] for first in (0, 4)
    ]
    return nodes, np.array(triangles, dtype=np.int32)


def lean(angle: float) -> np.ndarray:
    return np.array([[0.0, np.sin(angle), np.cos(angle)]])


def brute_force(
    nodes: np.ndarray,
    triangles: np.ndarray,
    tools: list[tuple[np.ndarray, np.ndarray]],
    points: np.ndarray,
    eye: np.ndarray,
) -> np.ndarray:
    """By Moller and Trumbore's test of every triangle: tools on the whole line, the organ beyond the point."""
    seen = []
    for point in points:
        blocked = cast_ray(point, eye, nodes, triangles)[0] >= 0
        for corners, faces in tools:
            blocked |= cast_ray(point - 1000.0 * eye, eye, corners, faces)[0] >= 0
        seen.append(not blocked)
    return np.array(seen)


@pytest.mark.parametrize("angle", [-0.3, -0.1, 0.0, 0.05, 0.2, 0.35])
def test_a_slit_shows_what_lies_within_the_shadow_of_its_walls(angle: float) -> None:
    nodes, triangles = slit()
    across = np.linspace(-0.999, 0.999, 57)
    points = np.column_stack([np.zeros(57), across, np.zeros(57)])[None]
    seen = visible_points(nodes[None], triangles, NO_TOOL, points, lean(angle))[0]
    at_the_lips = across + DEPTH * np.tan(angle)
    assert seen.tolist() == (np.abs(at_the_lips) < HALF_WIDTH).tolist()
    # Of the slit's width a part of depth times tangent is hidden.
    assert seen.mean() == pytest.approx(max(0.0, 1.0 - DEPTH * abs(np.tan(angle)) / (2.0 * HALF_WIDTH)), abs=0.03)


def test_what_is_behind_a_point_does_not_hide_it() -> None:
    nodes, triangles = slit()
    points = np.array([[[0.0, 0.9, 4.0], [0.0, 0.9, 0.5]]])
    assert visible_points(nodes[None], triangles, NO_TOOL, points, lean(0.05))[0].tolist() == [True, False]


def test_a_tool_hides_its_shadow() -> None:
    nodes, triangles = slit()
    corners = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (0.2, 0.4) for z in (2.0, 3.0)])
    across = np.linspace(-0.95, 0.95, 39)
    angle = -0.04
    points = np.column_stack([np.zeros(39), across, np.zeros(39)])[None]
    hidden = ~visible_points(nodes[None], triangles, corners[None, None], points, lean(angle))[0]
    hidden &= visible_points(nodes[None], triangles, NO_TOOL, points, lean(angle))[0]
    # A ray is at y + z tan(angle), and goes down along y here: it meets the box if it is not past it at either end.
    above, below = across + 3.0 * np.tan(angle), across + 2.0 * np.tan(angle)
    expected = (below > 0.2) & (above < 0.4)
    assert hidden.sum() >= 3
    assert hidden.tolist() == expected.tolist()
    beside = points + np.array([2.0, 0.0, 0.0])
    assert (
        visible_points(nodes[None], triangles, corners[None, None], beside, lean(angle)).tolist()
        == visible_points(nodes[None], triangles, NO_TOOL, beside, lean(angle)).tolist()
    )


def test_every_ray_agrees_with_a_test_of_all_triangles() -> None:
    generator = np.random.default_rng(5)
    sphere, box = icosphere(1.0, subdivisions=2), Tool.box((0.5, 0.3, 0.1))
    triangles, faces = np.array(sphere.triangles), np.array(box.triangles)
    worlds, count = 6, 80
    nodes = sphere.vertices + generator.normal(0.0, 0.05, (worlds, *sphere.vertices.shape))
    points = generator.uniform(-1.5, 1.5, (worlds, count, 3))
    eyes = generator.normal(size=(worlds, 3)) + np.array([0.0, 0.0, 2.0])
    eyes /= np.linalg.norm(eyes, axis=1, keepdims=True)
    turns = from_rotation_vector(generator.normal(size=(worlds, 2, 3)))
    corners = turn(turns[:, :, None], box.vertices) + generator.uniform(-1.0, 1.0, (worlds, 2, 1, 3))
    seen = visible_points(nodes, triangles, corners, points, eyes)
    assert 0.1 < seen.mean() < 0.9
    for w in range(worlds):
        tools = [(np.ascontiguousarray(one), faces) for one in corners[w]]
        expected = brute_force(nodes[w], triangles, tools, points[w], eyes[w])
        assert seen[w].tolist() == expected.tolist()


@given(st.integers(0, 2**32 - 1))
def test_a_tool_shows_nothing_that_was_hidden(seed: int) -> None:
    generator = np.random.default_rng(seed)
    nodes, triangles = slit()
    points = generator.uniform([-1.0, -0.9, 0.0], [1.0, 0.9, 1.0], (1, 30, 3))
    corners = generator.uniform([-1.0, -1.0, 1.0], [1.0, 1.0, 6.0], (1, 1, 8, 3))
    eye = lean(generator.uniform(-0.4, 0.4))
    without = visible_points(nodes[None], triangles, NO_TOOL, points, eye)
    assert not (visible_points(nodes[None], triangles, corners, points, eye) & ~without).any()
