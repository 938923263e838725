from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from spatula_env import cli

sys.path.insert(0, str(Path(__file__).parents[1] / "data"))
from demonstration_helpers import ID, write_dataset

pytest.importorskip("minari")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    write_dataset(tmp_path)
    return tmp_path


def run(capsys: pytest.CaptureFixture[str], root: Path, *words: str, status: int = 0) -> tuple[list[str], str]:
    capsys.readouterr()
    assert cli.main(["datasets", *words, "--root", str(root)]) == status
    said = capsys.readouterr()
    return said.out.splitlines(), said.err


def run_json(capsys: pytest.CaptureFixture[str], root: Path, *words: str) -> dict[str, Any]:
    lines, _ = run(capsys, root, *words, "--json")
    return json.loads(lines[-1])


def test_list(capsys, root) -> None:
    lines, _ = run(capsys, root, "list")
    assert lines[1].split()[:5] == [ID, "Spatula/Press-v0", "3", "2", "13"]
    (found,) = run_json(capsys, root, "list")["datasets"]
    assert found["operators"] == {"scripted": 2, "human": 1}


def test_there_are_none(capsys, tmp_path) -> None:
    lines, _ = run(capsys, tmp_path / "empty", "list")
    assert lines == [f"no datasets in {tmp_path / 'empty'}"]
    assert run_json(capsys, tmp_path / "empty", "list") == {"datasets": [], "damaged": []}


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda data: (data / "metadata.json").write_text('{"total'), "metadata.json cannot be read"),
        (lambda data: (data / "metadata.json").write_text("[]"), "has no metadata of a dataset"),
        (lambda data: (data / "episodes" / "000001.hdf5").unlink(), "episode 1 is missing"),
        (lambda data: (data / "episodes" / "000002.hdf5").write_bytes(b"\x89HDF"), "episode 2 is damaged"),
        (lambda data: (data / "main_data.hdf5").unlink(), "main_data.hdf5 is missing"),
        (lambda data: (data / "index.jsonl").write_text("{"), "index.jsonl"),
    ],
)
def test_a_damaged_dataset_does_not_hide_the_others(capsys, root, harm, message) -> None:
    harm(write_dataset(root, "spatula/press/bad-v0") / "data")
    lines, noted = run(capsys, root, "list", status=1)
    assert [line.split()[0] for line in lines] == ["dataset", ID]
    assert "spatula datasets list: spatula/press/bad-v0 is damaged: " in noted
    assert message in noted
    assert cli.main(["datasets", "list", "--json", "--root", str(root)]) == 1
    found = json.loads(capsys.readouterr().out)
    assert [each["dataset_id"] for each in found["datasets"]] == [ID]
    assert [each["dataset"] for each in found["damaged"]] == ["spatula/press/bad-v0"]


