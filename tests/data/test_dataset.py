from __future__ import annotations

import errno
import os
import random
import re
import resource
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from recording_helpers import ID, do_episode, make_pictures

import spatula_env
from spatula_env.data import DatasetWriteError, DatasetWriter, EpisodeRecorder, dataset
from spatula_env.installing import install_hint

minari = pytest.importorskip("minari")


@pytest.fixture
def root(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return tmp_path


@pytest.fixture
def env():
    made = make_pictures()
    yield made
    made.close()


def same(first, second) -> None:
    if isinstance(first, dict):
        assert first.keys() == second.keys()
        for name in first:
            same(first[name], second[name])
    else:
        np.testing.assert_array_equal(first, second)


def test_plain_minari_loads_what_was_recorded(root, env):
    writer = DatasetWriter(ID, env, author="A. N. Author")
    episodes = [do_episode(env, seed) for seed in (3, 4)]
    assert [writer.add(episode) for episode in episodes] == [0, 1]
    loaded = minari.load_dataset(ID)
    assert (loaded.total_episodes, loaded.total_steps) == (2, 12)
    assert loaded.observation_space == env.observation_space
    assert loaded.storage.metadata["author"] == {"A. N. Author"}
    for found, episode in zip(loaded.iterate_episodes(), episodes, strict=True):
        same(found.observations, episode.observations)
        assert found.observations["image"].shape == (7, 40, 40, 3)
        for name in ("actions", "rewards", "terminations", "truncations"):
            same(getattr(found, name), getattr(episode, name))
        same(found.infos["is_success"], episode.infos["is_success"])
        same(found.infos["reward"]["term"], episode.infos["reward/term"])
        assert [name.decode() for name in found.infos["acted_by"]] == ["human"] * 7


def test_episodes_know_who_and_what(root, env):
    writer = DatasetWriter(ID, env)
    writer.add(do_episode(env, 7))
    (metadata,) = minari.load_dataset(ID).storage.get_episode_metadata([0])
    assert metadata["seed"] == 7
    assert (metadata["operator"], metadata["device"], bool(metadata["success"])) == ("scripted", "dice", True)


@pytest.mark.filterwarnings("ignore:Package spatula-env is not installed")
def test_minari_lists_it_and_makes_the_environment_again(root):
    import gymnasium as gym

    env = gym.make("Spatula/Press-v0", engine="batch")
    DatasetWriter("spatula/press/human-v0", env)
    env.close()
    assert "spatula/press/human-v0" in minari.list_local_datasets()
    again = minari.load_dataset("spatula/press/human-v0").recover_environment()
    assert again.unwrapped.settings.engine == "batch"
    again.close()


def test_minari_filters_and_samples_it(root, env):
    writer = DatasetWriter(ID, env)
    for seed in range(4):
        writer.add(do_episode(env, seed))
    loaded = minari.load_dataset(ID)
    assert loaded.filter_episodes(lambda episode: episode.id % 2 == 0).total_episodes == 2
    assert len(list(loaded.sample_episodes(3))) == 3


def test_going_on_with_a_dataset(root, env):
    DatasetWriter(ID, env).add(do_episode(env, 0))
    writer = DatasetWriter(ID, env)
    assert (writer.total_episodes, writer.total_steps) == (1, 6)
    assert writer.add(do_episode(env, 1)) == 1
    assert minari.load_dataset(ID).total_steps == 12


def test_another_environment_does_not_mix(root, env):
    import gymnasium as gym

    DatasetWriter(ID, env)
    other = gym.make("CartPole-v1")
    with pytest.raises(ValueError, match=r"has episodes of Tests/Pictures-v0, not of CartPole-v1"):
        DatasetWriter(ID, other)
    other.close()


def test_a_malformed_name(root, env):
    for name, better in (
        ("mydata", "mydata-v0"),
        ("no version", "no_version-v0"),
        ("a/b-v0", "b-v0"),
        ("../out-v1", "out-v1"),
        ("spatula/press/", "spatula/press-v0"),
        ("", "my_data-v0"),
    ):
        with pytest.raises(ValueError, match=rf"got {re.escape(repr(name))}: say {better!r}"):
            DatasetWriter(name, env)
        dataset.check_dataset_id(better)
        minari.dataset.minari_dataset.parse_dataset_id(better)
    assert not list(root.iterdir())


def test_a_full_disk_costs_the_episode_only(root, env, monkeypatch):
    writer = DatasetWriter(ID, env)
    writer.add(do_episode(env, 0))
    episode = do_episode(env, 1)
    fsync = os.fsync

    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    # Whichever file it strikes: the episode, the index, the metadata. Renaming syncs a folder, too.
    for good in (0, 2, 3):
        calls = iter(range(100))
        monkeypatch.setattr(
            os, "fsync", lambda file, good=good, calls=calls: full(file) if next(calls) >= good else fsync(file)
        )
        with pytest.raises(DatasetWriteError, match=r"No space left on device.*1 episodes before are intact") as caught:
            writer.add(episode)
        assert caught.value.errno == errno.ENOSPC
        assert minari.load_dataset(ID).total_episodes == 1
        same(next(iter(minari.load_dataset(ID).iterate_episodes())).rewards, do_episode(env, 0).rewards)
    monkeypatch.setattr(os, "fsync", fsync)
    assert writer.add(episode) == 1
    assert minari.load_dataset(ID).total_episodes == 2
    assert not list(root.rglob("*.new"))


FULL = """
import os, resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
from recording_helpers import ID, do_episode, make_pictures
from spatula_env.data import DatasetWriter, DatasetWriteError
env = make_pictures()
writer = DatasetWriter(ID, env)
writer.add(do_episode(env, 0))
resource.setrlimit(resource.RLIMIT_FSIZE, (9000, 9000))
try:
    writer.add(do_episode(env, 1))
except DatasetWriteError as error:
    print(error)
"""


def run(code: str, root: Path, **options) -> subprocess.Popen:
    # Helpers of several folders are beside these.
    paths = [str(Path(spatula_env.__file__).parents[1]), str(Path(__file__).parents[1])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "MINARI_DATASETS_PATH": str(root)}
    return subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, text=True, **options)


