from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector as vector_wrappers
from vector_helpers import (
    ABOVE_GOAL,
    COUNT,
    ENGINES,
    GOAL,
    LentWorlds,
    assert_alike,
    lending,
    pressing_actions,
    single_envs,
)

from spatula_env.envs import PressEnv, PressVectorEnv, SpatulaVectorEnv

MODES = [mode.name.lower() for mode in AutoresetMode]
TOLERANCE = {"bullet": 0.0, "batch": 1e-5}
"""Of differences between environments for one agent and for many: Bullet's are computed by the same steps."""

STILL = np.zeros((COUNT, 3), dtype=np.float32)
DOWN = np.tile(np.float32([0.0, 0.0, -1.0]), (COUNT, 1))


@pytest.fixture(scope="module", autouse=True)
def _lending() -> Iterator[None]:
    with lending():
        yield


@pytest.fixture(scope="module", params=ENGINES)
def singles(request: pytest.FixtureRequest) -> Iterator[tuple[str, list[gym.Env[Any, Any]]]]:
    made = single_envs(request.param, steps=6)
    yield request.param, made
    for env in made:
        env.close()


@pytest.fixture(params=ENGINES)
def env(request: pytest.FixtureRequest) -> Iterator[PressVectorEnv]:
    made = PressVectorEnv(COUNT, engine=request.param, max_episode_steps=6)
    yield made
    made.close()


def make(**options: Any) -> PressVectorEnv:
    return PressVectorEnv(COUNT, **{"engine": "batch", **options})


def run(env: Any, actions: np.ndarray) -> list[Any]:
    return [env.step(action) for action in actions]


# ----------------------------------------------------------------------------------------- as Gymnasium has it


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_all_is_as_with_environments_one_by_one(singles: tuple[str, list[gym.Env[Any, Any]]], mode: str) -> None:
    engine, envs = singles
    tolerance = TOLERANCE[engine]
    theirs: Any = SyncVectorEnv([lambda env=one: env for one in envs], autoreset_mode=AutoresetMode[mode.upper()])
    mine: Any = make(engine=engine, max_episode_steps=6, autoreset_mode=mode)
    options = {"tool_position": (0.0, 0.0, -0.016)}
    assert_alike(mine.reset(seed=20, options=options), theirs.reset(seed=20, options=options), tolerance)
    mask = np.array([False, True, False])
    ends, force = np.zeros(COUNT, dtype=int), 0.0
    for k, action in enumerate(pressing_actions(17)):
        if k == 2:
            # From here on, worlds end at different times.
            begun = mine.reset(seed=[4, None, 5], options={"reset_mask": mask})
            assert_alike(begun, theirs.reset(seed=[4, None, 5], options={"reset_mask": mask}), tolerance)
        result = mine.step(action)
        assert_alike(result, theirs.step(action), tolerance, f"step {k}")
        ends += result[3]
        force = max(force, float(result[4]["force"].max()))
    assert ends.tolist() == [2, 2, 2]
    assert force > 0.3
    assert mine.np_random_seed == theirs.np_random_seed
    mine.close()


@pytest.mark.parametrize("options", [{"reward": "sparse"}, {"obs_mode": "dict", "reward": "sparse"}])
@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_observations_in_parts_are_batched_like_others(options: dict[str, str], mode: str) -> None:
    envs = single_envs("batch", steps=2, **options)
    theirs: Any = SyncVectorEnv([lambda env=one: env for one in envs], autoreset_mode=AutoresetMode[mode.upper()])
    mine: Any = make(max_episode_steps=2, autoreset_mode=mode, **options)
    assert mine.observation_space == theirs.observation_space
    assert_alike(mine.reset(seed=1), theirs.reset(seed=1), 1e-5)
    for k, action in enumerate(pressing_actions(4)):
        assert_alike(mine.step(action), theirs.step(action), 1e-5, f"step {k}")
    theirs.close()


def test_make_vec_makes_it_with_the_time_limit() -> None:
    env = gym.make_vec("Spatula/Press-v0", num_envs=COUNT, control_frequency=240.0, episode_time=0.05)
    assert isinstance(env, PressVectorEnv)
    assert env.spec is not None
    env.reset(seed=0)
    cut = [env.step(STILL)[3].tolist() for _ in range(14)]
    assert cut == [[False] * COUNT] * 11 + [[True] * COUNT] + [[False] * COUNT] * 2
    env.close()


