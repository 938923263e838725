"""What an organ has lost of its segmentation is measured and told, and refused where it is most of it."""

from __future__ import annotations

import importlib.util
import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from spatula_env.geometry import box_surface, icosphere

LIBRARIES = ("fast_simplification", "scipy", "skimage", "trimesh")
MISSING = [name for name in LIBRARIES if importlib.util.find_spec(name) is None]
pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"the extra anatomy is not installed: {', '.join(MISSING)}")

if not MISSING:
    import trimesh

    from spatula_env.anatomy import PrepareOptions, prepare_organ
    from spatula_env.anatomy.distances import greatest_distance
    from spatula_env.anatomy.libraries import load
    from spatula_env.anatomy.options import Report
    from spatula_env.anatomy.topology import Surface


def written(path: Path, *meshes: tuple[np.ndarray, np.ndarray]) -> Path:
    vertices = np.concatenate([mesh[0] for mesh in meshes])
    starts = np.cumsum([0, *(len(mesh[0]) for mesh in meshes)])
    triangles = np.concatenate([mesh[1] + start for mesh, start in zip(meshes, starts, strict=False)])
    trimesh.Trimesh(vertices, triangles, process=False).export(path)
    return path


def ball(place: float, radius: float = 30.0) -> tuple[np.ndarray, np.ndarray]:
    mesh = icosphere(radius, 3)
    return np.add(mesh.vertices, [place, 0.0, 0.0]), mesh.triangles


def plate(thickness: float) -> tuple[np.ndarray, np.ndarray]:
    box = box_surface((100.0, 80.0, thickness), 5.0)
    return np.asarray(box.vertices), np.asarray(box.triangles)


def report_of(path: Path, **options: object) -> Report:
    wanted = {"units": "mm", "nodes": 300, "fill": "no", **options}
    return prepare_organ(path, PrepareOptions(**wanted))[1]


def test_distances_are_those_of_surfaces_that_lie_inside_each_other() -> None:
    surfaces = [Surface(icosphere(radius, 4).vertices, icosphere(radius, 4).triangles) for radius in (1.0, 1.3)]
    assert greatest_distance(*surfaces) == pytest.approx(0.3, abs=0.01)
    near = Surface(np.add(surfaces[0].vertices, [0.1, 0.0, 0.0]), surfaces[0].triangles)
    assert greatest_distance(surfaces[0], near) == pytest.approx(0.1, abs=0.01)


def test_both_are_looked_at_unless_one_is_enough() -> None:
    small, large = (Surface(*ball(0.0, radius)) for radius in (10.0, 30.0))
    both = Surface(
        np.concatenate([small.vertices, large.vertices]),
        np.concatenate([small.triangles, large.triangles + len(small.vertices)]),
    )
    assert greatest_distance(large, both, both=False) < 1e-6
    assert greatest_distance(large, both) == pytest.approx(20.0, rel=0.02)


def test_a_plate_is_refused_when_most_of_it_is_lost_and_never_thickened(tmp_path: Path) -> None:
    thin = written(tmp_path / "thin.stl", plate(1.0))
    with pytest.raises(ValueError, match=r"thin.stl loses \d+% of its volume with 650 nodes, whose edges are "):
        report_of(thin, nodes=650)
    report = report_of(written(tmp_path / "thick.stl", plate(8.0)), nodes=650)
    assert report.result["size_mm"][2] < 1.1 * 8.0


def test_volume_in_pieces_that_are_left_out_is_told(tmp_path: Path) -> None:
    equal = report_of(written(tmp_path / "two.stl", ball(0.0), ball(80.0)))
    assert "1 island removed with 50.0% of the volume, the largest piece is kept" in equal.changes
    assert any("50.0% of the volume was in pieces that were removed" in warning for warning in equal.warnings)
    crumb = report_of(written(tmp_path / "crumb.stl", ball(0.0), ball(80.0, 3.0)))
    assert not any("pieces" in warning for warning in crumb.warnings)


def test_overlapping_pieces_are_not_compared_with_a_sum_that_counts_twice(tmp_path: Path) -> None:
    report = report_of(written(tmp_path / "overlap.stl", ball(0.0), ball(25.0)), keep_islands=True, nodes=650)
    exact = 2.0 * 113.1 - np.pi * (2 * 30.0 - 25.0) ** 2 * (25.0**2 + 4 * 25.0 * 30.0) / (12 * 25.0) * 1e-3
    assert report.result["volume_cm3"] == pytest.approx(exact, rel=0.02)
    assert report.result["volume_change"] is None
    assert any("pieces of it overlap" in warning for warning in report.warnings)
    assert report.result["distance_mm"] < 2.0


def test_a_surface_may_have_hardly_fewer_nodes_than_the_file(tmp_path: Path) -> None:
    mesh = icosphere(30.0, 4)
    report = report_of(written(tmp_path / "fine.stl", (mesh.vertices, mesh.triangles)), nodes=2000)
    assert report.result["nodes"] == 2000
    assert report.result["distance_mm"] < 0.1


def test_ctrl_c_during_an_import_is_not_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A library that ignores all exceptions while it imports another one."""
    (tmp_path / "greedy_library.py").write_text(
        "import os, signal\n"
        "try:\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    for _ in range(1000): pass\n"
        "except BaseException:\n"
        "    pass\n"
        "done = True\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert os.getpid() and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with pytest.raises(KeyboardInterrupt):
        load("greedy_library")
    assert sys.modules["greedy_library"].done
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
