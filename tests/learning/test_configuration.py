from __future__ import annotations

from pathlib import Path

import gymnasium
import numpy as np
import pytest
import yaml

from spatula_env.changes import with_changes
from spatula_env.learning.configuration import (
    ALGORITHMS,
    find_config,
    make_environment,
    read_environment,
    read_training,
    training_from_mapping,
    write_training,
)
from spatula_env.policies import PartSelection

CONFIGS = Path(__file__).parents[2] / "configs"


def test_the_press_configuration_makes_the_environment():
    env = make_environment(CONFIGS / "press.yaml", obs_mode="dict")
    observation, _ = env.reset(seed=0)
    assert env.spec.id == "Spatula/Press-v0"
    assert isinstance(observation, dict)
    env.step(np.zeros(3, dtype=np.float32))
    env.close()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id: Spatula/Press-v0\nseed: 3\n", r"unknown keys \['seed'\].*allowed are \['id', 'kwargs'\]"),
        ("kwargs: {}\n", "id, got None"),
        ("- 1\n- 2\n", r"mapping.*got \[1, 2\]"),
        ("id: Spatula/Press-v0\nkwargs: [1]\n", r"kwargs must be a mapping.*\[1\]"),
        ("id: [unclosed\n", "not YAML"),
        ("", "got None"),
    ],
)
def test_bad_configurations_say_what_is_wrong(tmp_path, text, message):
    file = tmp_path / "bad.yaml"
    file.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_environment(file)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.yaml"):
        read_environment(tmp_path / "none.yaml")


def test_unknown_options_are_refused_by_the_environment(tmp_path):
    file = tmp_path / "odd.yaml"
    file.write_text("id: Spatula/Press-v0\nkwargs: {obs_mode: sound}\n")
    with pytest.raises(ValueError, match=r"obs_mode.*sound"):
        make_environment(file)


TRAINING = sorted(file for file in CONFIGS.glob("*_*.yaml") if not file.name.startswith("rllib_"))

SMALL = {"environment": {"id": "Spatula/Press-v0"}, "algorithm": "sac"}


@pytest.mark.parametrize("file", TRAINING, ids=lambda file: file.stem)
def test_configurations_for_training_are_read_and_name_their_algorithm(file):
    config = read_training(file)
    task, _, algorithm = file.stem.partition("_")
    assert config.environment.id == f"Spatula/{task.capitalize()}-v0"
    assert config.algorithm == algorithm
    assert type(config.hyperparameters) is ALGORITHMS[algorithm]
    env = gymnasium.make_vec(config.environment.id, num_envs=1, **config.environment.kwargs)
    selection = PartSelection.of(env, config.environment.parts)
    if selection is not None:
        assert set(selection.parts) == set(config.environment.parts)
    env.close()


def test_there_is_a_configuration_for_each_task():
    assert {file.stem.partition("_")[0] for file in TRAINING} == {"press", "retract", "fissure", "clamp", "palpate"}


def test_what_is_written_is_read_as_it_was(tmp_path):
    config = training_from_mapping({**SMALL, "seeds": [3, 1], "hyperparameters": {"gamma": 0.9}})
    write_training(config, tmp_path / "config.yaml")
    assert read_training(tmp_path / "config.yaml") == config
    assert config.seeds == (3, 1)
    assert config.hyperparameters.gamma == 0.9


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"sed": [1]}, r"unknown keys \['sed'\].*allowed are \[.*'seeds'.*\]"),
        ({"hyperparameters": {"gama": 0.9}}, r"hyperparameters has unknown keys \['gama'\].*'gamma'"),
        ({"hyperparameters": {"n_steps": 3}}, r"hyperparameters has unknown keys \['n_steps'\]"),
        ({"environment": {"id": "Spatula/Press-v0", "num_env": 3}}, r"environment has unknown keys.*'num_envs'"),
        ({"environment": {}}, r"environment lacks the keys \['id'\]"),
        ({"environment": {"id": "Spatula/Press-v0", "engine": "boolet"}}, r"environment.engine.*'boolet'"),
        ({"environment": {"id": "Spatula/Press-v0", "kwargs": {"engine": "batch"}}}, "key of environment itself"),
        ({"algorithm": "dqn"}, r"algorithm must be one of \['ppo', 'sac', 'sac_her', 'tqc'\], got 'dqn'"),
        ({"algorithm": "sac_her"}, "reward must be 'sparse'"),
        ({"algorithm": "ppo", "demonstrations": 5}, "demonstrations must be 0"),
        ({"clone_steps": 5}, "clone_steps must be 0 without demonstrations, got 5"),
        ({"demonstration_share": 1.5}, r"demonstration_share must be in \[0, 1\], got 1.5"),
        ({"demonstration_noise": "much"}, "demonstration_noise must be a number from 0 on or 'auto', got 'much'"),
        ({"demonstrations": 4, "imitation_weight": 2}, "imitation_weight must be 0 unless demonstration_share"),
        ({"demonstrations": 4, "demonstration_share": 0.5, "imitation_weight": -1}, "a number from 0 on, got -1"),
        ({"actor_starts": 5}, "actor_starts must be 0 without demonstrations, got 5"),
        ({"total_steps": 0}, "total_steps must be 1 or more, got 0"),
        ({"total_steps": "many"}, "total_steps must be an integer, got 'many'"),
        ({"total_steps": 1.5}, "total_steps must be an integer, got 1.5"),
        ({"overlap": 1}, "overlap must be true or false, got 1"),
        ({"seeds": 3}, "seeds must be a list, got 3"),
        ({"seeds": [1, 1]}, "seeds must be different"),
        ({"network": {"layers": [0]}}, "network.layers must be 1 or more, got 0"),
        ({"normalization": {"clip": -1}}, "normalization.clip must be positive"),
        ({"hyperparameters": {"gamma": True}}, "hyperparameters.gamma must be a number, got True"),
        ({"hyperparameters": {"ent_coef": "much"}}, "ent_coef must be a number, 'auto'"),
    ],
)
def test_bad_configurations_for_training_say_what_is_wrong(content, message):
    with pytest.raises(ValueError, match=message):
        training_from_mapping({**SMALL, **content})


