"""Policies and datasets carry the version of their task's definition, and those of another version are recognised."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("minari")

from recording_helpers import do_episode

from spatula_env.data import DatasetWriter, replay
from spatula_env.data.dataset import read_layout
from spatula_env.data.index import SPECS
from spatula_env.data.layout import KEY
from spatula_env.definitions import DefinitionWarning, definition_number, present_options
from spatula_env.policies.exported import warn_of_definition

PALPATE = "Spatula/Palpate-v0"
ID = "spatula/test/definitions-v0"


def test_every_task_of_the_package_has_its_second_definition() -> None:
    for name in ("Press", "Retract", "Fissure", "Clamp", "Palpate"):
        assert definition_number(f"Spatula/{name}-v0") == 2
    assert definition_number("CartPole-v1") == definition_number("Nobody/Knows-v0") == 1


@pytest.mark.parametrize(
    ("number", "options", "present"),
    [
        (1, {}, {"control": "velocity_level"}),
        (1, {"control": "velocity", "max_speed": 0.02}, {"control": "velocity_level", "max_speed": 0.02}),
        (1, {"control": "velocity_6d"}, {"control": "velocity_6d"}),
        (2, {}, {}),
        (2, {"control": "velocity"}, {"control": "velocity"}),
    ],
)
def test_options_are_called_what_they_mean_now(number: int, options: dict[str, Any], present: dict[str, Any]) -> None:
    assert present_options(PALPATE, number, options) == present
    assert present_options("Spatula/Press-v0", number, options) == options


@pytest.mark.parametrize(("metadata", "told"), [({}, True), ({"definition": 1}, True), ({"definition": 2}, False)])
def test_a_policy_of_another_definition_is_told(metadata: dict[str, Any], told: bool) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_definition({"env_id": PALPATE, **metadata})
    assert [each.category for each in caught] == [DefinitionWarning] * told
    if told:
        assert "is of definition 1 of Spatula/Palpate-v0, which has definition 2 now" in str(caught[0].message)
    warn_of_definition({})


def recorded(root: Path, *, formerly: bool) -> None:
    """A dataset of palpation with a level plate, as it was written with the first definition, or is now."""
    env = gym.make(PALPATE, engine="batch", max_episode_steps=6, control="velocity_level")
    writer = DatasetWriter(ID, env, root=root)
    writer.add(do_episode(env, 0))
    env.close()
    (file,) = root.rglob("metadata.json")
    metadata = json.loads(file.read_text())
    assert metadata[KEY]["definition"] == 2
    if formerly:
        del metadata[KEY]["definition"]
        spec = json.loads(metadata["env_spec"])
        # As it was called then.
        spec["kwargs"].pop("control")
        metadata["env_spec"] = json.dumps(spec)
        metadata[KEY][SPECS] = [metadata["env_spec"]]
        file.write_text(json.dumps(metadata))


def test_a_dataset_of_the_first_definition_repeats_its_physics(tmp_path: Path) -> None:
    recorded(tmp_path, formerly=True)
    assert read_layout(ID, tmp_path).definition == 1
    with pytest.warns(DefinitionWarning, match=f"^dataset '{ID}' is of definition 1 of {PALPATE}"):
        (result,) = replay(ID, root=tmp_path)
    assert result.steps == 6
    assert result.difference == 0.0


def test_a_dataset_of_the_present_definition_is_replayed_without_a_word(tmp_path: Path) -> None:
    recorded(tmp_path, formerly=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DefinitionWarning)
        (result,) = replay(ID, root=tmp_path)
    assert result.matches
    assert np.isfinite(result.reward_difference)