def test_without_a_time_limit_episodes_go_on() -> None:
    env = gym.make_vec("Spatula/Press-v0", num_envs=COUNT, episode_time=0.05, max_episode_steps=-1)
    env.reset(seed=0)
    assert not any(env.step(STILL)[3].any() for _ in range(3))


def test_gymnasiums_own_vector_environment_takes_it_too() -> None:
    env = gym.make_vec("Spatula/Press-v0", num_envs=1, vectorization_mode="sync", engine="batch")
    assert isinstance(env, SyncVectorEnv)
    assert env.reset(seed=0)[0].shape == (1, 71)
    env.close()


def test_spaces_and_metadata(env: PressVectorEnv) -> None:
    assert env.num_envs == COUNT
    assert env.single_action_space == spaces.Box(-1.0, 1.0, (3,), np.float32)
    assert env.action_space == spaces.Box(-1.0, 1.0, (COUNT, 3), np.float32)
    assert isinstance(env.single_observation_space, spaces.Box)
    assert env.single_observation_space.shape == (71,)
    assert isinstance(env.observation_space, spaces.Box)
    assert env.observation_space.shape == (COUNT, 71)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert env.metadata["render_fps"] == 20
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)


@pytest.mark.parametrize("value", ["same_step", "SameStep", AutoresetMode.SAME_STEP])
def test_the_autoreset_mode_can_be_told_in_gymnasiums_words(value: Any) -> None:
    assert make(autoreset_mode=value).metadata["autoreset_mode"] is AutoresetMode.SAME_STEP


def test_it_takes_the_arguments_of_the_environment_for_one() -> None:
    one = dict(inspect.signature(PressEnv).parameters)
    many = dict(inspect.signature(PressVectorEnv).parameters)
    assert set(many) - set(one) == {"num_envs", "max_episode_steps", "autoreset_mode"}
    for name, parameter in one.items():
        assert many[name].default == ("batch" if name == "engine" else parameter.default)
    documented = re.findall(
        r"^ *\| `(\w+)` +\| \*\*.*?\*\* +\| `(.*?)` ", SpatulaVectorEnv.__doc__ or "", flags=re.MULTILINE
    )
    extra = ("num_envs", "max_episode_steps", "autoreset_mode", "engine")
    assert documented == [(name, repr(many[name].default).replace("'", '"')) for name in extra]


def test_gymnasiums_wrappers_work() -> None:
    made: Any = make(max_episode_steps=4)
    for wrapper in (
        vector_wrappers.RecordEpisodeStatistics,
        vector_wrappers.NormalizeObservation,
        lambda env: vector_wrappers.RescaleAction(env, np.full(3, -2.0, np.float32), np.full(3, 2.0, np.float32)),
        vector_wrappers.DictInfoToList,
    ):
        made = wrapper(made)
    observation, infos = made.reset(seed=0)
    assert observation.shape == (COUNT, 71)
    assert [info["is_success"] for info in infos] == [False] * COUNT
    rewards = np.zeros(COUNT)
    for _ in range(4):
        _, reward, _, truncated, infos = made.step(2.0 * DOWN)
        rewards += reward
    assert truncated.all()
    assert [info["episode"]["l"] for info in infos] == [4] * COUNT
    assert [info["episode"]["r"] for info in infos] == pytest.approx(rewards.tolist(), rel=1e-5)
    velocity = made.unwrapped.observation_builder.slices["tool_velocity"]
    assert made.unwrapped.step(STILL)[0][:, velocity].tolist() == [[0.0] * 3] * COUNT


# ----------------------------------------------------------------------------------------- when episodes end


@pytest.mark.parametrize("engine", ENGINES)
def test_disabled_episodes_begin_when_told(engine: str) -> None:
    made = make(engine=engine, autoreset_mode="disabled", max_episode_steps=2)
    made.reset(seed=0)
    made.step(DOWN)
    made.reset(options={"reset_mask": np.array([True, False, False])})
    observation, _, _, truncated, _ = made.step(DOWN)
    assert truncated.tolist() == [False, True, True]
    with pytest.raises(ResetNeeded, match=r"the episodes of worlds \[1, 2\] are over"):
        made.step(DOWN)
    mask = np.array([False, True, False])
    with pytest.raises(ResetNeeded, match=r"the episodes of worlds \[2\] are over"):
        made.reset(options={"reset_mask": mask})
        made.step(DOWN)
    after, infos = made.reset(seed=[None, None, 8], options={"reset_mask": np.array([False, False, True])})
    assert after[0].tolist() == observation[0].tolist()
    assert after[2].tolist() == make().reset(seed=[0, 0, 8])[0][2].tolist()
    assert infos["_time"].tolist() == [False, False, True]
    assert made.step(DOWN)[3].tolist() == [True, False, False]


