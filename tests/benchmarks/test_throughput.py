"""The throughput benchmark: does every side do the work that it claims to do? Speed itself is not tested."""

from __future__ import annotations

import json
import os
import subprocess

import gymnasium as gym
import numba
import numpy as np
import pytest

from benchmarks import throughput
from benchmarks.throughput import Size, Timing
from spatula_env import scenes
from spatula_env.sim.batch_body import BatchBody
from spatula_env.sim.soft_body import soft_body

SCENE = scenes.seed()
SMALL = Size(
    rounds=2, worlds=(1, 2), vectors=(2,), body_calls=2, press_depth=0.1, press_places=1, episodes=2, down=1, calls=2,
    whole_episodes=1, episode_length=3,
)  # fmt: skip


@pytest.fixture(scope="module")
def script():
    return throughput.make_script(down=4, calls=3)


class Scripted:
    """A side with given times: 2 calls of 6 steps in each of 3 worlds."""

    worlds, threads, steps = 3, 1, 36


# Figures -----------------------------------------------------------------------------------------------------------


def test_the_time_of_a_call_is_its_median_over_the_turns():
    timing = Timing(Scripted(), np.array([[1.0, 2.0], [9.0, 2.0], [1.0, 8.0]]))
    assert timing.steps_per_second == pytest.approx(36 / 3.0)
    assert timing.spread == pytest.approx((11.0 - 3.0) / 9.0)


def test_rows_are_compared_with_bullet():
    slow, fast = (Timing(Scripted(), np.full((1, 2), seconds)) for seconds in (3.0, 0.5))
    rows = throughput._rows({"bullet": slow, "batch 3": fast})
    assert rows["bullet"]["ratio"] == 1.0 and rows["batch 3"]["ratio"] == pytest.approx(6.0)
    assert rows["batch 3"]["microseconds"] == pytest.approx(1e6 / 36)
    assert "contact_share" not in rows["bullet"]


def test_parts_make_up_the_whole(script):
    driver = throughput.Driver(2, 2, script, None, None, None)
    turns = [{"step": np.full(3, 2e-3), "advance": np.full(3, 1.6e-3), "task": np.full(3, 2e-4)} for _ in range(3)]
    for turn in turns:
        turn["observation"] = np.full(3, 1e-4)
    found = throughput._share_out(turns, driver, {"batch 2": {"microseconds": 50.0}})
    assert found["microseconds"] == pytest.approx(
        {"physics": 600.0, "contact and ground": 200.0, "task": 100.0, "observation": 50.0, "rest": 50.0}
    )
    assert found["control_step_microseconds"] == pytest.approx(1000.0)
    assert sum(found["share"].values()) == pytest.approx(1.0)


def figures(ratio, threads=1.8):
    row = {"ratio": ratio, "steps_per_second": 100.0 * ratio, "threads": 1, "worlds": 64}
    row["simulated_seconds_per_second"] = 5.0 * ratio
    names = ("bullet", "batch simulation", "batch 1", "batch 64")
    parts = {part: dict.fromkeys(names, row) for part in ("body", "press", "environment")}
    episodes = {policy: dict.fromkeys(names, row) for policy in throughput.POLICIES}
    return {**parts, "episodes": episodes, "two_threads": {"ratio": threads}}


@pytest.mark.parametrize(
    ("ratio", "threads", "passed", "stretch"),
    [
        (11.0, 1.8, True, False),
        (11.0, 1.6, False, False),
        (9.0, 1.8, False, False),
        (11.0, None, True, False),
        (21.0, 1.8, True, True),
    ],
)
def test_figures_are_held_against_what_is_asked(ratio, threads, passed, stretch):
    verdict = throughput.judge(figures(ratio, threads))
    assert verdict["passed"] == passed
    assert verdict["thresholds"]["body_64_worlds"]["passed"] == (ratio >= 10.0)
    assert verdict["thresholds"]["two_threads"]["passed"] == (None if threads is None else threads >= 1.7)
    assert all(row["passed"] for row in verdict["stretch"].values()) == stretch


@pytest.mark.parametrize("policy", throughput.POLICIES)
def test_whole_episodes_count_each_by_itself(policy):
    slow = figures(11.0)
    slow["episodes"][policy] = {name: {**row, "ratio": 9.0} for name, row in slow["episodes"][policy].items()}
    thresholds = throughput.judge(slow)["thresholds"]
    failed = [name for name, row in thresholds.items() if not row["passed"]]
    assert failed == [f"{policy}_episodes_64_worlds"]


