from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import pytest

from spatula_env import cli
from spatula_env.cli.bench import CORE, NEED_BULLET, benchmarks
from spatula_env.engines import bullet_is_there


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Records the programs that would be started, instead of starting them."""
    calls: list[list[str]] = []

    def run(command: list[str], **_: Any) -> Any:
        calls.append(command[3:] if command[1] == "-m" else command)
        calls[-1].insert(0, command[2])
        return SimpleNamespace(returncode=0, stdout='some text\n{"value": 1}\n')

    monkeypatch.setattr(subprocess, "run", run)
    return calls


def test_they_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench"]) == 0
    names = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert names == list(benchmarks())
    assert {"detector", "tunnelling", *CORE} <= set(names)
    assert "measure" not in names
    assert all(benchmarks().values())


def test_what_is_listed_can_be_run() -> None:
    for name in ("step", *CORE):
        assert callable(import_module(f"benchmarks.{name}").main)


def test_options_are_passed_on(started: list[list[str]]) -> None:
    assert cli.main(["bench", "tunnelling", "--cases", "5", "--json"]) == 0
    assert started == [["benchmarks.tunnelling", "--cases", "5", "--json"]]


def test_the_core_ones(started: list[list[str]], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", "--core", "--json"]) == 0
    names = [name for name in CORE if name not in NEED_BULLET or bullet_is_there()]
    assert json.loads(capsys.readouterr().out) == {name: {"value": 1} for name in names}
    assert [command[0] for command in started] == [f"benchmarks.{name}" for name in names]


def test_without_pybullet_some_are_left_out_and_that_is_said(
    started: list[list[str]], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    assert cli.main(["bench", "--core", "--json"]) == 0
    told = capsys.readouterr()
    assert set(json.loads(told.out)) == set(CORE) - set(NEED_BULLET)
    for name in NEED_BULLET:
        assert f"{name} is left out: PyBullet is not installed" in told.err


def test_the_options_of_the_core_ones_exist(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, options in CORE.items():
        # Help comes after what stands before it has been understood.
        monkeypatch.setattr(sys, "argv", [name, *options, "--json", "--help"])
        with pytest.raises(SystemExit) as end:
            import_module(f"benchmarks.{name}").main()
        assert end.value.code == 0, name


def test_one_that_fails(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: SimpleNamespace(returncode=1, stdout=""))
    assert cli.main(["bench", "--core"]) == 1
    assert "failed" in capsys.readouterr().err
    assert cli.main(["bench", "step"]) == 1


def test_an_unknown_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", "weight"]) == 1
    assert "there is no benchmark 'weight'; there are cameras, detector" in capsys.readouterr().err
    assert cli.main(["bench", "--core", "step"]) == 1
