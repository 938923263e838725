"""The built site: no warnings, no network, tables in docstrings, and a search that finds what newcomers look for."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from collections.abc import Iterator
from html import unescape
from pathlib import Path
from typing import Any

import pytest
from browsers import open_browser

ROOT = Path(__file__).parents[2]

pytestmark = [pytest.mark.browser, pytest.mark.timeout(900)]

RIGHT = {
    "force": {"docs/calibration", "docs/haptics", "docs/tasks/common"},
    "units": {"docs/calibration"},
    "headless": {"docs/start"},
    "Windows": {"README", "docs/start"},
    "vector": {"docs/vector-environments"},
    "reward": {"docs/tasks/common", "docs/tasks"},
    "my own organ": {"docs/anatomy"},
    "Falcon": {"docs/falcon"},
    "cost": {"docs/tasks/common", "docs/tasks"},
    "seed": {"docs/vector-environments"},
    "GPU": {"docs/start", "docs/engines"},
    "record": {"docs/demonstrations"},
}
"""Words that newcomers try, and the pages of which one has to be among the first three results."""


def find_sphinx() -> str | None:
    """An interpreter that builds the site: this one, or that of `make docs`."""
    if all(importlib.util.find_spec(name) for name in ("sphinx", "myst_parser", "furo", "sphinx_copybutton")):
        return sys.executable
    made = ROOT / ".venv-docs" / "bin" / "python"
    return str(made) if made.exists() else None


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    python = find_sphinx()
    if python is None:
        pytest.skip("there is no Sphinx here, and no .venv-docs: `make docs` sets it up")
    place = tmp_path_factory.mktemp("site")
    command = [python, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", "-c", "docs", "-d", place / "trees"]
    done = subprocess.run(
        [*map(str, command), ".", str(place / "html")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=800,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return place / "html"


@pytest.fixture(scope="module")
def browser(site: Path) -> Iterator[Any]:
    with open_browser() as opened:
        yield opened


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    opened = browser.new_page()
    yield opened
    opened.close()


@pytest.mark.parametrize("word", RIGHT)
def test_the_right_page_is_among_the_first_three_results(site: Path, page: Any, word: str) -> None:
    page.goto((site / "search.html").as_uri())
    # The search's own list, before it is shown: (page, title, anchor, description, score, file, kind), the best last.
    results = page.evaluate("word => Search._performSearch(...Search._parseQuery(word)).map(each => each[0])", word)
    first = results[:-4:-1]
    assert RIGHT[word] & set(first), first


def test_the_search_shows_its_results_without_a_server(site: Path, page: Any) -> None:
    page.goto(f"{(site / 'search.html').as_uri()}?q=falcon")
    page.wait_for_selector("#search-results ul.search li a")
    first = page.eval_on_selector_all("#search-results ul.search li > a", "links => links.map(each => each.pathname)")
    assert any(each.endswith("docs/falcon.html") for each in first[:3])


@pytest.mark.parametrize("name", ["docs/index", "docs/start", "docs/tasks/press", "docs/reference/envs", "README"])
def test_a_page_is_whole_without_a_network(site: Path, page: Any, name: str) -> None:
    asked: list[str] = []
    failed: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("requestfailed", lambda request: failed.append(request.url))
    for width in (390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        page.goto((site / f"{name}.html").as_uri())
        too_wide = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
        assert page.evaluate(too_wide) == 0
        assert page.evaluate("[...document.images].filter(each => !each.alt).length") == 0
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
    assert failed == []


@pytest.mark.parametrize("task", ["Press", "Retract", "Fissure", "Clamp", "Palpate"])
def test_a_rendered_docstring_has_tables_with_units(site: Path, task: str) -> None:
    text = (site / "docs" / "reference" / "envs.html").read_text(encoding="utf-8")
    start = text.index(f'id="spatula_env.envs.{task}Env"')
    own = text[start : text.index('<dt class="sig sig-object py" id="spatula_env.envs.', start)]
    tables = [[plain(cell) for cell in re.findall(r"<th\b.*?</th>", table, re.DOTALL)] for table in tables_of(own)]
    for first in ("Action", "Observation"):
        assert ["Num", first, "Min", "Max"] in [each[:4] for each in tables]
        assert all(each[-1] == "Unit" for each in tables if each[1:2] == [first])
    assert "<math" in own and "$" not in plain(own)


def tables_of(text: str) -> list[str]:
    return re.findall(r"<table\b.*?</table>", text, re.DOTALL)


def plain(text: str) -> str:
    return unescape(re.sub(r"<[^>]*>", "", text)).strip()
