"""The benchmark measures what it says, in small."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import haptics, haptics_scenarios, haptics_stiffness
from benchmarks.haptics_closed_loop import Trace


def test_a_short_press():
    found = haptics.press("process", 2.0, 0.3)
    assert found["cycles"] > 0
    assert 0.0 < found["period_p50_ms"] <= found["period_p99_ms"] <= found["period_max_ms"]
    assert found["energy_into_hand_mj"] == pytest.approx(found["energy_by_loop_mj"], abs=1.0)


def test_a_hand_that_does_not_yield_feels_the_step(monkeypatch):
    monkeypatch.setattr(haptics, "TRIALS", 1)
    found = haptics.step_response()
    assert 0.0 < found["rise_63_ms"] <= found["rise_95_ms"]
    assert found["stall_to_zero_ms"] > 0.0


def test_the_target_goes_from_top_to_bottom_and_waits_first():
    motion = haptics.PressingMotion(0.04)
    heights = [motion(0.1 * index)[1] for index in range(60)]
    assert heights[0] == heights[9] == pytest.approx(0.02)
    assert min(heights) == pytest.approx(-0.02)


def test_a_hold_is_true_and_passive():
    found = haptics.run(haptics.Cell("hold", "nominal", True, 3.0, depth=0.003, seconds=2.1))
    assert 0.95 < found["shown_over_true_least"] <= found["shown_over_true_greatest"] < 1.05
    assert found["hold_step_n_per_ms"] < 0.1
    assert found["energy_to_hand_mj"] < 1.0


def test_the_worst_of_all_cells_is_told():
    cells = [
        {"scale": 1.0, "peak_ratio": 0.5, "shown_over_true_least": 0.9},
        {"scale": 1.0, "peak_ratio": 0.7},
        {"scale": 5.0, "peak_ratio": float("nan"), "shown_over_true_least": 0.8},
    ]
    assert haptics.summarize(cells) == {
        "shown_over_true_least x1": 0.9,
        "peak_ratio x1": 0.7,
        "shown_over_true_least x5": 0.8,
    }


def test_some_stiffnesses_are_stable_and_some_are_not():
    nominal, light = haptics.HANDS["nominal"], haptics.HANDS["light"]
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
