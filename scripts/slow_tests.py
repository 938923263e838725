"""Lists the slow tests in tests/slow.txt, from the results of a run of all tests.

`make test-fast` leaves them out, and other runs begin with their files.

    python scripts/slow_tests.py build/test-results/test.xml

The time of a test includes that of its fixtures.
"""

from __future__ import annotations

import argparse
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]

LIMIT = 0.2
"""A test is slow if it takes longer than this [s]."""


def slow_tests(results: Path, limit: float) -> dict[str, float]:
    """Total times of slow tests over all their parametrized cases [s], by names such as `tests/file.py::test`.

    Args:
        results: JUnit XML file that pytest has written.
        limit: A test is slow if one of its cases took longer than this [s].
    """
    times: defaultdict[str, list[float]] = defaultdict(list)
    for case in ElementTree.parse(results).iter("testcase"):
        names = case.get("classname", "").split(".")
        # The dotted name is that of the module, followed by those of test classes, if any.
        parts = [k for k in range(1, len(names) + 1) if Path(ROOT, *names[:k]).with_suffix(".py").exists()]
        if parts:
            file = "/".join(names[: parts[-1]]) + ".py"
            test = "::".join([file, *names[parts[-1] :], case.get("name", "").partition("[")[0]])
            times[test].append(float(case.get("time", 0.0)))
    return {test: sum(cases) for test, cases in sorted(times.items()) if max(cases) > limit}


def main() -> None:
    """Write the list."""
    parser = argparse.ArgumentParser(description="List the tests that take long.")
    parser.add_argument("results", type=Path, help="what pytest wrote with --junitxml, of a run of all tests")
    parser.add_argument("--limit", type=float, default=LIMIT, metavar="S", help="default: %(default)s")
    chosen = parser.parse_args()
    tests = slow_tests(chosen.results, chosen.limit)
    lines = [f"{name} {seconds:.1f}\n" for name, seconds in tests.items()]
    (ROOT / "tests" / "slow.txt").write_text("".join(lines), encoding="utf-8")
    print(f"{len(tests)} tests took more than {chosen.limit:g} s")


if __name__ == "__main__":
    main()
