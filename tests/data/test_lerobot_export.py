"""The export, with a stand-in for LeRobot, and with LeRobot itself where that is installed."""

from __future__ import annotations

import json
import re
import sys
from importlib.util import find_spec
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from demonstration_helpers import ID, LAYOUT, LENGTHS, NAMES, make_episode, write_dataset
from gymnasium import spaces

from spatula_env.data.drawing import recorded_moments, recorded_scene
from spatula_env.data.layout import Layout
from spatula_env.data.lerobot_export import CAMERA, export_lerobot, make_columns
from spatula_env.data.replaying import open_dataset
from spatula_env.installing import install_hint

pytest.importorskip("minari")


class StandIn:
    """Takes what LeRobot takes, and refuses what it refuses."""

    made: Any = None

    @classmethod
    def create(cls, repo_id, fps, features, root, robot_type, use_videos):
        self = cls()
        self.arguments = {"repo_id": repo_id, "fps": fps, "robot_type": robot_type, "use_videos": use_videos}
        self.features, self.root = features, root
        (root / "meta").mkdir(parents=True)
        self.episodes: list[list[dict]] = []
        self.frames: list[dict] = []
        self.finalized = False
        StandIn.made = self
        return self

    def add_frame(self, frame):
        assert set(frame) == {*self.features, "task"}
        for name, feature in self.features.items():
            value = frame[name]
            assert value.shape == feature["shape"], name
            assert value.dtype == ("uint8" if feature["dtype"] in ("image", "video") else feature["dtype"]), name
        self.frames.append(frame)

    def save_episode(self):
        self.episodes.append(self.frames)
        self.frames = []

    def finalize(self):
        self.finalized = True


@pytest.fixture
def lerobot(monkeypatch):
    module = ModuleType("lerobot.datasets.lerobot_dataset")
    module.LeRobotDataset = StandIn
    for name in ("lerobot", "lerobot.datasets"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, module.__name__, module)


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    folder = tmp_path_factory.mktemp("datasets")
    write_dataset(folder)
    return folder


def test_frames_are_what_was_seen_and_done(lerobot, root, tmp_path) -> None:
    done = export_lerobot(ID, tmp_path / "out", root=root)
    made = StandIn.made
    assert (done.episodes, done.frames, done.repo_id) == (3, sum(LENGTHS), "spatula/press-made_up-v0")
    assert made.finalized
    assert made.arguments["fps"] == 20
    assert made.arguments["use_videos"] is False
    assert made.features["observation.state"] == {"dtype": "float32", "shape": (4,), "names": list(NAMES)}
    assert made.features["action"]["names"] == list(LAYOUT.action_names)
    for number, frames in enumerate(made.episodes):
        wanted = make_episode(number)
        assert len(frames) == LENGTHS[number]
        np.testing.assert_array_equal([frame["observation.state"] for frame in frames], wanted.observations[:-1])
        np.testing.assert_array_equal([frame["action"] for frame in frames], wanted.actions)
        assert [float(frame["next.reward"][0]) for frame in frames] == wanted.rewards.tolist()
        assert [bool(frame["next.done"][0]) for frame in frames] == [False] * (LENGTHS[number] - 1) + [True]
        assert bool(frames[-1]["next.success"][0]) is (number % 2 == 0)
        assert {frame["task"] for frame in frames} == {LAYOUT.task}


def test_what_has_no_place_there_is_beside_it(lerobot, root, tmp_path) -> None:
    export_lerobot(ID, tmp_path / "out", root=root)
    notes = json.loads((tmp_path / "out" / "meta" / "spatula_env.json").read_text())
    assert notes["env_id"] == "Spatula/Press-v0"
    assert [each["operator"] for each in notes["episodes"]] == ["scripted", "human", "scripted"]
    assert [each["seed"] for each in notes["episodes"]] == [10, 11, 12]
    assert [each["success"] for each in notes["episodes"]] == [True, False, True]


def test_a_choice(lerobot, root, tmp_path) -> None:
    assert export_lerobot(ID, tmp_path / "a", root=root, successes_only=True).episodes == 2
    assert export_lerobot(ID, tmp_path / "b", root=root, episodes=[1], repo_id="me/mine").repo_id == "me/mine"
    with pytest.raises(ValueError, match="0 to 2, got 3"):
        export_lerobot(ID, tmp_path / "c", root=root, episodes=[3])
    with pytest.raises(ValueError, match="nothing to write"):
        export_lerobot(ID, tmp_path / "c", root=root, episodes=[1], successes_only=True)
    with pytest.raises(FileExistsError, match="exists already"):
        export_lerobot(ID, tmp_path / "a", root=root)
    assert not (tmp_path / "c").exists()


