"""Each observation is paired with the action that was chosen for it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from demonstration_helpers import ID, LENGTHS, make_episode, write_dataset

from spatula_env.data.d3rlpy_dataset import _vectors, load_d3rlpy

pytest.importorskip("minari")


def test_goals_stand_behind_observations() -> None:
    observations = {
        "achieved_goal": np.zeros((3, 2)),
        "desired_goal": np.full((3, 2), 7.0),
        "observation": np.arange(12.0).reshape(3, 4),
    }
    np.testing.assert_array_equal(_vectors(observations)[1], [4.0, 5.0, 6.0, 7.0, 7.0, 7.0])


def test_pictures_are_refused() -> None:
    with pytest.raises(ValueError, match=r"must be vectors for d3rlpy, got entries \['image', 'state'\]"):
        _vectors({"image": np.zeros((3, 8, 8, 3)), "state": np.zeros((3, 4))})


def test_without_the_library_the_error_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "d3rlpy", None)
    monkeypatch.setitem(sys.modules, "d3rlpy.dataset", None)
    with pytest.raises(ImportError, match="pip install d3rlpy"):
        load_d3rlpy(ID, tmp_path)


@pytest.mark.libraries
@pytest.mark.filterwarnings("ignore")
class TestWithTheLibrary:
    @pytest.fixture
    def buffer(self, tmp_path: Path) -> Any:
        pytest.importorskip("d3rlpy", reason="d3rlpy is not installed; `make test-libraries` installs it")
        write_dataset(tmp_path)
        return load_d3rlpy(ID, tmp_path)

    def test_observations_and_actions_are_aligned(self, buffer: Any) -> None:
        assert [each.size() for each in buffer.episodes] == list(LENGTHS)
        for number, episode in enumerate(buffer.episodes):
            recorded = make_episode(number)
            np.testing.assert_array_equal(episode.observations, recorded.observations[:-1])
            np.testing.assert_array_equal(episode.actions, recorded.actions)
            np.testing.assert_array_equal(episode.rewards[:, 0], recorded.rewards)
            assert not episode.terminated

    def test_transitions_lead_from_an_observation_to_the_next(self, buffer: Any) -> None:
        # The last step of an episode that was cut has no transition.
        assert buffer.transition_count == sum(LENGTHS) - len(LENGTHS)
        for number, episode in enumerate(buffer.episodes):
            recorded = make_episode(number)
            for index in range(episode.transition_count):
                transition = buffer.transition_picker(episode, index)
                np.testing.assert_array_equal(transition.observation, recorded.observations[index])
                np.testing.assert_array_equal(transition.next_observation, recorded.observations[index + 1])
                np.testing.assert_array_equal(transition.action, recorded.actions[index])

    def test_its_own_loader_is_shifted_by_a_row_for_each_episode_before(self, tmp_path: Path) -> None:
        """The reason for this package's own loader; if this test fails, d3rlpy's has been fixed."""
        dataset = pytest.importorskip("d3rlpy.dataset")
        episodes = [make_episode(number) for number in range(3)]
        theirs = dataset.MDPDataset(
            observations=np.concatenate([each.observations for each in episodes]),
            actions=np.concatenate([each.actions for each in episodes]),
            rewards=np.concatenate([each.rewards for each in episodes]),
            terminals=np.concatenate([each.terminations for each in episodes]),
            timeouts=np.concatenate([each.truncations for each in episodes]),
        )
        np.testing.assert_array_equal(theirs.episodes[0].observations, episodes[0].observations[:-1])
        np.testing.assert_array_equal(theirs.episodes[1].observations[1:], episodes[1].observations[: LENGTHS[1] - 1])
        np.testing.assert_array_equal(theirs.episodes[2].observations[2:], episodes[2].observations[: LENGTHS[2] - 2])

    def test_failures_can_be_left_out(self, tmp_path: Path) -> None:
        pytest.importorskip("d3rlpy")
        write_dataset(tmp_path)
        buffer = load_d3rlpy(ID, tmp_path, successes_only=True)
        assert [each.size() for each in buffer.episodes] == [LENGTHS[0], LENGTHS[2]]
