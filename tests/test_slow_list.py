"""The list of slow tests, and the script that makes it."""

from __future__ import annotations

import runpy
from pathlib import Path

ROOT = Path(__file__).parents[1]
SCRIPT = runpy.run_path(str(ROOT / "scripts" / "slow_tests.py"))

RESULTS = """<testsuites><testsuite>
<testcase classname="tests.cli.test_cli_options.TestFilm" name="test_is_written[a/film.gif-5]" time="0.5"/>
<testcase classname="tests.cli.test_cli_options.TestFilm" name="test_is_written[picture.png-1]" time="0.1"/>
<testcase classname="tests.test_imports" name="test_circles_are_found" time="0.1"/>
<testcase classname="" name="tests.gone" time="9"/>
</testsuite></testsuites>"""


def test_every_test_in_the_list_exists() -> None:
    gone = []
    for line in (ROOT / "tests" / "slow.txt").read_text(encoding="utf-8").splitlines():
        name, seconds = line.split()
        assert float(seconds) > 0.0
        file, *inside = name.split("::")
        text = (ROOT / file).read_text(encoding="utf-8") if (ROOT / file).is_file() else ""
        if not all(f"def {part}(" in text or f"class {part}" in text for part in inside) or not text:
            gone.append(name)
    assert gone == [], "take them out of tests/slow.txt"


def test_a_test_is_slow_if_one_of_its_cases_is(tmp_path: Path) -> None:
    (tmp_path / "results.xml").write_text(RESULTS)
    assert SCRIPT["slow_tests"](tmp_path / "results.xml", 0.2) == {
        "tests/cli/test_cli_options.py::TestFilm::test_is_written": 0.6
    }
