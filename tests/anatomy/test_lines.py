"""Lines on finished surfaces: on the floor of a fissure and on the crest of a ridge, found from their ends."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from own_organs import fold, mound

from spatula_env.anatomy.options import PrepareOptions
from spatula_env.geometry import PreparedOrgan, icosphere
from spatula_env.geometry.prepared import UNIT_LENGTH

pytestmark = pytest.mark.skipif(importlib.util.find_spec("scipy") is None, reason="SciPy is not installed")

if importlib.util.find_spec("scipy") is not None:
    from spatula_env.anatomy.lines import length_of, traced


def found(organ: PreparedOrgan, name: str, points: np.ndarray) -> np.ndarray:
    """(K, 3) positions of the nodes of a line [m]."""
    vertices = np.asarray(organ.vertices) * UNIT_LENGTH
    return np.asarray(vertices[list(traced(vertices, organ.triangles, points.tolist(), name))])


@pytest.mark.parametrize(("organ", "name"), [(mound(), "fissure"), (fold(), "ridge")])
@pytest.mark.parametrize("angle", [0.0, 1.1])
def test_the_line_between_two_ends_is_the_one_that_is_known(organ: PreparedOrgan, name: str, angle: float) -> None:
    turned = organ.turned(angle)
    known = turned.line(name) * UNIT_LENGTH
    ends = known[[0, -1]] + [0.0005, -0.0005, 0.001]
    line = found(turned, name, ends)
    away = np.sqrt(((line[:, None] - known) ** 2).sum(axis=2)).min(axis=1)
    assert away.max() < 0.003
    assert length_of(line) == pytest.approx(length_of(known), rel=0.15)
    np.testing.assert_allclose(found(turned, name, ends[::-1]).mean(axis=0), line.mean(axis=0), atol=0.002)


def test_a_line_may_have_points_between_its_ends() -> None:
    organ = mound()
    known = organ.line("fissure") * UNIT_LENGTH
    np.testing.assert_array_equal(found(organ, "fissure", known[[0, 4, 9]]), found(organ, "fissure", known[[0, -1]]))


def test_points_that_are_no_line_are_refused() -> None:
    organ = mound()
    known = organ.line("fissure") * UNIT_LENGTH
    far = known[[0, -1]] + [0.0, 0.0, 0.1]
    with pytest.raises(
        ValueError, match=r"fissure must be points on the surface: .* mm from its nearest node, \d+\.\d mm"
    ):
        found(organ, "fissure", far)
    with pytest.raises(ValueError, match="fissure must be points that are farther apart"):
        found(organ, "fissure", known[[0, 0]])
    with pytest.raises(ValueError, match="fissure must be points in their order along it"):
        found(organ, "fissure", known[[0, 9, 4]])
    ball = icosphere(1.0, 2)
    two = PreparedOrgan(
        np.concatenate([ball.vertices, ball.vertices + np.array([2.3, 0.0, 0.0])]),
        np.concatenate([ball.triangles, ball.triangles + len(ball.vertices)]),
    )
    with pytest.raises(ValueError, match="ridge must be points on one piece of the surface"):
        found(two, "ridge", np.array([[0.0, 0.0, 1.0], [2.3, 0.0, 1.0]]) * UNIT_LENGTH)


@pytest.mark.parametrize("points", [((0.0, 0.0, 0.0),), ((0.0, 0.0), (1.0, 0.0)), ((0.0, 0.0, "a"), (1.0, 0.0, 0.0))])
def test_options_of_lines_are_checked(points: tuple[tuple[float, ...], ...]) -> None:
    with pytest.raises(ValueError, match="ridge must be two points or more, three numbers each, in metres"):
        PrepareOptions(ridge=points)
