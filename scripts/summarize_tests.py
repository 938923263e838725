"""Summarizes test results of all environments: `python scripts/summarize_tests.py FOLDER`, with pytest's XML files.

A test counts as skipped only if no environment has run it.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the summary.

    Returns:
        The exit status: 1 if something has failed, or there are no results.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="with the files that pytest --junitxml has written")
    parser.add_argument("--failed", nargs="+", default=[], metavar="TARGET", help="what has ended with an error")
    chosen = parser.parse_args(arguments)
    files = sorted(chosen.folder.glob("*.xml"))
    run: set[str] = set()
    reasons: dict[str, str] = {}
    failed = list(chosen.failed)
    print("\n== In all")
    for file in files:
        counts, skipped, done = read(file)
        run |= done
        reasons |= skipped
        if counts["failed"] and not failed:
            failed.append(file.stem)
        told = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
        print(f"{file.stem}: {told or 'no tests'}")
    never = Counter(reason for test, reason in reasons.items() if test not in run)
    print("skipped in every environment:" if never else "skipped in every environment: nothing")
    for reason, count in sorted(never.items()):
        print(f"  {count} x {reason}")
    if failed or not files:
        print(f"failed: {', '.join(failed) or 'there are no results'}", file=sys.stderr)
        return 1
    return 0


def read(file: Path) -> tuple[dict[str, int], dict[str, str], set[str]]:
    """Read the results of one run of pytest.

    Args:
        file: JUnit XML file.

    Returns:
        Numbers of tests that passed, failed and were skipped; the reason for each skipped test or module, by name; and
        the names of tests that were run.
    """
    counts = {"passed": 0, "failed": 0, "skipped": 0}
    skipped: dict[str, str] = {}
    run: set[str] = set()
    for case in ElementTree.parse(file).getroot().iter("testcase"):
        # The entry of a module that is skipped as a whole has no class name.
        name = ".".join(filter(None, [case.get("classname"), case.get("name")]))
        omitted = case.find("skipped")
        if omitted is not None and omitted.get("type") != "pytest.xfail":
            counts["skipped"] += 1
            skipped[name] = omitted.get("message") or "no reason given"
            continue
        run.add(name)
        # The module counts as run, too: where it is skipped as a whole, only its own name appears.
        run.add(case.get("classname") or "")
        good = case.find("failure") is None and case.find("error") is None
        counts["passed" if good else "failed"] += 1
    return counts, skipped, run


if __name__ == "__main__":
    sys.exit(main())
