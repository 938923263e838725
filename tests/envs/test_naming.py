"""Names of environments, and which modules are imported for them."""

from __future__ import annotations

import sys

import gymnasium
import numpy as np
import pytest

from spatula_env.naming import (
    bare_id,
    find_environment,
    registered_id,
    same_environment,
    task_name,
    vector_spec,
)


@pytest.mark.parametrize("text", ["press", "Press", "press-v0", "Spatula/Press-v0", "spatula_env:Spatula/Press-v0"])
def test_this_package_has_short_names(text):
    assert find_environment(text) == "Spatula/Press-v0"


def test_a_module_that_is_named_is_imported(own_press):
    assert own_press not in sys.modules
    assert find_environment(f"{own_press}:Mine/Press-v0") == f"{own_press}:Mine/Press-v0"
    assert own_press in sys.modules
    # Registered now, it needs its module no more.
    assert find_environment("Mine/Press-v0") == "Mine/Press-v0"


def test_a_module_in_the_working_directory_is_found(own_press, tmp_path, monkeypatch):
    # As for the installed command, whose path does not begin with the working directory.
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [each for each in sys.path if each not in ("", str(tmp_path))])
    assert find_environment(f"{own_press}:Mine/Press-v0") == f"{own_press}:Mine/Press-v0"


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("knead", ValueError, "there is no environment 'knead'; there are Spatula/Clamp-v0"),
        ("no_such_module:Mine/Press-v0", ImportError, "names a module that cannot be imported.*no_such_module"),
        ("own_press:Mine/Knead-v0", ValueError, "own_press registers no 'Mine/Knead-v0'"),
        ("..:x", ValueError, "must be ID or MODULE:ID"),
        ("CartPole-v1", ValueError, "CartPole-v1 must be an environment of this package or built on it"),
    ],
)
def test_what_cannot_be_found_is_said(own_press, text, error, message):
    with pytest.raises(error, match=message):
        find_environment(text)


def test_a_file_imports_nothing(own_press):
    with pytest.raises(ValueError, match=r"no module is imported because a file names it.*own_press:Mine/Press-v0"):
        registered_id(f"{own_press}:Mine/Press-v0")
    assert own_press not in sys.modules
    assert registered_id(f"{own_press}:Mine/Press-v0", f"{own_press}:Mine/Press-v0") == f"{own_press}:Mine/Press-v0"
    assert registered_id(f"{own_press}:Mine/Press-v0") == "Mine/Press-v0"
    assert registered_id("Spatula/Press-v0", "press") == "Spatula/Press-v0"
    with pytest.raises(ValueError, match="is Mine/Press-v0, not Spatula/Press-v0"):
        registered_id("Mine/Press-v0", "press")


def test_ids_are_compared_without_modules():
    assert bare_id("touch:Spatula/Touch-v0") == "Spatula/Touch-v0"
    assert same_environment("touch:Spatula/Touch-v0", "Spatula/Touch-v0")
    assert not same_environment("Spatula/Touch-v0", "Spatula/Press-v0")
    assert [task_name(each) for each in ("touch:Spatula/Touch-v0", "Spatula/Press-v0", "Knead-v3")] == [
        "touch", "press", "knead",
    ]  # fmt: skip


def test_many_worlds_are_made_of_one_definition(own_press):
    find_environment(f"{own_press}:Mine/Alone-v0")
    one = gymnasium.make_vec(vector_spec("Mine/Alone-v0"), num_envs=2, max_episode_steps=7)
    other = gymnasium.make_vec("Spatula/Press-v0", num_envs=2, max_episode_steps=7)
    np.testing.assert_array_equal(one.reset(seed=3)[0], other.reset(seed=3)[0])
    assert one.unwrapped.max_episode_steps == 7
    one.close()
    other.close()
    with pytest.raises(ValueError, match=r"MoreEnv does more than its definition says \(step\)"):
        vector_spec("Mine/More-v0")
    with pytest.raises(ValueError, match="must be an environment of this package or built on it"):
        vector_spec("CartPole-v1")
