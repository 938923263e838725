"""The matrix of haptic runs in simulated time: plans them, runs them in several processes, stores and checks results.

Each run is appended to a file as soon as it is over, so that an interrupted benchmark continues where it stopped. A
stored line counts only as long as the sources it was made with are unchanged.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.haptics_closed_loop import TOUCHES
from benchmarks.haptics_scenarios import SCENARIOS, Cell, run
from benchmarks.parallel import results

ROOT = Path(__file__).parents[1]
SOURCES = (
    "benchmarks/haptics_closed_loop.py",
    "benchmarks/haptics_scenarios.py",
    "spatula_env/contact/**/*.py",
    "spatula_env/envs/**/*.py",
    "spatula_env/sim/**/*.py",
    "spatula_env/tasks/**/*.py",
    "spatula_env/teleop/*.py",
    "spatula_env/teleop/emulator/*.py",
    "spatula_env/teleop/falcon/*.py",
    "spatula_env/teleop/haptics/*.py",
)
"""Source files, as patterns, on which the results of a run depend."""
Row = Mapping[str, Any]
"""Parameters of a run and its measurements."""


@dataclass(frozen=True)
class Check:
    """A limit on a measurement.

    Attributes:
        title: What is measured, with its unit.
        scenarios: Scenarios it applies to.
        measure: Name of the measurement in a row.
        limit: Greatest allowed value, or least if `is_least`.
        is_least: Whether the limit is a lower bound.
    """

    title: str
    scenarios: tuple[str, ...]
    measure: str
    limit: float
    is_least: bool = False

    def worst(self, rows: Iterable[Row]) -> Row | None:
        """The row with the worst value; None if none has the measure."""
        known = [row for row in rows if row["scenario"] in self.scenarios and _is_number(row.get(self.measure))]
        return (min if self.is_least else max)(known, key=lambda row: row[self.measure], default=None)

    def holds(self, value: float) -> bool:
        """Whether a value is within the limit."""
        return value >= self.limit if self.is_least else value <= self.limit


TAPS = ("tap 0.25", "tap 0.5")
CHECKS = (
    Check("hold: shown over true, least", ("hold",), "shown_over_true_least", 0.95, True),
    Check("hold: shown over true, greatest", ("hold",), "shown_over_true_greatest", 1.05),
    Check("hold: greatest change in 1 ms [N]", ("hold",), "hold_step_n_per_ms", 0.1),
    Check("hold: limit cycle [mm]", ("hold",), "limit_cycle_mm", 0.1),
    Check("any: energy given to the hand [mJ]", tuple(SCENARIOS), "energy_to_hand_mj", 1.0),
    Check("tap: shown peak over true peak", TAPS, "peak_ratio", 1.3),
    Check("push: surface to force [ms]", ("push",), "surface_to_force_ms", 15.0),
    Check("stall of 50 ms: back to 0.95 after [ms]", ("stall 50",), "back_to_95_ms", 500.0),
    Check("stall of 200 ms: back to 0.95 after [ms]", ("stall 200",), "back_to_95_ms", 500.0),
    Check("stall of 300 ms: back to 0.95 after [ms]", ("stall 300",), "back_to_95_ms", 500.0),
    Check("stall of 2 s: back to 0.95 after [ms]", ("stall 2000",), "back_to_95_ms", 500.0),
    Check("half speed: shown over true, least", ("half speed",), "shown_over_true_least", 0.9, True),
    Check("half speed: 20 to 300 Hz [mN]", ("half speed",), "buzz_mn", 30.0),
    Check("0.3 of speed: shown over true, least", ("0.3 of speed",), "shown_over_true_least", 0.9, True),
    Check("0.3 of speed: 20 to 300 Hz [mN]", ("0.3 of speed",), "buzz_mn", 30.0),
    Check("0.1 of speed: told, if 1", ("0.1 of speed",), "is_slow", 1.0, True),
    Check("release: to zero [ms]", ("release",), "to_zero_ms", 50.0),
)
"""The limits; each is checked at the worst of all hands."""


def make_cells(
    parts: Sequence[str],
    hands: Sequence[str],
    scales: Sequence[float],
    mechanisms: Sequence[bool] = (False, True),
    hold_seconds: float = 30.0,
    engine: str = "batch",
) -> list[Cell]:
    """Plan the runs; those of the first force scale come first.

    Args:
        parts: Any of "holds" and "scenarios"; others are ignored.
        hands: Names in `haptics_closed_loop.HANDS`.
        scales: Force on the hand over force on the tool.
        mechanisms: Whether the emulated device has weight, friction and a structural mode.
        hold_seconds: Length of a hold [s].
        engine: Engine of the simulation.
    """
    kinds = [
        Cell("", hand, tremor, scale, mechanism=mechanism, seconds=hold_seconds, engine=engine)
        for scale in scales
        for mechanism in mechanisms
        for hand in hands
        for tremor in (False, True)
    ]
    cells: list[Cell] = []
    for kind in kinds:
        if "scenarios" in parts:
            cells += [kind.but(scenario=name) for name in SCENARIOS if name != "hold"]
        if "holds" in parts:
            cells += [
                kind.but(scenario="hold", task=task, depth=depth)
                for task, touch in TOUCHES.items()
                for depth in touch.depths
            ]
    return cells


def run_cells(cells: Sequence[Cell], workers: int, file: Path | None = None) -> list[dict[str, Any]]:
    """Run the cells whose results are not stored yet.

    Args:
        cells: Runs to make.
        workers: Number of processes.
        file: File from which stored results are read, and to which new ones are appended; None for neither.

    Returns:
        The results, in the order of the cells.
    """
    found = _kept(file) if file is not None else {}
    missing = [cell for cell in cells if _key(cell) not in found]
    if missing:
        for cell, row in results(run, missing, min(workers, len(missing)), "haptic loop"):
            found[_key(cell)] = row
            if file is not None:
                with open(file, "a", encoding="utf-8") as kept:
                    kept.write(json.dumps({"sources": sources(), "cell": _key(cell), "found": row}) + "\n")
    return [found[_key(cell)] for cell in cells]


def check(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """The worst value of every check, by mechanism and force scale, and the run it comes from."""
    lines = []
    for each in CHECKS:
        for mechanism in sorted({row["mechanism"] for row in rows}):
            for scale in sorted({row["scale"] for row in rows}):
                worst = each.worst(row for row in rows if row["mechanism"] == mechanism and row["scale"] == scale)
                if worst is None:
                    continue
                value = float(worst[each.measure])
                lines.append(
                    {
                        "check": each.title,
                        "limit": each.limit,
                        "mechanism": mechanism,
                        "scale": scale,
                        "worst": value,
                        "holds": each.holds(value),
                        "where": _place(worst),
                    }
                )
    return lines


def lightest(rows: Sequence[Row]) -> float:
    """Greatest difference between shown and true force in windows of holds that are too light for a ratio [mN]."""
    return max(
        (row["difference_of_light_touch_mn"] for row in rows if row["scenario"] == "hold"),
        default=math.nan,
    )


def describe(lines: Sequence[Mapping[str, Any]]) -> str:
    """Checks as a table: one line for a check and a mechanism, one column for a force scale."""
    scales = sorted({line["scale"] for line in lines})
    table = [["", "limit", "mechanism", *(f"x{scale:g}" for scale in scales), "worst at"]]
    for title, mechanism in dict.fromkeys((line["check"], line["mechanism"]) for line in lines):
        chosen = {line["scale"]: line for line in lines if (line["check"], line["mechanism"]) == (title, mechanism)}
        short = [line for line in chosen.values() if not line["holds"]]
        values = [_number(chosen[scale]) if scale in chosen else "" for scale in scales]
        where = "; ".join(f"x{line['scale']:g} {line['where']}" for line in short)
        limit = f"{next(iter(chosen.values()))['limit']:g}"
        table.append([title, limit, "yes" if mechanism else "no", *values, where])
    widths = [max(len(row[column]) for row in table) for column in range(len(table[0]))]
    return "\n".join(
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in table
    )


@cache
def sources() -> str:
    """Short hash of the current `SOURCES`."""
    digest = hashlib.sha256()
    for pattern in SOURCES:
        for path in sorted(ROOT.glob(pattern)):
            digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def _kept(file: Path) -> dict[str, dict[str, Any]]:
    """Stored results that were made with the current sources, by cell; incomplete lines are ignored."""
    found: dict[str, dict[str, Any]] = {}
    if not file.exists():
        return found
    for line in file.read_text(encoding="utf-8").splitlines():
        try:
            entry = json.loads(line)
        except json.JSONDecodeError:
            continue
        if entry["sources"] == sources():
            found[entry["cell"]] = entry["found"]
    return found


def _key(cell: Cell) -> str:
    return json.dumps(asdict(cell), sort_keys=True)


def _is_number(value: Any) -> bool:
    return isinstance(value, (bool, int, float)) and not math.isnan(value)


def _number(line: Mapping[str, Any]) -> str:
    return f"{line['worst']:.3g}{'' if line['holds'] else ' !'}"


def _place(row: Row) -> str:
    words = [row["scenario"], row["hand"]]
    if row["scenario"] == "hold":
        words[1:1] = [row["task"], f"{row['depth_mm']:g} mm"]
    return " ".join([*words, *(["tremor"] if row["tremor"] else [])])
