"""Datasets from untrusted sources: what they name is neither imported nor made, and what they link to is not read."""

from __future__ import annotations

import json
import os
import shutil
import sys

import gymnasium as gym
import numpy as np
import pytest

import spatula_env
from spatula_env.cli.main import main
from spatula_env.data import catalog
from spatula_env.data.dataset import dataset_folder, read_layout
from spatula_env.data.index import DatasetDamaged
from spatula_env.data.replaying import open_dataset, recorded_specs, recorded_states, replay
from spatula_env.data.statistics import statistics

gym.register_envs(spatula_env)

h5py = pytest.importorskip("h5py", reason="pip install 'spatula-env[data]'")
pytest.importorskip("minari", reason="pip install 'spatula-env[data]'")

ID = "spatula/press/poisoned-v0"


@pytest.fixture(scope="module")
def harmless(tmp_path_factory):
    """A dataset with one short episode."""
    from spatula_env.data.dataset import DatasetWriter
    from spatula_env.data.episode import EpisodeRecorder

    root = tmp_path_factory.mktemp("datasets")
    env = gym.make("Spatula/Press-v0", engine="batch", max_episode_steps=3)
    recorder = EpisodeRecorder(env)
    recorder.begin(*env.reset(seed=0), 0)
    ended = False
    while not ended:
        action = np.zeros(3, dtype=np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        recorder.add(action, observation, reward, terminated, truncated, info)
        ended = terminated or truncated
    DatasetWriter(ID, env, root=root).add(recorder.finish(operator="scripted", success=True))
    env.close()
    return root


@pytest.fixture
def root(harmless, tmp_path, monkeypatch):
    """A copy of it, and a module that tells when it is imported."""
    place = tmp_path / "datasets"
    shutil.copytree(harmless, place)
    modules = tmp_path / "modules"
    modules.mkdir()
    for name in ("poison_entry", "poison_wrapper", "poison_vector", "poison_id"):
        (modules / f"{name}.py").write_text(f"open({str(tmp_path / 'it-ran')!r}, 'w').close()\n")
    monkeypatch.syspath_prepend(modules)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(place))
    monkeypatch.chdir(modules)
    yield place
    assert not [name for name in sys.modules if name.startswith("poison_")]
    assert not (tmp_path / "it-ran").exists()


def change(root, **changes):
    """Change the stored specification; a value of None takes an entry of the metadata away."""
    file = root / ID / "data" / "metadata.json"
    metadata = json.loads(file.read_text())
    texts = [("env_spec", metadata), *((index, specs) for specs in _specs(metadata) for index in range(len(specs)))]
    for key, holder in texts:
        spec = json.loads(holder[key])
        spec.update({name: value for name, value in changes.items() if name in spec})
        holder[key] = json.dumps(spec)
    for name in ("observation_space", "action_space"):
        if name in changes:
            del metadata[name]
    file.write_text(json.dumps(metadata))


def _specs(value):
    """All lists of specifications in the metadata, wherever they are kept."""
    if isinstance(value, dict):
        for each in value.values():
            yield from _specs(each)
    elif isinstance(value, list) and value and all(isinstance(each, str) and '"entry_point"' in each for each in value):
        yield value


def wrapper(entry_point, name="Innocent", **kwargs):
    return [{"name": name, "entry_point": entry_point, "kwargs": kwargs}]


# What is meddled with is of another environment, with another definition.
pytestmark = pytest.mark.filterwarnings("ignore::spatula_env.definitions.DefinitionWarning")

POISONS = {
    "entry point": {"entry_point": "poison_entry:Env", "vector_entry_point": "poison_vector:Env"},
    "wrapper": {"additional_wrappers": wrapper("poison_wrapper:Wrapper")},
    "id": {"id": "poison_id:Spatula/Poison-v0"},
    "id and entry point": {"id": "Poison-v0", "entry_point": "poison_entry:Env"},
    "no spaces": {"observation_space": None, "entry_point": "poison_entry:Env"},
    "no actions": {"action_space": None, "entry_point": "poison_entry:Env"},
    "another maker": {"id": "GymV26Environment-v0", "kwargs": {"env_id": "poison_id:Env-v0"}},
}


