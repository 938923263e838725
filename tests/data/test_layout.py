from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from recording_helpers import do_episode, make_pictures

import spatula_env
from spatula_env.data import DatasetWriter, copy_episodes
from spatula_env.data.dataset import read_layout
from spatula_env.data.layout import VECTOR, Layout

pytest.importorskip("minari")
assert spatula_env.TASKS


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"obs_mode": "dict"},
        {"obs_mode": "pointcloud", "control": "velocity_6d"},
        {"reward": "sparse", "control_frequency": 40.0},
    ],
)
def test_every_number_has_a_name_and_is_where_it_is_said_to_be(options) -> None:
    env = gym.make("Spatula/Press-v0", engine="batch", **options)
    layout = Layout.of(env)
    observation, _ = env.reset(seed=3)
    entries = observation if isinstance(observation, dict) else {VECTOR: observation}
    for name, names in layout.observation_names.items():
        assert entries[name].shape[-1] == len(names) == len(set(names))
    entry, columns = layout.find("tool_position")
    np.testing.assert_allclose(entries[entry][columns], env.unwrapped._episodes.situation.tool_position[0], atol=1e-6)
    assert layout.action_names == tuple(env.unwrapped.control.names)
    assert layout.control_frequency == options.get("control_frequency", 20.0)
    assert layout.scene == "seed"
    assert layout.task.startswith("Press the organ")
    assert layout.lerobot_names.keys() == entries.keys()
    assert Layout.from_record(layout.as_record()) == layout
    env.close()


def test_goals_are_called_what_they_are() -> None:
    env = gym.make("Spatula/Press-v0", engine="batch")
    names = Layout.of(env).observation_names[VECTOR]
    assert tuple(name for name in names if name.startswith("goal_")) == tuple(
        f"goal_{name}" for name in env.unwrapped.task.goal_names
    )
    env.close()


def test_a_wrapper_that_makes_something_else_of_it_leaves_no_wrong_names() -> None:
    env = gym.make("Spatula/Press-v0", engine="batch")
    short = gym.wrappers.TransformObservation(env, lambda seen: seen[:5], gym.spaces.Box(-1, 1, (5,)))
    layout = Layout.of(short)
    assert layout.observation_names == {}
    assert layout.find("tool_position") is None
    env.close()


def test_others_have_none_and_copies_keep_it(tmp_path) -> None:
    env = make_pictures()
    assert Layout.of(env) == Layout()
    told = Layout(action_names=("a", "b", "c"), control_frequency=10.0, task="Do it.")
    writer = DatasetWriter("spatula/test/a-v0", env, root=tmp_path, layout=told)
    writer.add(do_episode(env, 0))
    assert read_layout("spatula/test/a-v0", tmp_path) == told
    copy_episodes(["spatula/test/a-v0"], "spatula/test/b-v0", root=tmp_path)
    assert read_layout("spatula/test/b-v0", tmp_path) == told
    env.close()


def test_a_dataset_is_made_again_without_a_window(tmp_path) -> None:
    import minari

    env = gym.make("Spatula/Press-v0", engine="batch")
    env.spec.kwargs["render_mode"] = "human"
    writer = DatasetWriter("spatula/press/seen-v0", env, root=tmp_path)
    spec = minari.MinariDataset(writer.path / "data").spec.env_spec
    assert "render_mode" not in spec.kwargs
    assert spec.kwargs["engine"] == "batch"
    assert env.spec.kwargs["render_mode"] == "human"
    env.close()
