"""Values that come step by step become arrays, whatever their type."""

from __future__ import annotations

import json
from collections import deque
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from recording_helpers import ID, do_episode, make_pictures

from spatula_env.data import DatasetWriter, EpisodeRecorder

minari = pytest.importorskip("minari")


@pytest.fixture
def env():
    made = make_pictures()
    yield made
    made.close()


def record_infos(env: gym.Env, infos: list[dict[str, Any]], root) -> dict[str, Any]:
    """The infos that plain Minari reads from an episode recorded with these infos."""
    recorder = EpisodeRecorder(env)
    observation, _ = env.reset(seed=0)
    recorder.begin(observation, infos[0], 0, {"nested": {"place": [0.0, 1.0]}, "nothing": None})
    for info in infos[1:]:
        action = np.zeros(3, dtype=np.float32)
        recorder.add(action, *env.step(action)[:-1], info)
    writer = DatasetWriter(ID, env, root=root)
    writer.add(recorder.finish(success=True))
    (episode,) = minari.MinariDataset(writer.path / "data").iterate_episodes()
    return episode.infos


def test_keys_that_come_with_the_last_step(env, tmp_path) -> None:
    """As those of `gymnasium.wrappers.RecordEpisodeStatistics`, once an episode is over."""
    last = {"force": 2.0, "episode": {"r": 3.5, "l": 2, "t": 0.25}, "why": "limit", "over": True}
    infos = record_infos(env, [{"force": 0.0}, {"force": 1.0}, last], tmp_path)
    np.testing.assert_array_equal(infos["force"], [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(infos["_episode"], [False, False, True])
    np.testing.assert_array_equal(infos["episode"]["r"], [np.nan, np.nan, 3.5])
    np.testing.assert_array_equal(infos["episode"]["l"], [0, 0, 2])
    assert "_r" not in infos["episode"]
    np.testing.assert_array_equal(infos["over"], [False, False, True])
    assert [text.decode() for text in infos["why"]] == ["", "", "limit"]


def test_keys_that_vanish_and_values_that_change(env, tmp_path) -> None:
    infos = record_infos(
        env,
        [
            {"gone": np.ones(2), "number": 1, "shape": np.zeros(2), "mixed": 1, "none": None, "deep": {"a": 1}},
            {"number": 2.5, "shape": np.zeros(3), "mixed": "two", "none": 3.0, "deep": {"b": 2}},
            {"number": True, "shape": [[1.0], [2.0, 3.0]], "mixed": {"three": 3}, "none": deque([1]), "deep": {}},
        ],
        tmp_path,
    )
    np.testing.assert_array_equal(infos["gone"], [[1.0, 1.0], [np.nan] * 2, [np.nan] * 2])
    np.testing.assert_array_equal(infos["_gone"], [True, False, False])
    np.testing.assert_array_equal(infos["number"], [1.0, 2.5, 1.0])
    assert [json.loads(text) for text in infos["shape"]] == [[0.0, 0.0], [0.0, 0.0, 0.0], [[1.0], [2.0, 3.0]]]
    assert [json.loads(text) for text in infos["mixed"]] == [1, "two", {"three": 3}]
    assert [json.loads(text) for text in infos["none"]] == [None, 3.0, "deque([1])"]
    np.testing.assert_array_equal(infos["deep"]["_a"], [True, False, False])
    np.testing.assert_array_equal(infos["deep"]["b"], [0, 2, 0])


def test_names_of_values_and_of_groups(env, tmp_path) -> None:
    infos = record_infos(env, [{"reward": 1.0, "reward/term": 0.5}] * 2, tmp_path)
    np.testing.assert_array_equal(infos["reward"]["value"], [1.0, 1.0])
    np.testing.assert_array_equal(infos["reward"]["term"], [0.5, 0.5])


def test_what_a_list_becomes_later_does_not_count(env, tmp_path) -> None:
    seen: list[int] = []
    infos = []
    for number in range(3):
        seen.append(number)
        infos.append({"seen": seen})
    recorder = EpisodeRecorder(env)
    observation, _ = env.reset(seed=0)
    recorder.begin(observation, {"seen": []})
    seen.clear()
    for number in range(2):
        seen.append(number)
        recorder.add(np.zeros(3), *env.step(np.zeros(3, dtype=np.float32))[:-1], {"seen": seen})
    assert [json.loads(text) for text in recorder.finish().infos["seen"]] == [[], [0], [0, 1]]


def test_options_of_the_reset_come_back(env, tmp_path) -> None:
    record_infos(env, [{}, {}], tmp_path)
    (told,) = minari.MinariDataset(tmp_path / ID / "data").storage.get_episode_metadata([0])
    np.testing.assert_array_equal(told["options"]["nested"]["place"], [0.0, 1.0])
    assert told["options"]["nothing"] == "null"


def test_statistics_are_recorded_with_an_episode(tmp_path) -> None:
    env = gym.wrappers.RecordEpisodeStatistics(make_pictures())
    episode = do_episode(env, 3)
    assert episode.infos["episode"]["r"][-1] == pytest.approx(episode.rewards.sum())
    writer = DatasetWriter(ID, env, root=tmp_path)
    assert writer.add(episode) == 0
    env.close()


def test_states_are_as_precise_as_is_asked(env) -> None:
    with pytest.raises(ValueError, match="state_dtype must be one of"):
        EpisodeRecorder(env, state_dtype="float16")
