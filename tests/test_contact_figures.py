"""The figures of docs/contact-model.md: are they drawn, and from runs that show what they say?"""

from __future__ import annotations

import importlib.util
import re
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.plunges import ALLOWED
from spatula_env import Simulation, scenes
from spatula_env.geometry import Tool
from spatula_env.geometry.transforms import quaternion_conjugate, rotate
from spatula_env.installing import install_hint

pytest.importorskip("matplotlib", reason="the figures are drawn with Matplotlib, which the extras viz and dev install")

SCRIPT = Path(__file__).parents[1] / "scripts" / "contact_figures.py"
LARGEST_FILE = 150_000
SMALLER = {
    "flags.png": {},
    "path.png": {},
    "features.png": {"depth": 0.06},
    "pressure.png": {"depths": (0.05, 0.1)},
    "force.png": {"seconds": 0.15},
    "speed.png": {"speeds": (2000.0,), "depth": 0.2},
}
"""Arguments with which figures are drawn fast."""


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("contact_figures", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["contact_figures"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["contact_figures"]


def test_there_are_arguments_for_every_figure(script):
    assert set(SMALLER) == set(script.FIGURES)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.bullet] if name == "force.png" else []) for name in SMALLER]
)
def test_a_figure_is_a_small_png_of_the_right_width(script, name, tmp_path):
    caption = script.FIGURES[name](tmp_path / name, **SMALLER[name])
    data = (tmp_path / name).read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", data[16:24])
    assert width == script.WIDTH
    assert 300 <= height <= 800
    assert 10_000 < len(data) <= LARGEST_FILE
    assert caption.endswith(".")
    assert "nan" not in caption


def test_the_command_draws_what_it_is_asked_for_and_always_the_same(script, tmp_path, capsys):
    for folder in ("first", "second"):
        script.main(["--output", str(tmp_path / folder), "--only", "path.png"])
    first, second = (sorted((tmp_path / folder).iterdir()) for folder in ("first", "second"))
    assert [path.name for path in first] == ["path.png"]
    assert first[0].read_bytes() == second[0].read_bytes()
    assert f"{first[0]}: The face that" in capsys.readouterr().out


def test_without_matplotlib_the_command_says_what_to_install(script, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=re.escape(install_hint("viz"))):
        script.main(["--output", str(tmp_path / "new")])
    assert not (tmp_path / "new").exists()


def test_only_the_second_step_alone_flags_both_nodes_of_a_pair(script):
    simulation = Simulation(scenes.seed())
    tool = simulation.scene.tools[0].tool
    both, one = (script.query_after_jump(simulation, name) for name in ("off", "inside"))
    simulation.close()
    assert (both.flags & both.flags[tool.opposite]).sum() > 20
    assert not both.unfeasible.any()
    lower = tool.normals[:, 2] < 0.0
    assert not (one.flags & ~lower).any()
    np.testing.assert_array_equal(one.flags[lower], both.flags[lower])
    np.testing.assert_array_equal(one.unfeasible, one.flags[tool.opposite])
    # All three states are in the picture.
    assert (~one.flags & ~one.unfeasible).any()


def test_the_paths_lead_through_the_faces_that_their_titles_name(script):
    expected = [((0, 0, -1), (0, 0, -1)), ((1, 0, 0), (0, 0, 1)), ((0, 0, -1), (0, 0, 1))]
    for way, (through, beneath) in zip(script.WAYS, expected, strict=True):
        face, nearest, normals = script.find_entry(way)
        assert tuple(normals[face]) == through
        assert tuple(normals[nearest]) == beneath


def test_constraints_of_the_plate_on_edge_are_on_its_lower_edge(script):
    touch = script.press_edge_on(depth=0.06)
    local = rotate(quaternion_conjugate(touch.orientation), touch.places - touch.position)
    width, height, thickness = touch.scene.tools[0].tool.size
    assert len(touch.kinds) >= 4
    assert set(touch.kinds.tolist()) <= set(script.KINDS)
    np.testing.assert_allclose(local[:, 1], -0.5 * height, atol=0.01)
    assert np.abs(local[:, 0]).max() <= 0.5 * width + 0.01
    assert np.abs(local[:, 2]).max() <= 0.5 * thickness + 0.01
    np.testing.assert_allclose(np.linalg.norm(touch.normals, axis=1), 1.0)
    assert (touch.normals[:, 2] < -0.8).all()


def test_pressure_times_area_is_the_force(script):
    scene = scenes.seed()
    areas = scene.tools[0].tool.areas * scene.scale.length**2
    (light, weak), (hard, strong) = script.press_to_depths((0.1, 0.2), hold=0.2)
    assert 1e3 * light @ areas == pytest.approx(weak, rel=1e-3)
    assert 1e3 * hard @ areas == pytest.approx(strong, rel=1e-3)
    assert strong > 1.5 * weak


@pytest.mark.bullet
def test_the_flags_method_holds_the_organ_and_bullet_loses_it(script):
    held, lost = (script.record_force(contact, 20.0, 0.12)[-5:] for contact in ("flags", "bullet"))
    assert held.min() > 0.5
    assert np.abs(lost).max() < 0.1


def test_fast_plunges_leave_nothing_in_the_organ(script):
    for values in script.plunge_residuals(0.02, (100.0, 2000.0), depth=0.3).values():
        assert values.shape == (2, 2)
        assert (values >= 0.0).all()
        assert values.max() <= ALLOWED


def test_a_cut_through_a_box_is_as_long_as_its_girth(script):
    box = Tool.box((1.0, 2.0, 3.0))
    segments = script.cut_surface(box.vertices, box.triangles, 0.3)
    assert np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum() == pytest.approx(8.0)
    assert len(script.cut_surface(box.vertices, box.triangles, 1.1)) == 0
