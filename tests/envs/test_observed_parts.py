"""The choice of parts of observations, and their bounds."""

from __future__ import annotations

import inspect
import re
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

import spatula_env
from spatula_env.envs.observations import ROBOT_PARTS, first_of, lerobot_keys
from spatula_env.envs.observed_ranges import ObservedRanges
from spatula_env.learning.demonstrations import collect
from spatula_env.learning.evaluation import Plan, run_episodes
from spatula_env.learning.experts import PressExpert
from spatula_env.learning.policies import RandomPolicy, make_expert
from spatula_env.policies import PartSelection

PRESS = "Spatula/Press-v0"
IDS = tuple(f"Spatula/{name}-v0" for name in spatula_env.TASKS)
KNOWN = {
    "tool_position",
    "tool_velocity",
    "tool_orientation",
    "tool_rotation_rate",
    "jaw_opening",
    "jaw_speed",
    "contact_force",
    "contact_torque",
    "normal_force",
    "goal",
}
"""Parts, over all tasks, that a robot knows from its own sensors or is told."""


def make(env_id: str = PRESS, **options: Any) -> Any:
    return gym.make_vec(env_id, num_envs=2, engine="batch", autoreset_mode="disabled", **options).unwrapped


def seen(env: Any) -> Any:
    """Observations with contact, from always the same seeds and actions."""
    env.reset(seed=3)
    down = np.tile(np.array([0.0, 0.0, -1.0], dtype=np.float32), (2, 1))
    for _ in range(9):
        observation = env.step(down)[0]
    return observation


@pytest.mark.parametrize("env_id", IDS)
def test_sensors_know_nothing_of_the_organ(env_id: str) -> None:
    everything, sensors = make(env_id), make(env_id, observation={"parts": "sensors"})
    try:
        chosen = [part.name for part in sensors.observation_builder.parts]
        assert chosen == [part.name for part in everything.observation_builder.parts if part.name in KNOWN]
        assert sensors.single_observation_space.shape == (sum(p.size for p in sensors.observation_builder.parts),)
        doc = inspect.cleandoc(gym.envs.registration.load_env_creator(gym.spec(env_id).entry_point).__doc__ or "")  # type: ignore[arg-type]
        told = re.search(r"^Sensors know (.+?); all else is privileged", doc, flags=re.MULTILINE | re.DOTALL)
        assert told is not None
        assert re.findall(r"`(\w+)`", told[1]) == chosen
    finally:
        everything.close()
        sensors.close()


def test_sensors_and_privileged_hold_what_the_whole_does() -> None:
    found = {}
    for parts in ("all", "sensors", "grouped"):
        env = make(observation={"parts": parts})
        found[parts] = seen(env), env.observation_builder, env.observation_space
        env.close()
    whole, builder, _ = found["all"]
    sensors, of_sensors, _ = found["sensors"]
    grouped, of_groups, space = found["grouped"]
    assert isinstance(space, spaces.Dict)
    assert space.contains(grouped)
    assert set(grouped) == {"sensors", "privileged"}
    assert grouped["sensors"].tolist() == sensors.tolist()
    assert grouped["sensors"].shape[1] + grouped["privileged"].shape[1] == whole.shape[1]
    assert {part.name for part in of_groups.parts} == set(builder.slices) == set(of_groups.slices)
    assert (whole[:, builder.slices["contact_depth"]] > 0.0).all()
    for name, where in builder.slices.items():
        group = "sensors" if name in of_sensors.slices else "privileged"
        assert whole[:, where].tolist() == grouped[group][:, of_groups.slices[name]].tolist(), name
        if group == "sensors":
            assert whole[:, where].tolist() == sensors[:, of_sensors.slices[name]].tolist(), name


def test_one_agent_has_the_same_choice() -> None:
    many = make(observation={"parts": "grouped"})
    one = gym.make(PRESS, engine="batch", observation={"parts": "grouped"})
    try:
        assert one.observation_space == many.single_observation_space
        assert one.observation_space.contains(one.reset(seed=0)[0])
    finally:
        many.close()
        one.close()


def test_goals_stay_entries_of_their_own() -> None:
    for parts, entries in (("sensors", {"observation"}), ("grouped", {"sensors", "privileged"})):
        env = make(reward="sparse", observation={"parts": parts})
        observation, _ = env.reset(seed=0)
        assert set(observation) == {*entries, "achieved_goal", "desired_goal"}
        assert env.observation_space.contains(observation)
        assert "goal" not in env.observation_builder.slices
        env.close()


def test_named_parts_are_those_that_are_chosen() -> None:
    env = make(obs_mode="dict", observation={"parts": "sensors"})
    assert set(env.single_observation_space.spaces) <= KNOWN
    assert "landmarks" not in env.single_observation_space.spaces
    env.close()


