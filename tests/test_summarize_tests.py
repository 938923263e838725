"""The summary of test results over all environments."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).parents[1] / "scripts" / "summarize_tests.py"

ONE = """<testsuites><testsuite>
<testcase classname="tests.test_a" name="test_good"/>
<testcase classname="tests.test_a" name="test_window"><skipped type="pytest.skip" message="no display"/></testcase>
<testcase classname="tests.test_a" name="test_ray"><skipped type="pytest.skip" message="no Ray"/></testcase>
<testcase classname="tests.test_a" name="test_known"><skipped type="pytest.xfail" message="known"/></testcase>
<testcase classname="" name="tests.test_web"><skipped type="pytest.skip" message="no viser"/></testcase>
</testsuite></testsuites>"""

OTHER = """<testsuites><testsuite>
<testcase classname="tests.test_a" name="test_ray"/>
<testcase classname="tests.test_web" name="test_page"/>
<testcase classname="tests.test_b" name="test_c">{}</testcase>
</testsuite></testsuites>"""


@pytest.fixture(scope="module")
def main() -> Any:
    return runpy.run_path(str(SCRIPT))["main"]


def test_what_another_environment_has_run_is_not_amiss(
    main: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "test.xml").write_text(ONE, encoding="utf-8")
    (tmp_path / "test-ray.xml").write_text(OTHER.format(""), encoding="utf-8")
    assert main([str(tmp_path)]) == 0
    told = capsys.readouterr().out.splitlines()
    assert "test: 2 passed, 3 skipped" in told
    assert "test-ray: 3 passed" in told
    assert told[-1] == "  1 x no display"


def test_failures_are_told(main: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path)]) == 1
    (tmp_path / "test-ray.xml").write_text(OTHER.format('<failure message="no"/>'), encoding="utf-8")
    assert main([str(tmp_path)]) == 1
    assert "failed: test-ray" in capsys.readouterr().err
    assert main([str(tmp_path), "--failed", "test-matrix"]) == 1
    assert "failed: test-matrix" in capsys.readouterr().err
