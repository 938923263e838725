"""The code in docs/extending.md runs as pasted: each section by itself, in a folder of its own."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path

import gymnasium
import pytest

PAGE = (Path(__file__).parents[1] / "docs" / "extending.md").read_text(encoding="utf-8")
SECTIONS = {
    title: re.findall(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    for title, text in re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", PAGE, flags=re.MULTILINE | re.DOTALL)
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    modules, ids = set(sys.modules), set(gymnasium.registry)
    yield tmp_path
    for name in set(sys.modules) - modules:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]
    for added in set(gymnasium.registry) - ids:
        del gymnasium.registry[added]


def test_there_is_a_section_for_each_kind_of_thing():
    assert list(SECTIONS) == ["Add a task", "Add an organ", "Add a tool"]
    assert all(SECTIONS.values())


@pytest.mark.parametrize("title", SECTIONS)
def test_a_section_runs_as_pasted(title, folder, capsys):
    for index, code in enumerate(SECTIONS[title]):
        if "load_organ" in code:
            pytest.importorskip("trimesh", reason="surfaces are read with trimesh: the extra mesh is not installed")
        file = re.match(r"# (\w+\.py)\n", code)
        if file:
            (folder / file[1]).write_text(code, encoding="utf-8")
            importlib.invalidate_caches()
            continue
        exec(compile(code, f"extending.md, {title}, block {index}", "exec"), {"__name__": "__main__"})
        told = re.findall(r"print\(.*\)  # (.*)", code)
        assert told
        assert capsys.readouterr().out.splitlines() == told