@pytest.mark.parametrize("parts", ["sensors", "grouped"])
def test_pictures_stand_beside_what_sensors_know(parts: str) -> None:
    options: dict[str, Any] = {"obs_mode": "rgb", "engine": "batch"}
    env: Any = gym.make("Spatula/Palpate-v0", observation={"parts": parts, "image_size": (16, 16)}, **options).unwrapped
    try:
        observation, _ = env.reset(seed=0)
        assert env.observation_space.contains(observation)
        slices = env.observation_builder.slices
        if parts == "sensors":
            assert set(observation) == {"image", "state"}
            # What is told of the path as it lies on the organ now is no sensor's.
            assert set(ROBOT_PARTS) - set(slices) >= {"path_ahead", "progress", "felt"}
            assert observation["state"].shape == (max(each.stop for each in slices.values()),)
        else:
            assert set(observation) == {"image", "sensors", "privileged"}
            assert {"path_ahead", "landmarks"} <= set(slices)
    finally:
        env.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"observation": {"parts": "some"}}, r"parts must be one of \['all', 'sensors', 'grouped'\], got 'some'"),
        ({"observation": {"parts": "grouped"}, "obs_mode": "dict"}, r"observation\.parts must be .* obs_mode='dict'"),
        ({"observation": {"parts": "sensors"}, "obs_mode": "pointcloud"}, r"parts must be 'all' .*no sensor"),
    ],
)  # fmt: skip
def test_what_cannot_be_chosen_is_said(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make(**options)


def test_ranges_are_checked() -> None:
    with pytest.raises(ValueError, match=r"observed\.torque must be"):
        ObservedRanges(torque=0.0)


def test_faces_that_nothing_touches_are_left_out() -> None:
    assert ObservedRanges().touched("velocity", 3).tolist() == [0, 1, 2]
    ranges = ObservedRanges(untouched={"velocity": (1,)}, face_count=3)
    assert ranges.touched("velocity", 3).tolist() == [0, 2]
    assert ranges.touched("velocity_6d", 3).tolist() == [0, 1, 2]
    # It is about other tools.
    assert ranges.touched("velocity", 4).tolist() == [0, 1, 2, 3]
    for faces, count in (((1,), 1), ((0, 1), 2)):
        with pytest.raises(
            ValueError, match=rf"faces 0 to {count - 1}, and not all, got .* for the control 'velocity'"
        ):
            ObservedRanges(untouched={"velocity": faces}, face_count=count)
    sizes = {}
    for control in ("velocity", "velocity_6d"):
        env = make(control=control)
        part = env.observation_builder.slices["contact_share"]
        sizes[control] = part.stop - part.start
        env.close()
    assert sizes == {"velocity": 1, "velocity_6d": 2}


def test_noise_and_history_keep_to_the_groups() -> None:
    env = make(observation={"parts": "grouped", "history": 3, "noise": 1.0})
    observation = seen(env)
    slices = env.observation_builder.slices
    assert observation["sensors"].shape[:2] == observation["privileged"].shape[:2] == (2, 3)
    assert env.observation_space.contains(observation)
    goals = observation["sensors"][..., slices["goal"]]
    assert goals[:, -1].tolist() == env.goals.astype(np.float32).tolist()
    assert (np.ptp(observation["privileged"][..., slices["landmarks"]], axis=1) > 0.0).all()
    env.close()


def test_experts_say_what_they_need_and_demonstrate_all_the_same() -> None:
    env = make(observation={"parts": "sensors"})
    with pytest.raises(ValueError, match=r"must have observation\.parts 'all', got 'sensors'"):
        PressExpert(env)
    env.close()
    (shown,) = collect(Plan(PRESS, {"observation": {"parts": "sensors"}}, "batch", 1, 0), num_envs=1, steps=3)
    (whole,) = collect(Plan(PRESS, {}, "batch", 1, 0), num_envs=1, steps=3)
    assert shown.actions.tolist() == whole.actions.tolist()
    assert shown.observations.shape[1] < whole.observations.shape[1]


def test_evaluation_finds_the_tool_in_any_choice() -> None:
    lengths = []
    for parts in ("all", "sensors", "grouped"):
        env = make(observation={"parts": parts}, max_episode_steps=5)
        lengths.append(run_episodes(env, RandomPolicy(env.single_action_space), [4, 5])["path_length"].tolist())
        env.close()
    assert lengths[0] == lengths[1] == lengths[2]
    assert min(lengths[0]) > 0.0


def test_parts_can_be_picked_out_of_sensors_and_not_of_groups() -> None:
    env = make(observation={"parts": "sensors"})
    selection = PartSelection.of(env, ["goal", "contact_force"])
    assert selection is not None
    assert selection.parts == ("contact_force", "goal")
    with pytest.raises(ValueError, match=r"observations have no parts \['error'\]"):
        PartSelection.of(env, ["error"])
    env.close()
    env = make(observation={"parts": "grouped"})
    with pytest.raises(ValueError, match=r"'all' or 'sensors' only.*'grouped'"):
        PartSelection.of(env, ["goal"])
    env.close()


def test_other_libraries_have_names_for_the_groups() -> None:
    env = make(observation={"parts": "grouped"})
    assert lerobot_keys(env.single_observation_space) == {
        "privileged": "observation.environment_state",
        "sensors": "observation.state",
    }
    env.close()


@pytest.mark.parametrize("env_id", IDS)
def test_forces_and_pressures_in_haste_stay_within_their_bounds(env_id: str) -> None:
    """They stay within their bounds, and use a good part of them."""
    env = make(env_id)
    act, slices = make_expert(env), env.observation_builder.slices
    observation, _ = env.reset(seed=11)
    highest = np.abs(observation)
    for _ in range(60):
        observation = env.step(np.clip(4.0 * act(observation), -1.0, 1.0))[0]
        highest = np.maximum(highest, np.abs(observation))
    space = env.single_observation_space
    for name in ("contact_force", "contact_torque", "contact_depth", "contact_pressure", "landmarks"):
        used = (highest / space.high).max(axis=0)[slices[name]].max()
        # A grip in the ridge's middle turns the jaws by next to nothing.
        least = 0.01 if (env_id, name) == ("Spatula/Clamp-v0", "contact_torque") else 0.05
        assert least < used < 1.0, (name, used)
    env.close()
    assert first_of(observation).shape == space.shape