def test_success_ends_an_episode_where_it_is_reached() -> None:
    options = {"max_episode_steps": 40, "terminate_on_success": True, "task": {"hold_time": 0.1}}
    env = make(**options, autoreset_mode="same_step")
    goals = np.array([GOAL, (0.0, 0.0, 0.018), GOAL])
    positions = np.array([ABOVE_GOAL, (0.02, 0.0, 0.0), ABOVE_GOAL])
    _, infos = env.reset(seed=0, options={"goal": goals, "tool_position": positions})
    assert env.goals.tolist() == goals.tolist()
    for _ in range(40):
        depth = np.where(infos["force"] == 0.0, -0.5, -60.0 * (GOAL[2] - infos["depth"]))
        actions = np.zeros((COUNT, 3))
        actions[[0, 2], 2] = depth[[0, 2]].clip(-1.0, 1.0)
        _, rewards, terminated, truncated, infos = env.step(actions)
        if terminated.any():
            break
    assert terminated.tolist() == [True, False, True]
    assert not truncated.any()
    assert infos["_final_info"].tolist() == [True, False, True]
    assert infos["final_info"]["is_success"].tolist() == [True, False, True]
    assert infos["final_info"]["hold_time"][0] == pytest.approx(0.1)
    assert infos["is_success"].tolist() == [False] * COUNT
    assert infos["hold_time"].tolist() == [0.0] * COUNT
    assert -0.5 < rewards[0] <= 0.0
    assert env.goals[1].tolist() == goals[1].tolist()
    assert env.goals[0].tolist() != goals[0].tolist()


# ----------------------------------------------------------------------------------------- beginnings


def test_seeds_start_random_numbers_anew_where_they_are_given(env: PressVectorEnv) -> None:
    first = env.reset(seed=5)[0]
    assert env.np_random_seed == (5, 6, 7)
    second, third = env.reset()[0], env.reset()[0]
    assert not (second == first).all(axis=1).any()
    again = env.reset(seed=np.array([6, 5, 5]))[0]
    assert (again == first[[1, 0, 0]]).all()
    mixed = env.reset(seed=[None, 5, None])[0]
    assert (mixed[1] == first[0]).all()
    assert (mixed[[0, 2]] == second[[1, 0]]).all()
    assert (env.reset()[0] == np.stack([third[1], second[0], third[0]])).all()


def test_options_choose_goals_and_starts_and_change_nothing_else(env: PressVectorEnv) -> None:
    env.reset(seed=9)
    following = env.reset()[0]
    slices = env.observation_builder.slices
    observation, infos = env.reset(seed=9, options={"goal": GOAL, "tool_position": ABOVE_GOAL})
    assert observation[:, slices["goal"]] == pytest.approx(np.tile(GOAL, (COUNT, 1)))
    assert observation[:, slices["tool_position"]] == pytest.approx(np.tile(ABOVE_GOAL, (COUNT, 1)))
    assert infos["place_error"] == pytest.approx(np.zeros(COUNT), abs=1e-7)
    assert (env.reset()[0] == following).all()
    goals = np.array([GOAL, (0.0, 0.0, 0.01), (0.0, 0.001, 0.012)])
    assert env.reset(options={"goal": goals})[0][:, slices["goal"]] == pytest.approx(goals)
    assert env.goals.tolist() == goals.tolist()
    # Rows of worlds that do not begin are not looked at.
    goals[0], mask = np.nan, np.array([False, True, True])
    env.reset(options={"goal": goals, "reset_mask": mask})
    assert env.goals[0].tolist() == pytest.approx(GOAL)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"options": {"reset_masks": 1}}, "options has no 'reset_masks'; did you mean 'reset_mask'"),
        ({"options": {"goal": (0.0, 0.0)}}, r"options\['goal'\] must be 3 finite numbers, or 3 times 3, got"),
        ({"options": {"goal": [GOAL] * 2}}, r"options\['goal'\] must be 3 finite numbers, or 3 times 3, got"),
        ({"options": {"goal": [GOAL, GOAL, (0.0, 0.0, 0.03)]}}, "goal must have a depth from 0.005 to 0.018 m"),
        ({"options": {"tool_position": (0.0, 0.0, 0.06)}}, r"options\['tool_position'\] must lie in"),
        ({"options": {"reset_mask": np.zeros(3, dtype=bool)}}, r"options\['reset_mask'\] must be 3 booleans of which"),
        ({"options": {"reset_mask": [1, 0, 1]}}, r"options\['reset_mask'\] must be 3 booleans"),
        ({"options": {"reset_mask": [True, False]}}, r"options\['reset_mask'\] must be 3 booleans"),
        ({"seed": [1, 2]}, "seed must be an integer or a sequence of 3, got 2 seeds"),
        ({"seed": "abc"}, "seed must be an integer, a sequence of them, or None, got 'abc'"),
        ({"seed": 0.5}, "seed must be an integer, a sequence of them, or None, got 0.5"),
        ({"seed": [0, -1, 2]}, "seed must not be negative"),
    ],
)
def test_what_reset_is_told_is_checked_before_anything_changes(arguments: dict[str, Any], message: str) -> None:
    env = make()
    env.reset(seed=1)
    expected = env.reset()[0].tolist()
    env.reset(seed=1)
    goals = env.goals.tolist()
    with pytest.raises(ValueError, match=message):
        env.reset(**{"seed": 3, **arguments})
    assert env.goals.tolist() == goals
    assert env.reset()[0].tolist() == expected


