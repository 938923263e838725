from __future__ import annotations

import numpy as np
import pytest
from recording_helpers import do_episode, make_pictures

from spatula_env.data import DatasetWriter, copy_episodes, list_datasets, summarize
from spatula_env.data.replaying import open_dataset

pytest.importorskip("minari")


@pytest.fixture
def root(tmp_path):
    env = make_pictures()
    for name, seeds in (("a", (0, 1)), ("b", (2,))):
        writer = DatasetWriter(f"spatula/test/{name}-v0", env, root=tmp_path)
        for seed in seeds:
            writer.add(do_episode(env, seed))
    env.close()
    return tmp_path


def test_list_and_summary(root):
    assert list_datasets(root) == ["spatula/test/a-v0", "spatula/test/b-v0"]
    found = summarize("spatula/test/a-v0", root)
    assert (found.episodes, found.steps, found.successes) == (2, 12, 2)
    assert found.operators == {"scripted": 2}
    assert found.devices == {"dice": 2}
    rewards = [episode.rewards.sum() for episode in open_dataset("spatula/test/a-v0", root).iterate_episodes()]
    assert found.mean_return == pytest.approx(np.mean(rewards))
    assert found.mean_length == 6.0
    assert found.megabytes > 0.01
    assert np.isnan(found.mean_peak_force)


def test_merging_keeps_everything(root):
    found = copy_episodes(["spatula/test/a-v0", "spatula/test/b-v0"], "spatula/test/all-v0", root=root)
    assert found.episodes == 3
    copy = open_dataset("spatula/test/all-v0", root)
    assert [int(each["seed"]) for each in copy.storage.get_episode_metadata(range(3))] == [0, 1, 2]
    (last,) = copy.iterate_episodes([2])
    (source,) = open_dataset("spatula/test/b-v0", root).iterate_episodes([0])
    np.testing.assert_array_equal(last.observations["image"], source.observations["image"])
    np.testing.assert_array_equal(last.infos["acted_by"], source.infos["acted_by"])


def test_dropping(root):
    found = copy_episodes(["spatula/test/a-v0"], "spatula/test/some-v0", root=root, keep=lambda each: each["seed"] == 1)
    assert found.episodes == 1
    with pytest.raises(FileExistsError, match="already"):
        copy_episodes(["spatula/test/a-v0"], "spatula/test/some-v0", root=root)


def test_an_empty_folder(tmp_path):
    assert list_datasets(tmp_path / "nothing") == []
    with pytest.raises(FileNotFoundError):
        summarize("spatula/test/a-v0", tmp_path)
