"""Organs that breathe: the same as a tool that moves over a resting organ, seen by a robot that stands still."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from spatula_env.envs import PressEnv, PressVectorEnv
from spatula_env.envs.randomization import read_ranges
from spatula_env.envs.sway import BREATHING_FREQUENCY, PULSE_FREQUENCY, Sway

GOAL = (0.0, 0.0, 0.01)
NEAR = (0.002, 0.001, -0.0225)
AMPLITUDE, PHASE = 0.006, 0.4
BREATH: dict[str, Any] = {"randomization": {"breathing": AMPLITUDE, "breathing_phase": PHASE}}
STILL = np.zeros(3)


def heights(times: Any) -> Any:
    """Heights of the bed at times, independently of the package."""
    return AMPLITUDE * np.sin(2.0 * np.pi * BREATHING_FREQUENCY * np.asarray(times) + PHASE)


def shown(actions: Any, engine: str = "batch", **options: Any) -> list[dict[str, Any]]:
    """Observations and infos of an episode with given actions (T, 3)."""
    with PressEnv(engine=engine, obs_mode="dict", **options) as env:
        found = [env.reset(seed=0, options={"goal": GOAL, "tool_position": NEAR})]
        for action in actions:
            observation, *_, info = env.step(action)
            found.append((observation, info))
    return [{**observation, **info} for observation, info in found]


def test_an_organ_rises_against_a_tool_that_stands_still() -> None:
    steps = shown(np.tile(STILL, (80, 1)), **BREATH)
    times = 0.05 * np.arange(81)
    still = NEAR + np.array([0.0, 0.0, heights(0.0)])
    assert np.array([step["tool_position"] for step in steps]) == pytest.approx(np.tile(still, (81, 1)), abs=1e-6)
    assert np.array([step["tool_velocity"] for step in steps]) == pytest.approx(np.zeros((81, 3)), abs=1e-7)
    forces = np.array([step["contact_force"][2] for step in steps])
    gap = 0.0025 - 0.00125 + heights(0.0) - heights(times)
    assert (forces[gap > 0.0005] == 0.0).all()
    assert (forces[gap < -0.001] > 0.01).all()
    # Landmarks that nothing presses on show the motion itself.
    rises = np.array([np.median(step["landmarks"].reshape(-1, 3)[:, 2]) for step in steps])
    free = np.flatnonzero(gap > 0.0)[:3]
    assert rises[free] == pytest.approx(heights(times[free]), abs=1e-4)


@pytest.mark.parametrize("engine", ["batch", "bullet", "tissue"])
def test_it_is_the_same_as_a_tool_that_moves_over_a_resting_organ(engine: str) -> None:
    if engine == "bullet":
        pytest.importorskip("pybullet", reason="needs the extra bullet")
    steps = 30
    rises = np.diff(heights(0.05 * np.arange(steps + 1)))
    moving = np.zeros((steps, 3))
    moving[:, 2] = -rises / 0.05 / 0.1
    breathing = shown(np.tile(STILL, (steps, 1)), engine, **BREATH)
    resting = shown(moving, engine)
    assert max(step["force"] for step in resting) > 0.01
    for one, other in zip(breathing, resting, strict=True):
        for name in ("contact_force", "contact_torque", "error", "contact_share"):
            assert one[name] == pytest.approx(other[name], rel=1e-3, abs=1e-5), name
        assert one["work"] == pytest.approx(other["work"], rel=1e-3, abs=1e-9)


def test_a_world_of_many_breathes_as_one_alone() -> None:
    options: dict[str, Any] = {"randomization": {"breathing": (0.001, 0.008), "pulse": (0.0, 0.001)}}
    many = PressVectorEnv(3, **options)
    together, _ = many.reset(seed=[4, 5, 6])
    with PressEnv(engine="batch", **options) as one:
        alone, _ = one.reset(seed=5)
        for k in range(25):
            assert np.array_equal(together[1], alone)
            if k == 12:
                # A partial reset leaves the others in their breath.
                many.reset(seed=[9, 5, 9], options={"reset_mask": np.array([True, False, True])})
            action = np.array([0.1, 0.0, -0.3], dtype=np.float32)
            together, *_ = many.step(np.tile(action, (3, 1)))
            alone, *_ = one.step(action)
    many.close()


def test_a_saved_breath_goes_on_the_same() -> None:
    with gym.make("Spatula/Press-v0", engine="batch", randomization={"breathing": (0.002, 0.01)}) as env:
        env.reset(seed=3)
        for _ in range(7):
            env.step(np.array([0.0, 0.0, -0.2], dtype=np.float32))
        made: Any = env.unwrapped
        state = made.save()
        other = copy.deepcopy(made)
        first = [made.step(np.zeros(3, dtype=np.float32))[0] for _ in range(5)]
        made.restore(state)
        again = [made.step(np.zeros(3, dtype=np.float32))[0] for _ in range(5)]
        copied = [other.step(np.zeros(3, dtype=np.float32))[0] for _ in range(5)]
        assert np.array_equal(first, again)
        assert np.array_equal(first, copied)
        other.close()


def test_the_tool_stays_in_the_workspace_of_the_bed() -> None:
    with PressEnv(engine="batch", obs_mode="dict", **BREATH) as env:
        env.reset(seed=0, options={"goal": GOAL, "tool_position": (0.0, 0.0, 0.045)})
        for _ in range(60):
            env.step(np.array([0.0, 0.0, 1.0]))
            height = float(env.workspace.from_scene(env.simulation.tool_position)[2])
            assert height <= 0.0508 + 1e-9
        assert height == pytest.approx(0.0508, abs=1e-9)


def test_a_pilot_feels_the_organ_rise() -> None:
    """Who holds the grip where it is, by its place in the frame of the robot, is pushed by the organ."""
    with PressEnv(engine="batch", **BREATH) as env:
        env.reset(seed=0, options={"goal": GOAL, "tool_position": NEAR})
        where = env.unwrapped._episodes.grips[0].copy()
        forces: list[float] = []
        places: list[Any] = []

        def hold(grip: Any) -> Any:
            places.append(grip.copy())
            return np.clip((where - grip) / (env.simulation.dt * 0.1), -1.0, 1.0)

        release = env.steer(hold)
        for _ in range(30):
            *_, info = env.step(STILL)
            forces.append(info["force"])
        release()
        assert max(forces) > 0.01
        assert len(places) == 30 * env.steps_per_action
        assert np.array(places) == pytest.approx(np.tile(where, (len(places), 1)), abs=2e-4)


def test_amplitudes_bring_their_phases() -> None:
    ranges = read_ranges({"breathing": (0.0, 0.002), "pulse": 0.0001}, {})
    assert ranges["breathing_phase"] == ranges["pulse_phase"] == (-np.pi, np.pi)
    assert read_ranges({"breathing": 0.001, "breathing_phase": 0.5}, {})["breathing_phase"] == (0.5, 0.5)
    with pytest.raises(ValueError, match=r"randomization\.breathing must lie in 0 to 0\.01, got 0\.02"):
        read_ranges({"breathing": 0.02}, {})


def test_breath_and_pulse_add_up() -> None:
    drawn = {name: np.zeros(2) for name in ("breathing", "breathing_phase", "pulse", "pulse_phase")}
    drawn["breathing"][:], drawn["pulse"][1] = 0.004, 0.0005
    sway = Sway(drawn, moving=True)
    quarter = np.full(2, 0.25 / BREATHING_FREQUENCY)
    beat = 0.0005 * np.sin(2.0 * np.pi * PULSE_FREQUENCY * quarter[0])
    assert sway.heights(quarter) == pytest.approx([0.004, 0.004 + beat])
    speeds = sway.velocities(np.zeros(2), 1e-5)
    assert speeds[0] == pytest.approx(0.004 * 2.0 * np.pi * BREATHING_FREQUENCY, rel=1e-3)
