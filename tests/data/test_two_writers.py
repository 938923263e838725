"""Several programs write into one dataset: no episode is lost, and none is there twice."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from recording_helpers import ID, do_episode, make_pictures

import spatula_env
from spatula_env.data import DatasetWriter, copy_episodes, list_datasets
from spatula_env.data.dataset import dataset_folder
from spatula_env.data.files import DatasetBusy, recording_lock
from spatula_env.data.index import read_index
from spatula_env.files import check_can_write
from spatula_env.teleop.recording import record
from spatula_env.teleop.scripted import ScriptedOperator
from spatula_env.teleop.scripted_dataset import make_scripted

minari = pytest.importorskip("minari")

WRITER = """
import sys
from recording_helpers import ID, do_episode, make_pictures
from spatula_env.data import DatasetWriter
env = make_pictures()
writer = DatasetWriter(ID, env, author=sys.argv[1])
for seed in range(int(sys.argv[2]), int(sys.argv[3])):
    writer.add(do_episode(env, seed))
    print(seed, flush=True)
"""
HOLDER = """
import sys, time
from pathlib import Path
from spatula_env.data.files import recording_lock
with recording_lock(Path(sys.argv[1]), "x"):
    print("held", flush=True)
    time.sleep(600)
"""


def run(code: str, root: Path, *words: object) -> subprocess.Popen[str]:
    # Helpers of several folders are beside these.
    paths = [str(Path(spatula_env.__file__).parents[1]), str(Path(__file__).parents[1])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "MINARI_DATASETS_PATH": str(root)}
    words = tuple(map(str, words))
    return subprocess.Popen([sys.executable, "-c", code, *words], env=environment, stdout=subprocess.PIPE, text=True)


def seeds(root: Path) -> list[int]:
    dataset = minari.MinariDataset(dataset_folder(ID, root) / "data")
    found = [each["seed"] for each in dataset.storage.get_episode_metadata(range(dataset.total_episodes))]
    assert [entry.seed for entry in read_index(dataset_folder(ID, root) / "data")] == found
    return found


def test_two_programs_write_at_the_same_time(tmp_path) -> None:
    programs = [run(WRITER, tmp_path, name, start, start + 20) for name, start in (("Ada", 0), ("Ben", 100))]
    for program in programs:
        program.communicate(timeout=200)
        assert program.returncode == 0
    found = seeds(tmp_path)
    assert sorted(found) == [*range(20), *range(100, 120)]
    # Each in its order, and each with its author.
    assert [seed for seed in found if seed < 100] == [*range(20)]
    entries = read_index(dataset_folder(ID, tmp_path) / "data")
    assert all(entry.attributes["author"] == ("Ada" if entry.seed < 100 else "Ben") for entry in entries)
    assert minari.MinariDataset(dataset_folder(ID, tmp_path) / "data").storage.metadata["author"] == {"Ada", "Ben"}
    env = make_pictures()
    dataset = minari.MinariDataset(dataset_folder(ID, tmp_path) / "data")
    for seed, episode in zip(found, dataset.iterate_episodes(), strict=True):
        np.testing.assert_array_equal(episode.actions, do_episode(env, seed).actions)
    env.close()


def test_two_programs_one_of_which_is_killed(tmp_path) -> None:
    generator = random.Random(11)
    told: set[int] = set()
    for turn in range(3):
        programs = [run(WRITER, tmp_path, "x", start, start + 1000) for start in (10000 * turn, 10000 * turn + 5000)]
        for program in programs:
            for _ in range(generator.randint(1, 4)):
                told.add(int(program.stdout.readline()))
        time.sleep(generator.uniform(0.0, 0.02))
        for program in programs:
            program.send_signal(signal.SIGKILL)
        for program in programs:
            rest, _ = program.communicate()
            told |= {int(line) for line in rest.splitlines() if line}
    found = seeds(tmp_path)
    assert len(set(found)) == len(found)
    # What was told is there; of each program one episode more may be.
    assert told <= set(found)
    assert len(found) <= len(told) + 6


@pytest.fixture
def env():
    made = gym.make("Spatula/Press-v0", engine="batch", max_episode_steps=3)
    yield made
    made.close()


def dive(_) -> np.ndarray:
    return np.array([0.05, 0.0, -0.8], dtype=np.float32)


def test_two_recordings_at_the_same_time(env, tmp_path) -> None:
    name = "spatula/press/test-v0"
    refused: list[str] = []

    def another(*_) -> None:
        with ScriptedOperator(dive) as device, pytest.raises(DatasetBusy, match="is recording into") as caught:
            record(env, device, name, root=tmp_path, real_time=False)
        refused.append(str(caught.value))
        with pytest.raises(DatasetBusy):
            make_scripted(
                "Spatula/Press-v0",
                lambda _: dive,
                dataset_id=name,
                root=tmp_path,
                options={"engine": "batch", "max_episode_steps": 3},
            )

    with ScriptedOperator(dive) as device:
        summary = record(env, device, name, root=tmp_path, episodes=2, progress=another, real_time=False)
        assert "spatula datasets merge" in refused[0]
        assert (summary.recorded, summary.total_episodes) == (2, 2)
        assert record(env, device, name, root=tmp_path, total=3, real_time=False).recorded == 1
        assert record(env, device, name, root=tmp_path, total=3, real_time=False).recorded == 0


def test_a_program_that_is_killed_holds_nothing(tmp_path) -> None:
    folder = tmp_path / "spatula" / "x-v0"
    holder = run(HOLDER, tmp_path, folder)
    assert holder.stdout.readline() == "held\n"
    with pytest.raises(DatasetBusy), recording_lock(folder, "x"):
        pass
    holder.kill()
    holder.communicate()
    with recording_lock(folder, "x"):
        pass


def test_a_lock_leaves_nothing_behind(tmp_path) -> None:
    folder = tmp_path / "datasets" / "spatula" / "x-v0"
    with recording_lock(folder, "x"):
        assert folder.exists()
    assert list(tmp_path.iterdir()) == []


def test_a_copy_is_there_whole_or_not_at_all(tmp_path, monkeypatch) -> None:
    env = make_pictures()
    for name in ("a", "b"):
        writer = DatasetWriter(f"spatula/test/{name}-v0", env, root=tmp_path, author=name)
        for seed in range(2):
            writer.add(do_episode(env, seed))
    env.close()
    sources = ["spatula/test/a-v0", "spatula/test/b-v0"]
    before = sorted(tmp_path.rglob("*"))
    add, count = DatasetWriter.add, iter(range(10))

    def interrupted(self, episode):
        if next(count) == 3:
            raise KeyboardInterrupt
        return add(self, episode)

    monkeypatch.setattr(DatasetWriter, "add", interrupted)
    with pytest.raises(KeyboardInterrupt):
        copy_episodes(sources, "spatula/test/all-v0", root=tmp_path)
    assert sorted(tmp_path.rglob("*")) == before
    monkeypatch.setattr(DatasetWriter, "add", add)
    # What a program that was killed has left does not count.
    left = tmp_path / "spatula" / "test" / ".all-v0.new" / "data"
    left.mkdir(parents=True)
    (left / "metadata.json").write_text("{")
    assert list_datasets(tmp_path) == sources
    found = copy_episodes(sources, "spatula/test/all-v0", root=tmp_path)
    assert found.authors == {"a": 2, "b": 2}
    assert list_datasets(tmp_path) == [sources[0], "spatula/test/all-v0", sources[1]]
    assert not left.exists()


class TestPlaces:
    def test_a_file_where_a_folder_is_to_be(self, env, tmp_path) -> None:
        (tmp_path / "file").write_text("")
        env.reset = None
        with ScriptedOperator(dive) as device, pytest.raises(OSError, match="is no folder"):
            record(env, device, "spatula/press/x-v0", root=tmp_path / "file", real_time=False)

    @pytest.mark.skipif(os.name == "nt", reason="other rights")
    @pytest.mark.parametrize("there", [False, True])
    def test_a_place_without_the_right_to_write(self, tmp_path, there, plain_user) -> None:
        env = make_pictures()
        if there:
            DatasetWriter(ID, env, root=tmp_path)
        for folder in (tmp_path, *tmp_path.rglob("*")):
            folder.chmod(0o555 if folder.is_dir() else 0o444)
        with plain_user(), pytest.raises(OSError, match="permission denied"):
            DatasetWriter(ID, env, root=tmp_path)
        env.close()

    @pytest.fixture
    def plain_user(self, tmp_path):
        from contextlib import contextmanager

        @contextmanager
        def dropped():
            """Root may write everywhere."""
            root = os.geteuid() == 0
            if root:
                os.chmod(tmp_path.parent, 0o755)
                for folder in (tmp_path.parents[1], tmp_path.parents[2]):
                    os.chmod(folder, folder.stat().st_mode | 0o055)
                os.seteuid(65534)
            try:
                yield
            finally:
                if root:
                    os.seteuid(0)

        yield dropped
        for folder in (tmp_path, *tmp_path.rglob("*")):
            folder.chmod(0o755)

    def test_nothing_is_left(self, tmp_path) -> None:
        check_can_write(tmp_path / "a" / "b")
        assert not list(tmp_path.iterdir())


def test_the_index_is_made_for_datasets_that_have_none(tmp_path) -> None:
    env = make_pictures()
    writer = DatasetWriter(ID, env, root=tmp_path)
    for seed in range(3):
        writer.add(do_episode(env, seed))
    data = writer.path / "data"
    expected = read_index(data)
    metadata = json.loads((data / "metadata.json").read_text())
    for name in ("index_bytes", "links", "env_specs"):
        del metadata["spatula_env"][name]
    (data / "metadata.json").write_text(json.dumps(metadata))
    (data / "index.jsonl").unlink()
    assert read_index(data) == expected
    DatasetWriter(ID, env, root=tmp_path).add(do_episode(env, 3))
    assert read_index(data)[:3] == expected
    assert seeds(tmp_path) == [0, 1, 2, 3]
    env.close()
