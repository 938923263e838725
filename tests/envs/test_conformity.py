"""Requirements on every environment, whatever its task, its engine and its observations."""

from __future__ import annotations

import json
import multiprocessing
import pickle
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from vector_helpers import assert_alike

import spatula_env
from spatula_env.envs.settings import OBS_MODES, RENDER_MODES
from spatula_env.envs.vector_arguments import AUTORESET_MODES

IDS = tuple(f"Spatula/{name}-v0" for name in spatula_env.TASKS)
ENGINES = ("batch", "bullet")
SMALL = {"observation": {"image_size": (36, 36), "organ_points": 32, "tool_points": 16}}
"""Observations that cost little."""

NOT_TOLD_BY_STILLNESS = re.compile(r"contact|jaw_speed|rate|velocity|hold_progress")
"""Parts that need not change where tools touch nothing."""

SB3_REMARKS = (
    "It seems that your observation depth is an image but",
    "It seems that your observation space depth is an image but",
    "Your observation organ has an unconventional shape",
    "Your observation tool has an unconventional shape",
)
"""Remarks that Stable-Baselines3's checker may make: depth is not an image of bytes, and point clouds are neither
images nor vectors. Both are true; they need a policy that handles them. No other remark is allowed."""


SEEN = [
    *((id, obs_mode, "dense") for id in IDS for obs_mode in OBS_MODES),
    *((id, "state", "sparse") for id in IDS),
    *((id, obs_mode, "sparse") for id, obs_mode in zip(IDS, OBS_MODES, strict=True) if obs_mode != "state"),
]
"""Combinations of environment, observation mode and reward that are tested; with sparse rewards fewer, as the goal
entries are added to the observation in the same way in all modes."""


class Env:
    """An environment by its id, made once for all tests that do not close it."""

    kept: ClassVar[dict[tuple[Any, ...], Any]] = {}

    def __call__(self, id: str, **options: Any) -> Any:
        key = (id, json.dumps(options, sort_keys=True))
        if key not in self.kept:
            self.kept[key] = gym.make(id, disable_env_checker=True, **options).unwrapped
        return self.kept[key]


@pytest.fixture(scope="module")
def make() -> Iterator[Env]:
    maker = Env()
    yield maker
    for env in maker.kept.values():
        env.close()
    maker.kept.clear()


def actions_of(env: Any, count: int, seed: int = 0, worlds: int | None = None) -> np.ndarray:
    """At random, but rather downwards than upwards: (count, A), or (count, worlds, A)."""
    space = env.action_space if worlds is None else env.single_action_space
    shape = (count, *space.shape) if worlds is None else (count, worlds, *space.shape)
    actions = np.random.default_rng(seed).uniform(-1.0, 1.0, shape)
    actions[..., 2] -= 0.5
    return actions.clip(-1.0, 1.0).astype(np.float32)


def episode(env: Any, actions: np.ndarray, seed: int | None = 0) -> list[Any]:
    shown = [env.reset(seed=seed)]
    shown += [env.step(action) for action in actions]
    return shown


def arrays(observation: Any) -> dict[str, np.ndarray]:
    return observation if isinstance(observation, dict) else {"": observation}


# ----------------------------------------------------------------------------------------- checkers


@pytest.mark.parametrize(("id", "obs_mode", "reward"), SEEN)
def test_gymnasiums_checker_finds_nothing(make: Env, id: str, obs_mode: str, reward: str) -> None:
    # Warnings are errors in all tests. Rendering is tested below: a window needs a display.
    check_env(make(id, engine="batch", obs_mode=obs_mode, reward=reward, **SMALL), skip_render_check=True)


@pytest.mark.parametrize(("id", "obs_mode", "reward"), SEEN)
def test_stable_baselines_checker_finds_nothing(make: Env, id: str, obs_mode: str, reward: str) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = make(id, engine="batch", obs_mode=obs_mode, reward=reward, **SMALL)
    with warnings.catch_warnings(record=True) as remarks:
        warnings.simplefilter("always")
        checker.check_env(env, skip_render_check=True)
    unexplained = [str(each.message) for each in remarks if not str(each.message).startswith(SB3_REMARKS)]
    assert unexplained == []


