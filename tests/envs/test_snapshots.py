"""A restored state, or a copy of an environment, continues exactly as the original did, bit for bit."""

from __future__ import annotations

import copy
import json
import pickle
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from hypothesis import given, settings
from hypothesis import strategies as st
from vector_helpers import assert_alike

import spatula_env
from spatula_env.envs import PressEnv, PressVectorEnv, SpatulaVectorEnv
from spatula_env.envs.snapshots import EnvState

EVERYTHING: dict[str, Any] = {"randomization": "default", "observation": {"noise": 1.0, "delay": 0.1, "history": 3}}
"""All that an environment can remember."""

COUNT = 3


@pytest.fixture(scope="module")
def three() -> EnvState:
    made = PressVectorEnv(3)
    made.reset(seed=4)
    return made.save()


def actions_of(env: Any, count: int, seed: int = 0) -> np.ndarray:
    """At random, but downwards."""
    actions = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, *env.action_space.shape))
    actions[..., 2] -= 0.5
    return actions.clip(-1.0, 1.0).astype(np.float32)


def go_on(env: Any, actions: np.ndarray) -> list[Any]:
    """Results of further steps, and of the episode after them."""
    return [*(env.step(action) for action in actions), env.reset()]


def episode_of(env: Any, actions: np.ndarray, seed: int = 1) -> list[Any]:
    return [env.reset(seed=seed), *(env.step(action) for action in actions)]


# ----------------------------------------------------------------------------------------- one agent


@pytest.mark.parametrize("task", spatula_env.TASKS)
@pytest.mark.parametrize("engine", ["batch", "bullet"])
def test_ten_steps_are_the_same_ten_steps_again(task: str, engine: str) -> None:
    with gym.make(f"Spatula/{task}-v0", engine=engine, **EVERYTHING) as env:
        actions = actions_of(env, 18)
        episode_of(env, actions[:8])
        made: Any = env.unwrapped
        state = made.save()
        first = go_on(env, actions[8:])
        observation, info = made.restore(pickle.loads(pickle.dumps(state)))
        assert made.observation_space.contains(observation)
        assert set(info) == set(first[0][4])
        assert_alike(go_on(env, actions[8:]), first, 0.0)
        # Neither has changed the state.
        made.restore(state)
        assert_alike([env.step(action) for action in actions[8:11]], first[:3], 0.0)
        assert max(result[4]["peak_force"] for result in first[:-1]) > 0.0


@pytest.mark.parametrize(
    "options",
    [
        {"contact": "second_step", "engine": "bullet"},
        {"contact": "second_step", "engine": "batch"},
        {"obs_mode": "dict", "reward": "sparse", "engine": "batch", "damage_limit": 1000.0},
        {"obs_mode": "pointcloud", "reward": "sparse", "engine": "batch", "control": "velocity_6d"},
        {"obs_mode": "rgbd", "engine": "batch", "observation": {"image_size": (36, 36), "delay": 0.05}},
    ],
)
def test_so_it_is_with_other_options(options: dict[str, Any]) -> None:
    with gym.make("Spatula/Press-v0", **options) as env:
        actions = actions_of(env, 14)
        episode_of(env, actions[:6])
        made: Any = env.unwrapped
        state = made.save()
        first = go_on(env, actions[6:])
        observation, _ = made.restore(state)
        assert made.observation_space.contains(observation)
        assert_alike(go_on(env, actions[6:]), first, 0.0)


@pytest.mark.bullet
def test_bullets_own_contact_is_restored_up_to_rounding() -> None:
    with PressEnv(engine="bullet", contact="bullet") as env:
        actions = actions_of(env, 10)
        episode_of(env, actions[:6])
        state = env.save()
        first = [env.step(action) for action in actions[6:]]
        env.restore(state)
        again = [env.step(action) for action in actions[6:]]
        for one, other in zip(again, first, strict=True):
            assert one[1] == pytest.approx(other[1], rel=1e-6)
            assert one[4] == pytest.approx(other[4], rel=1e-6)