def test_the_callers_options_are_left_alone() -> None:
    options = {"reset_mask": np.ones(COUNT, dtype=bool), "goal": GOAL}
    make().reset(seed=0, options=options)
    assert set(options) == {"reset_mask", "goal"}


def test_a_part_of_the_worlds_may_begin_first() -> None:
    env = make()
    with pytest.raises(ResetNeeded, match=r"nothing has begun in worlds \[0, 1, 2\]"):
        env.step(STILL)
    observation, infos = env.reset(seed=0, options={"reset_mask": np.array([False, True, False])})
    assert observation[0].tolist() == [0.0] * 71
    assert infos["_depth"].tolist() == [False, True, False]
    with pytest.raises(ResetNeeded, match=r"call reset\(\) before step\(\): nothing has begun in worlds \[0, 2\]"):
        env.step(STILL)
    rest, _ = env.reset(seed=0, options={"reset_mask": np.array([True, False, True])})
    assert rest.tolist() == make().reset(seed=0)[0].tolist()
    env.step(STILL)


# ----------------------------------------------------------------------------------------- results


@pytest.mark.parametrize("mode", MODES)
def test_results_are_arrays_of_their_own(mode: str) -> None:
    def episode(*, spoil: bool) -> list[Any]:
        env = make(max_episode_steps=3, autoreset_mode=mode)
        results: list[Any] = [env.reset(seed=2)]
        seen = [results[0][0].tolist()]
        for action in pressing_actions(3):
            results.append(env.step(action))
            seen.append([part.tolist() for part in results[-1][:4]])
            if spoil:
                for part in results[-1][:4]:
                    part[:] = 1
                for values in results[-1][4].values():
                    if isinstance(values, np.ndarray):
                        values[:] = 1
        # Two worlds stay as they were last seen.
        seen.append(env.reset(options={"reset_mask": np.array([False, True, False])})[0].tolist())
        return seen

    assert episode(spoil=True) == episode(spoil=False)


def test_infos_have_the_same_keys_and_kinds_at_reset_and_at_every_step(env: PressVectorEnv) -> None:
    def kinds(infos: dict[str, Any]) -> dict[str, Any]:
        return {name: (values.dtype, values.shape) for name, values in infos.items()}

    _, infos = env.reset(seed=0)
    expected = kinds(infos)
    assert {f"_{name}" for name in expected if not name.startswith("_")} == {n for n in expected if n.startswith("_")}
    for *_, infos in run(env, pressing_actions(8)):
        assert kinds(infos) == expected
    with PressEnv(engine="batch") as one:
        assert set(one.reset(seed=0)[1]) == {name for name in expected if not name.startswith("_")}


def test_the_sparse_reward_is_that_of_compute_reward() -> None:
    env = make(reward="sparse", task={"place_tolerance": 0.01, "depth_tolerance": 0.0049})
    goals = np.array([(0.0, 0.0, 0.005), (0.0, 0.0, 0.018), (0.01, 0.0, 0.005)])
    env.reset(seed=0, options={"goal": goals, "tool_position": (0.0, 0.0, -0.0235)})
    seen = set()
    for action in (STILL, 0.3 * DOWN, 0.3 * DOWN):
        observation, rewards, _, _, infos = env.step(action)
        again = env.compute_reward(observation["achieved_goal"], observation["desired_goal"], [{}] * COUNT)
        assert rewards.dtype == np.float64
        assert again.tolist() == rewards.tolist()
        assert (rewards == 0.0).tolist() == infos["within_tolerance"].tolist()
        seen |= set(rewards.tolist())
    assert seen == {-1.0, 0.0}
    assert not hasattr(make(), "compute_reward")


