from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from spatula_env.envs import PressEnv, PressVectorEnv
from spatula_env.learning.policies import make_expert
from spatula_env.pressure_limits import COST_PRESSURE, VIOLATION_PRESSURE

GOAL = (0.0, 0.0, 0.018)
ABOVE = (0.0, 0.0, -0.02)
DOWN, UP = np.array([0.0, 0.0, -0.6]), np.array([0.0, 0.0, 1.0])


def plunge(env: Any, steps: int = 12, **options: Any) -> list[tuple[float, bool, dict[str, Any]]]:
    """Go down fast, right above the organ's top, then up again."""
    env.reset(seed=0, options={"goal": GOAL, "tool_position": ABOVE, **options})
    shown = []
    for k in range(steps):
        _, reward, terminated, _, info = env.step(DOWN if k < steps - 2 else UP)
        shown.append((reward, terminated, info))
        if terminated:
            break
    return shown


def grip_height(env: PressEnv) -> float:
    """Of the tool over the workspace's middle [m]."""
    return float(env.workspace.from_scene(env.simulation.tool_position)[2])


@pytest.fixture(scope="module")
def env() -> Any:
    with PressEnv(engine="batch") as made:
        yield made


def test_the_thresholds_are_those_of_the_source() -> None:
    # 20 and 30 mmHg.
    assert pytest.approx(20 * 133.322, rel=2e-3) == COST_PRESSURE
    assert pytest.approx(30 * 133.322, rel=2e-3) == VIOLATION_PRESSURE


def test_a_dose_is_counted_where_pressure_is_high(env: PressEnv) -> None:
    infos = [info for *_, info in plunge(env)]
    assert infos[0]["dose"] == infos[0]["episode_dose"] == 0.0
    assert not infos[0]["violation"]
    assert any(info["dose"] > 0.0 for info in infos)
    for info in infos:
        assert (info["dose"] > 0.0) == (info["peak_pressure"] > COST_PRESSURE)
        assert info["violation"] == (info["peak_pressure"] > VIOLATION_PRESSURE)
        # The greatest pressure lasts for a part of the step of 50 ms only.
        assert info["dose"] <= max(info["peak_pressure"] - COST_PRESSURE, 0.0) * 0.05 + 1e-9
        assert info["mean_pressure"] <= info["peak_pressure"]


def test_cost_is_what_is_too_fast_and_what_the_goal_does_not_need(env: PressEnv) -> None:
    infos = [info for *_, info in plunge(env)]
    limits = env.task.loading_limit, env.task.pressure_limit(np.array([GOAL]))[0]
    force = 0.0
    for info in infos:
        loading, force = (info["force"] - force) / 0.05, info["force"]
        beyond = max(loading / limits[0] - 1.0, 0.0) + max(info["peak_pressure"] / limits[1] - 1.0, 0.0)
        assert info["cost"] == pytest.approx(0.05 * beyond, abs=1e-9)
    assert infos[-1]["episode_cost"] > env.task.cost_budget


def test_the_same_press_costs_less_when_it_is_done_slowly(env: PressEnv) -> None:
    costs = []
    for slower in (1, 2, 4):
        env.reset(seed=0, options={"goal": GOAL, "tool_position": ABOVE})
        for _ in range(7 * slower):
            *_, info = env.step(DOWN / slower)
        costs.append(info["episode_cost"])
    assert costs[0] > costs[1] > costs[2]


def test_success_is_safe_within_the_budget_of_cost() -> None:
    for budget, safe in ((1.0, True), (0.0, False)):
        with PressEnv(engine="batch", task={"cost_budget": budget, "loading_limit": 0.5}) as made:
            expert = make_expert(made)
            observation, info = made.reset(seed=0, options={"goal": (0.0, 0.0, 0.01), "tool_position": ABOVE})
            assert not info["is_safe_success"]
            while not info["is_success"]:
                observation, _, _, _, info = made.step(expert(observation))
            assert info["episode_cost"] > 0.0
            assert info["is_safe_success"] is safe
            # What comes after success does not make it unsafe.
            for _ in range(4):
                *_, info = made.step(DOWN)
            assert info["is_safe_success"] is safe


def test_episodes_add_up(env: PressEnv) -> None:
    infos = [info for *_, info in plunge(env)]
    last = infos[-1]
    assert last["episode_cost"] == pytest.approx(sum(info["cost"] for info in infos))
    assert last["episode_dose"] == pytest.approx(sum(info["dose"] for info in infos))
    assert last["episode_work"] == pytest.approx(sum(info["work"] for info in infos))
    assert last["episode_violation_time"] == pytest.approx(0.05 * sum(info["violation"] for info in infos))
    assert last["episode_violation_time"] > 0.0
    for name in ("peak_force", "peak_pressure"):
        assert last[f"episode_{name}"] == max(info[name] for info in infos)
    # The next episode begins with nothing.
    info = env.reset()[1]
    assert all(value == 0.0 for name, value in info.items() if name.startswith("episode_"))
    assert info["cost"] == info["work"] == info["peak_pressure"] == 0.0


