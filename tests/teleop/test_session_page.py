"""The scripted example on docs/teleoperation.md runs as pasted, and what the page says of defaults is so."""

from __future__ import annotations

import re
from pathlib import Path

from spatula_env.teleop.haptics import HapticSettings
from spatula_env.teleop.keyboard import BUTTONS
from spatula_env.teleop.registry import DEVICES

PAGE = (Path(__file__).parents[2] / "docs" / "teleoperation.md").read_text(encoding="utf-8")


def test_scripted_example(capsys):
    (example,) = [code for code in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL) if "ScriptedFalcon(" in code]
    exec(compile(example, "docs/teleoperation.md", "exec"), {})
    steps, cycles = map(int, capsys.readouterr().out.split()[-2:])
    assert steps == 20
    assert cycles >= 990


def test_all_devices_are_listed():
    assert re.findall(r"^\| `([a-z-]+)` \|", PAGE, re.MULTILINE) == list(DEVICES)


def test_defaults():
    settings = HapticSettings()
    assert f"({settings.stiffness:g} N/m;" in PAGE
    assert f"silent for {500 * settings.stall_time:g} ms, and is zero after {1000 * settings.stall_time:g} ms" in PAGE
    assert f"low-pass filtered at {settings.cutoff:g} Hz" in PAGE
    assert f"counts {100 * settings.tank_margin:g} % more" in PAGE
    assert f"allowance ({settings.tank_start:g} J)" in PAGE
    assert set(BUTTONS.values()) == {"center", "finish", "discard", "quit"}