def test_a_bad_action_changes_nothing(env: PressVectorEnv) -> None:
    actions = pressing_actions(4, seed=2)
    env.reset(seed=3)
    expected = run(env, actions)
    env.reset(seed=3)
    for bad, message in (
        (np.zeros(3), r"actions must have shape \(3, 3\), got \(3,\)"),
        (np.zeros((4, 3)), r"actions must have shape \(3, 3\), got \(4, 3\)"),
        ([[0.0] * 3, [0.0] * 3, [0.0, np.nan, 0.0]], r"actions must be finite, got \[0.0, nan, 0.0\] for world 2"),
        ([[0.0] * 3, [np.inf, 0.0, 0.0], [0.0] * 3], r"actions must be finite, got \[inf, 0.0, 0.0\] for world 1"),
        ("left", r"actions must be 3 times 3 numbers in \[-1, 1\], got 'left'"),
    ):
        with pytest.raises(ValueError, match=message):
            env.step(bad)
    assert_alike(run(env, actions), expected, 0.0)


def test_actions_that_do_not_count_are_not_looked_at() -> None:
    env = make(max_episode_steps=1)
    env.reset(seed=0)
    assert env.step(DOWN)[3].all()
    _, rewards, _, truncated, infos = env.step(np.full((COUNT, 3), np.nan))
    assert rewards.tolist() == [0.0] * COUNT
    assert not truncated.any()
    assert infos["time"].tolist() == [0.0] * COUNT


def test_actions_beyond_the_bounds_act_like_the_bounds(env: PressVectorEnv) -> None:
    env.reset(seed=3)
    beyond = env.step(np.tile([5.0, -7.0, 1.5], (COUNT, 1)))[0].tolist()
    env.reset(seed=3)
    assert env.step(np.tile([1.0, -1.0, 1.0], (COUNT, 1)))[0].tolist() == beyond


# ----------------------------------------------------------------------------------------- physics that breaks down


@pytest.mark.parametrize("mode", MODES)
def test_a_world_that_breaks_down_leaves_the_others_alone(mode: str) -> None:
    actions = pressing_actions(5)
    env = make(autoreset_mode=mode)
    env.reset(seed=3)
    expected = run(env, actions)
    begun = env.reset()[0][1]
    env.reset(seed=3)
    before = run(env, actions[:2])[-1]
    env.worlds.breaking = 1
    with pytest.warns(RuntimeWarning, match=r"physics has diverged in worlds \[1\]: their episodes are cut"):
        observation, rewards, terminated, truncated, infos = env.step(actions[2])
    assert truncated.tolist() == [False, True, False]
    assert not terminated.any()
    assert rewards[1] == 0.0
    others = [0, 2]
    assert observation[others].tolist() == expected[2][0][others].tolist()
    assert rewards[others].tolist() == expected[2][1][others].tolist()
    last_info = infos["final_info"] if mode == "same_step" else infos
    last_seen = infos["final_obs"][1] if mode == "same_step" else observation[1]
    assert last_seen.tolist() == before[0][1].tolist()
    assert last_info["diverged"].tolist() == [False, True, False]
    assert last_info["time"][1] == before[4]["time"][1]
    # The next episode is that which a reset would have brought.
    if mode == "same_step":
        assert observation[1].tolist() == begun.tolist()
        assert not infos["diverged"].any()
    elif mode == "next_step":
        observation, rewards, _, truncated, infos = env.step(actions[3])
        assert observation[1].tolist() == begun.tolist()
        assert observation[others].tolist() == expected[3][0][others].tolist()
        assert rewards[1] == 0.0
        assert not truncated.any()
        assert not infos["diverged"].any()
    else:
        with pytest.raises(ResetNeeded, match=r"the episodes of worlds \[1\] are over"):
            env.step(actions[3])
        assert env.reset(options={"reset_mask": np.arange(COUNT) == 1})[0][1].tolist() == begun.tolist()
    assert np.isfinite(env.step(actions[4])[0]).all()


