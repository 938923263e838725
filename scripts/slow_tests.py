"""Lists the tests that take long, by the results of a run of all.

`make test-fast` leaves them out, and other runs begin with their files.

    python scripts/slow_tests.py build/test-results/test.xml

A test counts with what was made for it. The list is tests/slow.txt.
"""

from __future__ import annotations

import argparse
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]

LIMIT = 0.2
"""The greatest time of a test that is not slow [s]."""


def slow_tests(results: Path, limit: float) -> dict[str, float]:
    """How long tests took with all their cases [s], by names as `tests/file.py::test`.

    Args:
        results: What pytest wrote.
        limit: Only those one of whose cases took longer [s].
    """
    times: defaultdict[str, list[float]] = defaultdict(list)
    for case in ElementTree.parse(results).iter("testcase"):
        names = case.get("classname", "").split(".")
        # Classes of tests stand behind the module.
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
