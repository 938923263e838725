"""Saved policies from untrusted sources: no code in their files is run; runs of earlier versions can be converted."""

from __future__ import annotations

import base64
import io
import json
import pickle
import random
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from training_helpers import write_small

torch = pytest.importorskip("torch", reason="pip install 'spatula-env[train]'")
pytest.importorskip("stable_baselines3", reason="pip install 'spatula-env[train]'")

from spatula_env.cli.main import main  # noqa: E402
from spatula_env.learning import storage  # noqa: E402 - needs what is optional
from spatula_env.learning.commands import convert  # noqa: E402 - needs what is optional
from spatula_env.learning.configuration import read_training  # noqa: E402
from spatula_env.learning.models import make_model  # noqa: E402
from spatula_env.learning.saving import (  # noqa: E402
    load_model,
    load_normalizer,
    load_policy,
    restore_checkpoint,
    save_checkpoint,
    save_policy,
)
from spatula_env.learning.worlds import make_training_env  # noqa: E402

# What is meddled with does not say which definition of its task it is of.
pytestmark = pytest.mark.filterwarnings("ignore::spatula_env.definitions.DefinitionWarning")

PRESS = "Spatula/Press-v0"


class Bomb:
    """Makes a file when it is unpickled."""

    def __init__(self, file: Path):
        self.file = str(file)

    def __reduce__(self):
        return (open, (self.file, "w"))


@pytest.fixture(scope="module", params=["sac", "ppo", "sac_her", "tqc"])
def trained(request, tmp_path_factory):
    """The folder of a policy and that of a checkpoint."""
    if request.param == "tqc":
        pytest.importorskip("sb3_contrib", reason="pip install 'spatula-env[train]'")
    place = tmp_path_factory.mktemp(request.param)
    config = read_training(write_small(place / "config.yaml", request.param))
    env, _ = make_training_env(config, 0, 0.9)
    model = make_model(config, env, 0)
    model.learn(40)
    # The estimates stay as they are.
    env.training = False
    save_policy(place / "run" / "seed-0" / "policy", model, env, config)
    checkpoint = save_checkpoint(place / "run" / "seed-0" / "checkpoints", model, env, config, {"best": np.float64(1)})
    yield place / "run" / "seed-0", checkpoint, config, env, model
    env.close()


@pytest.fixture
def bomb(tmp_path):
    """Whose file is there if it went off."""
    file = tmp_path / "it-ran"
    # That it works is seen first.
    pickle.loads(pickle.dumps(Bomb(file))).close()
    file.unlink()
    yield Bomb(file)
    assert not file.exists()


def rewrite(archive: Path, change) -> None:
    """Change the members of a zip file."""
    with zipfile.ZipFile(archive) as before:
        members = {name: before.read(name) for name in before.namelist()}
    change(members)
    with zipfile.ZipFile(archive, "w") as after:
        for name, content in members.items():
            after.writestr(name, content)


def poison_data(folder: Path, bomb: Bomb) -> None:
    """As cloudpickle's objects stand in Stable-Baselines3's file; all of them."""

    def change(members):
        data = json.loads(members["data"])
        text = base64.b64encode(pickle.dumps(bomb)).decode()
        for name in [*data, "policy_class", "policy_kwargs", "lr_schedule", "custom"]:
            data[name] = {":type:": "<class 'x'>", ":serialized:": text}
        members["data"] = json.dumps(data).encode()

    rewrite(folder / "model.zip", change)


def poison_weights(name: str):
    def poison(folder: Path, bomb: Bomb) -> None:
        content = io.BytesIO()
        torch.save({"x": bomb}, content)

        def change(members):
            members[name] = content.getvalue()

        rewrite(folder / "model.zip", change)

    return poison


def poison_array(name: str):
    def poison(folder: Path, bomb: Bomb) -> None:
        with zipfile.ZipFile(folder / name, "w") as archive:
            for key in ("action/low", "action/high", "observation/low", "observation/high", "norm_obs", "pos"):
                content = io.BytesIO()
                np.save(content, np.array([bomb], dtype=object), allow_pickle=True)
                archive.writestr(f"{key}.npy", content.getvalue())

    return poison


def poison_pickles(folder: Path, bomb: Bomb) -> None:
    """As an earlier version's folder."""
    for name in storage.PICKLES:
        (folder / name).write_bytes(pickle.dumps(bomb))
    (folder / "spaces.npz").unlink()
    (folder / "normalizer.npz").unlink(missing_ok=True)


