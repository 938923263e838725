"""The documentation page about the web device is true, and its code runs as pasted."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from web_helpers import Script

from spatula_env.render.palette import PRESSURE_LIMITS
from spatula_env.teleop.web.access import SHORTEST_TOKEN
from spatula_env.teleop.web.gauges import SPAN
from spatula_env.teleop.web.operator_input import AWAY, KEYS, SILENT
from spatula_env.teleop.web.recording import DATASET

pytest.importorskip("viser", reason="the extra web is not installed")
pytest.importorskip("minari", reason="the extra data is not installed")

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "web.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def run(example, printed):
    """Run an example at any port that is free."""
    assert "port=8080" in example
    exec(compile(example.replace("port=8080", "port=0"), "docs/web.md", "exec"), {"print": printed})


@pytest.mark.parametrize("example", [code for code in EXAMPLES if "serve(" in code])
def test_serving(example):
    said = []

    def printed(url):
        said.append(url)
        raise KeyboardInterrupt

    run(example, printed)
    (url,) = said
    assert url.startswith("http://127.0.0.1:")
    assert ("?token=" in url) == ("token=" in example)


def test_recording_with_the_device(monkeypatch, tmp_path):
    (example,) = [code for code in EXAMPLES if "make_device(" in code]
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    said, scripts = [], []

    def printed(text):
        said.append(text)
        if len(said) == 1:
            scripts.append(Script(text.removeprefix("open ")))
            # One after the other: each episode is finished at once.
            scripts[0].press_again("Enter")

    try:
        run(example.replace("episodes=10", "episodes=2"), printed)
    finally:
        scripts[0].close()
    assert "recorded=2" in str(said[-1])


def test_numbers():
    assert f"from {PRESSURE_LIMITS[0] / 1e3:.2f} kPa" in PAGE and f"from {PRESSURE_LIMITS[1] / 1e3:.1f} kPa" in PAGE
    assert f"the last {SPAN:.0f} s" in PAGE
    assert f"`{DATASET}` if nothing else is said" in PAGE
    assert SILENT == 0.5 and "half a second of silence" in PAGE
    assert AWAY == 3.0 and "After three seconds" in PAGE
    assert SHORTEST_TOKEN == 8 and "of eight characters" in PAGE


def test_keys():
    for key, (name, _) in KEYS.items():
        letter = key.removeprefix("Key").lower()
        if len(letter) == 1:
            (row,) = re.findall(rf"^\|[^|]*\b{letter}\b[^|]*\|(.*)\|$", PAGE, re.MULTILINE)
            assert name[-1] in row


def test_the_picture_is_there():
    (picture,) = re.findall(r"!\[.*\]\((.*)\)", PAGE)
    assert 10_000 < (DOCS / picture).stat().st_size < 400_000