@pytest.mark.parametrize(("cached", "passed"), [(4.0, True), (6.0, False)])
def test_compiling_counts_if_it_was_measured(cached, passed):
    verdict = throughput.judge(figures(11.0), {"compiling": 50.0, "from_cache": cached})
    assert verdict["thresholds"]["cold_compiling"]["passed"]
    assert verdict["thresholds"]["cold_from_cache"]["passed"] == verdict["passed"] == passed


def test_two_threads_need_two_cores():
    rates = {"batch 64": {"steps_per_second": 100.0}, "batch 64 on 2 threads": {"steps_per_second": 180.0}}
    result = {"press": rates, "environment": rates}
    assert throughput._compare_threads(result, 2)["ratio"] == pytest.approx(1.8)
    assert throughput._compare_threads(result, 2)["environment_ratio"] == pytest.approx(1.8)
    single = throughput._compare_threads(result, 1)
    assert single["ratio"] is None and "one core" in single["reason"]


# Sides -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(throughput.BulletBody, marks=pytest.mark.bullet, id="bullet"),
        pytest.param(lambda *size: throughput.CompiledBody(SCENE, 3, *size[1:]), id="batch"),
    ],
)
def test_a_body_makes_the_same_steps_in_every_turn(make):
    side = make(SCENE, 3, 4)
    assert side.steps == side.worlds * 12
    ends = []
    for _ in range(2):
        seconds = side.turn()
        assert seconds.shape == (3,) and (seconds > 0.0).all()
        if side.worlds == 1:
            nodes = np.empty_like(side._start[0])
            side._world._read(nodes)
        else:
            nodes = side._body.positions[-1]
        ends.append(nodes)
    np.testing.assert_array_equal(*ends)
    # Twelve steps and an untimed one of falling, with what the centre had of velocity.
    masses = 1.0 / BatchBody(soft_body(SCENE.organs[0])).inverse_masses[0]
    before, velocity, after = (masses @ values / masses.sum() for values in (*side._start, nodes))
    fallen = 13 * SCENE.dt * velocity[2] - 0.5 * SCENE.gravity * SCENE.dt**2 * 13 * 14
    assert (after - before)[2] == pytest.approx(fallen, rel=1e-3)
    assert side.turn(1).shape == (1,)
    side.close()


def test_a_press_has_its_places():
    few, many = (throughput.make_press(SCENE, count, 0.1, 0.1) for count in (2, 40))
    np.testing.assert_array_equal(few.velocities, many.velocities)
    assert few.velocities.shape == (6 + 2 + 6, 3)
    np.testing.assert_array_equal(few.places, many.places[:2])
    distances = np.linalg.norm(many.places[:, :2] - many.places[:, :2].mean(axis=0), axis=1)
    assert len(np.unique(many.places[:, 0])) == 40 and distances.max() < 0.7
    assert np.ptp(many.places[:, 2]) == 0.0


@pytest.fixture(scope="module")
def press_plan():
    return throughput.make_press(SCENE, 2, 0.2, 0.1)


@pytest.mark.bullet
def test_a_press_of_many_is_the_press_of_each(press_plan):
    sides = [
        throughput.PressOfOne(SCENE, "bullet", press_plan),
        throughput.PressOfOne(SCENE, "batch", press_plan),
        throughput.PressOfMany(SCENE, press_plan),
    ]
    shares, ends = [], []
    for side in sides:
        assert side.steps == 2 * len(press_plan.velocities) * 12
        calls = len(press_plan.velocities) * (1 if side.worlds == 2 else 2)
        assert side.turn().shape == (calls,)
        shares.append(side.contact_share)
        ends.append(side._batch.nodes[1] if side.worlds == 2 else side._simulation.nodes)
        assert side.turn(1).shape == (1,)
        side.close()
    assert shares[0] == shares[1] == shares[2] and 0.2 < shares[0] < 0.8
    np.testing.assert_array_equal(ends[1], ends[2])
    np.testing.assert_allclose(ends[0], ends[1], atol=0.02)


@pytest.mark.skipif(numba.get_num_threads() < 2, reason="there is one core only")
def test_threads_change_nothing_but_time(press_plan):
    shares = []
    for threads in (1, 2):
        side = throughput.PressOfMany(SCENE, press_plan, threads)
        side.turn()
        shares.append(side.contact_share)
        assert side.threads == threads
    assert shares[0] == shares[1]
    assert numba.get_num_threads() >= 2


