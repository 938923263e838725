from __future__ import annotations

import json

import pytest

from spatula_env import cli
from spatula_env.teleop.falcon import transport

NAMES = ["found", "firmware", "packets", "homed", "frames", "force"]


def test_an_emulated_one_is_checked_to_the_end(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["falcon", "--emulated"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "This Falcon is software; nothing is plugged in."
    assert sum(line.startswith("ok: ") for line in lines) == len(NAMES)
    assert lines[-1] == "All is well."


def test_what_is_ignored_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["falcon", "--emulated", "--no-force", "--firmware", "falcon.bin", "--index", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1:3] == ["--firmware is ignored: it has its firmware.", "--index is ignored: there is only one."]
    assert cli.main(["falcon", "--emulated", "--yes"]) == 0
    assert "--yes is ignored: it asks nobody." in capsys.readouterr().out


def test_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["falcon", "--emulated", "--no-force", "--json"]) == 0
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert found["emulated"] is True
    assert [step["name"] for step in found["steps"]] == NAMES
    assert [step["passed"] for step in found["steps"]] == [True] * 5 + [None]
    assert "Move the grip 2 cm up." in said.err


def test_there_is_none(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transport, "find_falcons", lambda: [])
    assert cli.main(["falcon"]) == 1
    said = capsys.readouterr().out
    assert "FAILED: no Novint Falcon on the USB" in said
    assert "ended at 'found'" in said


def test_nobody_pushes_a_hand_that_was_not_asked(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from argparse import Namespace

    from spatula_env.cli.falcon import _consent

    chosen = Namespace(no_force=False, yes=False, emulated=False)
    # The standard input of tests is no terminal.
    assert _consent(chosen, "May it push?", print) is False
    assert "Nobody is there to answer" in capsys.readouterr().out
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    for answer, consents in (("yes", True), ("Y", True), ("no", False), ("", False)):
        monkeypatch.setattr("builtins.input", lambda _, answer=answer: answer)
        assert _consent(chosen, "May it push?", print) is consents
    assert _consent(Namespace(no_force=True, yes=False, emulated=False), "?", print) is False
    assert _consent(Namespace(no_force=False, yes=True, emulated=False), "?", print) is True