def test_restoring_returns_what_the_step_returned() -> None:
    with PressEnv(engine="batch", **EVERYTHING) as env:
        results = episode_of(env, actions_of(env, 5))
        state = env.save()
        env.reset(seed=99)
        observation, info = env.restore(state)
        assert_alike(observation, results[-1][0], 0.0)
        assert_alike(info, results[-1][4], 0.0)
        assert env.goal.tolist() == state.episodes.counters["goals"][0].tolist()


def test_saving_changes_nothing_in_the_batch_engine() -> None:
    with PressEnv(engine="batch", **EVERYTHING) as env:
        actions = actions_of(env, 8)
        plain = episode_of(env, actions)
        env.reset(seed=1)
        watched = []
        for action in actions:
            env.save()
            watched.append(env.step(action))
        assert_alike(watched, plain[1:], 0.0)


def test_the_time_of_the_episode_is_part_of_the_state() -> None:
    with gym.make("Spatula/Press-v0", engine="batch", episode_time=0.3) as env:
        actions = actions_of(env, 6)
        env.reset(seed=0)
        env.step(actions[0])
        state = env.unwrapped.save()  # type: ignore[attr-defined]
        for _ in range(3):
            assert [env.step(action)[3] for action in actions[1:]] == [False] * 4 + [True]
            env.unwrapped.restore(state)  # type: ignore[attr-defined]


def test_success_and_holding_are_part_of_the_state() -> None:
    with PressEnv(engine="batch", task={"hold_time": 0.15, "place_tolerance": 0.03, "depth_tolerance": 0.0049}) as env:
        env.reset(seed=0, options={"goal": (0.0, 0.0, 0.005), "tool_position": (0.0, 0.0, -0.0235)})
        still = np.zeros(3)
        env.step([0.0, 0.0, -0.3])
        held = env.step(still)[4]["hold_time"]
        state = env.save()
        first = [env.step(still)[4] for _ in range(4)]
        assert first[-1]["is_success"]
        assert first[-1]["hold_time"] > held
        _, info = env.restore(state)
        assert info["hold_time"] == held
        assert not info["is_success"]
        assert_alike([env.step(still)[4] for _ in range(4)], first, 0.0)


@pytest.mark.bullet
def test_what_does_not_fit_is_refused_and_changes_nothing() -> None:
    with PressEnv(engine="batch") as env:
        with pytest.raises(ResetNeeded, match=r"call reset\(\) before save\(\)"):
            env.save()
        actions = actions_of(env, 4)
        env.reset(seed=0)
        state = env.save()
        expected = [env.step(action) for action in actions]
        env.restore(state)
        with pytest.raises(TypeError, match="state must be what save"):
            env.restore({"nodes": 1})  # type: ignore[arg-type]
        for other, message in (
            (PressEnv(engine="batch", max_speed=0.05), "with max_speed=0.1, it is of one with 0.05"),
            (PressEnv(engine="batch", observation={"delay": 0.05}), "with observation=ObservationSettings"),
            (PressEnv(engine="bullet"), "with engine='batch', it is of one with 'bullet'"),
            (gym.make("Spatula/Retract-v0", engine="batch").unwrapped, "of the task 'press', it is of 'retract'"),
        ):
            other.reset(seed=0)
            with pytest.raises(ValueError, match=message):
                env.restore(other.save())  # type: ignore[attr-defined]
            other.close()
        many = PressVectorEnv(2)
        many.reset(seed=0)
        with pytest.raises(ValueError, match="state must be of one world, it is of 2"):
            env.restore(many.save())
        assert_alike([env.step(action) for action in actions], expected, 0.0)
        env.restore(many.save(1))
        assert env.goal.tolist() == many.goals[1].tolist()


WRONG_ROWS: list[Any] = [
    [], [-1], [3], [True, False], [False] * 3, slice(0, 1), "a", None, 0.5, [0.0], [[0]], [[0], [0, 1]], 10**30,
]  # fmt: skip


@pytest.mark.parametrize("rows", WRONG_ROWS, ids=repr)
def test_rows_that_there_are_not_are_refused_in_words(three: EnvState, rows: Any) -> None:
    with pytest.raises(
        ValueError, match=r"^rows must be one or more indices from 0 to 2, or 3 booleans of which one is"
    ):
        three.rows(rows)


