from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import spatula_env
from spatula_env.data import DatasetWriter
from spatula_env.data.replaying import open_dataset
from spatula_env.teleop.scripted_dataset import Hand, make_scripted, scripted_id, scripted_ids

pytest.importorskip("minari")
OPTIONS = {"engine": "batch", "max_episode_steps": 6}


def down(_):
    """Makes a policy that goes down."""
    return lambda observation: np.array([0.1, 0.0, -0.8], dtype=np.float32)


def make(root, episodes, **options):
    return make_scripted("Spatula/Press-v0", down, episodes=episodes, options=OPTIONS, root=root, **options)


def actions(root, number):
    (episode,) = open_dataset("spatula/press/scripted-v0", root).iterate_episodes([number])
    return episode.actions


def test_ids():
    assert scripted_id("Spatula/Press-v0") == "spatula/press/scripted-v0"
    assert len(scripted_ids()) == len(spatula_env.TASKS) == len(set(scripted_ids().values()))


def test_episodes_say_that_they_are_scripted(tmp_path):
    told = []
    made = make(tmp_path, 2, progress=lambda fate, summary, seconds: told.append((fate, summary.seed)))
    assert told == [("recorded", 0), ("recorded", 1)]
    assert (made.recording.recorded, made.recording.successes, len(made.episode_seconds)) == (2, 0, 2)
    dataset = open_dataset("spatula/press/scripted-v0", tmp_path)
    for metadata in dataset.storage.get_episode_metadata([0, 1]):
        assert (metadata["operator"], metadata["device"]) == ("scripted", "emulated Falcon")
        assert not metadata["success"]
    assert "No human and no device took part" in dataset.storage.metadata["description"]
    assert actions(tmp_path, 0).shape == (6, 3)
    assert (actions(tmp_path, 0) != actions(tmp_path, 1)).any()


def test_an_interruption_changes_nothing(tmp_path):
    make(tmp_path / "at_once", 2)
    make(tmp_path / "in_parts", 1)
    assert make(tmp_path / "in_parts", 2).recording.recorded == 1
    for number in range(2):
        np.testing.assert_array_equal(actions(tmp_path / "at_once", number), actions(tmp_path / "in_parts", number))


def test_nothing_is_left_to_do(tmp_path):
    make(tmp_path, 1)
    again = make(tmp_path, 1)
    assert (again.recording.recorded, again.recording.total_episodes, again.episode_seconds) == (0, 1, ())


def test_the_hand_matters(tmp_path):
    make(tmp_path / "a", 1, hand=Hand(0.0, 0.0, 1.0))
    make(tmp_path / "b", 1, hand=Hand(0.1, 0.0, 0.3))
    assert np.abs(actions(tmp_path / "a", 0)[1]).max() > np.abs(actions(tmp_path / "b", 0)[1]).max()


def test_a_humans_dataset_stays_one(tmp_path):
    from recording_helpers import do_episode, make_pictures

    env = make_pictures()
    episode = do_episode(env, 0)
    env.close()
    press = gym.make("Spatula/Press-v0", **OPTIONS)
    writer = DatasetWriter("spatula/press/scripted-v0", press, root=tmp_path)
    press.close()
    episode.attributes["operator"] = "human"
    writer.add(episode)
    with pytest.raises(ValueError, match="episodes of a human"):
        make(tmp_path, 2)
    with pytest.raises(ValueError, match="one of Spatula/Press-v0, not of Spatula/Clamp-v0"):
        make_scripted("Spatula/Clamp-v0", down, dataset_id="spatula/press/scripted-v0", root=tmp_path)


def test_numbers_are_checked(tmp_path):
    with pytest.raises(ValueError, match="episodes must be 1 or more"):
        make(tmp_path, 0)
