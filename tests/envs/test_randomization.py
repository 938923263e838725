from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from spatula_env.envs import ClampEnv, PressEnv, PressVectorEnv
from spatula_env.envs.randomization import DEFAULT_RANGES, draw, read_ranges

GOAL = (0.0, 0.0, 0.01)
ABOVE = np.array([0.004, 0.0, -0.02])
DOWN = np.array([0.1, 0.05, -0.4])


def press(actions: Any = DOWN, start: Any = ABOVE, steps: int = 8, **options: Any) -> list[dict[str, Any]]:
    """Parts of the observations and infos of a press with fixed parameters."""
    with PressEnv(**{"engine": "batch", "obs_mode": "dict", **options}) as env:
        env.reset(seed=0, options={"goal": GOAL, "tool_position": start})
        shown = []
        for action in np.broadcast_to(actions, (steps, 3)):
            observation, *_, info = env.step(action)
            shown.append({**observation, **info})
    assert shown[-1]["force"] > 0.05
    return shown


def test_a_stiffer_organ_pushes_back_harder_and_moves_alike() -> None:
    soft, stiff = (press(randomization={"stiffness": factor})[-1] for factor in (1.0, 2.0))
    assert stiff["landmarks"] == pytest.approx(soft["landmarks"], abs=1e-7)
    for name in ("force", "peak_force", "peak_pressure", "mean_pressure", "work"):
        assert stiff[name] == pytest.approx(2.0 * soft[name], rel=1e-6), name
    assert stiff["contact_force"] == pytest.approx(2.0 * soft["contact_force"], rel=1e-5)


def test_an_organ_elsewhere_is_the_same_organ() -> None:
    shift = np.array([0.004, -0.003, 0.0])
    here = press()[-1]
    there = press(start=ABOVE + shift, randomization={"organ_x": 0.004, "organ_y": -0.003})[-1]
    assert there["contact_force"] == pytest.approx(here["contact_force"], rel=1e-4, abs=1e-5)
    moved = (there["landmarks"] - here["landmarks"]).reshape(-1, 3)
    # Landmarks tell where the organ is.
    assert moved == pytest.approx(np.tile(shift, (16, 1)), abs=1e-5)
    assert there["tool_position"] - here["tool_position"] == pytest.approx(shift, abs=1e-6)


def test_a_turned_organ_is_felt_from_the_other_side() -> None:
    # The spatula is square: after a quarter of a turn it lies on the organ as before.
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    straight = press()[-1]
    turned = press(actions=quarter @ DOWN, start=quarter @ ABOVE, randomization={"organ_yaw": 0.5 * np.pi})[-1]
    for name in ("contact_force", "contact_torque", "tool_velocity", "tool_position"):
        assert turned[name] == pytest.approx(quarter @ straight[name], rel=0.02, abs=2e-4), name
    assert turned["depth"] == pytest.approx(straight["depth"], abs=1e-4)


def test_a_larger_organ_and_tool_are_alike_in_all_lengths() -> None:
    factor = 1.1
    small = press(control_frequency=20.0)[-1]
    # The organ grows about the middle of its top, 25 mm below the workspace's middle.
    top = np.array([0.0, 0.0, -0.025])
    large = press(
        start=top + factor * (ABOVE - top),
        max_speed=0.1 * factor,
        randomization={"organ_size": factor, "tool_size": factor},
    )[-1]
    assert large["tool_position"] - top == pytest.approx(factor * (small["tool_position"] - top), abs=1e-6)
    # Of the same material: pressures are the same, and forces grow as areas do.
    assert large["peak_pressure"] == pytest.approx(small["peak_pressure"], rel=1e-3)
    assert large["contact_force"] == pytest.approx(factor**2 * small["contact_force"], rel=1e-3, abs=1e-5)
    assert large["contact_torque"] == pytest.approx(factor**3 * small["contact_torque"], rel=1e-3, abs=1e-7)
    assert large["depth"] == pytest.approx(factor * small["depth"], rel=1e-3)


def test_a_larger_tool_touches_first() -> None:
    thin, thick = (press(randomization={"tool_size": factor})[-1] for factor in (0.8, 1.6))
    assert thick["force"] > thin["force"]


def test_friction_is_what_drags() -> None:
    down, aside = np.array([0.0, 0.0, -0.5]), np.array([0.5, 0.0, 0.0])
    actions = np.array([down] * 7 + [aside])
    smooth, rough = (press(actions, ABOVE, 8, randomization={"friction": factor}) for factor in (0.0, 3.0))
    assert rough[-1]["contact_force"][0] < smooth[-1]["contact_force"][0] - 0.02


@pytest.mark.parametrize("engine", ["batch", "bullet"])
def test_both_engines_can_do_all_of_it(engine: str) -> None:
    ranges = {
        "stiffness": 1.3,
        "friction": 1.5,
        "organ_size": 1.05,
        "organ_x": 0.002,
        "organ_yaw": 0.3,
        "tool_size": 0.9,
    }
    reference = press(engine="batch", randomization=ranges)[-1]
    shown = press(engine=engine, randomization=ranges)[-1]
    assert shown["force"] == pytest.approx(reference["force"], rel=0.03)
    assert shown["landmarks"] == pytest.approx(reference["landmarks"], abs=5e-4)


