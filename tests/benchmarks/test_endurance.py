"""The endurance benchmark: are faults under random and exploring actions detected, reported and recorded?"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from benchmarks import endurance
from benchmarks.endurance import Endurance, Job
from benchmarks.physics_steps import look_after_every_step
from benchmarks.recordings import Recorder, restore_recording
from spatula_env import Simulation, scenes

NOTHING = Endurance(**{**dict.fromkeys(Endurance.__dataclass_fields__, 0), "task": "Press", "touching": 9_999})


@pytest.mark.parametrize("actions", endurance.ACTIONS)
def test_nothing_breaks_in_a_few_random_actions(actions: str) -> None:
    outcome = endurance.run(Job("Press", "batch", actions, 0, 320))
    assert outcome.control_steps == 320
    # Worlds whose episodes are over are reset in a control step without physics.
    assert 0.95 * 320 * 12 <= outcome.steps <= 320 * 12
    assert outcome.passed
    assert np.isfinite(outcome.peak_pressure)


def test_a_policy_that_explores_makes_whole_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(endurance.WORLDS, "batch", 2)
    outcome = endurance.run(Job("Palpate", "batch", endurance.POLICY, 3, 2))
    assert outcome.episodes >= 2
    assert outcome.touching > 100
    assert outcome.passed


@pytest.mark.parametrize("field", ["diverged", "non_finite", "deep", "wrong_side", "untold"])
def test_what_broke_is_told(field: str) -> None:
    assert NOTHING.passed
    assert not replace(NOTHING, **{field: 1}).passed
    assert not replace(NOTHING, memory_growth=20.0).passed
    # A long crossing is not a failure if it is reported as tangled.
    assert replace(NOTHING, crossed=48, stretches=1, tangles=1, tangled=24, longest_crossed=0.2).passed


def test_a_deep_step_in_ten_thousand_is_allowed_where_organs_crumple() -> None:
    one = replace(NOTHING, task="Retract", deep=1, wrong_side=1)
    assert not one.passed
    assert replace(one, touching=10_000).passed
    assert not replace(one, touching=10_000, deep=2).passed
    assert replace(one, touching=10_000).deep_in_ten_thousand == 1.0


class Loads:
    """Stands in for the loads of two worlds, with the fields that a watch reads."""

    def __init__(self, tangled: tuple[bool, bool]) -> None:
        self.tangled = np.array(tangled)
        self.residuals, self.peak_forces, self.diverged = np.zeros(2), np.ones((2, 1)), np.zeros(2, dtype=bool)


class Worlds:
    """Stands in for two worlds of the seed's scene; `pulled` has a vertex that is pulled through the organ."""

    def __init__(self) -> None:
        self.scene, self.count = scenes.seed(), 2
        rest = self.scene.organs[0].vertices
        self.nodes = np.array([rest, rest])
        self.pulled = np.array(rest)
        self.pulled[0] -= 2.2 * (rest[0] - rest.mean(axis=0))
        self.tool_positions = np.full((2, 1, 3), 50.0)
        self.tool_orientations = np.tile([0.0, 0.0, 0.0, 1.0], (2, 1, 1))
        self.tangled = (False, False)

    def advance(self, *arguments: Any) -> Loads:
        return Loads(self.tangled)


def test_what_crosses_for_long_is_to_be_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.physics_steps.join_loads", lambda parts: parts[-1])
    worlds: Any = Worlds()
    watch = endurance.Watch(worlds)

    def advance(steps: int) -> None:
        worlds.advance(None, None, steps, None, None)

    patience = round(endurance.LONGEST_CROSSED / worlds.scene.dt)
    advance(1)
    worlds.nodes[1] = worlds.pulled
    advance(patience)
    assert (watch.crossed, watch.stretches, watch.tangles, watch.untold) == (patience, 1, 0, 0)
    advance(2)
    assert (watch.tangles, watch.untold, watch.tangled) == (1, 2, 0)
    worlds.tangled = (False, True)
    advance(3)
    assert (watch.tangles, watch.untold, watch.tangled) == (1, 2, 3)
    worlds.nodes[1] = worlds.nodes[0]
    advance(1)
    worlds.nodes[1] = worlds.pulled
    advance(1)
    assert (watch.stretches, watch.tangles, watch.longest_crossed) == (2, 1, patience + 5)
    watch.forget([1])
    assert watch.crossed_for.tolist() == [0, 0]


