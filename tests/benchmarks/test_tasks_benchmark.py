"""The benchmarks that ask whether the tasks are solvable, and whether they endure."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium
import numpy as np
import pytest

from benchmarks import endurance, tasks
from benchmarks.physics_steps import look_after_every_step
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
    return Episodes(success, [40] * count, [False] * count, [False] * count, quantities, 40 * count, 2.0)


def test_pieces_are_summed_up() -> None:
    summary = tasks.summarize([episodes([True, False]), episodes([True], peak=0.5)])
    assert summary["episodes"] == 3
    assert summary["success"] == pytest.approx(2 / 3)
    assert summary["steps_per_second"] == pytest.approx(120 / 4.0)
    assert summary["peak_force"] == {"median": 0.2, "max": 0.5, "unit": "N"}
    assert tasks.summarize([episodes([False])])["steps_to_success"] is None


def test_what_is_good_enough() -> None:
    good = {
        "Press": {"batch": {"expert": {"success": 0.95, "non_finite": 0}, "random": {"success": 0.05, "non_finite": 0}}}
    }
    assert tasks.passed(good)
    for policy, key, value in [("expert", "success", 0.94), ("random", "success", 0.06), ("random", "non_finite", 1)]:
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


@pytest.mark.parametrize("actions", endurance.ACTIONS)
def test_endurance_sees_that_nothing_breaks(actions: str) -> None:
    outcome = endurance.run("Press", "batch", 320, 0, actions)
    assert outcome.control_steps == 320
    # Worlds that are over are reset in a control step without physics.
    assert 0.95 * 320 * 12 <= outcome.steps <= 320 * 12
    assert outcome.passed
    assert np.isfinite(outcome.peak_pressure)


@pytest.mark.parametrize("field", ["diverged", "non_finite", "deep", "wrong_side"])
def test_endurance_tells_what_broke(field: str) -> None:
    fields = dict.fromkeys(endurance.Endurance.__dataclass_fields__, 0)
    assert endurance.Endurance(**fields).passed
    assert not endurance.Endurance(**{**fields, field: 1}).passed
    assert not endurance.Endurance(**{**fields, "memory_growth": 20.0}).passed
    assert endurance.Endurance(**{**fields, "crossed": 12, "longest_crossed": 0.05}).passed
    assert not endurance.Endurance(**{**fields, "crossed": 48, "longest_crossed": 0.2}).passed


def test_kept_actions_are_kept_and_go_down() -> None:
    drawn = endurance.RandomActions("kept", (50, 4), np.random.default_rng(0))
    actions = np.array([drawn.draw() for _ in range(200)])
    assert set(np.abs(actions).ravel().tolist()) == set(endurance.LEVELS)
    assert (actions[:, :, endurance.VERTICAL] < 0.0).mean() == pytest.approx(endurance.DOWN, abs=0.05)
    changes = (actions[1:] != actions[:-1]).any(axis=2)
    # Kept for 1 to 6 steps, 3.5 on the average.
    assert changes.mean() == pytest.approx(2.0 / (1 + endurance.HOLD), abs=0.03)


@pytest.mark.parametrize("engine", ["batch", "bullet"])
def test_worlds_go_on_as_before_when_every_physics_step_is_looked_at(engine: str) -> None:
    looks: list[Any] = []
    outcomes = []
    for watched in (False, True):
        envs: Any = gymnasium.make_vec("Spatula/Press-v0", num_envs=2, engine=engine)
        if watched:
            look_after_every_step(envs.unwrapped.worlds, looks.append)
        envs.reset(seed=1)
        for _ in range(14):
            observations, _, _, _, infos = envs.step(np.tile(np.array([0.0, 0.0, -1.0], dtype=np.float32), (2, 1)))
        outcomes.append((observations, infos["peak_pressure"], infos["force"], envs.unwrapped.worlds.nodes))
        steps = envs.unwrapped.steps_per_action if hasattr(envs.unwrapped, "steps_per_action") else 12
        envs.close()
    assert len(looks) == 14 * steps
    assert outcomes[0][2].max() > 0.0
    for plain, looked_at in zip(*outcomes, strict=True):
        np.testing.assert_allclose(looked_at, plain, rtol=1e-6, atol=1e-9)