def poison_more_pickles(folder: Path, bomb: Bomb) -> None:
    """Beside what is read."""
    for name in storage.PICKLES:
        (folder / name).write_bytes(pickle.dumps(bomb))


def poison_config(folder: Path, bomb: Bomb) -> None:
    with (folder / "config.yaml").open("a") as file:
        file.write(f"evil: !!python/object/apply:builtins.open [{bomb.file!r}, w]\n")


def poison_id(folder: Path, bomb: Bomb) -> None:
    """A module that makes the file."""
    (folder / "poison_policy.py").write_text(f"open({bomb.file!r}, 'w').close()\n")
    file = folder / "config.yaml"
    file.write_text(file.read_text().replace(f"id: {PRESS}", "id: poison_policy:Spatula/Press-v0"))
    assert "poison_policy" in file.read_text()


POISONS = {
    "data": poison_data,
    "weights": poison_weights("policy.pth"),
    "variables": poison_weights("pytorch_variables.pth"),
    "more weights": poison_weights("other.pth"),
    "spaces": poison_array("spaces.npz"),
    "normalizer": poison_array("normalizer.npz"),
    "buffer": poison_array("buffer.npz"),
    "pickles": poison_pickles,
    "more pickles": poison_more_pickles,
    "config": poison_config,
    "id": poison_id,
}


@pytest.fixture
def copied(trained, tmp_path):
    """A copy of the run, to be poisoned."""
    shutil.copytree(trained[0], tmp_path / "seed-0")
    return tmp_path / "seed-0"


@pytest.mark.parametrize("poison", list(POISONS))
def test_no_function_runs_what_a_policy_holds(trained, copied, bomb, poison, monkeypatch):
    _, checkpoint, config, env, _ = trained
    place = copied / "checkpoints" / checkpoint.name
    monkeypatch.chdir(place)
    monkeypatch.syspath_prepend(place)
    POISONS[poison](place, bomb)

    def go_on():
        restore_checkpoint(place, load_model(place, config, env))

    for call in (
        lambda: load_model(place, config),
        lambda: load_normalizer(place),
        lambda: load_policy(place, env.unwrapped if hasattr(env, "unwrapped") else env),
        lambda: storage.read_steps(place),
        go_on,
    ):
        try:
            call()
        except (AttributeError, FileNotFoundError, ValueError) as error:
            assert str(error)


@pytest.mark.parametrize("trained", ["sac"], indirect=True)
@pytest.mark.parametrize("poison", list(POISONS))
def test_no_command_runs_what_a_policy_holds(copied, bomb, poison, tmp_path, monkeypatch, capsys):
    policy = copied / "policy"
    for place in (policy, *(copied / "checkpoints").iterdir()):
        POISONS[poison](place, bomb)
    monkeypatch.chdir(policy)
    monkeypatch.syspath_prepend(policy)
    path, few = str(policy), ["--set", "max_episode_steps=2"]
    for words in (
        ["evaluate", "--env", PRESS, "--policy", path, "--episodes", "1", *few],
        ["view", "press", "--policy", path, "--steps", "1", "--output", str(tmp_path / "x.png"), *few],
        ["play", "press", "--device", "scripted", "--policy", path, "--view", "none", "--no-wait", "--engine", "batch",
         "--episodes", "1", *few],
        ["export", path, str(tmp_path / "x.npz")],
        ["train", "--resume", str(copied), "--set", "total_steps=40"],
    ):  # fmt: skip
        assert main(words) in (0, 1), words
    assert "Traceback" not in capsys.readouterr().err


def test_what_is_saved_acts_as_the_model_did(trained):
    seed, checkpoint, config, env, model = trained
    observation = env.reset()
    expected = model.predict(observation, deterministic=True)[0]
    for place in (seed / "policy", checkpoint):
        again, normalizer = load_model(place, config), load_normalizer(place)
        np.testing.assert_array_equal(again.predict(observation, deterministic=True)[0], expected)
        assert again.observation_space == model.observation_space and again.action_space == model.action_space
        raw = env.get_original_obs()
        for one, other in zip(_flat(normalizer.normalize_obs(raw)), _flat(env.normalize_obs(raw)), strict=True):
            np.testing.assert_array_equal(one, other)
        assert storage.read_steps(place) == model.num_timesteps == 40
        assert not [file for file in place.rglob("*") if file.suffix == ".pkl"]


