from __future__ import annotations

import json
import math
import sys
from importlib import util
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from spatula_env import __version__, cli, demo
from spatula_env.demo import runner
from spatula_env.engines import bullet_is_there, bullet_version
from spatula_env.installing import install_hint

# Without PyBullet its own contact is left out.
VERDICTS = {"flags": {"contact"}, "second_step": {"unstable"}} | ({"bullet": {"inside"}} if bullet_is_there() else {})
NUMBERS = {"bullet": 3, "second_step": 4, "flags": 5}
FIGURES = tuple(sorted(f"figure-{NUMBERS[contact]}-{contact}.png" for contact in VERDICTS))


def read_picture(path: Path) -> NDArray[np.uint8]:
    with Image.open(path) as picture:
        return np.array(picture.convert("RGB"))


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demo") / "new" / "folder"
    assert cli.main(["demo", "--quick", "--output", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def document(output: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((output / "results.json").read_text())
    return content


def test_the_three_models_end_as_the_figures_say(document: dict[str, Any]) -> None:
    verdicts: dict[str, set[str]] = {}
    for result in document["results"]:
        verdicts.setdefault(result["contact"], set()).add(result["verdict"])
    assert verdicts == VERDICTS


def test_what_is_left_out_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Enough(Exception):
        pass

    def stop(pool: Any, engine: str, actor: Any, console: Any, quick: bool) -> None:
        assert {case.contact for case in runner.comparison_cases(engine, quick)} == {"flags", "second_step"}
        raise Enough

    monkeypatch.setitem(sys.modules, "pybullet", None)
    monkeypatch.setattr(runner, "_compute", stop)
    with pytest.raises(Enough):
        cli.main(["demo", "--quick", "--output", str(tmp_path)])
    told = " ".join(capsys.readouterr().out.split())
    assert told.startswith("PyBullet is not installed: left out is its own contact, contact='bullet'")


def test_results_are_in_order_and_complete(document: dict[str, Any]) -> None:
    assert [(result["contact"], result["speed"]) for result in document["results"]] == [
        (contact, speed) for contact in VERDICTS for speed in (5.0, 60.0)
    ]
    keys = {
        "contact", "speed", "hold_time", "engine", "verdict", "residual_mean", "residual_max", "covered_share",
        "lower_nodes", "upper_nodes", "pairs_steps", "inside_share", "steps", "diverged", "wall_time", "force_newtons",
        "force_scene_units",
    }  # fmt: skip
    for result in document["results"]:
        assert set(result) == keys
        assert all(math.isfinite(value) for value in result["force_newtons"].values())
    assert document["versions"]["spatula_env"] == __version__
    bullet = {name for name, _ in filter(None, [bullet_version()])}
    assert set(document["versions"]) == {"spatula_env", "python", "gymnasium", "numba", "numpy", *bullet}
    assert {"units", "scene", "press", "criteria", "platform", "created", "format"} < set(document)


def test_a_trained_policy_succeeds_in_the_episode(document: dict[str, Any]) -> None:
    episode = document["episode"]
    assert episode["task"] == "Spatula/Press-v0"
    assert episode["policy"] == "trained policy"
    assert "demonstrations" in episode["origin"]
    assert episode["success"] is True
    assert abs(episode["depth_error"]) < 0.001


@pytest.mark.parametrize("name", FIGURES)
def test_figures_are_pictures_of_something(output: Path, name: str) -> None:
    picture = read_picture(output / name)
    assert picture.shape[1] == 560
    # Without the first step the organ may have been thrown out of most of the picture.
    assert picture.reshape(-1, 3).std(axis=0).min() > 12.0
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 2000


def test_figures_differ(output: Path) -> None:
    pictures = [read_picture(output / name)[:330].astype(int) for name in FIGURES]
    for one, other in combinations(range(len(FIGURES)), 2):
        assert (np.abs(pictures[one] - pictures[other]).max(axis=-1) > 30).mean() > 0.02


@pytest.mark.parametrize("name", ["press.gif", "episode.gif"])
def test_films_move(output: Path, name: str) -> None:
    with Image.open(output / name) as film:
        assert film.n_frames > 3
        first = np.asarray(film.convert("RGB")).astype(int)
        film.seek(film.n_frames // 2)
        middle = np.asarray(film.convert("RGB"))
    assert (np.abs(middle - first).max(axis=-1) > 30).sum() > 50


def test_nothing_else_is_left_behind(output: Path, document: dict[str, Any]) -> None:
    names = {item.name for item in output.iterdir()}
    assert names == {"results.json", "results.md", *document["pictures"]}
    assert {*FIGURES, "press.gif", "episode.gif"} == set(document["pictures"])


def test_a_folder_that_cannot_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "file"
    file.touch()
    assert cli.main(["demo", "--output", str(file / "folder")]) == 1
    assert f"cannot write to {file / 'folder'}" in capsys.readouterr().err


def test_without_the_extra(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(demo, "find_spec", lambda name: None if name == "rich" else util.find_spec(name))
    assert cli.main(["demo"]) == 1
    assert f"needs rich: {install_hint('demo')}" in capsys.readouterr().err


def test_an_interrupt_is_no_traceback(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(demo, "require_extra", interrupt)
    assert cli.main(["demo"]) == 130
    assert capsys.readouterr().err == "spatula demo: interrupted\n"


def test_envs_lists_ids_with_a_word_on_each(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["envs"]) == 0
    lines = capsys.readouterr().out.splitlines()
    ids = [line.split()[0] for line in lines]
    assert "Spatula/Press-v0" in ids
    assert ids == sorted(ids)
    assert all(len(line.split(maxsplit=1)[1]) > 10 for line in lines)


@pytest.mark.parametrize("arguments", [[], ["nothing"], ["demo", "--nothing"]])
def test_wrong_arguments_end_with_status_two(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as error:
        cli.main(arguments)
    assert error.value.code == 2


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as error:
        cli.main(["--version"])
    assert error.value.code == 0
    assert __version__ in capsys.readouterr().out