@pytest.mark.parametrize(
    ("rows", "meant"),
    [
        ([0, 0, 2], [0, 0, 2]),
        ((1,), [1]),
        (2, [2]),
        (np.uint8(1), [1]),
        ([True, False, True], [0, 2]),
        (np.array([1, 1], dtype=np.int8), [1, 1]),
    ],
)
def test_rows_may_be_repeated_or_masked(three: EnvState, rows: Any, meant: list[int]) -> None:
    taken = three.rows(rows)
    assert taken.count == len(meant)
    assert taken.seeds == tuple(three.seeds[row] for row in meant)
    assert taken.episodes.counters["goals"].tolist() == three.episodes.counters["goals"][meant].tolist()


def test_the_one_row_of_a_single_environment_can_be_repeated() -> None:
    with PressEnv(engine="batch") as env:
        env.reset(seed=0)
        state = env.save()
        assert state.rows([0, 0]).count == 2
        with pytest.raises(ValueError, match=r"^rows must be one or more indices from 0 to 0, or 1 booleans"):
            state.rows([5])


def test_wrappers_want_one_reset_before_a_state_is_restored() -> None:
    with PressEnv(engine="batch") as saved, gym.make("Spatula/Press-v0", engine="batch") as env:
        saved.reset(seed=0)
        made: Any = env.unwrapped
        made.restore(saved.save())
        with pytest.raises(ResetNeeded):
            env.step(np.zeros(3))
        made.step(np.zeros(3))
        env.reset()
        made.restore(saved.save())
        assert_alike(env.step(np.zeros(3)), saved.step(np.zeros(3)), 0.0)


def test_pictures_and_time_may_differ() -> None:
    with PressEnv(engine="batch") as env, PressEnv(engine="batch", render_mode="rgb_array", width=32) as seen:
        env.reset(seed=0)
        observation, _ = seen.restore(env.save())
        assert_alike(seen.step(np.zeros(3)), env.step(np.zeros(3)), 0.0)
        assert seen.render() is not None
        assert observation.shape == (71,)  # type: ignore[union-attr]


# ----------------------------------------------------------------------------------------- many agents


@pytest.fixture(scope="module", params=["batch", "bullet"])
def envs(request: pytest.FixtureRequest) -> Iterator[SpatulaVectorEnv]:
    made: Any = gym.make_vec(
        "Spatula/Palpate-v0", num_envs=COUNT, engine=request.param, max_episode_steps=9, **EVERYTHING
    )
    yield made
    made.close()


def test_many_go_on_as_they_did(envs: SpatulaVectorEnv) -> None:
    actions = actions_of(envs, 16)
    episode_of(envs, actions[:6])
    state = envs.save()
    # Episodes end in between, and others begin.
    first = go_on(envs, actions[6:])
    assert any(result[3].any() for result in first[:-1])
    envs.restore(pickle.loads(pickle.dumps(state)))
    assert_alike(go_on(envs, actions[6:]), first, 0.0)


@pytest.mark.parametrize("task", [task for task in spatula_env.TASKS if task != "Palpate"])
def test_so_do_those_of_the_other_tasks(task: str) -> None:
    many: Any = gym.make_vec(f"Spatula/{task}-v0", num_envs=2, max_episode_steps=9, **EVERYTHING)
    actions = actions_of(many, 16)
    episode_of(many, actions[:6])
    state = many.save()
    first = go_on(many, actions[6:])
    assert any(result[3].any() for result in first[:-1])
    many.restore(state)
    assert_alike(go_on(many, actions[6:]), first, 0.0)


def test_a_world_goes_on_in_another_world(envs: SpatulaVectorEnv) -> None:
    actions = actions_of(envs, 8)
    episode_of(envs, actions[:6])
    states = envs.save([2, 0])
    expected = envs.step(actions[6])
    envs.reset(seed=50)
    before, _ = envs.reset(seed=60)
    observation, infos = envs.restore(states, np.array([True, True, False]))
    assert (observation[2] == before[2]).all()  # type: ignore[call-overload]
    assert infos["_share"].tolist() == [True, True, False]
    result = envs.step(actions[6][[2, 0, 1]])
    for part in range(4):
        assert_alike(result[part][:2], expected[part][[2, 0]], 0.0)  # type: ignore[index]
    for name in infos:
        if not name.startswith("_"):
            assert result[4][name][:2].tolist() == expected[4][name][[2, 0]].tolist(), name


