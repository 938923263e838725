"""Statements in the environments' docstrings are true."""

from __future__ import annotations

import inspect
import re
from dataclasses import fields
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.registration import load_env_creator

import spatula_env
from spatula_env.envs import SpatulaEnv, SpatulaVectorEnv
from spatula_env.envs.observations import LEROBOT_KEYS
from spatula_env.envs.randomization import DEFAULT_RANGES, NEUTRAL
from spatula_env.envs.settings import EnvSettings

IDS = tuple(f"Spatula/{name}-v0" for name in spatula_env.TASKS)
SECTIONS = (
    "Description",
    "Action Space",
    "Observation Space",
    "Rewards",
    "Starting State",
    "Episode End",
    "Info",
    "Arguments",
    "Version History",
)

OWN_ORGAN = "An Organ of One's Own"
"""A section of tasks that can be set on an organ from a file; it is before the arguments."""


def read_tables(text: str) -> dict[str, list[dict[str, str]]]:
    """The tables of a docstring in Markdown, by the heading of their first column's neighbour."""
    tables: dict[str, list[dict[str, str]]] = {}
    for block in re.findall(r"(?:^ *\|.*\n)+", text, flags=re.MULTILINE):
        rows = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in block.splitlines()]
        tables[rows[0][1]] = [dict(zip(rows[0], row, strict=True)) for row in rows[2:]]
    return tables


def section(text: str, name: str) -> str:
    return text.partition(f"## {name}\n")[2].partition("\n## ")[0]


# Cleaned, because from Python 3.13 on the compiler removes the indentation of docstrings.
COMMON = read_tables(inspect.cleandoc(SpatulaEnv.__doc__ or ""))


@pytest.fixture(scope="module", params=IDS)
def env(request: pytest.FixtureRequest) -> Any:
    made = gym.make(request.param, engine="batch").unwrapped
    yield made
    made.close()


@pytest.fixture
def doc(env: Any) -> str:
    return inspect.cleandoc(type(env).__doc__ or "")


@pytest.fixture
def tables(doc: str) -> dict[str, list[dict[str, str]]]:
    return read_tables(doc)


def test_all_sections_are_there(env: Any, doc: str) -> None:
    own = [] if env.definition.own_organ is None else [OWN_ORGAN]
    last = len(SECTIONS) - 2
    wanted = [*SECTIONS[:last], *own, *SECTIONS[last:]]
    assert re.findall(r"^## (.*)$", doc, flags=re.MULTILINE) == wanted


def test_the_documented_observations_are_those_of_the_space(env: Any, doc: str, tables: Any) -> None:
    space, builder = env.observation_space, env.observation_builder
    assert isinstance(space, spaces.Box)
    units = {part.name: part.unit for part in builder.parts}
    following = 0
    for row in tables["Observation"]:
        first, _, last = row["Num"].partition("-")
        assert int(first) == following
        following = int(last or first) + 1
        numbers = slice(int(first), following)
        width = following - int(first)
        assert space.low[numbers] == pytest.approx(np.full(width, float(row["Min"])), rel=1e-4, abs=1e-9), row
        assert space.high[numbers] == pytest.approx(np.full(width, float(row["Max"])), rel=1e-4, abs=1e-9), row
        part = builder.slices[row["Name"]]
        assert part.start <= int(first) < following <= part.stop, row
        assert row["Unit"] in units[row["Name"]], row
    assert following == space.shape[0]
    assert f"`Box(({following},), float32)`" in doc


def test_the_documented_actions_are_those_of_the_space(env: Any, doc: str, tables: Any) -> None:
    space = env.action_space
    assert [int(row["Num"]) for row in tables["Action"]] == list(range(space.shape[0]))
    assert [float(row["Min"]) for row in tables["Action"]] == space.low.tolist()
    assert [float(row["Max"]) for row in tables["Action"]] == space.high.tolist()
    assert tuple(row["Name"] for row in tables["Action"]) == env.control.names
    greatest = {"velocity": "max_speed", "rotation": "max_rotation_rate", "jaw": "max_jaw_speed"}
    for row, unit in zip(tables["Action"], env.control.units, strict=True):
        option = greatest[row["Name"].partition("_")[0]]
        name, value, told = re.fullmatch(r"`(\w+)` \(([\d.]+) (.+)\)", row["Unit"]).groups()
        assert (name, float(value), told) == (option, getattr(env.settings, option), unit)
    assert f"`Box(-1, 1, ({space.shape[0]},), float32)`" in doc


def test_the_documented_weights_are_the_defaults(env: Any, tables: Any) -> None:
    documented = {row["Name"]: float(row["Weight"]) for row in tables["Weight"]}
    assert documented == vars(env.settings.task.weights)


def test_the_documented_info_is_what_there_is(env: Any, doc: str) -> None:
    info = env.reset(seed=0)[1]
    common = {name for row in COMMON["Meaning"] for name in re.findall(r"`([^`]+)`", row["Key"])}
    assert {"reward/<name>", "randomization/<name>"} <= common
    told = set(re.findall(r"`([a-z_]+)`", section(doc, "Info"))) - {"reset", "step", *vars(env.settings)}
    named = {name for name in info if not name.startswith("reward/")}
    assert told - common == named - common
    assert common - named == {"reward/<name>", "randomization/<name>"}


def test_the_documented_arguments_are_the_options(env: Any, doc: str, tables: Any) -> None:
    documented = {row["Parameter"].strip("`"): row["Default"].strip("`") for row in COMMON["Type"]}
    assert documented == {each.name: shown(each.default) for each in fields(EnvSettings)}
    parameters = inspect.signature(type(env)).parameters
    defaults = {name: shown(parameter.default) for name, parameter in parameters.items()}
    own = {row["Parameter"].strip("`"): row["Default"].strip("`") for row in tables.get("Type", [])}
    assert {**documented, **own} == defaults
    assert set(own) >= set(type(env).definition.defaults)
    assert f"`{type(env).definition.config.__name__}`" in section(doc, "Arguments")


def test_vector_environments_take_the_same_arguments(env: Any) -> None:
    many = load_env_creator(env.spec.vector_entry_point)
    assert issubclass(many, SpatulaVectorEnv)
    one, more = dict(inspect.signature(type(env)).parameters), dict(inspect.signature(many).parameters)
    assert set(more) - set(one) == {"num_envs", "max_episode_steps", "autoreset_mode"}
    for name, parameter in one.items():
        assert more[name].default == ("batch" if name == "engine" else parameter.default)


def test_the_documented_ranges_are_the_defaults() -> None:
    rows = {row["Name"].strip("`"): row["Default range"] for row in COMMON["Default range"]}
    assert set(rows) == set(NEUTRAL)
    for name, told in rows.items():
        if name in DEFAULT_RANGES:
            assert tuple(float(number) for number in told.split(" to ")) == DEFAULT_RANGES[name]
        else:
            assert told == "not varied"


def test_the_documented_names_are_those_of_lerobot() -> None:
    told = {}
    for row in COMMON["LeRobot"]:
        for entry in re.findall(r"`(\w+)`", row["Entry"]):
            told[entry] = row["LeRobot"].strip("`").replace("<name>", entry)
    for entry, name in told.items():
        assert LEROBOT_KEYS[entry] == name


def shown(value: Any) -> str:
    return repr(value).replace("'", '"')
