"""Limits on the figures of growth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.growth.memory import MOST_GROWTH

EXPONENTS = {
    ("sizes", "worlds", "step of all worlds"): 1.03,
    ("sizes", "worlds", "reset of one world"): 0.1,
    ("sizes", "nodes", "step, organ's nodes"): 1.0,
    ("sizes", "nodes", "step, tool's nodes"): 1.0,
    ("sizes", "tools", "step, tools"): 1.2,
    ("sizes", "pictures", "picture"): 1.0,
    ("datasets", "appended"): 1.1,
    ("datasets", "summarized"): 1.1,
    ("datasets", "opened"): 1.1,
    ("datasets", "merged"): 1.1,
}
"""Greatest exponents, by path in the results. The time per world and step must not grow; the margin is for noise."""

LIMITS: Mapping[tuple[str, ...], float] = {
    ("datasets", "append", "ratio"): 1.3,
    ("datasets", "append", "cpu_ratio"): 1.3,
    ("datasets", "list", "cpu_seconds"): 2.0,
    ("datasets", "payload_ratio"): 1.5,
}
"""Greatest values, by path in the results: time to append to a large dataset relative to a new one; processor time of
`datasets list` [s]; size of a short episode's file relative to its numbers."""

COUNTS: Mapping[tuple[str, ...], float] = {
    ("killing", "lost"): 0,
    ("killing", "twice"): 0,
    ("killing", "damaged"): 0,
    ("killing", "left_behind"): 0,
}
LEFT = {"growth": MOST_GROWTH, "clients": 0, "descriptors": 0, "threads": 0, "files": 0}
"""Most that environments may leave behind; memory in MB."""
LONG = {"growth": MOST_GROWTH}
"""Greatest growth of memory over a long run [MB]."""


def judge(result: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Compare figures with their limits.

    Args:
        result: Results by part.

    Returns:
        For each limited figure that was measured, its "value", its "limit", and whether it "passed".
    """
    found: dict[str, dict[str, Any]] = {}

    def hold(name: str, value: float, limit: float) -> None:
        found[name] = {"value": float(value), "limit": float(limit), "passed": bool(value <= limit)}

    for path, limit in EXPONENTS.items():
        row = _at(result, path)
        if row is not None:
            hold(f"exponent of {path[-1]} over {row['over']}", row["exponent"], limit)
    for path, limit in {**LIMITS, **COUNTS}.items():
        value = _at(result, path)
        if value is not None:
            hold(" ".join(path), value, limit)
    minari = _at(result, ("datasets", "minari"))
    if minari is not None:
        hold("datasets not read by Minari", not minari["whole"], 0)
    for part, limits in (("left", LEFT), ("long", LONG)):
        for name, row in (result.get(part) or {}).items():
            for quantity, limit in limits.items():
                hold(f"{part} {name} {quantity}", row[quantity], limit)
    return found


def _at(result: Mapping[str, Any], path: tuple[str, ...]) -> Any:
    value: Any = result
    for name in path:
        value = value.get(name) if isinstance(value, Mapping) else None
    return value