@pytest.mark.parametrize("poison", list(POISONS))
def test_no_command_runs_what_a_dataset_names(root, poison, tmp_path, capsys):
    change(root, **POISONS[poison])
    weights = str(tmp_path / "clone")
    for words in (
        ["datasets", "list"],
        ["datasets", "inspect", ID],
        ["datasets", "statistics", ID],
        ["datasets", "merge", ID, "--into", "spatula/press/merged-v0"],
        ["datasets", "drop-failures", ID, "--into", "spatula/press/good-v0"],
        ["replay", ID],
        ["replay", ID, "--by", "states"],
        ["play", "press", "--device", "replay", "--recording", ID, "--view", "none", "--engine", "batch", "--no-wait"],
    ):
        # An error in words, or none: what matters is what has run, which the fixture looks for.
        assert main(words) in (0, 1), words
    from spatula_env.learning.commands.clone import main as clone

    pytest.importorskip("stable_baselines3", reason="pip install 'spatula-env[train]'")
    assert clone(["--dataset", ID, "--gradient-steps", "1", "--output", weights]) in (0, 1)
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("poison", list(POISONS))
def test_no_function_runs_what_a_dataset_names(root, poison):
    change(root, **POISONS[poison])
    for call in (
        lambda: open_dataset(ID),
        lambda: replay(ID),
        lambda: list(recorded_states(ID)),
        lambda: catalog.list_datasets(),
        lambda: catalog.summarize(ID),
        lambda: statistics(ID),
        lambda: read_layout(ID),
    ):
        try:
            call()
        except ValueError as error:
            assert str(error)


def test_what_is_registered_here_is_made_whatever_a_dataset_says(root):
    change(root, **POISONS["entry point"])
    (episode,) = replay(ID)
    assert episode.matches


def test_a_wrapper_that_films_is_left_out_by_whatever_name(root, tmp_path):
    films = tmp_path / "films"
    change(root, additional_wrappers=wrapper("gymnasium.wrappers:RecordVideo", video_folder=str(films)))
    (episode,) = replay(ID, render_mode="rgb_array")
    assert episode.matches
    assert not films.exists()


class Notes(gym.Wrapper, gym.utils.RecordConstructorArgs):
    """Writes a file, as Stable-Baselines3's Monitor does."""

    def __init__(self, env, file):
        gym.utils.RecordConstructorArgs.__init__(self, file=file)
        super().__init__(env)
        with open(file, "w"):
            pass


def test_a_wrapper_that_writes_is_made_only_if_the_caller_says_so(root, tmp_path, capsys):
    precious = tmp_path / "precious"
    precious.write_text("years of work")
    point = f"{__name__}:Notes"
    change(root, additional_wrappers=wrapper(point, file=str(precious)))
    with pytest.raises(ValueError, match=r"allow it: replay\(\.\.\., wrappers=\[THE_CLASS\]\), or --wrapper"):
        replay(ID)
    assert main(["replay", ID]) == 1
    assert f"--wrapper {point}" in capsys.readouterr().err
    assert precious.read_text() == "years of work"
    (episode,) = replay(ID, wrappers=[Notes])
    assert episode.matches
    assert precious.read_text() == ""
    precious.write_text("others")
    assert main(["replay", ID, "--wrapper", point]) == 0
    assert main(["replay", ID, "--wrapper", "json:loads"]) == 1
    assert main(["replay", ID, "--wrapper", "Notes"]) == 1


@pytest.mark.parametrize(
    "point",
    [
        "gymnasium.wrappers:TransformAction",
        "gymnasium.wrappers.transform_action:TransformAction",
        "gymnasium.utils.save_video:save_video",
        "spatula_env.cli.__main__:Anything",
        "spatula_env.teleop.wrapper:FalconTeleop",
        "gymnasium.wrappers:TimeLimit.env",
        "json:loads",
        "",
    ],
)
def test_other_wrappers_are_refused(root, point):
    change(root, additional_wrappers=wrapper(point, func="os.system"))
    with pytest.raises(ValueError, match="If you trust the dataset"):
        replay(ID)