def test_the_system_refuses_to_write_more(root):
    program = run(FULL, root)
    said, _ = program.communicate(timeout=120)
    assert "episode 1 could not be written" in said
    assert "File too large" in said
    assert minari.load_dataset(ID).total_episodes == 1


ENDLESS = """
from recording_helpers import ID, do_episode, make_pictures
from spatula_env.data import DatasetWriter
env = make_pictures()
writer = DatasetWriter(ID, env)
seed = writer.total_episodes
while True:
    writer.add(do_episode(env, seed))
    seed += 1
    print(writer.total_episodes, flush=True)
"""


def test_kill_loses_no_more_than_the_running_episode(root, env):
    """Killed at random moments, again and again; what was reported as written is there, whole."""
    generator = random.Random(5)
    reported = 0
    for _ in range(3):
        program = run(ENDLESS, root)
        for _ in range(generator.randint(1, 6)):
            reported = int(program.stdout.readline())
        time.sleep(generator.uniform(0.0, 0.02))
        program.send_signal(signal.SIGKILL)
        rest, _ = program.communicate()
        reported = max([reported, *(int(line) for line in rest.split())])
        loaded = minari.load_dataset(ID)
        assert reported <= loaded.total_episodes <= reported + 1
        reported = loaded.total_episodes
        assert loaded.total_steps == 6 * reported
    for seed, found in enumerate(minari.load_dataset(ID).iterate_episodes()):
        same(found.observations, do_episode(env, seed).observations)


def test_killed_between_any_two_files(root, env, monkeypatch):
    """The dataset is good whichever file was the last to be written."""
    monkeypatch.setattr(dataset, "FIRST_LINKS", 1)
    writer = DatasetWriter(ID, env)
    writer.add(do_episode(env, 0))
    writers = {name: getattr(dataset, name) for name in ("write_file", "append_to_file")}

    class Killed(BaseException):
        pass

    # The episode, the links to more, the index, the metadata.
    for files in range(4):
        left = iter(range(files))

        def stop(*content, name, left=left):
            if next(left, None) is None:
                raise Killed
            writers[name](*content)

        for name in writers:
            monkeypatch.setattr(dataset, name, partial(stop, name=name))
        with pytest.raises(Killed):
            DatasetWriter(ID, env).add(do_episode(env, 9))
        for name, write in writers.items():
            monkeypatch.setattr(dataset, name, write)
        loaded = minari.load_dataset(ID)
        assert loaded.total_episodes == 1
        same(next(iter(loaded.iterate_episodes())).actions, do_episode(env, 0).actions)
    DatasetWriter(ID, env).add(do_episode(env, 1))
    found = list(minari.load_dataset(ID).iterate_episodes())
    same(found[1].actions, do_episode(env, 1).actions)


def test_an_episode_that_was_cut_is_truncated(env):
    recorder = EpisodeRecorder(env)
    recorder.begin(*env.reset(seed=0))
    for _ in range(2):
        recorder.add(np.zeros(3), *env.step(np.zeros(3, dtype=np.float32)))
    np.testing.assert_array_equal(recorder.finish().truncations, [False, True])
    recorder.begin(*env.reset(seed=0))
    with pytest.raises(ValueError, match="a step at least"):
        recorder.finish()


def test_minari_is_named_if_it_is_missing(monkeypatch, env, tmp_path):
    monkeypatch.setitem(sys.modules, "minari", None)
    with pytest.raises(ImportError, match=re.escape(install_hint("data"))):
        DatasetWriter(ID, env, root=tmp_path)


def test_the_limit_of_this_process_is_untouched():
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 9000