@pytest.mark.bullet
@pytest.mark.parametrize("id", IDS)
def test_the_passive_checker_finds_nothing_in_bullet(id: str) -> None:
    with gym.make(id, engine="bullet") as env:
        assert isinstance(env, gym.Wrapper)
        env.reset(seed=0)
        env.action_space.seed(0)
        for _ in range(4):
            env.step(env.action_space.sample())


# ----------------------------------------------------------------------------------------- what is seen


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize("obs_mode", OBS_MODES)
def test_observations_stay_in_their_space(make: Env, id: str, obs_mode: str) -> None:
    # Tools that turn as well go to more places.
    env = make(id, engine="batch", obs_mode=obs_mode, control="velocity_6d", **SMALL)
    for observation, *_ in episode(env, actions_of(env, 8)):
        assert env.observation_space.contains(observation)
        for name, values in arrays(observation).items():
            assert np.isfinite(values).all(), name


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize("obs_mode", OBS_MODES)
def test_late_noisy_and_stacked_observations_stay_in_their_space(make: Env, id: str, obs_mode: str) -> None:
    seeing = {**SMALL["observation"], "noise": 3.0, "delay": 0.1, "history": 3}
    env = make(id, engine="batch", obs_mode=obs_mode, reward="sparse", observation=seeing)
    for observation, *_ in episode(env, actions_of(env, 3)):
        assert env.observation_space.contains(observation)


@pytest.mark.parametrize("id", IDS)
def test_bounds_are_finite(make: Env, id: str) -> None:
    for obs_mode in OBS_MODES:
        space = make(id, engine="batch", obs_mode=obs_mode, **SMALL).observation_space
        for name, box in space.spaces.items() if isinstance(space, spaces.Dict) else [("", space)]:
            assert isinstance(box, spaces.Box)
            assert np.isfinite(box.low).all(), name
            assert np.isfinite(box.high).all(), name
            assert (box.low < box.high).all(), name


@pytest.mark.parametrize("id", IDS)
def test_nothing_seen_is_constant(make: Env, id: str) -> None:
    env = make(id, engine="batch", obs_mode="dict", control="velocity_6d")
    seen = [
        arrays(observation) for seed in range(6) for observation, *_ in episode(env, actions_of(env, 6, seed), seed)
    ]
    for name in seen[0]:
        spread = np.ptp([each[name] for each in seen], axis=0)
        if NOT_TOLD_BY_STILLNESS.search(name):
            continue
        assert (spread > 0.0).any(), name


@pytest.mark.parametrize("id", IDS)
def test_results_are_arrays_of_their_own(make: Env, id: str) -> None:
    for obs_mode in OBS_MODES:
        env = make(id, engine="batch", obs_mode=obs_mode, **SMALL)
        actions = actions_of(env, 4)
        first = [arrays(result[0]) for result in episode(env, actions)]
        kept = [{name: values.copy() for name, values in each.items()} for each in first]
        again = []
        for result in episode(env, actions):
            again.append({name: values.copy() for name, values in arrays(result[0]).items()})
            for values in arrays(result[0]).values():
                values[...] = 1
        assert_alike(first, kept, 0.0)
        assert_alike(again, kept, 0.0)


# ----------------------------------------------------------------------------------------- determinism


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize("engine", ENGINES)
def test_equal_seeds_give_equal_episodes_to_the_last_bit(make: Env, id: str, engine: str) -> None:
    env = make(id, engine=engine)
    actions = actions_of(env, 6 if engine == "bullet" else 12)
    first = episode(env, actions, seed=11)
    assert_alike(episode(env, actions, seed=11), first, 0.0)
    with gym.make(id, engine=engine) as other:
        assert_alike(episode(other.unwrapped, actions, seed=11), first, 0.0)