def test_half_a_dataset_is_none(lerobot, root, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(StandIn, "save_episode", lambda self: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        export_lerobot(ID, tmp_path / "out", root=root)
    assert list(tmp_path.iterdir()) == []


def test_pictures_are_drawn_from_states(lerobot, tmp_path) -> None:
    scene = recorded_scene(LAYOUT)
    write_dataset(tmp_path, episodes=1, nodes=scene.organs[0].vertices)
    export_lerobot(ID, tmp_path / "out", root=tmp_path, camera=(48, 64))
    made = StandIn.made
    assert made.arguments["use_videos"] is True
    assert made.features[CAMERA]["shape"] == (48, 64, 3)
    first, *_, last = (frame[CAMERA] for frame in made.episodes[0])
    assert first.std() > 10.0
    assert (first != last).any()


def test_without_states_nothing_can_be_drawn(lerobot, root, tmp_path) -> None:
    with pytest.raises(ValueError, match="without states"):
        export_lerobot(ID, tmp_path / "out", root=root, camera=(48, 64))
    assert not (tmp_path / "out").exists()


def test_only_scenes_of_this_package_are_made() -> None:
    for name in ("", "os", "Scene_", "__doc__"):
        with pytest.raises(ValueError, match="must name a scene"):
            recorded_scene(Layout(scene=name))


def test_randomised_tools_are_drawn_as_large_as_they_were() -> None:
    nodes, tools = np.zeros((3, 4, 3)), np.zeros((3, 1, 7))
    infos = {"state": {"nodes": nodes, "tools": tools}, "randomization": {"tool_size": np.full(3, 1.25)}}
    moments = list(recorded_moments(SimpleNamespace(infos=infos)))
    assert [moment.tool_scale for moment in moments] == [1.25] * 3


def test_pictures_and_clouds() -> None:
    space = spaces.Dict(
        {
            "image": spaces.Box(0, 255, (40, 50, 3), np.uint8),
            "organ": spaces.Box(-1.0, 1.0, (256, 3), np.float32),
            "state": spaces.Box(-1.0, 1.0, (2,), np.float32),
        }
    )
    layout = Layout(
        observation_names={"state": ("a", "b")},
        lerobot_names={"image": CAMERA, "organ": "observation.points.organ", "state": "observation.state"},
    )
    actions = spaces.Box(-1.0, 1.0, (3,))
    features = make_columns(space, actions, layout).features
    assert (features[CAMERA]["dtype"], features[CAMERA]["shape"]) == ("video", (40, 50, 3))
    assert features["observation.points.organ"] == {"dtype": "float32", "shape": (256, 3), "names": None}
    assert features["observation.state"]["names"] == ["a", "b"]
    assert make_columns(space, actions, layout, videos=False).features[CAMERA]["dtype"] == "image"


def test_what_lerobot_cannot_take(lerobot, tmp_path) -> None:
    write_dataset(tmp_path, "spatula/press/nameless-v0", layout=Layout(control_frequency=20.0))
    with pytest.raises(ValueError, match="what LeRobot calls 'observation'"):
        export_lerobot("spatula/press/nameless-v0", tmp_path / "out", root=tmp_path)
    record = {**LAYOUT.as_record(), "control_frequency": 12.5}
    write_dataset(tmp_path, "spatula/press/odd-v0", layout=Layout.from_record(record))
    with pytest.raises(ValueError, match="whole number of control steps"):
        export_lerobot("spatula/press/odd-v0", tmp_path / "out", root=tmp_path)


def test_lerobot_is_named_if_it_is_missing(monkeypatch, root, tmp_path) -> None:
    monkeypatch.setitem(sys.modules, "lerobot", None)
    with pytest.raises(ImportError, match=r"Python 3\.12.*" + re.escape(install_hint("lerobot"))):
        export_lerobot(ID, tmp_path / "out", root=root)


# Reading back what LeRobot itself has written, with PyArrow and with LeRobot.


def with_lerobot(test):
    """Marks a test that needs LeRobot."""
    reason = "LeRobot is not installed: it needs an environment of its own with Python 3.12 or later"
    test = pytest.mark.skipif(find_spec("lerobot") is None, reason=reason)(test)
    return pytest.mark.filterwarnings("default")(pytest.mark.lerobot(test))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    root = tmp_path_factory.mktemp("datasets")
    write_dataset(root)
    return root, export_lerobot(ID, root / "out", root=root)


@with_lerobot
def test_the_files_are_those_of_version_3(written) -> None:
    _, done = written
    info = json.loads((done.path / "meta" / "info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (3, sum(LENGTHS), 20)
    assert info["features"]["observation.state"]["names"] == list(NAMES)
    for file in ("stats.json", "tasks.parquet", "episodes/chunk-000/file-000.parquet", "spatula_env.json"):
        assert (done.path / "meta" / file).is_file()


@with_lerobot
def test_pyarrow_reads_the_frames(written) -> None:
    from pyarrow import parquet

    _, done = written
    table = parquet.read_table(done.path / "data" / "chunk-000" / "file-000.parquet").to_pydict()
    assert table["episode_index"] == [number for number, length in enumerate(LENGTHS) for _ in range(length)]
    assert table["frame_index"] == [step for length in LENGTHS for step in range(length)]
    np.testing.assert_allclose(table["timestamp"], np.array(table["frame_index"]) / 20.0)
    wanted = [make_episode(number) for number in range(3)]
    np.testing.assert_array_equal(
        table["observation.state"], np.concatenate([each.observations[:-1] for each in wanted])
    )
    np.testing.assert_array_equal(table["action"], np.concatenate([each.actions for each in wanted]))
    np.testing.assert_array_equal(table["next.reward"], np.concatenate([each.rewards for each in wanted]))
    assert sum(table["next.success"]) == 2
    (task,) = parquet.read_table(done.path / "meta" / "tasks.parquet").to_pylist()
    assert LAYOUT.task in task.values()


@with_lerobot
def test_lerobot_reads_it(written) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    root, done = written
    dataset = LeRobotDataset(done.repo_id, root=done.path)
    assert (len(dataset), dataset.num_episodes) == (sum(LENGTHS), 3)
    assert dataset[0]["task"] == LAYOUT.task
    (second,) = open_dataset(ID, root).iterate_episodes([1])
    np.testing.assert_array_equal(dataset[LENGTHS[0] + 2]["action"].numpy(), second.actions[2])