def test_work_is_force_times_way(env: PressEnv) -> None:
    env.reset(seed=0, options={"goal": GOAL, "tool_position": ABOVE})
    for _ in range(10):
        observation, *_, info = env.step(0.5 * DOWN)
    slices = env.observation_builder.slices
    force, velocity = observation[slices["contact_force"]], observation[slices["tool_velocity"]]
    assert info["work"] > 0.0
    assert info["work"] == pytest.approx(-float(force @ velocity) * 0.05, rel=1e-4)


def test_cost_is_no_part_of_the_reward(env: PressEnv) -> None:
    for reward, _, info in plunge(env):
        terms = {name: info[f"reward/{name}"] for name in env.task.weights}
        assert reward == pytest.approx(sum(weight * terms[name] for name, weight in env.task.weights.items()))
    assert not {"cost", "dose"} & set(env.task.weights)


def test_damage_ends_an_episode_when_asked_to(env: PressEnv) -> None:
    free = plunge(env)
    assert not any(terminated for _, terminated, _ in free)
    assert not any(info["is_damaged"] for *_, info in free)
    limit = 0.3 * free[-1][2]["episode_dose"]
    with PressEnv(engine="batch", damage_limit=limit, episode_time=10.0) as ending:
        shown = plunge(ending)
    assert shown[-1][1]
    assert [info["is_damaged"] for *_, info in shown] == [False] * (len(shown) - 1) + [True]
    assert shown[-1][2]["episode_dose"] > limit >= shown[-2][2]["episode_dose"]
    assert len(shown) < len(free)


def test_each_world_is_damaged_by_itself() -> None:
    env = PressVectorEnv(2, damage_limit=0.0, episode_time=10.0, autoreset_mode="disabled")
    env.reset(seed=0, options={"goal": GOAL, "tool_position": np.array([ABOVE, (0.0, 0.0, 0.02)])})
    for _ in range(12):
        _, _, terminated, _, infos = env.step(np.stack([DOWN, UP]))
        if terminated.any():
            break
    assert terminated.tolist() == infos["is_damaged"].tolist() == [True, False]
    assert infos["episode_dose"][1] == 0.0
    _, infos = env.reset(options={"reset_mask": np.array([True, False])})
    assert infos["episode_dose"].tolist() == [0.0, 0.0]
    env.close()


def test_a_tool_that_meets_too_great_a_force_does_not_push_on() -> None:
    peaks, depths = [], []
    for limit in (None, 0.3):
        with PressEnv(engine="batch", max_force=limit) as env:
            env.reset(seed=0, options={"goal": GOAL, "tool_position": ABOVE})
            forces, heights = [], []
            for _ in range(40):
                *_, info = env.step(DOWN)
                forces.append(info["force"])
                heights.append(grip_height(env))
            peaks.append(max(forces))
            depths.append(heights[-1])
            # It gets away as fast as ever.
            env.step(UP)
            assert grip_height(env) - heights[-1] == pytest.approx(0.1 * 0.05, rel=1e-6)
    assert peaks[0] > 0.8
    # The organ swings against the tool that has stopped.
    assert 0.3 < peaks[1] < 0.5
    assert depths[1] > depths[0] + 0.01


@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan])
def test_an_impossible_greatest_force_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match="max_force must be positive and finite"):
        PressEnv(engine="batch", max_force=value)


@pytest.mark.bullet
def test_both_engines_count_alike() -> None:
    totals = []
    for engine in ("batch", "bullet"):
        with PressEnv(engine=engine) as env:
            totals.append(plunge(env)[-1][2])
    for name in ("episode_cost", "episode_dose", "episode_work", "episode_peak_force", "episode_peak_pressure"):
        assert totals[0][name] == pytest.approx(totals[1][name], rel=0.05), name


@pytest.mark.parametrize("contact", ["flags", "bullet"])
def test_info_tells_how_deep_contact_was_left(contact: str) -> None:
    env = PressEnv(contact=contact, engine="bullet")
    shown = plunge(env)
    residuals = [info["residual"] for *_, info in shown]
    env.close()
    assert residuals[0] >= 0.0 and np.isfinite(residuals).all()
    # PyBullet's own contact lets the plate in by centimetres.
    assert (max(residuals) < 1e-4) == (contact == "flags")


@pytest.mark.parametrize("engine", ["batch", "bullet"])
def test_info_tells_the_greatest_residual_of_the_physics_steps(engine: str) -> None:
    env = PressEnv(engine=engine)
    reported: list[float] = []
    env.reset(seed=0, options={"goal": GOAL, "tool_position": ABOVE})
    env.simulation.listeners.append(lambda report: reported.append(report.residual))
    for _ in range(10):
        reported.clear()
        residual = env.step(DOWN)[4]["residual"]
        assert len(reported) == 12 and residual == pytest.approx(max(reported) * env.simulation.scene.scale.length)
    env.close()
