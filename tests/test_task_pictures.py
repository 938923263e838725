"""The picture of the tasks: is it small enough for a README, and does it show what its script claims?"""

from __future__ import annotations

import importlib.util
import io
import sys
from pathlib import Path

import numpy as np
import pytest

from spatula_env import TASKS

Image = pytest.importorskip(
    "PIL.Image", reason="pictures are put together with Pillow: the extra demo is not installed"
)

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("task_pictures", ROOT / "scripts" / "task_pictures.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["task_pictures"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["task_pictures"]


def test_every_task_has_a_picture(script):
    assert set(script.SEEDS) == set(TASKS)
    path = ROOT / "docs" / "images" / "tasks.png"
    assert path.stat().st_size <= script.MOST_BYTES
    with Image.open(path) as picture:
        assert picture.size == (5 * script.SIDE + 4 * script.GAP, script.SIDE + 2 * script.STRIP)


def test_an_expert_is_shown_when_it_has_solved_its_task(script, capsys):
    picture = script.solve("Press", "batch", script.SEEDS["Press"])
    assert picture.shape == (script.SIDE, script.SIDE, 3)
    assert "Press: solved" in capsys.readouterr().out


def test_a_file_is_never_too_large(script):
    noise = np.random.default_rng(0).integers(0, 256, (script.SIDE, script.SIDE, 3), dtype=np.uint8)
    smooth = np.broadcast_to(np.arange(script.SIDE, dtype=np.uint8)[:, None, None], noise.shape)
    sheet = script.tile({"Noise": noise, "Smooth": np.ascontiguousarray(smooth)})
    data = script.encode(sheet)
    assert len(data) <= script.MOST_BYTES
    with Image.open(io.BytesIO(data)) as read:
        assert read.size == sheet.size
    wide = Image.fromarray(np.random.default_rng(0).integers(0, 256, (900, 900, 3), dtype=np.uint8))
    with pytest.raises(ValueError, match="does not fit into 250000 bytes"):
        script.encode(wide)
