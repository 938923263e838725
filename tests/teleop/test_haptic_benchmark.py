"""The benchmark measures what it says, in small."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks import haptics_closed_loop, haptics_matrix, haptics_period, haptics_scenarios, haptics_stiffness
from benchmarks.haptics_closed_loop import Trace


def test_a_short_press():
    found = haptics_period.press("process", 2.0, 0.3)
    assert found["cycles"] > 0
    assert 0.0 < found["period_p50_ms"] <= found["period_p99_ms"] <= found["period_max_ms"]
    assert found["energy_into_hand_mj"] == pytest.approx(found["energy_by_loop_mj"], abs=1.0)


def test_a_hand_that_does_not_yield_feels_the_step(monkeypatch):
    monkeypatch.setattr(haptics_period, "TRIALS", 1)
    found = haptics_period.step_response()
    assert 0.0 < found["rise_63_ms"] <= found["rise_95_ms"]
    assert found["stall_to_zero_ms"] > 0.0


def test_the_target_goes_from_top_to_bottom_and_waits_first():
    motion = haptics_period.PressingMotion(0.04)
    heights = [motion(0.1 * index)[1] for index in range(60)]
    assert heights[0] == heights[9] == pytest.approx(0.02)
    assert min(heights) == pytest.approx(-0.02)


def test_a_hold_is_true_and_passive():
    found = haptics_scenarios.run(haptics_scenarios.Cell("hold", "nominal", True, 3.0, depth=0.003, seconds=2.1))
    assert 0.95 < found["shown_over_true_least"] <= found["shown_over_true_greatest"] < 1.05
    assert found["hold_step_n_per_ms"] < 0.1
    assert found["energy_to_hand_mj"] < 1.0


def row(scenario: str, scale: float, mechanism: bool = False, **found):
    return {"scenario": scenario, "hand": "light", "tremor": False, "scale": scale, "mechanism": mechanism, **found}


def test_the_worst_of_every_check_is_told_and_where():
    rows = [
        row("tap 0.25", 1.0, peak_ratio=0.5),
        row("tap 0.5", 1.0, peak_ratio=0.7),
        row("tap 0.5", 5.0, peak_ratio=1.4),
        row("tap 0.5", 1.0, True, peak_ratio=0.6),
        row("stall 50", 1.0, back_to_95_ms=math.inf, peak_ratio=9.0),
        row("half speed", 1.0, shown_over_true_least=math.nan),
    ]
    lines = haptics_matrix.check(rows)
    taps = {(line["mechanism"], line["scale"]): line for line in lines if line["check"].startswith("tap")}
    assert {key: line["worst"] for key, line in taps.items()} == {
        (False, 1.0): 0.7,
        (False, 5.0): 1.4,
        (True, 1.0): 0.6,
    }
    assert [line["holds"] for line in lines] == [True, False, True, False]
    assert taps[False, 5.0]["where"] == "tap 0.5 light"
    assert "1.4 !" in haptics_matrix.describe(lines)


def test_runs_are_kept_and_gone_on_with(tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr(haptics_matrix, "run", lambda cell: made.append(cell) or row(cell.scenario, cell.scale))
    cells = haptics_matrix.make_cells(["scenarios"], ["light"], [1.0], [False])[:3]
    file = tmp_path / "runs.jsonl"
    first = haptics_matrix.run_cells(cells[:2], 1, file)
    file.write_text(file.read_text() + '{"sources": "broke o')
    assert haptics_matrix.run_cells(cells, 1, file)[:2] == first
    assert made == cells


def test_all_there_is_to_run():
    cells = haptics_matrix.make_cells(["holds", "scenarios"], list(haptics_closed_loop.HANDS), [1.0, 3.0, 5.0])
    assert len(cells) == len(set(map(str, cells))) == 792
    assert {cell.seconds for cell in cells} == {30.0}


def test_some_stiffnesses_are_stable_and_some_are_not():
    nominal, light = haptics_closed_loop.HANDS["nominal"], haptics_closed_loop.HANDS["light"]
    assert haptics_stiffness.is_stable(nominal, 300.0, 240.0, 0.0)
    assert not haptics_stiffness.is_stable(light, 3000.0, 240.0, 0.01)


def test_a_light_touch_is_compared_by_difference():
    time = np.arange(4000) * 1e-3
    true = np.zeros((4000, 3))
    true[:2000, 2], true[2000:, 2] = 0.1, 0.002
    trace = Trace(time, np.zeros((4000, 3)), 1.1 * true, true, np.zeros(4000), None)
    found = haptics_scenarios._fidelity(trace, 0.0, 4.0)
    assert found["shown_over_true_least"] == found["shown_over_true_greatest"] == pytest.approx(1.1)
    assert found["difference_of_light_touch_mn"] == pytest.approx(0.2)
