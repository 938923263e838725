from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agents.configuration import make_environment, read_environment

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