@pytest.mark.parametrize("id", IDS)
def test_random_things_are_determined_too(make: Env, id: str) -> None:
    options = {"engine": "batch", "randomization": "default", "observation": {"noise": 1.0}}
    env = make(id, **options)
    actions = actions_of(env, 5)
    first = episode(env, actions, seed=3)
    # An episode of another length in between changes nothing.
    episode(env, actions[:2], seed=3)
    following = env.reset()
    assert_alike(episode(env, actions, seed=3), first, 0.0)
    assert_alike(env.reset(), following, 0.0)


@pytest.mark.parametrize("id", IDS)
def test_without_a_seed_random_numbers_go_on(make: Env, id: str) -> None:
    env = make(id, engine="batch")
    first = [env.reset(seed=5)[0], env.reset()[0], env.reset()[0]]
    assert (first[0] != first[1]).any()
    assert (first[1] != first[2]).any()
    assert_alike([env.reset(seed=5)[0], env.reset()[0], env.reset()[0]], first, 0.0)


@pytest.mark.parametrize("id", IDS)
def test_goals_and_starts_are_drawn(make: Env, id: str) -> None:
    env = make(id, engine="batch")
    starts = [env.reset(seed=seed)[0] for seed in range(8)]
    for name in ("tool_position", "goal"):
        assert (np.ptp([start[env.observation_builder.slices[name]] for start in starts], axis=0) > 0.0).any(), name


def _play(id: str, actions: np.ndarray, sent: Any) -> None:
    with gym.make(id, engine="batch") as env:
        sent.send([result[0] for result in episode(env.unwrapped, actions, seed=4)])


@pytest.mark.parametrize("id", IDS[:1])
def test_another_process_plays_the_same_episode(make: Env, id: str) -> None:
    env = make(id, engine="batch")
    actions = actions_of(env, 8)
    context = multiprocessing.get_context("spawn")
    received, sent = context.Pipe(duplex=False)
    process = context.Process(target=_play, args=(id, actions, sent))
    process.start()
    theirs = received.recv()
    process.join(60.0)
    assert_alike(theirs, [result[0] for result in episode(env, actions, seed=4)], 0.0)


# ----------------------------------------------------------------------------------------- rewards and info


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize("engine", ENGINES)
def test_info_has_the_same_keys_and_kinds_at_reset_and_at_every_step(make: Env, id: str, engine: str) -> None:
    env = make(id, engine=engine)
    results = episode(env, actions_of(env, 4))
    kinds = {name: type(value) for name, value in results[0][1].items()}
    # What JSON, Stable-Baselines3, Gymnasium's vector environments and TorchRL's reader (`dtype`) take.
    assert set(kinds.values()) == {bool, np.float64}
    assert json.loads(json.dumps(results[-1][-1])) == results[-1][-1]
    for result in results:
        assert {name: type(value) for name, value in result[-1].items()} == kinds
        assert all(np.isfinite(value) for value in result[-1].values())


@pytest.mark.parametrize("id", IDS)
def test_the_dense_reward_is_the_weighted_sum_of_its_terms(make: Env, id: str) -> None:
    env = make(id, engine="batch")
    for _, reward, terminated, truncated, info in episode(env, actions_of(env, 15))[1:]:
        terms = {name: info[f"reward/{name}"] for name in env.task.weights}
        assert reward == pytest.approx(sum(weight * terms[name] for name, weight in env.task.weights.items()))
        assert isinstance(reward, float)
        assert not terminated
        assert not truncated


WITH_HINDSIGHT = ("Spatula/Press-v0", "Spatula/Retract-v0", "Spatula/Clamp-v0")