def test_one_state_branches_into_all_worlds(envs: SpatulaVectorEnv) -> None:
    options: dict[str, Any] = {"engine": envs.settings.engine, **EVERYTHING}
    actions = actions_of(envs, 6)
    with gym.make("Spatula/Palpate-v0", **options) as env:
        episode_of(env, actions[:4, 0])
        made: Any = env.unwrapped
        envs.restore(made.save())
        expected = env.step(actions[4, 0])
        result = envs.step(np.tile(actions[4, 0], (COUNT, 1)))
        for world in range(COUNT):
            assert (result[0][world] == result[0][0]).all()  # type: ignore[index]
            assert np.allclose(result[0][world], expected[0], atol=1e-5)  # type: ignore[index]
        # And back.
        made.restore(envs.save(1))
        assert np.allclose(env.step(actions[5, 0])[0], envs.step(np.tile(actions[5, 0], (COUNT, 1)))[0][1], atol=1e-4)  # type: ignore[index]


def test_rows_of_states_can_be_repeated(envs: SpatulaVectorEnv) -> None:
    episode_of(envs, actions_of(envs, 3))
    states = envs.save()
    assert states.count == COUNT
    picked = states.rows(np.array([1, 1, 2]))
    assert isinstance(picked, EnvState)
    envs.restore(picked)
    assert envs.goals[0].tolist() == envs.goals[1].tolist() == states.episodes.counters["goals"][1].tolist()
    assert envs.np_random_seed == (2, 2, 3)
    # Generators are not shared.
    first, second = envs.np_random[:2]
    assert first is not second
    assert first.random() == second.random()


@pytest.mark.parametrize(
    ("worlds", "message"),
    [
        ([0, 0], "worlds must be different indices from 0 to 2 or 3 booleans"),
        ([3], "worlds must be different indices"),
        ([-1], "worlds must be different indices"),
        ([], "worlds must be different indices"),
        ([0.5], "worlds must be different indices"),
        ([True, False], "worlds must be different indices"),
    ],
)
def test_worlds_that_do_not_exist_are_refused(envs: SpatulaVectorEnv, worlds: Any, message: str) -> None:
    envs.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        envs.save(worlds)
    state = envs.save([0, 1])
    with pytest.raises(ValueError, match=message):
        envs.restore(state, worlds)
    with pytest.raises(ValueError, match="state must be of 3 worlds, or of one, it is of 2"):
        envs.restore(state)


def test_what_has_not_begun_or_has_broken_down_is_not_saved() -> None:
    made = PressVectorEnv(2)
    made.reset(seed=0, options={"reset_mask": np.array([True, False])})
    with pytest.raises(ResetNeeded, match=r"nothing has begun in worlds \[1\]"):
        made.save()
    made.restore(made.save(0))
    made.step(np.zeros((2, 3)))
    made._episodes._info["diverged"][1] = True
    with pytest.raises(ValueError, match=r"worlds must not have diverged, as \[1\] have"):
        made.save()
    made.save([0])


class Runner:
    """An environment that hypothesis tries many sequences on."""

    made: ClassVar[PressEnv | None] = None

    @classmethod
    def env(cls) -> PressEnv:
        if cls.made is None:
            cls.made = PressEnv(engine="batch", **EVERYTHING)
        return cls.made


@settings(max_examples=12, deadline=None)
@given(st.lists(st.sampled_from(["step", "save", "restore", "reset"]), min_size=4, max_size=14), st.integers(0, 5))
def test_whatever_happens_in_between_a_state_stays_what_it_is(moves: list[str], seed: int) -> None:
    env = Runner.env()
    action = np.array([0.3, -0.2, -0.8])
    env.reset(seed=seed)
    state, told = env.save(), env.step(action)
    env.restore(state)
    for move in moves:
        if move == "step":
            env.step(action)
        elif move == "reset":
            env.reset()
        elif move == "save":
            state, told = env.save(), env.step(action)
        else:
            env.restore(state)
            assert_alike(env.step(action), told, 0.0)


# ----------------------------------------------------------------------------------------- copies


