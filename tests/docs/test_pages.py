"""Pages of the documentation: whom they are for, where they lead, what runs as pasted."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from functools import cache
from pathlib import Path

import pytest
import yaml

import spatula_env

ROOT = Path(__file__).parents[2]

DOCS = sorted((ROOT / "docs").rglob("*.md"))

ALL = [*DOCS, ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "requirements" / "README.md"]

START = re.findall(
    r"^```python\n(.*?)^```", (ROOT / "docs" / "start.md").read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
)


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def text_of(path: Path) -> str:
    """The text of a page without its code."""
    return re.sub(r"^(```+).*?^\1$", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


@cache
def anchors(path: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    found: set[str] = set()
    seen: Counter[str] = Counter()
    for heading in re.findall(r"^#+ (.*)$", text_of(path), re.MULTILINE):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        slug = "".join(each for each in plain if each in " -_" or unicodedata.category(each)[0] in "LN").replace(
            " ", "-"
        )
        found.add(slug if not seen[slug] else f"{slug}-{seen[slug]}")
        seen[slug] += 1
    return found


@pytest.mark.parametrize("path", [path for path in ALL if path.name != "README.md" or path.parent != ROOT], ids=name_of)
def test_a_page_says_at_its_head_whom_it_is_for(path: Path) -> None:
    title, _, rest = path.read_text(encoding="utf-8").partition("\n\n")
    head = " ".join(rest.partition("\n\n")[0].split())
    assert re.fullmatch(r"# \S.*", title)
    assert re.match(
        r"This page (is for|gives|helps) (you|anyone|everybody|people|readers|users|operators|developers)\b", head
    )


@pytest.mark.parametrize("path", ALL, ids=name_of)
def test_links_lead_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`\n]*`(?!\])", "", text_of(path))):
        if re.match(r"https?://", target):
            continue
        place, _, anchor = target.partition("#")
        there = (path.parent / place).resolve() if place else path
        assert there.exists(), target
        assert not anchor or anchor in anchors(there), target


def test_every_page_is_in_the_table_of_contents() -> None:
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    listed = re.findall(r"^- \[[^\]]+\]\(([^)]+)\)", index, re.MULTILINE)
    assert len(set(listed)) == len(listed)
    alone = [name for name in map(name_of, DOCS) if not re.match(r"docs/(index\.md|tasks/|reference/)", name)]
    assert {f"docs/{name}" for name in listed if not name.startswith("../")} - {"docs/reference/index.md"} == set(alone)
    assert re.findall(r"^## (.*)$", index, re.MULTILINE) == [
        "Start here", "Tutorials", "How-to", "Reference", "Explanation", "Project",
    ]  # fmt: skip


def test_words_are_told_once_and_lead_to_three_places_at_most() -> None:
    rows = re.findall(r"^\| ([^|]*?) \| (\[[^|]*?) \|$", (ROOT / "docs" / "words.md").read_text("utf-8"), re.MULTILINE)
    words = [word for row in rows for word in row[0].split(", ")]
    assert [word for word, times in Counter(words).items() if times > 1] == []
    assert all(word == word.lower() for word in words)
    assert [row[0] for row in rows if not 1 <= len(re.findall(r"\]\(", row[1])) <= 3] == []


def test_the_first_five_minutes_run_as_pasted(tmp_path, monkeypatch, capsys) -> None:
    pytest.importorskip("PIL.Image", reason="the picture is saved with Pillow: the extra demo is not installed")
    monkeypatch.chdir(tmp_path)
    for index, code in enumerate(START):
        exec(compile(code, f"start.md, block {index}", "exec"), {"__name__": "__main__"})
        printed = capsys.readouterr().out.splitlines()
        told = re.findall(r"print\(.*\)  # (.*)", code)
        assert printed[: len(told)] == told
    assert len(START) == 3 and printed[-1].startswith("pressed to ")
    assert (tmp_path / "press.png").stat().st_size > 10_000


def test_what_is_to_be_cited_is_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "cite.md").read_text(encoding="utf-8")
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert citation["version"] == spatula_env.__version__
    assert f'version = "{spatula_env.__version__}"' in project
    assert f"version = {{{spatula_env.__version__}}}" in page
    assert f'license = "{citation["license"]}"' in project
    assert set(citation["keywords"]) == set(
        re.findall(r'^    "([^"]*)",$', project.partition("keywords")[2].partition("]")[0], re.MULTILINE)
    )
    (article,) = citation["references"]
    assert article["doi"] in page and " ".join(article["title"].split()) in " ".join(page.split())
    assert [author["family-names"] for author in article["authors"]] == re.findall(
        r"(\w+), \w+", re.search(r"@article.*?author  = \{(.*?)\}", page, re.DOTALL)[1]
    )