def test_listing_opens_no_episode(capsys, root, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    monkeypatch.setitem(sys.modules, "minari", None)
    lines, _ = run(capsys, root, "list")
    assert len(lines) == 2


def test_ctrl_c_while_datasets_are_joined(capsys, root, monkeypatch) -> None:
    from spatula_env.data import DatasetWriter

    def interrupted(*_: Any) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(DatasetWriter, "add", interrupted)
    for words in (["merge", ID, ID], ["drop-failures", ID]):
        _, noted = run(capsys, root, *words, "--into", "spatula/press/all-v0", status=130)
        assert f"spatula datasets {words[0]}: stopped; nothing of spatula/press/all-v0 was made" in noted
    assert [each["dataset_id"] for each in run_json(capsys, root, "list")["datasets"]] == [ID]
    assert not (root / "spatula" / "press" / "all-v0").exists()


def test_inspect(capsys, root) -> None:
    lines, _ = run(capsys, root, "inspect", ID)
    text = "\n".join(lines)
    assert "Made up." in text
    assert "3 (2 scripted, 1 human)" in text
    assert "velocity_x, velocity_y, velocity_z" in text
    assert lines[-2].split() == ["1", "6", "11", "human", "made-up", "no", "bullet", "unknown"]
    found = run_json(capsys, root, "inspect", ID)
    assert found["layout"]["control_frequency"] == 20.0
    assert [each["success"] for each in found["list"]] == [True, False, True]


def test_a_dataset_that_is_not_there(capsys, root) -> None:
    for words in (["inspect", "aa/b-v0"], ["statistics", "aa/b-v0"], ["merge", "aa/b-v0", "--into", "b-v0"]):
        _, noted = run(capsys, root, *words, status=1)
        assert "there is no dataset 'aa/b-v0'" in noted


def test_merge(capsys, root) -> None:
    write_dataset(root, "spatula/press/other-v0", episodes=1)
    found = run_json(capsys, root, "merge", ID, "spatula/press/other-v0", "--into", "spatula/press/all-v0")
    assert (found["episodes"], found["successes"]) == (4, 3)
    _, noted = run(capsys, root, "merge", ID, "--into", "spatula/press/all-v0", status=1)
    assert "already" in noted


def test_drop_failures(capsys, root) -> None:
    lines, noted = run(capsys, root, "drop-failures", ID, "--into", "spatula/press/good-v0")
    assert "1 of 3 episodes were left out" in noted
    assert "has 2 episodes" in lines[0]
    assert run_json(capsys, root, "inspect", ID)["episodes"] == 3


def test_nothing_would_be_left(capsys, root) -> None:
    from spatula_env.data import catalog, copy_episodes

    copy_episodes([ID], "spatula/press/bad-v0", root=root, keep=lambda episode: not episode["success"])
    assert catalog.summarize("spatula/press/bad-v0", root).episodes == 1
    _, noted = run(capsys, root, "drop-failures", "spatula/press/bad-v0", "--into", "spatula/press/x-v0", status=1)
    assert "nothing would be left" in noted
    assert "spatula/press/x-v0" not in catalog.list_datasets(root)


def test_statistics(capsys, root) -> None:
    file = root / "statistics.png"
    lines, noted = run(capsys, root, "statistics", ID, "--plot", str(file))
    assert any(line.strip().startswith("success") and "66.7 %" in line for line in lines)
    assert f"drew {file}" in noted
    assert file.stat().st_size > 10_000
    assert run_json(capsys, root, "statistics", ID)["peak_force"]["greatest"] == 4.0


@pytest.mark.parametrize(
    ("name", "message"), [("file/plot.png", "cannot be written to"), ("plot.bmp", "must end with .png")]
)
def test_a_plot_that_cannot_be_drawn_is_refused_before_episodes_are_read(
    capsys, root, monkeypatch, name, message
) -> None:
    from spatula_env.data import statistics

    (root / "file").write_text("in the way")
    monkeypatch.setattr(statistics, "statistics", lambda *_: pytest.fail("episodes were read"))
    _, noted = run(capsys, root, "statistics", ID, "--plot", str(root / name), status=1)
    assert message in noted and len(noted.splitlines()) == 1


def test_scripted_demonstrations(capsys, tmp_path, monkeypatch) -> None:
    from spatula_env.teleop import scripted_dataset as scripted

    made: list[Any] = []
    make = scripted.gymnasium.make

    def short(env_id: str, **options: Any) -> Any:
        made.append((env_id, options))
        return make(env_id, max_episode_steps=4, **options)

    monkeypatch.setattr(scripted.gymnasium, "make", short)
    found = run_json(capsys, tmp_path, "make", "press", "--episodes", "1", "--engine", "batch")
    name = "spatula/press/scripted-v0"
    assert found[name]["episodes"] == found[name]["new"] == 1
    assert found[name]["new_successes"] == 0
    assert found[name]["seconds_per_episode"] > 0.0
    lines, noted = run(capsys, tmp_path, "make", "press", "--episodes", "2", "--engine", "batch")
    assert lines[0].startswith(f"{name}: 2 episodes, 1 of them new")
    assert "NO SUCCESS, kept and labelled" in noted
    lines, _ = run(capsys, tmp_path, "make", "press", "--episodes", "2", "--engine", "batch")
    assert lines[0].startswith(f"{name}: 2 episodes, 0 of them new")
    assert made == [("Spatula/Press-v0", {"engine": "batch"})] * 2


def test_export_says_what_is_missing(capsys, root, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "lerobot", None)
    _, noted = run(capsys, root, "export-lerobot", ID, "--output", str(root / "out"), status=1)
    assert "Python 3.12 or later" in noted
    assert not (root / "out").exists()