@pytest.mark.parametrize("id", WITH_HINDSIGHT)
def test_the_sparse_reward_is_that_of_compute_reward(make: Env, id: str) -> None:
    env = make(id, engine="batch", reward="sparse")
    results = episode(env, actions_of(env, 15))[1:]
    achieved = np.array([observation["achieved_goal"] for observation, *_ in results])
    desired = np.array([observation["desired_goal"] for observation, *_ in results])
    rewards = [reward for _, reward, *_ in results]
    assert env.compute_reward(achieved, desired, [{}] * 15).tolist() == rewards
    one_by_one = [float(env.compute_reward(*pair, {})) for pair in zip(achieved, desired, strict=True)]
    assert one_by_one == rewards
    assert [reward == 0.0 for reward in rewards] == [result[-1]["within_tolerance"] for result in results]
    # What is desired fulfils itself.
    assert (env.compute_reward(desired, desired, None) == 0.0).all()


@pytest.mark.parametrize("id", IDS)
def test_only_the_goal_interface_has_compute_reward(make: Env, id: str) -> None:
    assert not hasattr(make(id, engine="batch"), "compute_reward")
    sparse = make(id, engine="batch", reward="sparse")
    assert hasattr(sparse, "compute_reward") == (id in WITH_HINDSIGHT)
    if id not in WITH_HINDSIGHT:
        with pytest.raises(AttributeError, match="has no compute_reward: what is achieved in it depends on what is"):
            _ = sparse.compute_reward
        for observation, reward, *_, info in episode(sparse, actions_of(sparse, 3))[1:]:
            assert sparse.observation_space.contains(observation)
            assert isinstance(observation, np.ndarray)
            assert reward == float(info["within_tolerance"]) - 1.0


# ----------------------------------------------------------------------------------------- many at once


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize(
    ("mode", "options"),
    [("next_step", {"reward": "sparse", "obs_mode": "pointcloud", "randomization": "default"}), ("same_step", {})],
)
def test_many_at_once_go_through_the_same_episodes(id: str, mode: str, options: dict[str, Any]) -> None:
    options = {**SMALL, **options, "engine": "batch"}
    mine: Any = gym.make_vec(id, num_envs=2, max_episode_steps=4, autoreset_mode=mode, **options)
    theirs: Any = SyncVectorEnv(
        [lambda: gym.make(id, max_episode_steps=4, disable_env_checker=True, **options)] * 2,
        autoreset_mode=AutoresetMode[mode.upper()],
    )
    assert mine.observation_space == theirs.observation_space
    assert_alike(mine.reset(seed=20), theirs.reset(seed=20), 1e-5)
    for k, action in enumerate(actions_of(mine, 6, worlds=2)):
        # Organs are integrated in single precision, in another order.
        assert_alike(mine.step(action)[:4], theirs.step(action)[:4], 2e-3, f"step {k}")
    mine.close()
    theirs.close()


@pytest.mark.parametrize("id", IDS)
def test_each_world_can_begin_alone(id: str) -> None:
    env: Any = gym.make_vec(id, num_envs=2, autoreset_mode="disabled", engine="batch")
    both = env.reset(seed=[3, 4])[0]
    env.step(actions_of(env, 1, worlds=2)[0])
    alone = env.reset(seed=[None, 4], options={"reset_mask": np.array([False, True])})[0]
    assert_alike(alone[1], both[1], 1e-6)
    assert (alone[0] != both[0]).any()
    env.close()


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize("mode", AUTORESET_MODES)
def test_all_modes_of_beginning_anew_are_offered(id: str, mode: str) -> None:
    env = gym.make_vec(id, num_envs=2, autoreset_mode=mode, engine="batch")
    assert env.metadata["autoreset_mode"] is AutoresetMode[mode.upper()]
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    env.close()


# ----------------------------------------------------------------------------------------- life


