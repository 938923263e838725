"""The benchmark that asks whether the tasks are solvable."""

from __future__ import annotations

import copy

import pytest

from benchmarks import tasks
from benchmarks.tasks import Episodes, Job


def test_the_batch_engine_takes_all_episodes_at_once_and_bullet_takes_pieces() -> None:
    jobs = tasks.plan(["Press"], ["batch", "bullet"], ["expert"], 25, seed=7)
    assert [(job.engine, len(job.seeds)) for job in jobs] == [
        ("batch", 25),
        ("bullet", 10),
        ("bullet", 10),
        ("bullet", 5),
    ]
    assert jobs[0].seeds == sum((job.seeds for job in jobs[1:]), ()) == tuple(range(7, 32))


def episodes(success: list[bool], peak: float = 0.2) -> Episodes:
    count = len(success)
    quantities = {name: [peak] * count for name in tasks.QUANTITIES}
    no = [False] * count
    return Episodes(success, [40] * count, no, no, [True, *no[1:]], quantities, 40 * count, 2.0)


def test_pieces_are_summed_up() -> None:
    summary = tasks.summarize([episodes([True, False]), episodes([True], peak=0.5)])
    assert summary["episodes"] == 3
    assert summary["success"] == pytest.approx(2 / 3)
    assert summary["within_budget"] == pytest.approx(2 / 3)
    assert summary["steps_per_second"] == pytest.approx(120 / 4.0)
    assert summary["peak_force"] == {"median": 0.2, "max": 0.5, "unit": "N"}
    assert tasks.summarize([episodes([False])])["steps_to_success"] is None


def test_what_is_good_enough() -> None:
    good = {
        "Press": {
            "batch": {
                "expert": {"success": 0.95, "within_budget": 0.95, "non_finite": 0},
                "hasty": {"success": 1.0, "within_budget": 0.2, "non_finite": 0},
                "random": {"success": 0.05, "within_budget": 0.5, "non_finite": 0},
            }
        }
    }
    assert tasks.passed(good)
    for policy, key, value in [
        ("expert", "success", 0.94),
        ("expert", "within_budget", 0.94),
        ("hasty", "within_budget", 0.21),
        ("random", "success", 0.06),
        ("random", "non_finite", 1),
    ]:
        bad = copy.deepcopy(good)
        bad["Press"]["batch"][policy][key] = value
        assert not tasks.passed(bad)


@pytest.mark.parametrize("policy", ["expert", "random"])
def test_a_press_is_run(policy: str) -> None:
    outcome = tasks.run_job(Job("Press", "batch", policy, (0, 1)))
    assert outcome.success == [policy == "expert"] * 2
    assert not any(outcome.diverged)
    assert all(steps < 200 for steps in outcome.steps) == (policy == "expert")
    assert (min(outcome.quantities["peak_force"]) > 0.0) >= (policy == "expert")
    assert outcome.seconds > 0.0