def test_a_checkpoint_has_all_that_training_goes_on_with(trained):
    _, checkpoint, config, env, model = trained
    again = load_model(checkpoint, config, env)
    assert restore_checkpoint(checkpoint, again) == {"best": 1.0}
    for name in (*storage.COUNTERS, "action_space"):
        assert getattr(again, name, None) == getattr(model, name, None)
    _, variables = model._get_torch_save_params()
    before, after = model.get_parameters(), again.get_parameters()
    assert _tensors(after) and len(_tensors(after)) == len(_tensors(before))
    for one, other in zip(_tensors(after), _tensors(before), strict=True):
        assert torch.equal(one, other)
    for name in variables:
        assert torch.equal(getattr(again, name), getattr(model, name))
    if config.algorithm != "ppo":
        one, other = (storage.buffer_arrays(each.replay_buffer) for each in (again, model))
        assert set(one) == set(other)
        for name in one:
            np.testing.assert_array_equal(one[name], other[name])
        assert one["pos"] > 0


@pytest.mark.parametrize("trained", ["sac"], indirect=True)
def test_what_does_not_fit_is_said(trained, copied):
    _, checkpoint, config, env, _ = trained
    place = copied / "checkpoints" / checkpoint.name
    other = read_training(copied / "policy" / "config.yaml", ["network.layers=[8]"])
    with pytest.raises(ValueError, match="does not fit its configuration"):
        load_model(place, other)
    other = read_training(copied / "policy" / "config.yaml", ["hyperparameters.buffer_size=100"])
    with pytest.raises(ValueError, match=r"buffer.npz does not fit: observations must be"):
        restore_checkpoint(place, load_model(place, other, env))
    (place / "model.zip").write_bytes(b"no archive")
    with pytest.raises(ValueError, match="holds more than weights, or is damaged"):
        load_model(place, config)


def as_before(place: Path, model, env) -> None:
    """A checkpoint as an earlier version wrote it."""
    for name in ("spaces.npz", "normalizer.npz", "buffer.npz", "state.json"):
        (place / name).unlink(missing_ok=True)
    env.save(str(place / "normalizer.pkl"))
    if hasattr(model, "replay_buffer"):
        model.save_replay_buffer(place / "buffer.pkl")
    state = {
        "progress": {"best": [0.5, np.float64(-2.0)]},
        "torch": torch.get_rng_state(),
        "numpy": np.random.get_state(),  # noqa: NPY002 - what is kept
        "python": random.getstate(),
        "action_space": model.action_space,
    }
    (place / "state.pkl").write_bytes(pickle.dumps(state))


def test_a_run_of_an_earlier_version_is_converted(trained, copied, capsys, monkeypatch):
    _, checkpoint, config, env, model = trained
    place = copied / "checkpoints" / checkpoint.name
    as_before(place, model, env)
    expected = [random.random(), torch.rand(2).tolist()]
    with pytest.raises(ValueError, match=r"earlier version, as pickles, which run whatever they hold.*spatula convert"):
        load_model(place, config)
    monkeypatch.setattr("sys.stdin", io.StringIO("no\n"))
    assert convert.main([str(copied)]) == 1
    assert "nothing was read" in capsys.readouterr().err
    monkeypatch.setattr("sys.stdin", io.StringIO("yes\n"))
    assert convert.main([str(copied)]) == 0
    assert sorted(file.suffix for file in place.iterdir() if file.suffix == ".pkl") == []
    again = load_model(place, config, env)
    assert restore_checkpoint(place, again) == {"best": [0.5, -2.0]}
    assert [random.random(), torch.rand(2).tolist()] == expected
    normalizer = load_normalizer(place)
    raw = env.get_original_obs()
    for one, other in zip(_flat(normalizer.normalize_obs(raw)), _flat(env.normalize_obs(raw)), strict=True):
        np.testing.assert_array_equal(one, other)
    if config.algorithm != "ppo":
        one, other = (storage.buffer_arrays(each.replay_buffer) for each in (again, model))
        for name in other:
            np.testing.assert_array_equal(one[name], other[name])
    capsys.readouterr()
    assert convert.main([str(copied)]) == 0
    assert capsys.readouterr().out == "nothing to convert\n"
    assert convert.main([str(copied / "missing")]) == 1


def _flat(observation):
    return list(observation.values()) if isinstance(observation, dict) else [observation]


def _tensors(value):
    if isinstance(value, torch.Tensor):
        return [value]
    if isinstance(value, dict):
        return [each for key in value for each in _tensors(value[key])]
    if isinstance(value, list | tuple):
        return [each for one in value for each in _tensors(one)]
    return []