@pytest.mark.parametrize("id", IDS)
def test_specifications_can_be_sent_and_kept(id: str) -> None:
    spec = gym.spec(id)
    assert spec.kwargs == {"episode_time": spatula_env.EPISODE_TIME}
    assert not spec.nondeterministic
    assert pickle.loads(pickle.dumps(spec)) == spec
    with gym.make(spec, engine="batch", reward="sparse", observation={"noise": 0.5}) as env:
        assert env.spec is not None
        written = env.spec.to_json()
    with gym.make(EnvSpec.from_json(written)) as again:
        assert again.spec is not None
        chosen = {"engine": "batch", "reward": "sparse", "observation": {"noise": 0.5}}
        assert again.spec.kwargs == {"episode_time": 10.0, **chosen}
        again.reset(seed=0)


@pytest.mark.parametrize("id", IDS)
def test_pictures_are_made_when_asked_for(make: Env, id: str) -> None:
    assert set(RENDER_MODES) == set(make(id, engine="batch").metadata["render_modes"])
    env = make(id, engine="batch", render_mode="rgb_array", width=48, height=40)
    env.reset(seed=0)
    before = env.render()
    assert before.shape == (40, 48, 3)
    assert before.dtype == np.uint8
    env.step(actions_of(env, 1)[0])
    assert np.ptp(env.render()) > 50
    silent = make(id, engine="batch")
    silent.reset(seed=0)
    assert silent.render() is None


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize("engine", ENGINES)
def test_closing_twice_is_allowed(id: str, engine: str) -> None:
    env = gym.make(id, engine=engine).unwrapped
    env.reset(seed=0)
    env.close()
    env.close()
    with pytest.raises(gym.error.ClosedEnvironmentError):
        env.reset()


@pytest.mark.parametrize("id", IDS)
def test_what_does_not_exist_is_refused(make: Env, id: str) -> None:
    def made(**options: Any) -> Any:
        return gym.make(id, engine="batch", **options)

    with pytest.raises(TypeError, match=r"unexpected keyword argument 'colour'.* are contact, control"):
        made(colour=1)
    for option, value, allowed in (
        ("obs_mode", "smell", r"\['state', 'dict', 'rgb', 'rgbd', 'pointcloud'\]"),
        ("control", "force", r"\['velocity', 'velocity_6d'(, 'velocity_level')?\]"),
        ("reward", "shaped", r"\['dense', 'sparse'\]"),
        ("contact", "magic", r"\['flags', 'second_step', 'bullet', 'mujoco'\]"),
    ):
        with pytest.raises(ValueError, match=f"{option} must be one of {allowed}, got '{value}'"):
            made(**{option: value})
    with pytest.raises(ValueError, match="task has no colour; allowed are "):
        made(task={"colour": 1})
    with pytest.raises(ValueError, match="weights has no colour; allowed are "):
        made(task={"weights": {"colour": 1}})
    env = make(id, engine="batch")
    env.reset(seed=0)
    size = env.action_space.shape[0]
    for bad in (np.zeros(size + 1), np.full(size, np.nan), "left"):
        with pytest.raises(ValueError, match="action must"):
            env.step(bad)
    for options in ({"goal": "far"}, {"goal": [0.0]}, {"tool_position": (0.0, 0.0, 1.0)}, {"goals": 1.0}):
        with pytest.raises(ValueError, match="options"):
            env.reset(options=options)


@pytest.mark.parametrize(
    ("engine", "options", "resets"),
    [("batch", {"randomization": "default"}, 100), ("batch", {"obs_mode": "rgbd"}, 60), ("bullet", {}, 60)],
)
def test_memory_does_not_grow_with_resets(engine: str, options: dict[str, Any], resets: int) -> None:
    def resident() -> int:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * 4096

    if not Path("/proc/self/statm").exists():
        pytest.skip("only Linux tells how much memory there is in use")
    with gym.make(IDS[0], engine=engine, disable_env_checker=True, **SMALL, **options) as made:
        env = made.unwrapped
        actions = actions_of(env, 2)
        for seed in range(20):
            episode(env, actions, seed)
        before = resident()
        for seed in range(resets):
            episode(env, actions, seed)
        grown = resident() - before
    # One organ holds 60,000 bytes.
    assert grown < 20_000 * resets
