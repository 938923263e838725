from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from spatula_env import cli

SMALL = ["--engine", "batch", "--size", "64"]


@pytest.fixture(autouse=True)
def headless(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)


def test_without_a_display_it_is_a_picture(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["view", "press", "--steps", "2", *SMALL]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "out/view/press.png"
    with Image.open("out/view/press.png") as picture:
        assert picture.size == (64, 64)
        assert np.asarray(picture).std() > 10.0


def test_a_film_shows_the_episode() -> None:
    assert cli.main(["view", "press", "--steps", "5", "--output", "a.gif", *SMALL]) == 0
    with Image.open("a.gif") as film:
        assert film.n_frames == 6


def test_the_beginning_alone() -> None:
    assert cli.main(["view", "press", "--steps", "0", "--output", "a.png", *SMALL]) == 0
    assert Path("a.png").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--output", "a.txt"], "must end with"),
        (["--policy", "nowhere/run"], "policy must be one of"),
    ],
)
def test_what_cannot_be(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["view", "press", *words, *SMALL]) == 1
    assert message in capsys.readouterr().err
