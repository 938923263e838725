"""The benchmark of bad surfaces: they are as bad as they should be, and what is beyond a limit is found."""

from __future__ import annotations

import importlib.util
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from own_organs import ellipsoid

from benchmarks import organs, surfaces
from benchmarks.organ_pictures import draw_pressed
from benchmarks.presses import Press, Pressed, press_organ
from spatula_env.geometry import PreparedOrgan

LIBRARIES = ("fast_simplification", "nibabel", "scipy", "skimage", "trimesh")
MISSING = [name for name in LIBRARIES if importlib.util.find_spec(name) is None]
needs_libraries = pytest.mark.skipif(bool(MISSING), reason=f"the extra anatomy is not installed: {', '.join(MISSING)}")


@needs_libraries
@pytest.mark.parametrize("name", ["staircase", "duplicates", "holes", "fin"])
def test_bad_surfaces_become_organs(name: str, tmp_path: Path) -> None:
    source = surfaces.sources()[name]
    row = organs.prepare(name, replace(source, nodes=120, options={**source.options, "fill": "no"}), tmp_path)
    assert row is not None
    assert row.passed
    assert row.nodes == 120
    assert row.triangles > 5000
    assert row.organ is not None
    height = row.organ.vertices[:, 2]
    assert 0 < len(row.organ.held) < 60
    assert (height[list(row.organ.held)] <= surfaces.HELD * np.ptp(height) + height.min()).all()


@needs_libraries
def test_the_benchmark_ends_with_json_and_a_status(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    names = [name for name, source in surfaces.sources().items() if source.refusal]
    assert len(names) == 5
    monkeypatch.setattr(sys, "argv", ["organs", "--surfaces", *names, "--engines", "batch"])
    with pytest.raises(SystemExit) as ended:
        organs.main()
    assert ended.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum("refused:" in line for line in lines[:-1]) == 5
    result = json.loads(lines[-1])
    assert result["passed"]
    assert [row["outcome"] for row in result["surfaces"]] == ["refused"] * 5


def test_an_organ_is_pressed_and_no_limit_exceeded(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    pressed = press_organ(ellipsoid(), "batch", (0.5,))
    (press,) = pressed.presses
    assert press.steps == 66
    assert press.touching > 30
    assert press.reached == pytest.approx(0.01)
    assert pressed.allowed > 0.01
    assert organs.find_faults(pressed) == []
    assert pressed.picture is not None
    assert len(pressed.picture.corners) == 8
    assert pressed.picture.normal[2] > 0.7
    draw_pressed({"ball": {"batch": pressed}}, tmp_path / "ball.png")
    assert (tmp_path / "ball.png").stat().st_size > 1000
    assert "| ball | batch | 1.25 |" in organs.describe_presses({"ball": {"batch": pressed}}, (0.5,))


@pytest.mark.filterwarnings("ignore::spatula_env._warnings.SceneWarning")
def test_an_organ_without_a_place_says_why() -> None:
    pressed = press_organ(ellipsoid((0.03, 0.03, 0.01), 0.004), "batch", (0.5,))
    assert pressed.presses == ()
    table = organs.describe_presses({"thin": {"batch": pressed}}, (0.5,))
    assert "no place: of" in table
    assert "are thinner than" in table


def test_what_is_beyond_a_limit() -> None:
    good = Press("batch", 0.5, steps=60, touching=50, reported=0.009, depth=0.01, longest_crossed=24)
    assert organs.find_faults(Pressed("batch", 1.0, presses=(good,))) == []
    for change, told in (
        ({"reported": 0.011}, "reported residual at 0.5 m/s"),
        ({"depth": 0.011}, "depth at 0.5 m/s"),
        ({"missed": 1}, "missed at 0.5 m/s"),
        ({"inside": 1}, "inside at 0.5 m/s"),
        ({"longest_crossed": 25}, "crossed at 0.5 m/s"),
        ({"diverged": "gone"}, "diverged (gone) at 0.5 m/s"),
        ({"touching": 0}, "no contact at 0.5 m/s"),
    ):
        assert organs.find_faults(Pressed("batch", 1.0, presses=(replace(good, **change),))) == [told]
    assert organs.find_faults(Pressed("batch", failure="cannot be filled")) == ["cannot be filled"]


def test_what_ought_to_become_of_a_surface() -> None:
    known = surfaces.sources()
    organ: PreparedOrgan = ellipsoid()
    assert organs.Prepared("torus", known["torus"], organ=organ).passed
    assert not organs.Prepared("torus", known["torus"], reason="is open").passed
    assert not organs.Prepared("sheet", known["sheet"], organ=organ).passed
    assert not organs.Prepared("sheet", known["sheet"], reason="is empty").passed
    assert organs.Prepared("sheet", known["sheet"], reason="sheet.ply is open: 1 hole").passed
