"""The code and commands in docs/demonstrations.md run as pasted."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from spatula_env.cli import devices, forward
from spatula_env.cli.main import make_parser
from spatula_env.teleop.scripted_dataset import HANDS, Hand, scripted_ids

PAGE = (Path(__file__).parents[2] / "docs" / "demonstrations.md").read_text(encoding="utf-8")


def test_the_commands_are_understood() -> None:
    (block,) = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    lines = block.strip().splitlines()
    assert len(lines) == 5
    for line in lines:
        program, *words = shlex.split(line)
        assert program == "spatula"
        if words[0] not in forward.TARGETS:
            make_parser().parse_args(words)


def test_the_table_has_the_commands() -> None:
    told = re.findall(r"^\| `spatula (datasets [a-z-]+|[a-z]+)", PAGE, re.MULTILINE)
    assert len(told) == 10
    for command in told:
        with pytest.raises(SystemExit) as end:
            make_parser().parse_args([*command.split(), "--help"])
        assert end.value.code == 0


def test_the_devices_are_those_there_are() -> None:
    (listed,) = re.findall(r"`--device` is one of (.*?)\. With", PAGE, re.DOTALL)
    plain = re.sub(r"\([^)]*\)", "", listed).replace(" and ", ", ")
    assert {name.strip() for name in plain.replace("\n", " ").split(",")} == set(devices.DEVICES)


def test_the_hands_are_those_of_the_table() -> None:
    rows = re.findall(r"^\| ([A-Z][A-Za-z, ]+) \| (\d+) ms \| (\d+) % \| (\d+) % \|$", PAGE, re.MULTILINE)
    told = {}
    for names, delay, tremor, gain in rows:
        for name in names.split(", "):
            told[f"Spatula/{name}-v0"] = (int(delay), int(tremor), int(gain))
    assert told.keys() == scripted_ids().keys()
    for env_id, numbers in told.items():
        hand = HANDS.get(env_id, Hand())
        assert numbers == (round(1000 * hand.reaction_delay), round(100 * hand.tremor), round(100 * hand.gain))


def test_the_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("minari")
    (block,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    exec(compile(block, "docs/demonstrations.md", "exec"), {})
    assert capsys.readouterr().out == "1 episode, 1 with success, by {'scripted': 1}\n"


def test_links_lead_somewhere() -> None:
    folder = Path(__file__).parents[2] / "docs"
    for target in re.findall(r"\]\(([a-z-]+\.md)(?:#[a-z-]+)?\)", PAGE):
        assert (folder / target).exists()
