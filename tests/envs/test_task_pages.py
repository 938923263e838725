"""The pages in docs/tasks agree with the docstrings."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path

import pytest

from spatula_env import TASKS

pytest.importorskip("PIL.Image", reason="pictures are cut out with Pillow: the extra demo is not installed")

ROOT = Path(__file__).parents[2]
NAMES = tuple(name.lower() for name in TASKS)


@pytest.fixture(scope="module")
def script():
    folder = str(ROOT / "scripts")
    sys.path.insert(0, folder)
    yield importlib.import_module("task_pages")
    sys.path.remove(folder)
    for name in ("task_pages", "task_pictures"):
        sys.modules.pop(name, None)


@pytest.fixture
def elsewhere(script, tmp_path, monkeypatch):
    """The script, writing into another folder."""
    sheet = tmp_path / "docs" / "images" / "tasks.png"
    sheet.parent.mkdir(parents=True)
    sheet.write_bytes(script.SHEET.read_bytes())
    for name, path in (("ROOT", tmp_path), ("PAGES", tmp_path / "docs" / "tasks"), ("SHEET", sheet)):
        monkeypatch.setattr(script, name, path)
    return script


@pytest.mark.parametrize("name", [*NAMES, "common"])
def test_a_page_is_current(script, name):
    old = [str(path.relative_to(ROOT)) for path in script.outdated(name)]
    assert not old, f"not current: {', '.join(old)}; run `{script.COMMAND}`"


@pytest.mark.parametrize("name", [*NAMES, "common"])
def test_a_page_reads_well(script, name):
    text = script.page(name)
    outside_code = re.sub(r"`[^`]*`", "", text)
    assert text.startswith("# ")
    assert len(re.findall(r"^# ", text, flags=re.MULTILINE)) == 1
    # Nothing is indented as in the source, which Markdown takes for code, and no formula is left for it to garble.
    assert not re.search(r"^ {4}", text, flags=re.MULTILINE)
    assert "\\," not in outside_code
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert (script.PAGES / target).resolve().exists(), target


@pytest.mark.parametrize("page", ["docs/tasks.md", "README.md"])
def test_every_id_leads_to_its_page(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    folder = "" if page.startswith("docs") else "docs/"
    for task, name in zip(TASKS, NAMES, strict=True):
        assert f"| [`Spatula/{task}-v0`]({folder}tasks/{name}.md) |" in text


def test_what_is_written_is_current_until_it_is_changed(elsewhere, capsys):
    assert elsewhere.main(["--check"]) == 1
    assert elsewhere.main([]) == 0
    assert elsewhere.main(["--check"]) == 0
    capsys.readouterr()

    page = elsewhere.page_path("clamp")
    page.write_text(page.read_text(encoding="utf-8").replace("slip", "skid", 1), encoding="utf-8")
    elsewhere.picture_path("press").write_bytes(elsewhere.picture_path("retract").read_bytes())
    assert elsewhere.main(["--check"]) == 1
    assert "skid" in page.read_text(encoding="utf-8")
    told = capsys.readouterr().err.splitlines()
    assert [line.partition(" ")[0] for line in told] == ["docs/images/press.png", "docs/tasks/clamp.md"]
    assert all(elsewhere.COMMAND in line for line in told)
