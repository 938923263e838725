"""Datasets of episodes on an organ of one's own: they know which, and are replayed on it wherever it is."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import spatula_env
from spatula_env import cli
from spatula_env.data import replay
from spatula_env.data.dataset import read_layout
from spatula_env.files import checksum
from spatula_env.teleop.recording import record
from spatula_env.teleop.scripted import ScriptedFalcon

sys.path.insert(0, str(Path(__file__).parents[1]))
from own_organs import bean, ellipsoid, written

pytest.importorskip("minari")
assert spatula_env.TASKS

ID = "spatula/press/own-organ-v0"


def record_on(organ: Path, root: Path) -> None:
    with (
        gym.make("Spatula/Press-v0", engine="batch", organ=str(organ), max_episode_steps=4) as env,
        ScriptedFalcon(lambda _: np.array([0.0, 0.0, -0.8]), np.random.default_rng(3)) as device,
    ):
        record(env, device, ID, episodes=1, seed=11, root=root)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Folder of the datasets, and the organ's file."""
    folder = tmp_path_factory.mktemp("own organ")
    organ = Path(written(ellipsoid(divisions=2), folder))
    record_on(organ, folder / "data")
    return folder / "data", organ


def test_the_dataset_knows_its_organ_and_is_replayed_on_it(recorded: tuple[Path, Path]) -> None:
    root, organ = recorded
    assert read_layout(ID, root).organ == checksum(organ)
    assert [episode.matches for episode in replay(ID, root=root)] == [True]


def test_the_organ_may_be_elsewhere_when_it_is_replayed(
    recorded: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root, organ = recorded
    there = tmp_path / "there.npz"
    organ.rename(there)
    try:
        with pytest.raises(FileNotFoundError, match="organ must name the file of the organ on which the episodes were"):
            replay(ID, root=root)
        command = ["replay", ID, "--root", str(root)]
        assert cli.main(command) == 1
        assert "organ must name the file" in capsys.readouterr().err
        assert cli.main([*command, "--organ", str(there), "--json"]) == 0
        assert json.loads(capsys.readouterr().out.splitlines()[-1])["matches"] is True
        assert cli.main([*command, "--organ", str(there), "--by", "states"]) == 1
    finally:
        there.rename(organ)


def test_another_organ_is_refused(recorded: tuple[Path, Path], tmp_path: Path) -> None:
    root, organ = recorded
    other = Path(written(bean(divisions=2), tmp_path))
    with pytest.raises(ValueError, match="organ must be the file on which the episodes were recorded"):
        replay(ID, root=root, organ=other)
    content = organ.read_bytes()
    try:
        organ.write_bytes(other.read_bytes())
        with pytest.raises(ValueError, match=r"has episodes with another .*organ"):
            record_on(organ, root)
    finally:
        organ.write_bytes(content)


def test_episodes_on_the_tasks_own_organ_are_replayed_on_no_other(tmp_path: Path, recorded: tuple[Path, Path]) -> None:
    with (
        gym.make("Spatula/Press-v0", engine="batch", max_episode_steps=4) as env,
        ScriptedFalcon(lambda _: np.array([0.0, 0.0, -0.8]), np.random.default_rng(3)) as device,
    ):
        record(env, device, ID, episodes=1, seed=11, root=tmp_path)
    assert read_layout(ID, tmp_path).organ == ""
    with pytest.raises(ValueError, match="organ must be None: the episodes are of the task's own organ"):
        replay(ID, root=tmp_path, organ=recorded[1])
