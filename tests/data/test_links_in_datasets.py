"""Links that lead out of a dataset are neither read nor written through."""

from __future__ import annotations

import json
import os
import pickle
import shutil

import numpy as np
import pytest
from recording_helpers import ID, do_episode, make_pictures

from spatula_env.cli.main import main
from spatula_env.data import DatasetWriter, copy_episodes, summarize
from spatula_env.data.files import DatasetDamaged
from spatula_env.data.replaying import open_dataset, read_entries, recorded_states, replay
from spatula_env.data.statistics import statistics

h5py = pytest.importorskip("h5py", reason="pip install 'spatula-env[data]'")
pytest.importorskip("minari", reason="pip install 'spatula-env[data]'")
from spatula_env.data import reading  # noqa: E402 - it loads Minari

pytestmark = pytest.mark.skipif(os.name != "posix", reason="links need no permission on POSIX")
SECRET = b"a private key" * 20
OTHER = "spatula/test/other-v0"


@pytest.fixture
def root(tmp_path):
    """A dataset with one episode, and private files beside it."""
    place = tmp_path / "datasets"
    env = make_pictures()
    DatasetWriter(ID, env, root=place).add(do_episode(env, 0))
    env.close()
    (tmp_path / "home" / "data").mkdir(parents=True)
    (tmp_path / "home" / "key").write_bytes(SECRET)
    (tmp_path / "home" / "data" / "work").write_bytes(SECRET)
    yield place
    assert sorted(path.name for path in (tmp_path / "home").rglob("*")) == ["data", "key", "work"]
    assert (tmp_path / "home" / "key").read_bytes() == (tmp_path / "home" / "data" / "work").read_bytes() == SECRET


@pytest.mark.parametrize("command", ["merge", "drop-failures"])
@pytest.mark.parametrize("name", [".other-v0.new", ".other-v0.new/data", "other-v0/data"])
def test_a_copy_touches_nothing_behind_a_link(root, tmp_path, command, name, capsys):
    link = root / "spatula" / "test" / name
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(tmp_path / "home")
    assert main(["datasets", command, ID, "--into", OTHER, "--root", str(root)]) == 1
    assert f"{link} is a link" in capsys.readouterr().err
    assert not (root / OTHER / "data" / "metadata.json").exists()


@pytest.mark.parametrize(
    "name", ["data", "data/episodes", "data/index.jsonl", "data/metadata.json", "data/main_data.hdf5"]
)
@pytest.mark.parametrize("dangling", [False, True])
def test_a_link_in_the_folder_is_neither_read_nor_written_through(root, tmp_path, name, dangling):
    place, moved = root / ID / name, tmp_path / "moved"
    if dangling:
        shutil.rmtree(place) if place.is_dir() else place.unlink()
    else:
        shutil.move(place, moved)
    before = {path: path.read_bytes() for path in moved.rglob("*") if path.is_file()}
    place.symlink_to(moved)
    env = make_pictures()
    episode = do_episode(env, 1)
    for call in (
        lambda: DatasetWriter(ID, env, root=root).add(episode),
        lambda: summarize(ID, root),
        lambda: open_dataset(ID, root),
        lambda: copy_episodes([ID], OTHER, root=root),
    ):
        with pytest.raises((DatasetDamaged, FileNotFoundError)):
            call()
    with pytest.raises(DatasetDamaged, match="is a link"):
        DatasetWriter(ID, env, root=root)
    env.close()
    assert {path: path.read_bytes() for path in moved.rglob("*") if path.is_file()} == before
    assert dangling != moved.exists()


def test_a_link_that_comes_later_is_not_written_through(root, tmp_path):
    env = make_pictures()
    writer = DatasetWriter(ID, env, root=root)
    shutil.move(root / ID / "data" / "episodes", tmp_path / "moved")
    (root / ID / "data" / "episodes").symlink_to(tmp_path / "moved")
    with pytest.raises(DatasetDamaged, match="is a link"):
        writer.add(do_episode(env, 1))
    env.close()
    assert len(list((tmp_path / "moved").iterdir())) == 1


def test_files_that_are_being_written_go_through_no_link(root, tmp_path):
    env = make_pictures()
    writer = DatasetWriter(ID, env, root=root)
    for folder, name in (("data", "metadata.json"), ("data", "main_data.hdf5"), ("data/episodes", "000001.hdf5")):
        for link in (f".{name}.new", f".{name}.{os.getpid()}.new"):
            (root / ID / folder / link).symlink_to(tmp_path / "home" / "key")
    (root / ID / "data" / "episodes" / "000001.hdf5").symlink_to(tmp_path / "home" / "key")
    assert writer.add(do_episode(env, 1)) == 1
    # Nor does what a killed program may have left, when it is removed.
    assert DatasetWriter(ID, env, root=root).add(do_episode(env, 2)) == 2
    assert not list((root / ID).rglob("*.new"))
    env.close()