def test_threads_are_given_back():
    before = numba.get_num_threads()
    with pytest.raises(RuntimeError), throughput.numba_threads(1):
        assert numba.get_num_threads() == 1
        raise RuntimeError
    assert numba.get_num_threads() == before


# Environments ------------------------------------------------------------------------------------------------------


def test_a_world_has_its_own_start_and_chance(script):
    starts = [script.start(world) for world in range(50)]
    goals = np.array([start["goal"] for start in starts])
    assert (np.hypot(*goals[:, :2].T) <= 0.015).all() and len(np.unique(goals)) == goals.size
    assert (goals[:, 2] >= 0.005).all() and (goals[:, 2] <= 0.018).all()
    for start in starts:
        np.testing.assert_array_equal(start["tool_position"][:2], start["goal"][:2])
    np.testing.assert_array_equal(script.start(7)["goal"], goals[7])
    chance = script.by_chance(range(10))
    assert chance.shape == (10, 3, 3) and chance.dtype == np.float32
    np.testing.assert_array_equal(script.by_chance([8])[0], chance[8])


def test_the_script_goes_to_the_goal_and_holds(script):
    observations = np.zeros((3, 71), dtype=np.float32)
    observations[:, script.error] = [[0.001, -0.002, 0.01], [0.0, 0.0, 0.0], [0.0, 0.0, 0.005]]
    observations[1:, script.touch] = 0.5
    actions = script.actions(observations)
    np.testing.assert_allclose(actions[0], [0.08, -0.16, -0.6], rtol=1e-5)
    np.testing.assert_array_equal(actions[1], 0.0)
    np.testing.assert_allclose(actions[2], [0.0, 0.0, -0.3], rtol=1e-5)


def played(driver):
    """Play a turn, and return the forces (worlds, timed calls) and the times."""
    step, rows = driver.step, []

    def watched(actions):
        result = step(actions)
        rows.append(result[1])
        return result

    driver.step = watched
    seconds = driver.turn()
    driver.close()
    script = driver.script
    groups = np.array(rows).reshape(-1, script.down + script.calls, driver.worlds)[:, script.down :]
    return groups.transpose(0, 2, 1).reshape(-1, script.calls), seconds


@pytest.mark.bullet
def test_environments_play_the_same_one_by_one_and_together(script):
    drivers = [
        throughput.single_driver("batch", 2, script),
        throughput.vector_driver(2, 1, script),
        throughput.single_driver("bullet", 2, script),
        throughput.process_driver("batch", 1, 2, script),
    ]
    forces = []
    for driver in drivers:
        assert driver.steps == 2 * script.calls
        found, seconds = played(driver)
        assert seconds.shape == (driver.total // driver.worlds * script.calls,)
        assert found.shape == (2, script.calls)
        assert driver.contact_share == (found > 0.0).mean() > 0.4
        forces.append(found)
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-9)
    np.testing.assert_array_equal(forces[3], forces[0])
    np.testing.assert_allclose(forces[2], forces[0], rtol=0.02, atol=0.02 * forces[0].max())


def test_odd_worlds_leave_the_script_when_time_is_taken(script):
    seen = []

    def step(actions):
        seen.append(actions)
        return np.zeros((2, 71), dtype=np.float32), np.zeros(2)

    def reset(worlds):
        return np.zeros((2, 71), dtype=np.float32)

    throughput.Driver(2, 2, script, reset, step, None).turn()
    scripted = np.repeat(script.actions(reset([0, 1]))[None], len(seen), axis=0)
    np.testing.assert_array_equal(np.array(seen)[:, 0], scripted[:, 0])
    np.testing.assert_array_equal(np.array(seen)[: script.down, 1], scripted[: script.down, 1])
    np.testing.assert_array_equal(np.array(seen)[script.down :, 1], script.by_chance([1])[0])