def test_a_breakdown_of_all_worlds_is_survived() -> None:
    env = PressVectorEnv(
        1, engine="batch", reward="sparse", obs_mode="dict", render_mode="rgb_array", width=48, height=48
    )
    first, _ = env.reset(seed=0)
    env.worlds.breaking = 0
    with pytest.warns(RuntimeWarning, match="physics has diverged"):
        observation, rewards, _, truncated, infos = env.step(DOWN[:1])
    assert_alike(observation, first, 0.0)
    assert rewards.tolist() == [0.0]
    assert truncated.all()
    assert infos["diverged"].all()
    pictures = env.render()
    assert pictures is not None
    assert pictures[0].shape == (48, 48, 3)
    assert not env.step(DOWN[:1])[4]["diverged"].any()


@pytest.mark.bullet
def test_a_simulation_that_diverges_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    def break_down(*_: object) -> None:
        raise FloatingPointError("positions are not finite")

    env = make(engine="bullet")
    env.reset(seed=0)
    with monkeypatch.context() as patch:
        patch.setattr(env.worlds.engine.loaded[2], "step", break_down)
        with pytest.warns(RuntimeWarning, match=r"worlds \[2\]"):
            assert env.step(DOWN)[3].tolist() == [False, False, True]
    env.step(DOWN)
    assert not env.step(DOWN)[3].any()


# ----------------------------------------------------------------------------------------- pictures, and the end


def test_there_is_a_picture_of_each_world(env: PressVectorEnv) -> None:
    made: SpatulaVectorEnv = make(render_mode="rgb_array", width=64, height=48)
    made.reset(seed=0)
    pictures = made.render()
    assert pictures is not None
    assert [picture.shape for picture in pictures] == [(48, 64, 3)] * COUNT
    with PressEnv(engine="batch", render_mode="rgb_array", width=64, height=48) as one:
        for k, picture in enumerate(pictures):
            one.reset(seed=k)
            single = one.render()
            assert single is not None
            assert (np.abs(single.astype(int) - picture).max(axis=-1) > 8).mean() < 0.01
    assert (pictures[0] != pictures[1]).any()
    # The force of an episode is gone from the next one's picture.
    made.reset(options={"tool_position": (0.0, 0.0, -0.0237)})
    assert run(made, [DOWN, DOWN])[-1][4]["force"].min() > 0.3
    made.reset(seed=0)
    assert_alike(made.render(), pictures, 0.0)
    env.reset(seed=0)
    assert env.render() is None


def test_the_life_of_an_environment_is_watched() -> None:
    env = make(render_mode="rgb_array")
    with pytest.raises(ResetNeeded, match=r"call reset\(\) before render\(\)"):
        env.render()
    env.reset(seed=0)
    env.close()
    env.close()
    for call in (env.reset, lambda: env.step(STILL), env.render):
        with pytest.raises(ClosedEnvironmentError, match="closed; make a new one"):
            call()


def test_worlds_are_closed_where_the_construction_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    closed: list[LentWorlds] = []
    monkeypatch.setattr(LentWorlds, "close", lambda worlds: closed.append(worlds))
    with pytest.raises(ValueError, match="depth_range must end at"):
        make(task={"depth_range": (0.005, 0.05)})
    assert len(closed) == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_envs": 0}, "num_envs must be an integer of at least 1, got 0"),
        ({"max_episode_steps": 0}, "max_episode_steps must be an integer of at least 1, got 0"),
        ({"max_episode_steps": 2.5}, "max_episode_steps must be an integer of at least 1, got 2.5"),
        ({"autoreset_mode": "later"}, r"autoreset_mode must be one of \['next_step', 'same_step', 'disabled'\] or an"),
        ({"engine": "magic"}, r"engine must be one of \['bullet', 'batch', 'tissue', 'mujoco'\], got 'magic'"),
        ({"contact": "magic"}, "contact must be one of .* got 'magic'"),
        ({"render_mode": "human"}, r"render_mode must be one of \[None, 'rgb_array'\], got 'human'"),
        ({"control": "force"}, r"control must be one of \['velocity', 'velocity_6d'\], got 'force'"),
        ({"reward": "shaped"}, r"reward must be one of \['dense', 'sparse'\], got 'shaped'"),
        ({"obs_mode": "smell"}, r"obs_mode must be one of \['state', 'dict', 'rgb', 'rgbd', 'pointcloud'\], got"),
        ({"control_frequency": 50.0}, "control_frequency must go a whole number of times into"),
        ({"task": {"colour": 1}}, "task has no colour"),
    ],
)
def test_options_that_do_not_exist_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PressVectorEnv(**{"num_envs": COUNT, "engine": "batch", **options})