# Output and recordings ----------------------------------------------------------------------------------------------


def run_main(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *options: str) -> Any:
    monkeypatch.setattr(sys, "argv", ["endurance", *options, "--json"])
    endurance.main()
    return json.loads(capsys.readouterr().out)


def test_what_was_run_is_not_run_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file, made = tmp_path / "runs" / "runs.jsonl", []

    def run_job(job: Job) -> Endurance:
        made.append(job.seed)
        return replace(NOTHING, task=job.task, depth=0.25 * job.seed)

    monkeypatch.setattr(endurance, "run_job", run_job)
    options = ("--tasks", "Clamp", "--engines", "batch", "--actions", "kept", "--steps", "64", "--output", str(file))
    run_main(monkeypatch, capsys, *options, "--seeds", "0", "1")
    # Killed while it wrote.
    with file.open("a", encoding="utf-8") as cut_off:
        cut_off.write('{"job": {"task": "Cl')
    result = run_main(monkeypatch, capsys, *options, "--seeds", "1", "2", "3")
    assert made == [0, 1, 2, 3]
    runs = result["tasks"]["Clamp"]["batch"]["kept"]
    assert {seed: run["depth"] for seed, run in runs.items()} == {"1": 0.25, "2": 0.5, "3": 0.75}
    assert result["passed"]
    assert len(endurance.read_output(file)) == 4
    with pytest.raises(SystemExit):
        run_main(monkeypatch, capsys, *options, "--processes", "0")


@pytest.mark.parametrize("engine", ["batch", "bullet"])
def test_a_recording_repeats_what_happened(engine: str, tmp_path: Path) -> None:
    path = tmp_path / "worst.npz"
    envs: Any = gymnasium.make_vec("Spatula/Palpate-v0", num_envs=2, engine=engine)
    worlds = envs.unwrapped.worlds
    envs.reset(seed=1)
    recorder = Recorder(worlds, path)
    forces: list[float] = []
    look_after_every_step(worlds, lambda loads: forces.append(float(loads.peak_forces[1].max())))
    drawn = endurance.RandomActions("kept", (2, envs.single_action_space.shape[0]), np.random.default_rng(0))
    for step in range(30):
        recorder.begin_control_step()
        envs.step(drawn.draw())
        recorder.end_control_step(np.array([0.0, float(step == 28)]))
    nodes, positions = worlds.nodes[1], worlds.tool_positions[1]
    envs.close()
    simulation = Simulation(scenes.palpate(), engine=engine)
    try:
        linear, angular = restore_recording(simulation, path)
        for v, w in zip(linear, angular, strict=True):
            simulation.step(v, w)
        # The step in which something was amiss, the next, and those before.
        assert len(linear) == 6 * 12
        assert max(forces[-len(linear) :]) > 0.0
        np.testing.assert_allclose(simulation.nodes, nodes, atol=1e-9)
        np.testing.assert_allclose(simulation.tool_positions, positions, atol=1e-12)
    finally:
        simulation.close()


def test_the_worst_stretch_is_kept_and_none_reaches_into_the_episode_before(tmp_path: Path) -> None:
    path = tmp_path / "worst.npz"
    envs: Any = gymnasium.make_vec("Spatula/Press-v0", num_envs=2, engine="batch")
    envs.reset(seed=0)
    recorder = Recorder(envs.unwrapped.worlds, path)
    look_after_every_step(envs.unwrapped.worlds, lambda loads: None)

    def step(*badness: float) -> None:
        recorder.begin_control_step()
        envs.step(np.zeros((2, 3), dtype=np.float32))
        recorder.end_control_step(np.array(badness))

    def recorded() -> int:
        with np.load(path) as arrays:
            return len(arrays["linear"]) // 12

    for badness in (0.0, 0.0), (0.2, 0.0), (0.3, 0.0), (0.0, 0.0):
        step(*badness)
    assert recorder.worst == 0.3
    assert recorded() == 4
    for badness in (0.0, 0.1), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0):
        step(*badness)
    assert recorded() == 4
    recorder.forget([0])
    # Reset in the first of these.
    for badness in (0.0, 0.0), (0.5, 0.0), (0.0, 0.0):
        step(*badness)
    assert recorder.worst == 0.5
    assert recorded() == 2
    envs.close()


# Actions ------------------------------------------------------------------------------------------------------------


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
