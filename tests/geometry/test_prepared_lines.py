"""Lines that prepared organs name: kept in files and by changes of place, and checked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from own_organs import ellipsoid, fold, mound, written

from spatula_env.geometry import PreparedOrgan, load_organ


def test_lines_are_kept_in_a_file(tmp_path: Path) -> None:
    for organ in (mound(), fold(), ellipsoid()):
        loaded = load_organ(written(organ, tmp_path))
        assert isinstance(loaded, PreparedOrgan)
        assert loaded.lines == organ.lines


def test_files_of_organs_without_lines_are_as_before(tmp_path: Path) -> None:
    with np.load(written(ellipsoid(), tmp_path)) as file:
        assert set(file.files) == {"format", "vertices", "triangles", "held", "unit_length", "provenance"}


def test_lines_go_with_the_organ() -> None:
    organ = mound()
    line = organ.line("fissure")
    np.testing.assert_allclose(organ.moved((1.0, 2.0, 3.0)).line("fissure"), line + np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(organ.scaled(2.0).line("fissure"), 2.0 * line)
    quarter = organ.turned(0.5 * np.pi)
    np.testing.assert_allclose(
        quarter.line("fissure"), line @ [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], atol=1e-12
    )
    assert quarter.held == organ.held
    assert quarter.volume == pytest.approx(organ.volume)


@pytest.mark.parametrize("nodes", [(), (1,), (1, 1), (0, 100_000), (-1, 2)])
def test_lines_are_different_nodes_of_the_organ(nodes: Any) -> None:
    ball = ellipsoid()
    with pytest.raises(ValueError, match=r"lines must be two or more different nodes in 0\.\.641 each"):
        PreparedOrgan(ball.vertices, ball.triangles, lines={"ridge": nodes})


def test_a_line_that_is_not_there_is_asked_for() -> None:
    with pytest.raises(ValueError, match="organ must say where its ridge is, and 'mound' does not: it names fissure; "):
        mound().line("ridge")
