from __future__ import annotations

import io
import json
import stat
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from spatula_env.demo.press import PressCase, PressResult, Snapshot
from spatula_env.demo.report import as_document, markdown_table, terminal_table, write_json


def make_result(contact: str = "flags", speed: float = 60.0, residual: float | None = -0.0076) -> PressResult:
    nothing = np.zeros(72, dtype=np.bool_)
    zeros = np.zeros(3)
    return PressResult(
        case=PressCase(contact, speed),
        verdict="contact",
        residual_mean=residual,
        residual_max=residual,
        covered_share=1.0,
        force_mean=5.4321,
        force_deviation=0.0005,
        force_peak=5.5,
        force_peak_of_run=16.25,
        lower_nodes=36,
        upper_nodes=0,
        pairs_steps=0,
        inside_share=0.0,
        steps=486,
        diverged=False,
        wall_time=1.0,
        force_scale=0.002,
        snapshot=Snapshot(0.0, np.zeros((4, 3)), zeros, np.array([0.0, 0.0, 0.0, 1.0]), nothing, nothing, zeros),
    )


def test_the_table_fits_an_eighty_column_terminal() -> None:
    results = [make_result(name, speed) for name in ("flags", "second_step", "bullet") for speed in (0.2, 400.0)]
    console = Console(file=io.StringIO(), width=80)
    console.print(terminal_table(results, 80))
    text = console.file.getvalue()
    lines = text.splitlines()
    assert max(map(len, lines)) <= 80
    assert "…" not in text
    assert text.count("contact") == 1 + len(results)
    assert text.count("second_step") == 1
    assert "0.2" in text and "36/0" in text and "5.43" in text


def test_the_markdown_table_has_a_cell_for_every_column() -> None:
    text = markdown_table([make_result(), make_result(residual=None)])
    rows = [line.strip("|").split("|") for line in text.splitlines()]
    assert len(rows) == 4
    assert len({len(row) for row in rows}) == 1
    assert rows[3][2].strip() == "none"


def test_the_document_is_strict_json(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    write_json(path, as_document([make_result(residual=None)], None, ["figure.png"]))
    document = json.loads(path.read_text())
    assert document["results"][0]["residual_max"] is None
    assert document["results"][0]["force_scene_units"]["mean"] == pytest.approx(5.4321 / 0.002)
    assert document["scene"]["organ_nodes"] == 328
    assert document["pictures"] == ["figure.png"]
    assert set(document["criteria"]) == {"contact", "inside", "unstable"}
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


def test_what_cannot_be_written_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    write_json(path, {"number": 1})
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(path, {"number": float("nan")})
    # A folder of that name cannot be replaced by a file.
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError):
        write_json(tmp_path / "folder", {"number": 2})
    assert json.loads(path.read_text()) == {"number": 1}
    assert sorted(item.name for item in tmp_path.iterdir()) == ["folder", "results.json"]
