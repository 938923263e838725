"""Episodes of a dataset come from the same environment, which can be made again."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from recording_helpers import ID, make_pictures

import spatula_env
from spatula_env.data import DatasetWriter, copy_episodes, replay
from spatula_env.data.dataset import check_target
from spatula_env.data.replaying import open_dataset, read_entries, recorded_specs
from spatula_env.data.specs import differences, make_recorded, storable_spec
from spatula_env.teleop.recording import record
from spatula_env.teleop.scripted import ScriptedOperator

pytest.importorskip("minari")
assert spatula_env.TASKS

PRESS = "spatula/press/test-v0"


def make(**options):
    return gym.make("Spatula/Press-v0", engine="batch", max_episode_steps=4, **options)


def dive(_) -> np.ndarray:
    return np.array([0.05, 0.0, -0.8], dtype=np.float32)


def record_once(env, root, **options):
    with ScriptedOperator(dive) as device:
        return record(env, device, PRESS, root=root, real_time=False, **options)


class Typed(gym.Wrapper, gym.utils.RecordConstructorArgs):
    def __init__(self, env, kind):
        gym.utils.RecordConstructorArgs.__init__(self, kind=kind)
        super().__init__(env)


def test_other_options_are_refused_by_name(tmp_path) -> None:
    first, second = make(), make(control_frequency=10, randomization="default")
    record_once(first, tmp_path)
    with pytest.raises(ValueError, match="differ in") as caught:
        record_once(second, tmp_path)
    said = str(caught.value)
    assert "control_frequency (10 here, 20.0 there)" in said
    assert "randomization (default here, none there)" in said
    assert "engine" not in said
    assert open_dataset(PRESS, tmp_path).total_episodes == 1
    assert all(each.matches for each in replay(PRESS, root=tmp_path))
    for env in (first, second):
        env.close()


def test_other_observations_are_refused_by_option(tmp_path) -> None:
    first, second = make(), make(obs_mode="dict")
    DatasetWriter(PRESS, first, root=tmp_path)
    with pytest.raises(ValueError, match=r"another observation space, as the options differ in obs_mode \(dict here"):
        DatasetWriter(PRESS, second, root=tmp_path)
    for env in (first, second):
        env.close()


def test_what_means_the_same_is_the_same(tmp_path) -> None:
    """Explicit default values, options of rendering and NumPy numbers make no difference."""
    first, second = make(), make(control_frequency=np.float64(20.0), width=np.int64(64), render_mode="rgb_array")
    assert differences(storable_spec(first), storable_spec(second)) == []
    DatasetWriter(PRESS, second, root=tmp_path)
    check_target(PRESS, first, tmp_path)
    for env in (first, second):
        env.close()


def test_the_engine_is_kept_by_name() -> None:
    env = gym.make("Spatula/Press-v0", max_episode_steps=4)
    assert storable_spec(env).kwargs["engine"] == env.unwrapped.settings.engine
    env.close()


@pytest.mark.parametrize(
    ("wrap", "message"),
    [
        (
            lambda env: gym.wrappers.TransformReward(env, lambda reward: 2 * reward),
            r"argument func of the wrapper Transf",
        ),
        (
            lambda env: gym.wrappers.TransformObservation(env, np.copy, env.observation_space),
            "argument func of the wrapper TransformObservation",
        ),
        (lambda env: type("Mute", (gym.Wrapper,), {})(env), "wrapper Mute, which does not tell its arguments"),
        (lambda env: Typed(env, kind=np.float32), "argument kind of the wrapper Typed"),
    ],
)
def test_what_json_cannot_keep_is_refused_at_the_start(tmp_path, wrap, message) -> None:
    made = make()
    env = wrap(made)
    # A reset or a step would fail the test.
    env.reset = env.step = None
    with pytest.raises(ValueError, match=message) as caught:
        record_once(env, tmp_path)
    assert "RecordConstructorArgs" in str(caught.value)
    assert not list(tmp_path.iterdir())
    made.close()


def test_an_environment_that_is_registered_by_its_class(tmp_path) -> None:
    from recording_helpers import Pictures

    gym.register("Tests/ByClass-v0", entry_point=Pictures)
    try:
        env = gym.make("Tests/ByClass-v0", disable_env_checker=True)
        assert storable_spec(env).entry_point == "recording_helpers:Pictures"
        DatasetWriter(ID, env, root=tmp_path)
        env.close()
    finally:
        del gym.registry["Tests/ByClass-v0"]


def test_merged_episodes_keep_their_options_and_authors(tmp_path) -> None:
    """Datasets of other options may be joined, and each episode is repeated with its own."""
    names = ["spatula/press/a-v0", "spatula/press/b-v0"]
    for name, author, options in zip(
        names, ("Ada", "Ben"), ({}, {"max_force": 0.1, "control": "velocity"}), strict=True
    ):
        env = make(**options)
        with ScriptedOperator(dive) as device:
            record(env, device, name, root=tmp_path, author=author, real_time=False)
        env.close()
    found = copy_episodes(names, "spatula/press/both-v0", root=tmp_path)
    assert found.authors == {"Ada": 1, "Ben": 1}
    assert [spec.kwargs.get("max_force") for spec in recorded_specs("spatula/press/both-v0", tmp_path)] == [None, 0.1]
    assert [each.matches for each in replay("spatula/press/both-v0", root=tmp_path)] == [True, True]
    assert open_dataset("spatula/press/both-v0", tmp_path).storage.metadata["author"] == {"Ada", "Ben"}
    # And once more, without the first one's.
    copy_episodes(
        ["spatula/press/both-v0"], "spatula/press/d-v0", root=tmp_path, keep=lambda each: each["author"] == "Ben"
    )
    (entry,) = read_entries("spatula/press/d-v0", tmp_path)
    assert recorded_specs("spatula/press/d-v0", tmp_path)[entry.spec].kwargs["max_force"] == 0.1
    assert replay("spatula/press/d-v0", root=tmp_path)[0].matches
    slow = make(control_frequency=10.0)
    DatasetWriter("spatula/press/slow-v0", slow, root=tmp_path)
    slow.close()
    with pytest.raises(ValueError, match=r"same control frequency, got 20.0 in 'spatula/press/a-v0' and 10.0 in"):
        copy_episodes([names[0], "spatula/press/slow-v0"], "spatula/press/e-v0", root=tmp_path)


def test_a_wrapper_that_needs_pictures_gets_them_again(tmp_path) -> None:
    env = gym.wrappers.AddRenderObservation(make(render_mode="rgb_array", width=32, height=24), render_only=False)
    record_once(env, tmp_path, states=False)
    env.close()
    (spec,) = recorded_specs(PRESS, tmp_path)
    again = make_recorded(spec)
    observation, _ = again.reset(seed=0)
    assert observation["pixels"].shape == (24, 32, 3)
    again.close()
    with pytest.warns(UserWarning, match="not installed") if not _installed() else _nothing():
        recovered = open_dataset(PRESS, tmp_path).recover_environment()
    recovered.close()
    (result,) = replay(PRESS, root=tmp_path)
    assert result.matches


def test_onlookers_are_not_kept(tmp_path) -> None:
    """However a recording was watched or filmed, its environment opens no windows and makes no films."""
    pytest.importorskip("moviepy")
    made = make(render_mode="rgb_array", width=32, height=24)
    filmed = gym.wrappers.RecordVideo(made, str(tmp_path / "films"), episode_trigger=lambda _: False)
    assert storable_spec(filmed).additional_wrappers == ()
    assert differences(storable_spec(filmed), storable_spec(made)) == []
    made.close()


def test_pictures_are_of_one_size_where_they_are_seen() -> None:
    specs = []
    for width in (32, 40):
        env = gym.wrappers.AddRenderObservation(make(render_mode="rgb_array", width=width, height=24))
        specs.append(storable_spec(env))
        env.close()
    assert differences(*specs) == ["width (32 here, 40 there)"]


def test_a_window_is_not_kept() -> None:
    env = make_pictures()
    env.spec.kwargs["render_mode"] = "human"
    assert "render_mode" not in storable_spec(env).kwargs
    env.close()


def test_nothing_is_imported_for_a_datasets_sake(tmp_path, monkeypatch) -> None:
    env = make()
    writer = DatasetWriter(PRESS, env, root=tmp_path)
    env.close()
    (tmp_path / "poison.py").write_text("raise SystemError('it ran')")
    monkeypatch.syspath_prepend(str(tmp_path))
    (spec,) = recorded_specs(PRESS, tmp_path)
    spec.entry_point = "poison:Env"
    again = make_recorded(spec)
    assert type(again.unwrapped).__name__ == "PressEnv"
    again.close()
    for point, kwargs in (
        ("poison:Wrapper", {}),
        ("subprocess:Popen", {"args": ["false"]}),
        ("gymnasium.wrappers:nothing", {}),
        ("spatula_env.files:check_can_write", {"folder": "x"}),
    ):
        spec.additional_wrappers = (gym.envs.registration.WrapperSpec("Wrapper", point, kwargs),)
        with pytest.raises(ValueError, match="allow it: replay"):
            make_recorded(spec)
    spec.id = "Spatula/Poison-v0"
    with pytest.raises(ValueError, match="is not registered"):
        make_recorded(spec)
    # Nor when episodes are added.
    metadata = writer.path / "data" / "metadata.json"
    metadata.write_text(metadata.read_text().replace("spatula_env.envs.press:PressEnv", "poison:Env"))
    env = make()
    record_once(env, tmp_path)
    env.close()
    assert replay(PRESS, root=tmp_path)[0].matches


def _installed() -> bool:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return bool(version("spatula-env"))
    except PackageNotFoundError:
        return False


def _nothing():
    from contextlib import nullcontext

    return nullcontext()