@pytest.mark.parametrize("engine", ["batch", "bullet"])
@pytest.mark.parametrize("options", [{}, {"max_episode_steps": 9}])
def test_copies_go_on_alike_and_apart(engine: str, options: dict[str, Any]) -> None:
    with gym.make("Spatula/Press-v0", engine=engine, **EVERYTHING, **options) as env:
        actions = actions_of(env, 14)
        env.action_space.seed(3)
        episode_of(env, actions[:6])
        copies = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
        for one in copies:
            assert one.spec == env.spec
            assert one.get_wrapper_attr("_max_episode_steps") == env.get_wrapper_attr("_max_episode_steps")
            assert one.unwrapped.simulation is not env.unwrapped.simulation  # type: ignore[attr-defined]
        expected = go_on(env, actions[6:])
        sample = env.action_space.sample()
        for one in copies:
            assert_alike(go_on(one, actions[6:]), expected, 0.0)
            assert one.action_space.sample().tolist() == sample.tolist()
            one.close()
        env.reset()


@pytest.mark.parametrize("mode", ["next_step", "same_step", "disabled"])
def test_many_are_copied_too(mode: str) -> None:
    envs: Any = gym.make_vec("Spatula/Press-v0", num_envs=2, autoreset_mode=mode, max_episode_steps=30, **EVERYTHING)
    actions = actions_of(envs, 6)
    episode_of(envs, actions[:3])
    copies = [copy.deepcopy(envs), pickle.loads(pickle.dumps(envs))]
    expected = go_on(envs, actions[3:])
    for one in copies:
        assert one.spec == envs.spec
        assert one.autoreset_mode is envs.autoreset_mode
        assert_alike(go_on(one, actions[3:]), expected, 0.0)


class CountingEnv(PressEnv):
    """With arguments and attributes of its own."""

    def __init__(self, level: int, *, names: list[str] | None = None, **options: Any) -> None:
        super().__init__(max_speed=0.01 * level, engine="batch", **options)
        self.level, self.names, self.resets = level, names or [], 0

    def reset(self, **arguments: Any) -> Any:  # type: ignore[override]
        self.resets += 1
        return super().reset(**arguments)


def test_copies_of_ones_own_classes_keep_what_they_have() -> None:
    names = ["a"]
    with CountingEnv(5, names=names) as env:
        names.append("b")
        env.reset(seed=0)
        env.reset()
        other = copy.deepcopy(env)
        assert (other.level, other.names, other.resets) == (5, ["a", "b"], 2)
        assert other.names is not env.names
        assert_alike(other.reset(), env.reset(), 0.0)
        other.close()


def test_copies_of_what_has_not_begun_or_is_closed() -> None:
    env = PressEnv(engine="batch")
    assert_alike(copy.deepcopy(env).reset(seed=2), env.reset(seed=2), 0.0)
    env.close()
    with pytest.raises(gym.error.ClosedEnvironmentError):
        copy.deepcopy(env).reset()
    many = PressVectorEnv(2)
    many.reset(seed=4, options={"reset_mask": np.array([True, False])})
    other = copy.deepcopy(many)
    mask = {"reset_mask": np.array([False, True])}
    assert_alike(other.reset(seed=[0, 7], options=mask), many.reset(seed=[0, 7], options=mask), 0.0)


def test_states_and_specs_say_what_they_are_of() -> None:
    with gym.make("Spatula/Press-v0", engine="batch", reward="sparse") as env:
        env.reset(seed=6)
        state = env.unwrapped.save()  # type: ignore[attr-defined]
        assert (state.name, state.settings.reward, state.seeds, state.count) == ("press", "sparse", (6,), 1)
        assert env.spec is not None
        assert json.loads(env.spec.to_json())["kwargs"]["reward"] == "sparse"


# ----------------------------------------------------------------------------------------- the page


PAGE = (Path(__file__).parents[2] / "docs" / "planning.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("block", BLOCKS)
def test_the_code_of_the_page_runs_as_pasted(block: str, capsys: pytest.CaptureFixture[str]) -> None:
    # Fewer branches than on the page, to be quick.
    block = block.replace("num_envs=100", "num_envs=24").replace("(100, 3)", "(24, 3)").replace("(100)", "(24)")
    exec(compile(block, "planning.md", "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out.splitlines()[-1:] == re.findall(r"print\(.*\)  # (.*)", block)
