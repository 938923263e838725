"""`spatula organ prepare`."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from spatula_env.cli.main import main
from spatula_env.geometry import PreparedOrgan, icosphere, load_organ

for library in ("fast_simplification", "matplotlib", "scipy", "skimage", "trimesh"):
    pytest.importorskip(library, reason="the extra anatomy is not installed")


@pytest.fixture
def ball(tmp_path: Path) -> Path:
    """A ball of 60 mm, in millimetres."""
    sphere = icosphere(30.0, 3)
    path = tmp_path / "ball.obj"
    with path.open("w", encoding="utf-8") as file:
        file.writelines(f"v {x} {y} {z}\n" for x, y, z in sphere.vertices)
        file.writelines(f"f {a} {b} {c}\n" for a, b, c in sphere.triangles + 1)
    return path


def test_an_organ_a_picture_and_a_report(ball: Path, capsys: pytest.CaptureFixture[str]) -> None:
    organ, picture = ball.with_name("organ.npz"), ball.with_name("organ.png")
    words = ["organ", "prepare", str(ball), "-o", str(organ), "--units", "mm", "--nodes", "100", "--hold", "z<0.01"]
    assert main([*words, "--picture", str(picture), "--json"]) == 0
    told = capsys.readouterr()
    report = json.loads(told.out.splitlines()[-1])
    loaded = load_organ(organ)
    assert isinstance(loaded, PreparedOrgan)
    assert report["result"]["nodes"] == len(loaded.vertices) == 100
    assert report["result"]["held"] == len(loaded.held) > 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "remeshing to 100 nodes" in told.err
    assert main(words) == 1
    assert "exists already: name another file, or replace it with --overwrite" in capsys.readouterr().err
    assert not list(ball.parent.glob(".*"))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "--units must be given, mm or m: ball.obj does not say"),
        (("--units", "m"), "in mm it would be 60 mm: --units mm?"),
        (("--units", "mm", "--label", "2"), "--label must not be given, as ball.obj is a surface: got 2"),
        (("--units", "mm", "--hold", "down"), '--hold must be like "z<0.01"'),
        (("--units", "mm", "--ridge", "0,0,0.06"), "--ridge must be like '0.01,-0.02,0.03 0.01,0.02,0.03', two points"),
        (("--units", "mm", "--fissure", "0,0,1 0,0,2"), "--fissure must be points on the surface: [0.0, 0.0, 1.0] is"),
        (("--units", "mm", "--hold-box", *"111000"), "--hold-box must be lower corners"),
        (("--units", "mm", "--widest-hole", "-1"), "--widest-hole must be positive"),
        (("--units", "mm", "--picture", "organ.gif"), "--picture must end in .png or .svg or .pdf"),
    ],
)
def test_errors_leave_nothing(
    ball: Path, words: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    organ = ball.with_name("organ.npz")
    assert main(["organ", "prepare", str(ball), "-o", str(organ), *words]) == 1
    assert told in capsys.readouterr().err
    assert not organ.exists()


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission_is_refused_before_the_work(ball: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ball.parent.chmod(0o500)
    try:
        assert main(["organ", "prepare", str(ball), "-o", str(ball.with_name("o.npz")), "--units", "mm"]) == 1
    finally:
        ball.parent.chmod(0o700)
    told = capsys.readouterr().err
    assert "is no folder that you may write to" in told
    assert "reading" not in told


def test_a_file_is_no_folder(ball: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["organ", "prepare", str(ball), "-o", str(ball / "organ.npz"), "--units", "mm"]) == 1
    assert "cannot be written" in capsys.readouterr().err


def test_held_nodes_from_a_file(ball: Path) -> None:
    nodes, organ = ball.with_name("held.txt"), ball.with_name("organ.npz")
    nodes.write_text("3, 4\n7\n", encoding="utf-8")
    words = ["organ", "prepare", str(ball), "-o", str(organ), "--units", "mm", "--nodes", "80"]
    assert main([*words, "--hold-nodes", str(nodes), "--tetrahedra", "no"]) == 0
    loaded = load_organ(organ)
    assert isinstance(loaded, PreparedOrgan)
    assert loaded.held == (3, 4, 7)
    assert np.isfinite(loaded.vertices).all()


def test_a_line_is_named_by_its_ends_or_by_a_file(ball: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ends = "-0.015,0,0.056 0.015,0,0.056"
    points = ball.with_name("points.txt")
    points.write_text(ends.replace(" ", "\n"), encoding="utf-8")
    lines = []
    for number, option in enumerate((ends, str(points))):
        organ = ball.with_name(f"{number}.npz")
        words = ["organ", "prepare", str(ball), "-o", str(organ), "--units", "mm", "--nodes", "200", "--ridge", option]
        assert main([*words, "--tetrahedra", "no"]) == 0
        loaded = load_organ(organ)
        assert isinstance(loaded, PreparedOrgan)
        lines.append(loaded.line("ridge"))
    assert "  ridge: " in capsys.readouterr().out
    np.testing.assert_array_equal(*lines)
    assert (lines[0][:, 2] > 2.6).all()
