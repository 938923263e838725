"""The emulator's example on docs/falcon.md runs as pasted, and the page's numbers are the package's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from spatula_env.teleop.falcon import ftdi, kinematics
from spatula_env.teleop.falcon.frames import CENTRE, HALF_WIDTH

PAGE = (Path(__file__).parents[2] / "docs" / "falcon.md").read_text(encoding="utf-8")


def test_emulator_example(capsys):
    (example,) = [code for code in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL) if "FalconEmulator(" in code]
    exec(compile(example, "docs/falcon.md", "exec"), {})
    assert "Energies(motors=" in capsys.readouterr().out


@pytest.mark.parametrize("value", [ftdi.BAUD_BOOT, ftdi.BAUD_UPLOAD, ftdi.BAUD_NORMAL])
def test_baud_rates(value):
    assert f"| 0x{value:04x} |" in PAGE


def test_lengths_and_frames():
    lengths = {
        "a": kinematics.THIGH,
        "b": kinematics.SHIN,
        "c": kinematics.PLATE,
        "f": kinematics.PLATE_TANGENT,
        "r": kinematics.RADIUS,
        "s": kinematics.TANGENT,
    }
    for name, length in lengths.items():
        number = f"{1000.0 * length:g}".replace("-", "\N{MINUS SIGN}")
        assert re.search(rf"\b{name} {number} mm", PAGE), name
    assert f"{CENTRE:g} m - z" in PAGE
    assert f"cube of ±{1000 * HALF_WIDTH:g} mm" in PAGE
