"""Data sets recorded in wrappers: a policy is cloned only from the observations and actions that it will have."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium import wrappers

pytest.importorskip("stable_baselines3")
pytest.importorskip("minari")
pytest.importorskip("h5py")

from spatula_env.data import DatasetWriter, EpisodeRecorder, copy_episodes
from spatula_env.data.wrappers import NEUTRAL, NEUTRAL_OWN, is_neutral
from spatula_env.envs.adapters.masa import LabelsWrapper
from spatula_env.learning import cloning
from spatula_env.learning.commands import clone
from spatula_env.learning.demonstrations import read_minari
from spatula_env.teleop.wrapper import FalconTeleop

PRESS = "Spatula/Press-v0"
NAME = "spatula/press/wrapped-v0"


class Mirror(gymnasium.ActionWrapper, gymnasium.utils.RecordConstructorArgs):
    """A wrapper of the user's own."""

    def __init__(self, env):
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)

    def action(self, action):
        return -action


CHANGING = {
    "RescaleObservation": lambda env: wrappers.RescaleObservation(env, np.float32(-1.0), np.float32(1.0)),
    "RescaleAction": lambda env: wrappers.RescaleAction(env, np.float32(-0.5), np.float32(0.5)),
    "FrameStackObservation": lambda env: wrappers.FrameStackObservation(env, 2),
    "FlattenObservation": wrappers.FlattenObservation,
    "FilterObservation": lambda env: wrappers.FilterObservation(env, ["tool_position", "error"]),
    "AddRenderObservation": lambda env: wrappers.AddRenderObservation(env, render_only=False),
    "Mirror": Mirror,
}


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    return tmp_path


def write(wrap, name=NAME, **options):
    """Record an episode of two steps, each action zero."""
    env = wrap(gymnasium.make(PRESS, engine="batch", max_episode_steps=2, **options))
    recorder = EpisodeRecorder(env, states=False)
    writer = DatasetWriter(name, env)
    recorder.begin(*env.reset(seed=0), 0)
    for _ in range(2):
        action = np.zeros(env.action_space.shape, dtype=env.action_space.dtype)
        recorder.add(action, *env.step(action))
    writer.add(recorder.finish())
    env.close()


def refused(place, capsys, monkeypatch):
    """What is said of the data set."""
    for module, name in ((cloning, "clone"), (cloning, "collect")):
        monkeypatch.setattr(module, name, lambda *_, **__: pytest.fail("something was learnt"))
    before = sorted(place.rglob("*"))
    assert clone.main(["--dataset", NAME, "--gradient-steps", "3", "--output", str(place / "run")]) == 1
    assert sorted(place.rglob("*")) == before
    said = capsys.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    return line


@pytest.mark.parametrize("name", CHANGING)
def test_wrappers_that_change_what_is_seen_or_done_are_refused(name, place, capsys, monkeypatch):
    options = {"obs_mode": "dict"} if name.startswith(("Filter", "Flatten")) else {}
    if name == "AddRenderObservation":
        options = {"render_mode": "rgb_array", "width": 32, "height": 32}
    write(CHANGING[name], **options)
    line = refused(place, capsys, monkeypatch)
    verb = "may change" if name == "Mirror" else "changes"
    assert f"dataset '{NAME}' was recorded with the wrapper {name}, which {verb} what is seen or done" in line
    with pytest.raises(ValueError, match=f"the wrapper {name}, "):
        read_minari(NAME)


def test_all_wrappers_are_named(place, capsys, monkeypatch):
    write(lambda env: CHANGING["RescaleAction"](wrappers.RecordEpisodeStatistics(CHANGING["RescaleObservation"](env))))
    assert "with the wrappers RescaleObservation, RescaleAction, which change " in refused(place, capsys, monkeypatch)


def test_episodes_that_came_later_count_as_well(place, capsys, monkeypatch):
    write(lambda env: env, "spatula/press/bare-v0")
    write(Mirror, "spatula/press/mirrored-v0")
    copy_episodes(["spatula/press/bare-v0", "spatula/press/mirrored-v0"], NAME)
    assert "with the wrapper Mirror, which may change " in refused(place, capsys, monkeypatch)


def test_wrappers_that_change_nothing_are_no_hindrance(place):
    write(lambda env: LabelsWrapper(wrappers.TimeLimit(wrappers.RecordEpisodeStatistics(env), 2)))
    assert clone.main(["--dataset", NAME, "--gradient-steps", "3", "--output", str(place / "run")]) == 0
    assert (place / "run" / "policy" / "model.zip").exists()


def test_what_is_neutral_leaves_spaces_as_they_are():
    known = {name: getattr(wrappers, name) for name in NEUTRAL if hasattr(wrappers, name)}
    assert len(known) >= 8
    for name, found in known.items():
        assert is_neutral(f"{found.__module__}:{name}") and is_neutral(f"gymnasium.wrappers:{name}")
        assert not issubclass(found, gymnasium.ObservationWrapper | gymnasium.ActionWrapper)
        assert not is_neutral(f"elsewhere.wrappers:{name}")
    assert f"{FalconTeleop.__module__}:{FalconTeleop.__qualname__}" in NEUTRAL_OWN
    assert not is_neutral("") and not is_neutral("gymnasium.wrappers")