def test_changes_replace_what_the_file_says(tmp_path):
    file = tmp_path / "press_sac.yaml"
    file.write_text(yaml.safe_dump(SMALL))
    changes = ["hyperparameters.learning_rate=3e-4", "network.layers=[8, 9]", "total_steps=5e3", "success_target=null"]
    config = read_training(file, changes)
    assert config.hyperparameters.learning_rate == 3e-4
    assert config.network.layers == (8, 9)
    assert config.total_steps == 5000
    assert config.success_target is None
    assert config.environment.id == "Spatula/Press-v0"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("gamma", "KEY=VALUE"),
        ("=3", "KEY=VALUE"),
        ("a..b=3", "KEY=VALUE"),
        ("seeds=[1", "not YAML"),
        ("hyperparameters.gama=3", "unknown keys"),
    ],
)
def test_bad_changes_say_what_is_wrong(tmp_path, change, message):
    file = tmp_path / "press_sac.yaml"
    file.write_text(yaml.safe_dump(SMALL))
    with pytest.raises(ValueError, match=message):
        read_training(file, [change])


def test_changes_leave_the_mapping_as_it_was():
    content = {"a": {"b": 1, "c": 2}}
    assert with_changes(content, ["a.b=3", "d.e=4"]) == {"a": {"b": 3, "c": 2}, "d": {"e": 4}}
    assert content == {"a": {"b": 1, "c": 2}}


def test_only_configurations_of_the_kind_that_is_wanted_are_offered():
    offered = {}
    for holds in ("algorithm", "tasks", "env_runners"):
        with pytest.raises(FileNotFoundError, match=r"config must be a file or one of .*: no knead") as caught:
            find_config("knead", holds)
        offered[holds] = str(caught.value).partition("one of ")[2].rpartition(":")[0].split(", ")
    assert offered["tasks"] == ["results"] and offered["env_runners"] == ["rllib_press"]
    assert "press_sac" in offered["algorithm"]
    for name in offered["algorithm"]:
        read_training(find_config(name))


def test_broken_yaml_names_its_file_and_line(tmp_path):
    file = tmp_path / "broken.yaml"
    file.write_text("algorithm: sac\nenvironment:\n  id: [press\nseeds: 3\n")
    with pytest.raises(ValueError, match=r"broken\.yaml, line 4, column \d+: this is not YAML"):
        read_training(file)
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match=r"broken\.yaml.*this is not YAML"):
        read_training(file)


@pytest.mark.parametrize(
    ("text", "line"),
    [("algorithm: sac\nseeds: 3\nalgorithm: tqc\n", 3), ("environment: {id: press, id: clamp}\nalgorithm: sac\n", 1)],
)
def test_a_key_that_is_told_twice_names_its_file_and_line(text, line, tmp_path):
    file = tmp_path / "twice.yaml"
    file.write_text(text)
    with pytest.raises(ValueError, match=rf"twice\.yaml, line {line}, .*the key '(algorithm|id)' is there twice"):
        read_training(file)


def test_only_parts_that_there_are_can_be_chosen():
    env = gymnasium.make_vec("Spatula/Press-v0", num_envs=2)
    observation, _ = env.reset(seed=0)
    selection = PartSelection.of(env, ["error", "tool_position"])
    slices = env.unwrapped.observation_builder.slices
    expected = np.concatenate([observation[:, slices["tool_position"]], observation[:, slices["error"]]], axis=1)
    np.testing.assert_array_equal(selection(observation), expected)
    assert selection.space(env.single_observation_space).contains(selection(observation)[0])
    assert PartSelection.of(env, None) is None
    with pytest.raises(ValueError, match=r"no parts \['smell'\].*'landmarks'"):
        PartSelection.of(env, ["smell"])
    env.close()
    env = gymnasium.make_vec("Spatula/Press-v0", num_envs=1, obs_mode="dict")
    with pytest.raises(ValueError, match="obs_mode='state'"):
        PartSelection.of(env, ["error"])
    env.close()
