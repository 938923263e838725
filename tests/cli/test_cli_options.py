from __future__ import annotations

import io
import json
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from films import opened_film

from spatula_env import cli
from spatula_env.changes import with_changes
from spatula_env.cli.common import CommandError, print_json, resolve_env
from spatula_env.cli.main import MODULES, make_parser
from spatula_env.cli.showing import Film
from spatula_env.naming import env_ids

COMMAND_LINES = [
    ["play"],
    ["record"],
    ["replay"],
    ["datasets"],
    ["datasets", "list"],
    ["datasets", "inspect"],
    ["datasets", "merge"],
    ["datasets", "drop-failures"],
    ["datasets", "statistics"],
    ["datasets", "make"],
    ["datasets", "export-lerobot"],
    ["falcon"],
    ["view"],
    ["bench"],
    ["train"],
    ["evaluate"],
    ["demo"],
    ["envs"],
]


@pytest.mark.parametrize("words", COMMAND_LINES, ids=" ".join)
def test_every_command_has_help(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main([*words, "--help"])
    assert end.value.code == 0
    said = capsys.readouterr().out
    assert said.startswith("usage: ")
    assert len(said) > 150


def test_help_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["--help"])
    said = capsys.readouterr().out
    for words in COMMAND_LINES:
        assert f"\n    {words[0]} " in said
    assert len(MODULES) == len(set(MODULES))


def test_help_fits_a_terminal(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "110")
    for words in COMMAND_LINES:
        if words[0] not in ("train", "evaluate"):
            with pytest.raises(SystemExit):
                cli.main([*words, "--help"])
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 115


@pytest.mark.parametrize("text", ["press", "Press", "press-v0", "Spatula/Press-v0", "spatula_env:Spatula/Press-v0"])
def test_environments_have_short_names(text: str) -> None:
    assert resolve_env(text) == "Spatula/Press-v0"


def test_an_unknown_environment(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["view", "knead"]) == 1
    said = capsys.readouterr().err
    assert "there is no environment 'knead'" in said
    assert all(env_id in said for env_id in env_ids())


def test_an_unknown_option_of_an_environment(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["view", "press", "--set", "colour=red", "--output", "a.png"]) == 1
    said = capsys.readouterr().err
    assert "unexpected keyword argument 'colour'" in said
    assert "environment creator" not in said


def test_changes_are_yaml() -> None:
    assert with_changes({}, ["a=1", "b.c=[1, x]", "b.d=null", "e=default"]) == {
        "a": 1,
        "b": {"c": [1, "x"], "d": None},
        "e": "default",
    }


@pytest.mark.parametrize("change", ["a", "=1", "a.=1", "a={", "a..b=1"])
def test_changes_that_are_none(change: str) -> None:
    with pytest.raises(ValueError, match=r"a change must be KEY=VALUE|is not YAML"):
        with_changes({}, [change])


def test_a_change_below_a_value() -> None:
    with pytest.raises(ValueError, match=r"there is no a\.b: a has the value 1"):
        with_changes({}, ["a=1", "a.b=2"])


def test_json_is_strict(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"a": float("nan"), "b": (1.5, float("inf")), "c": {"d": None}})
    assert json.loads(capsys.readouterr().out) == {"a": None, "b": [1.5, None], "c": {"d": None}}


@pytest.mark.parametrize(
    "words",
    [
        ["play", "press"],
        ["play", "press", "--device", "broom"],
        ["record", "press", "--device", "keyboard"],
        ["record", "press", "--device", "keyboard", "--dataset", "a", "--episodes", "0"],
        ["record", "press", "--device", "keyboard", "--dataset", "a", "--episodes", "1", "--total", "2"],
        ["datasets"],
        ["falcon", "--yes", "--no-force"],
    ],
)
def test_wrong_options(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main(words)
    assert end.value.code == 2
    assert "usage: spatula" in capsys.readouterr().err


def test_a_reader_that_has_seen_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    class Closed(io.StringIO):
        def write(self, _: str) -> int:
            raise BrokenPipeError

    monkeypatch.setattr(sys, "stdout", Closed())
    assert cli.main(["envs"]) == 1


def test_envs_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["envs", "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)) == env_ids()


@pytest.mark.parametrize("name", ["train", "evaluate", "clone", "export", "convert"])
def test_options_of_agents_are_passed_on(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[Any] = []
    stand_in = SimpleNamespace(main=lambda arguments, program: given.append((program, arguments)) or 3)
    monkeypatch.setitem(sys.modules, f"spatula_env.learning.commands.{name}", stand_in)
    assert cli.main([name, "--config", "a.yaml", "--help", "x"]) == 3
    assert given == [(f"spatula {name}", ["--config", "a.yaml", "--help", "x"])]


def test_the_parser_is_not_asked_about_them() -> None:
    with pytest.raises(SystemExit):
        make_parser().parse_args(["train", "--config", "a.yaml"])


class TestFilm:
    @staticmethod
    def frames(count: int) -> list[np.ndarray]:
        pictures = []
        for number in range(count):
            picture = np.full((33, 47, 3), 200, dtype=np.uint8)
            picture[:, 4 * number : 4 * number + 8] = (200, 30, 30)
            pictures.append(picture)
        return pictures

    @pytest.mark.parametrize(("name", "shown"), [("a/film.gif", 5), ("picture.png", 1)])
    def test_is_written(self, name, shown, tmp_path) -> None:
        from PIL import Image

        film = Film(tmp_path / name, 20.0)
        for picture in self.frames(5):
            film.add(picture)
        assert film.write() == tmp_path / name
        with Image.open(tmp_path / name) as found:
            assert found.size == (47, 33)
            assert getattr(found, "n_frames", 1) == shown
            if name.endswith("png"):
                np.testing.assert_array_equal(np.asarray(found), self.frames(5)[-1])
        assert [each.name for each in (tmp_path / name).parent.iterdir()] == [name.rpartition("/")[2]]

    def test_as_mp4(self, tmp_path) -> None:
        pytest.importorskip("moviepy")
        film = Film(tmp_path / "film.mp4", 20.0)
        for picture in self.frames(5):
            film.add(picture)
        film.write()
        with opened_film(tmp_path / "film.mp4") as clip:
            # The encoder wants even numbers.
            assert tuple(clip.size) == (46, 32)

    def test_of_an_unknown_kind(self, tmp_path) -> None:
        with pytest.raises(CommandError, match=r"must end with \.png"):
            Film(tmp_path / "film.txt", 20.0)

    def test_of_nothing(self, tmp_path) -> None:
        with pytest.raises(CommandError, match="no picture"):
            Film(tmp_path / "film.gif", 20.0).write()