def test_late_actions_are_carried_out_later() -> None:
    with PressEnv(engine="batch", obs_mode="dict", randomization={"action_delay": 0.1}) as env:
        start = env.reset(seed=0)[0]["tool_position"]
        places = [env.step(np.array([0.0, 0.0, 0.5]))[0]["tool_position"] - start for _ in range(4)]
    assert np.array(places)[:, 2] == pytest.approx([0.0, 0.0, 0.0025, 0.005], abs=1e-7)


@pytest.mark.parametrize("frequency", [20.0, 60.0])
def test_delays_last_as_long_at_any_frequency(frequency: float) -> None:
    def way(**options: Any) -> np.ndarray:
        with PressEnv(engine="batch", obs_mode="dict", control_frequency=frequency, **options) as env:
            start = env.reset(seed=0)[0]["tool_position"]
            steps = round(0.4 * frequency)
            places = [env.step(np.array([0.0, 0.0, 0.2]))[0]["tool_position"] - start for _ in range(steps)]
        return np.array(places)[:, 2]

    late = round(0.1 * frequency)
    for options in ({"observation": {"delay": 0.1}}, {"randomization": {"action_delay": 0.1}}):
        delayed = way(**options)
        assert (delayed[:late] == 0.0).all()
        assert delayed[late:] == pytest.approx(way()[:-late], abs=1e-6)


def test_noise_is_drawn_anew_in_every_step_and_spares_goals() -> None:
    with PressEnv(engine="batch", obs_mode="dict", randomization={"sensor_noise": 1.0}) as env:
        env.reset(seed=0)
        seen = [env.step(np.zeros(3))[0] for _ in range(30)]
    places = np.array([each["tool_position"] for each in seen])
    assert 0.4e-4 < places.std(axis=0).mean() < 2e-4
    assert (np.ptp([each["goal"] for each in seen], axis=0) == 0.0).all()


def test_what_is_drawn_is_told_and_varies() -> None:
    with PressEnv(engine="batch", randomization="default") as env:
        drawn = [env.reset(seed=seed)[1] for seed in range(12)]
        later = env.step(np.zeros(3))[-1]
    for name, (low, high) in DEFAULT_RANGES.items():
        values = [info[f"randomization/{name}"] for info in drawn]
        assert low <= min(values) < max(values) <= high, name
        assert later[f"randomization/{name}"] == values[-1]


def test_each_world_is_drawn_by_itself() -> None:
    many = PressVectorEnv(3, randomization="default")
    _, infos = many.reset(seed=5)
    with PressEnv(engine="batch", randomization="default") as one:
        for world in range(3):
            info = one.reset(seed=5 + world)[1]
            for name in DEFAULT_RANGES:
                assert infos[f"randomization/{name}"][world] == info[f"randomization/{name}"]
    before = infos["randomization/stiffness"]
    _, infos = many.reset(options={"reset_mask": np.array([False, True, False])})
    assert infos["randomization/stiffness"][1] not in (0.0, before[1])
    many.close()


def test_goals_and_starts_are_those_without_it() -> None:
    with PressEnv(engine="batch") as plain, PressEnv(engine="batch", randomization={"stiffness": (0.5, 2.0)}) as other:
        for seed in range(3):
            assert plain.reset(seed=seed)[0].tolist() == other.reset(seed=seed)[0].tolist()
            plain.step(np.zeros(3))
        assert plain.reset()[0].tolist() == other.reset()[0].tolist()


def test_nothing_is_left_of_the_last_episode() -> None:
    with PressEnv(engine="batch", randomization="default", obs_mode="dict") as env:
        first = env.reset(seed=3)
        env.reset(seed=4)
        again = env.reset(seed=3)
    for name, values in first[0].items():
        assert values.tolist() == again[0][name].tolist()
    assert first[1] == again[1]


def test_jaws_of_another_size_leave_another_opening() -> None:
    openings = []
    for size in (0.9, 1.1):
        with ClampEnv(engine="batch", obs_mode="dict", randomization={"tool_size": size}) as env:
            env.reset(seed=0)
            start = env.step(np.zeros(4))[0]["jaw_opening"][0]
            after = env.step(np.array([0.0, 0.0, 0.0, -0.5]))[0]["jaw_opening"][0]
            openings.append(start)
            # 25 mm/s for 50 ms.
            assert after - start == pytest.approx(-0.00125, abs=1e-6)
    assert min(openings) > 0.0


def test_ranges_are_read() -> None:
    assert read_ranges("none", DEFAULT_RANGES) == {}
    assert read_ranges("default", DEFAULT_RANGES) == dict(DEFAULT_RANGES)
    assert read_ranges({"stiffness": [0.5, 2], "friction": 1}, DEFAULT_RANGES) == {
        "stiffness": (0.5, 2.0),
        "friction": (1.0, 1.0),
    }


def test_draws_fill_their_ranges() -> None:
    generator = np.random.default_rng(0)
    drawn = [draw({"stiffness": (0.5, 2.0), "action_delay": (0.05, 0.15)}, generator, 0.05) for _ in range(300)]
    assert np.mean([each["stiffness"] for each in drawn]) == pytest.approx(1.25, abs=0.08)
    assert {round(each["action_delay"], 9) for each in drawn} == {0.05, 0.1, 0.15}
    # The same time, in more steps.
    finer = {round(draw({"action_delay": (0.05, 0.1)}, generator, 0.0125)["action_delay"], 9) for _ in range(300)}
    assert finer == {0.05, 0.0625, 0.075, 0.0875, 0.1}
    assert {each["friction"] for each in drawn} == {1.0}
