"""The scripted example on docs/teleoperation.md runs as pasted, and what the pages say of defaults is so."""

from __future__ import annotations

import re
from pathlib import Path

from spatula_env.teleop.haptics import HapticSettings
from spatula_env.teleop.haptics.scales import FORCE_SCALES
from spatula_env.teleop.keyboard import BUTTONS
from spatula_env.teleop.registry import DEVICES

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "teleoperation.md").read_text(encoding="utf-8")
HAPTICS = " ".join((DOCS / "haptics.md").read_text(encoding="utf-8").split())


def test_scripted_example(capsys):
    (example,) = [code for code in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL) if "ScriptedFalcon(" in code]
    exec(compile(example, "docs/teleoperation.md", "exec"), {})
    steps, cycles = map(int, capsys.readouterr().out.split()[-2:])
    assert steps == 20
    assert cycles >= 990


def test_all_devices_are_listed():
    assert re.findall(r"^\| `([a-z-]+)` \|", PAGE, re.MULTILINE) == list(DEVICES)


def test_defaults():
    gains = HapticSettings()
    for sentence in (
        f"low-pass filtered alike ({gains.cutoff:g} Hz)",
        f"-f <= lead <= {gains.lead:g} f + {1e3 * gains.least_lead:g} mN",
        f"`b` is {gains.damping:g} N s/m, for what is quicker than {gains.drift:g} Hz",
        f"by at most {1e-3 * gains.slew:g} N in a millisecond",
        f"fades in {1e3 * gains.ramp:g} ms, what comes back does so in {1e3 * gains.resume:g} ms",
        f"an allowance of {1e3 * gains.energy_allowance:g} mJ",
        f"a debt is forgotten at {1e6 * gains.energy_leak:g} \N{MICRO SIGN}W",
        f"silent for {1e3 * gains.stall_time:g} ms",
        f"at most {1e3 * gains.longest_stall:g} ms",
        f"{gains.wall_stiffness:g} N/m, at most {gains.wall_force:g} N",
    ):
        assert sentence in HAPTICS, sentence
    for task, scale in FORCE_SCALES.items():
        assert re.search(rf"{task}\b[a-z ]* {scale:g}\b", PAGE), task
    assert set(BUTTONS.values()) == {"center", "finish", "discard", "quit"}
