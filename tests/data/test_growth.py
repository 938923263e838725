"""Growth of datasets: the cost of an episode does not depend on their number."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from demonstration_helpers import ID, LAYOUT, made_up_env, make_episode, write_dataset

import spatula_env
from spatula_env.data import DatasetWriter, EpisodeRecorder, dataset, replay
from spatula_env.data.encoding import episode_image
from spatula_env.data.episode import STATE
from spatula_env.data.replaying import open_dataset
from spatula_env.teleop.recording import record
from spatula_env.teleop.scripted import ScriptedOperator

minari = pytest.importorskip("minari")
assert spatula_env.TASKS

PRESS = "spatula/press/test-v0"


def dive(_) -> np.ndarray:
    return np.array([0.05, 0.0, -0.8], dtype=np.float32)


def payload(value: Any) -> int:
    """Size of the numbers and texts in a nested value [bytes]."""
    if isinstance(value, Mapping):
        return sum(map(payload, value.values()))
    return sum(map(len, value)) if isinstance(value, list) else np.asarray(value).nbytes


def test_a_short_episode_is_not_much_more_than_its_numbers() -> None:
    env = gym.make("Spatula/Press-v0", engine="batch")
    recorder = EpisodeRecorder(env, states=False)
    recorder.begin(*env.reset(seed=0))
    for _ in range(50):
        recorder.add(dive(None), *env.step(dive(None)))
    env.close()
    episode = recorder.finish(operator="scripted", success=False)
    arrays = {name: getattr(episode, name) for name in ("observations", "actions", "rewards", "infos")}
    assert len(episode_image(episode, 0)) < 1.5 * payload(arrays)


def test_adding_writes_no_more_for_many_than_for_few(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_dataset(tmp_path, episodes=1)
    written: list[int] = []
    write, append = dataset.write_file, dataset.append_to_file

    def count_file(path: Path, content: bytes) -> None:
        written.append(len(content))
        write(path, content)

    def count_line(path: Path, start: int, content: bytes) -> None:
        written.append(len(content))
        append(path, start, content)

    monkeypatch.setattr(dataset, "write_file", count_file)
    monkeypatch.setattr(dataset, "append_to_file", count_line)
    sizes = []
    writer = DatasetWriter(ID, made_up_env(), root=tmp_path, layout=LAYOUT)
    episode = make_episode(0)
    for _ in range(200):
        written.clear()
        writer.add(episode)
        sizes.append(sum(written))
    assert folder == writer.path
    # Numbers have more digits, and that is all; links are written a few times only.
    usual = np.median(sizes[:50])
    assert np.median(sizes[-50:]) < 1.01 * usual
    assert sum(size > 1.2 * usual for size in sizes) <= 2
    loaded = minari.MinariDataset(writer.path / "data")
    assert sum(len(each.rewards) for each in loaded.iterate_episodes()) == loaded.total_steps == 201 * len(episode)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_replays_are_compared_as_precisely_as_was_recorded(tmp_path, monkeypatch, precision) -> None:
    env = gym.make("Spatula/Press-v0", engine="batch", max_episode_steps=4)
    with ScriptedOperator(dive) as device:
        record(env, device, PRESS, root=tmp_path, state_dtype=precision, real_time=False)
    env.close()
    (episode,) = open_dataset(PRESS, tmp_path).iterate_episodes()
    assert {values.dtype for values in episode.infos[STATE].values()} == {np.dtype(precision)}
    (result,) = replay(PRESS, root=tmp_path)
    assert result.difference == 0.0
    from spatula_env.data import replaying

    states = replaying.physics_state
    for shift, same in ((1e-12, True), (1e-5, False)):

        def shifted(made: Any, shift: float = shift) -> dict[str, Any]:
            return {name: each + shift for name, each in states(made).items()}

        monkeypatch.setattr(replaying, "physics_state", shifted)
        (result,) = replay(PRESS, root=tmp_path)
        assert result.matches == same


def test_statistics_of_a_wrapper_cost_no_episode(tmp_path) -> None:
    """`RecordEpisodeStatistics` puts "episode" into `info` in the last step only."""
    env = gym.wrappers.RecordEpisodeStatistics(gym.make("Spatula/Press-v0", engine="batch", max_episode_steps=4))
    with ScriptedOperator(dive) as device:
        summary = record(env, device, PRESS, episodes=2, root=tmp_path, real_time=False)
    env.close()
    assert summary.total_episodes == 2
    for episode in open_dataset(PRESS, tmp_path).iterate_episodes():
        np.testing.assert_array_equal(episode.infos["_episode"], [False] * 4 + [True])
        assert episode.infos["episode"]["r"][-1] == pytest.approx(episode.rewards.sum())
    assert all(each.matches for each in replay(PRESS, root=tmp_path))