def spoil(root, change):
    """Change the episode in its file, and record the new length, as an attacker who wants it to be read would."""
    data = root / ID / "data"
    file = data / "episodes" / "000000.hdf5"
    with h5py.File(file, "a") as episode:
        change(episode)
    line = json.loads((data / "index.jsonl").read_text())
    content = json.dumps({**line, "size": file.stat().st_size}).encode() + b"\n"
    (data / "index.jsonl").write_bytes(content)
    metadata = json.loads((data / "metadata.json").read_text())
    metadata["spatula_env"]["index_bytes"] = len(content)
    (data / "metadata.json").write_text(json.dumps(metadata))


def external(home):
    return lambda file: file["infos"].create_dataset("x", (7, 16), "u1", external=[(str(home / "key"), 0, 112)])


def linked(home):
    def change(file):
        del file["actions"]
        file["actions"] = h5py.ExternalLink(str(home / "secret.hdf5"), "/a")

    return change


def nested(home):
    def change(file):
        file["infos"].create_group("a/b")["c"] = h5py.ExternalLink(str(home / "secret.hdf5"), "/a")

    return change


def virtual(home):
    def change(file):
        layout = h5py.VirtualLayout((7, 3), "f8")
        layout[:] = h5py.VirtualSource(str(home / "secret.hdf5"), "a", (7, 3))
        file["infos"].create_virtual_dataset("x", layout)

    return change


def soft(_):
    def change(file):
        file["infos/x"] = h5py.SoftLink("/rewards")

    return change


@pytest.mark.parametrize("kind", [external, linked, nested, virtual, soft])
@pytest.mark.parametrize("index", [True, False])
def test_an_episode_that_shows_another_file_is_not_read(root, tmp_path, kind, index):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "key").write_bytes(SECRET)
    with h5py.File(elsewhere / "secret.hdf5", "w") as file:
        file["a"] = np.zeros((7, 3))
    spoil(root, kind(elsewhere))
    if not index:
        file = root / ID / "data" / "metadata.json"
        metadata = json.loads(file.read_text())
        del metadata["spatula_env"]["index_bytes"]
        file.write_text(json.dumps(metadata))
        with pytest.raises(DatasetDamaged, match=r"has a link in place of|in another file"):
            read_entries(ID, root)
    for call in (
        lambda dataset: list(dataset.iterate_episodes()),
        lambda dataset: dataset[0],
        lambda dataset: dataset.sample_episodes(1),
        lambda dataset: dataset.filter_episodes(lambda _: True),
        lambda dataset: list(pickle.loads(pickle.dumps(dataset))),
        lambda dataset: list(dataset.storage.get_episode_metadata([0])),
        lambda dataset: list(dataset.storage.apply(len)),
        lambda dataset: dataset.storage.update_episode_metadata([{"a": 1}]),
        lambda _: replay(ID, root=root),
        lambda _: list(recorded_states(ID, root=root)),
        lambda _: statistics(ID, root=root),
        lambda _: copy_episodes([ID], OTHER, root=root),
    ):
        with pytest.raises(DatasetDamaged, match=r"has a link in place of|in another file"):
            call(open_dataset(ID, root))
    assert not (root / OTHER).exists()


def test_an_episode_is_checked_when_it_is_first_read(root, monkeypatch):
    env = make_pictures()
    writer = DatasetWriter(ID, env, root=root)
    for seed in (1, 2):
        writer.add(do_episode(env, seed))
    env.close()
    checked = []
    check = reading.check_episode_file

    def watch(data, name):
        checked.append(name)
        check(data, name)

    monkeypatch.setattr(reading, "check_episode_file", watch)
    dataset = open_dataset(ID, root)
    assert checked == []
    for _ in range(2):
        assert [each["seed"] for each in dataset.storage.get_episode_metadata([2])] == [2]
        assert len(dataset[2].rewards) == 6
    assert checked == ["episodes/000002.hdf5"]
    assert dataset.total_steps == sum(len(episode) for episode in dataset.iterate_episodes())
    assert sorted(checked) == [f"episodes/00000{number}.hdf5" for number in range(3)]
    # What has become a link since it was opened is not followed, either.
    dataset = open_dataset(ID, root)
    file = root / ID / "data" / "episodes" / "000001.hdf5"
    shutil.move(file, root / "moved.hdf5")
    file.symlink_to(root / "moved.hdf5")
    with pytest.raises(DatasetDamaged, match="is a link"):
        dataset[1]


@pytest.mark.parametrize("name", ["..\\x.hdf5", "C:x.hdf5", "\\x.hdf5", "\\\\server\\x.hdf5", "a/../../x.hdf5"])
def test_no_system_reads_a_path_as_one_out_of_the_folder(root, name):
    with h5py.File(root / ID / "data" / "main_data.hdf5", "w") as main:
        main["episode_0"] = h5py.ExternalLink(name, "/")
    with pytest.raises(DatasetDamaged, match="no part of the dataset"):
        open_dataset(ID, root)


def test_an_episode_in_the_current_folder_is_none_of_the_dataset(root, tmp_path, monkeypatch):
    here = tmp_path / "here" / "episodes"
    here.mkdir(parents=True)
    shutil.move(root / ID / "data" / "episodes" / "000000.hdf5", here)
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(DatasetDamaged, match="episode 0 is missing"):
        open_dataset(ID, root)


def test_what_is_whole_is_read(root):
    assert open_dataset(ID, root).total_episodes == 1
    assert copy_episodes([ID], OTHER, root=root).episodes == 1