def test_wrappers_that_write_nothing_are_made(root):
    change(root, additional_wrappers=wrapper("gymnasium.wrappers:RecordEpisodeStatistics"))
    (episode,) = replay(ID)
    assert episode.matches
    change(root, additional_wrappers=wrapper("spatula_env.envs.adapters.masa:LabelsWrapper"))
    (episode,) = replay(ID)
    assert episode.matches


NONSENSE = {
    "wrapper's entry point a number": {"additional_wrappers": wrapper(5)},
    "wrapper without an entry point": {"additional_wrappers": wrapper(None)},
    "wrapper with unknown arguments": {"additional_wrappers": wrapper("gymnasium.wrappers:TimeLimit", sense=1)},
    "wrappers a number": {"additional_wrappers": 5},
    "wrapper without a name": {"additional_wrappers": [{}]},
    "arguments a text": {"kwargs": "zzz"},
    "unknown arguments": {"kwargs": {"zzz": 1}},
    "another environment": {"id": "CartPole-v1"},
    "no id": {"id": 5},
    "a number of steps that is none": {"max_episode_steps": "many"},
    "an entry point that is none": {"entry_point": 5},
}


@pytest.mark.parametrize("name", list(NONSENSE))
def test_nonsense_of_the_environment_is_said_in_words(root, name, capsys):
    change(root, **NONSENSE[name])
    with pytest.raises(ValueError, match=r"dataset|specification|actions"):
        replay(ID)
    assert main(["replay", ID]) == 1
    assert capsys.readouterr().err.startswith("spatula replay: ")


def test_nobody_needs_the_windows_of_a_dataset(root):
    metadata = json.loads((root / ID / "data" / "metadata.json").read_text())
    change(root, kwargs={**json.loads(metadata["env_spec"])["kwargs"], "render_mode": "human"})
    (episode,) = replay(ID)
    assert episode.matches
    assert "render_mode" not in recorded_specs(ID)[0].kwargs


def test_the_reason_is_told(root):
    change(root, **POISONS["wrapper"])
    with pytest.raises(ValueError, match=r"poison_wrapper:Wrapper.*If you trust the dataset, allow it: replay"):
        replay(ID)
    change(root, additional_wrappers=[], **POISONS["id"])
    with pytest.raises(ValueError, match="no module is imported because a file names it"):
        replay(ID)


@pytest.mark.parametrize("target", ["/etc/passwd", "../../../../elsewhere.hdf5"])
def test_an_episode_that_is_no_part_of_the_dataset_is_not_read(root, target):
    with h5py.File(root / ID / "data" / "main_data.hdf5", "w") as main:
        main["episode_0"] = h5py.ExternalLink(target, "/")
    with pytest.raises(DatasetDamaged, match="no part of the dataset"):
        open_dataset(ID)


@pytest.mark.parametrize(
    "name", ["../x-v0", "a/../../x-v0", "/etc/x-v0", "./x-v0", "..", "a\\..\\x-v0", "x-v0/", "~/x-v0", "x\0-v0"]
)
def test_names_lead_nowhere_else(root, name, capsys):
    for call in (dataset_folder, open_dataset, catalog.summarize, statistics, replay, read_layout):
        with pytest.raises(ValueError, match="dataset must be named as"):
            call(name, root=root)
    assert main(["datasets", "inspect", name]) == 1
    assert "dataset must be named as" in capsys.readouterr().err


@pytest.mark.skipif(os.name != "posix", reason="links need no permission on POSIX")
def test_a_link_out_of_the_folder_is_not_followed(root, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    shutil.move(root / "spatula", tmp_path / "elsewhere" / "spatula")
    (root / "spatula").symlink_to(tmp_path / "elsewhere" / "spatula")
    with pytest.raises(ValueError, match="is a link out of"):
        open_dataset(ID)
    # All datasets together may well be elsewhere.
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    assert open_dataset(ID, root=tmp_path / "link").total_episodes == 1