@pytest.mark.bullet
@pytest.mark.parametrize("policy", throughput.POLICIES)
def test_whole_episodes_are_those_that_a_seed_begins(policy):
    length, ends = 8, []
    drivers = [
        throughput.single_episodes("batch", policy, 2, length),
        throughput.vector_episodes(2, policy, length),
        throughput.single_episodes("bullet", policy, 2, length),
    ]
    for driver in drivers:
        assert driver.steps == 2 * length
        step, rows = driver.step, []

        def watched(actions, step=step, rows=rows):
            result = step(actions)
            rows.append(result[0])
            return result

        driver.step = watched
        seconds = driver.turn()
        assert seconds.shape == (2 // driver.worlds * (length + 1),) and (seconds > 0.0).all()
        assert 0.0 <= driver.contact_share <= 1.0
        ends.append(np.array(rows).reshape(-1, length, driver.worlds, rows[0].shape[1]).swapaxes(1, 2))
        assert driver.turn(3).shape == (3,)
        driver.close()
    one_by_one, together, with_bullet = (end.reshape(2, length, -1) for end in ends)
    np.testing.assert_allclose(together, one_by_one, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(with_bullet[:, :, :3], one_by_one[:, :, :3], atol=1e-6)
    # Two seeds, two episodes.
    assert np.abs(one_by_one[0, -1] - one_by_one[1, -1]).max() > 0.005


def test_chance_is_each_seeds_own_and_the_expert_goes_down():
    begin = throughput.policy_of("random", None)
    act, again, other = begin([3, 5]), begin([3, 5]), begin([5])
    first = act(None)
    np.testing.assert_array_equal(first, again(None))
    np.testing.assert_array_equal(first[1], other(None)[0])
    assert first.shape == (2, 3) and np.abs(first).max() <= 1.0 and (act(None) != first).all()
    driver = throughput.vector_episodes(2, "expert", 40)
    driver.turn()
    assert driver.contact_share > 0.2
    driver.close()


def test_the_baseline_is_not_slowed_by_checks(script):
    env = throughput.make_single("batch", script)
    assert "PassiveEnvChecker" not in str(env)
    env.close()
    assert "PassiveEnvChecker" in str(gym.make(throughput.ENVIRONMENT, engine="batch"))


def test_parts_are_watched(script):
    parts = throughput.Parts(2, script)
    turn = parts.turn()
    assert turn.keys() == {"step", "advance", "task", "observation"}
    assert all(values.shape == (script.calls,) and (values > 0.0).all() for values in turn.values())
    assert (turn["advance"] + turn["task"] + turn["observation"] < turn["step"]).all()
    parts.driver.close()


# All of it ---------------------------------------------------------------------------------------------------------


def test_new_processes_share_a_fresh_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("SPATULA_TEST_FILE", str(tmp_path / "seen"))
    code = (
        "import os, spatula_env\n"
        "open(os.environ['SPATULA_TEST_FILE'], 'a').write(os.environ['NUMBA_CACHE_DIR'] + os.linesep)"
    )
    told = []
    seconds = throughput.first_steps(told.append, code)
    assert seconds.keys() == throughput.COLD_LIMITS.keys() and len(told) == 2
    assert all(value > 0.0 for value in seconds.values())
    first, second = (tmp_path / "seen").read_text().splitlines()
    assert first == second != os.environ.get("NUMBA_CACHE_DIR") and not os.path.exists(first)
    with pytest.raises(subprocess.CalledProcessError):
        throughput.first_steps(told.append, "raise SystemExit(3)")


@pytest.mark.bullet
def test_last_line_is_json(monkeypatch, capsys):
    monkeypatch.setattr(throughput, "available_cores", lambda: 1)
    monkeypatch.setattr(throughput, "Size", lambda rounds: SMALL)
    monkeypatch.setattr(throughput.Size, "rounds", 2, raising=False)
    throughput.main(["--rounds", "2"])
    captured = capsys.readouterr()
    result = json.loads(captured.out.splitlines()[-1])
    assert result["benchmark"] == "throughput" and result["cold"] is None
    assert result["body"].keys() == {"bullet", "batch 1", "batch 2"}
    assert result["press"].keys() == {"bullet", "batch simulation", "batch 1", "batch 2"}
    assert result["environment"].keys() == {"bullet", "batch", "batch 2"}
    assert result["episodes"].keys() == {"random", "expert"}
    for rows in (result["body"], result["press"], result["environment"], *result["episodes"].values()):
        for row in rows.values():
            assert row["steps_per_second"] > 0.0 and row["threads"] == 1
            assert row["simulated_seconds_per_second"] > 0.0
    assert result["two_threads"]["reason"] == "there is one core only"
    assert result["thresholds"]["press_64_worlds"]["passed"] is None
    assert result["thresholds"]["body_one_world"]["passed"] is not None
    assert sum(result["parts"]["share"].values()) == pytest.approx(1.0)
    assert all(rows.keys() == {"bullet", "batch", "batch 2"} for rows in result["episodes"].values())
    assert "round 2 of 2: environment, batch 2" in captured.err
    assert "round 2 of 2: expert episodes, batch 2" in captured.err
