"""Return, length and cost of episodes come out the same, however episodes begin anew."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import spatula_env
from spatula_env.envs.episode_sums import RecordEpisodeSums, values_of_step

assert spatula_env.TASKS
WORLDS, EPISODES = 3, 3
MODES = ("next_step", "same_step", "disabled")
# Episodes end early by damage, at different times, or are cut.
OPTIONS: dict[str, Any] = {"max_episode_steps": 14, "damage_limit": 40.0}
DOWN = np.tile(np.float32([0.0, 0.0, -1.0]), (WORLDS, 1))


def collect(envs: gym.vector.VectorEnv) -> list[list[tuple[float, int, float]]]:
    """(return, length, cost) of each world's first episodes."""
    episodes: list[list[tuple[float, int, float]]] = [[] for _ in range(WORLDS)]
    envs.reset(seed=3)
    while min(len(each) for each in episodes) < EPISODES:
        _, _, terminations, truncations, infos = envs.step(DOWN)
        ended = terminations | truncations
        assert ("episode" in infos) == bool(ended.any())
        if ended.any():
            np.testing.assert_array_equal(infos["_episode"], ended)
            for world in np.flatnonzero(ended):
                episodes[world].append(tuple(infos["episode"][name][world] for name in ("r", "l", "cost")))
            if envs.metadata["autoreset_mode"] is gym.vector.AutoresetMode.DISABLED:
                np.testing.assert_allclose(infos["episode"]["cost"][ended], infos["episode_cost"][ended])
                envs.reset(options={"reset_mask": ended})
    envs.close()
    return [each[:EPISODES] for each in episodes]


@pytest.fixture(scope="module")
def expected() -> list[list[tuple[float, int, float]]]:
    """Summed by hand, one world after the other."""
    episodes: list[list[tuple[float, int, float]]] = []
    for world in range(WORLDS):
        env = gym.make("Spatula/Press-v0", engine="batch", **OPTIONS)
        episodes.append([])
        for number in range(EPISODES):
            env.reset(seed=3 + world if number == 0 else None)
            total, length, cost, over = 0.0, 0, 0.0, False
            while not over:
                _, reward, terminated, truncated, info = env.step(DOWN[0])
                total, length, cost, over = total + reward, length + 1, cost + info["cost"], terminated or truncated
            episodes[-1].append((total, length, cost))
        env.close()
    return episodes


@pytest.mark.parametrize("mode", MODES)
def test_sums_are_those_of_single_environments(mode: str, expected: list[list[tuple[float, int, float]]]) -> None:
    envs = gym.make_vec("Spatula/Press-v0", num_envs=WORLDS, autoreset_mode=mode, **OPTIONS)
    np.testing.assert_allclose(collect(RecordEpisodeSums(envs)), expected, rtol=1e-4)
    assert all(cost > 0.0 for each in expected for _, _, cost in each)


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_sums_are_right_in_gymnasiums_own_vector_environment(
    mode: str, expected: list[list[tuple[float, int, float]]]
) -> None:
    envs = gym.make_vec(
        "Spatula/Press-v0",
        num_envs=WORLDS,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": gym.vector.AutoresetMode[mode.upper()]},
        engine="batch",
        **OPTIONS,
    )
    np.testing.assert_allclose(collect(RecordEpisodeSums(envs)), expected, rtol=1e-4)


def test_with_same_step_autoreset_the_last_dose_is_in_the_final_info() -> None:
    envs = gym.make_vec("Spatula/Press-v0", num_envs=WORLDS, autoreset_mode="same_step", max_episode_steps=12)
    envs.reset(seed=3)
    for _ in range(12):
        _, _, _, truncations, infos = envs.step(DOWN)
    envs.close()
    assert truncations.all()
    assert (infos["dose"] == 0.0).all()
    assert (values_of_step(infos, "dose") > 0.0).all()
    np.testing.assert_array_equal(values_of_step(infos, "dose"), infos["final_info"]["dose"])


def test_sums_stand_beside_gymnasiums_statistics() -> None:
    envs = gym.make_vec("Spatula/Press-v0", num_envs=2, autoreset_mode="same_step", max_episode_steps=3)
    envs = RecordEpisodeSums(RecordEpisodeStatistics(envs), names=("cost", "work"), stats_key="sums")
    envs.reset(seed=0)
    for _ in range(3):
        *_, infos = envs.step(DOWN[:2])
    envs.close()
    for name in ("r", "l"):
        np.testing.assert_allclose(infos["sums"][name], infos["episode"][name])
    assert set(infos["sums"]) == {"r", "l", "cost", "work"}


def test_what_cannot_be_summed_is_an_error() -> None:
    envs = gym.make_vec("Spatula/Press-v0", num_envs=1, max_episode_steps=1)
    with pytest.raises(ValueError, match="names must differ"):
        RecordEpisodeSums(envs, names=("cost", "r"))
    unknown = RecordEpisodeSums(envs, names=("price",))
    unknown.reset(seed=0)
    with pytest.raises(KeyError, match="price"):
        unknown.step(DOWN[:1])
    twice = RecordEpisodeSums(RecordEpisodeStatistics(envs))
    twice.reset(seed=0)
    with pytest.raises(ValueError, match="hold 'episode' already"):
        twice.step(DOWN[:1])
    envs.close()
